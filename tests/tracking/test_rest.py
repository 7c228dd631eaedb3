"""An object at rest and gaps in a stream: no information, any contact open, little computation and memory."""

from functools import cache

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from contact_tracker.config.loading import load_model
from contact_tracker.motion.poses import Poses
from contact_tracker.motion.tick_averaging import EMPTY_PER_TICK, EMPTY_TICKS, TickGrid
from contact_tracker.motion.window import rest_ticks
from contact_tracker.states import Contact
from contact_tracker.tracking.belief import Detail
from contact_tracker.tracking.offline_smoother import segment
from contact_tracker.tracking.transition_model import REST_EXPOSURE
from pose_filter import FilteredTick, forward
from pose_filter import after as after_tick
from short_recordings import FACE_TO_EDGE, recorded
from smooth_motion import least_jerk, with_noise

MODEL = load_model()
RATE_HZ = 200.0
MOVED = 1200
"""Frames of motion before the rest."""


def paused(seconds: float) -> Poses:
    """Motion with a rest of some seconds in the middle, with the same noise."""
    made = recorded(FACE_TO_EDGE).poses
    rng, rest, around = np.random.default_rng(0), int(seconds * RATE_HZ), slice(MOVED - 15, MOVED + 15)
    # the pose at that time, without the noise of one frame
    place, turn = (
        np.polynomial.polynomial.polyfit(np.linspace(-1.0, 1.0, 30), values[around], 3)[0]
        for values in (made.position_m, made.quat_xyzw)
    )
    position_m = place + rng.normal(size=(rest, 3)) * 3e-4
    quat_xyzw = turn + rng.normal(size=(rest, 4)) * 1e-3
    quat_xyzw /= np.linalg.norm(quat_xyzw, axis=1, keepdims=True)
    count = len(made) + rest
    return Poses(
        made.stamp_ns[0] + (np.arange(count) * 1e9 / RATE_HZ).astype(np.int64),
        np.concatenate([made.position_m[:MOVED], position_m, made.position_m[MOVED:]]),
        np.concatenate([made.quat_xyzw[:MOVED], quat_xyzw, made.quat_xyzw[MOVED:]]),
    )


@cache
def seen(seconds: float) -> list[FilteredTick]:
    return list(forward(paused(seconds), MODEL))


def still(ticks: list[FilteredTick]) -> list[int]:
    """The uninformative ticks."""
    return [i for i, one in enumerate(ticks) if not one.state.hazard_exposure and i]


REMAIN_OPEN = (Contact.FF, Contact.FE, Contact.FV)
"""What a rest leaves open beside e-f, which contains the other states, if the motion beside it shows e-f."""


def test_rest_changes_no_hypothesis_and_opens_the_belief_once():
    """Only the first ticks of a rest, before it is detected, are evaluated."""
    ticks = seen(5.0)
    waited = still(ticks)
    assert len(waited) >= 40
    for i in waited:
        before, now = ticks[i - 1], ticks[i]
        for old, new in zip(before.state.banks, now.state.banks, strict=True):
            assert new.words is old.words
        assert now.belief.contact is before.belief.contact
        assert now.belief.stamp_ns == now.tick.stamp_ns
    beliefs = [tick.belief for tick in ticks[MOVED // 20 : waited[-1] + 1]]
    opened = next(i for i, belief in enumerate(beliefs) if {*REMAIN_OPEN} <= {*belief.inseparable})
    assert rest_ticks(MODEL.tick_s) - 1 <= opened <= rest_ticks(MODEL.tick_s)
    assert all({*REMAIN_OPEN} <= {*belief.inseparable} for belief in beliefs[opened:])
    assert all({Contact.VF, Contact.FREE}.isdisjoint(belief.inseparable) for belief in beliefs[opened:])
    assert beliefs[opened].probability.max() < 0.76 < beliefs[opened - 1].probability.max()
    assert not {*REMAIN_OPEN} <= {*ticks[waited[-1] + 1].belief.inseparable}


def test_after_rest_the_belief_is_the_former_one_less_certain_by_time():
    ticks = seen(5.0)
    last = still(ticks)[-1]
    rested, next_tick = ticks[last].state, ticks[last + 1].tick
    contact = ticks[last].belief.contact

    def after(rest_s: float) -> float:
        state = rested._replace(deferred_exposure=rest_s / MODEL.tick_s * REST_EXPOSURE)
        return float(after_tick(state, next_tick)[1].probability[contact.column])

    assert after(5.0) > 0.75 * ticks[MOVED // 20 + 5].belief.probability[contact.column] > 0.5
    assert after(5.0) > after(60.0) > after(600.0)


def test_a_rest_in_the_middle_is_a_row_of_its_own_and_shows_no_further_constraint():
    """Also one that is longer than the window; the rows beside it are as without it."""
    rest_s = 40.0
    without, with_rest = (segment(paused(s), MODEL).segments for s in (0.0, rest_s))
    faces, edge, rest, on = with_rest
    assert [one.contact for one in (faces, edge)] == [one.contact for one in without]
    assert edge.contact is rest.contact is on.contact
    assert [one.inseparable for one in with_rest] == [(), (), REMAIN_OPEN, ()]
    assert rest.probability <= 0.9 < 0.95 < min(edge.probability, on.probability)
    assert rest.geometry is edge.geometry
    begins_s, lasts_s = (rest.start_ns - faces.start_ns) * 1e-9, (rest.end_ns - rest.start_ns) * 1e-9
    assert (begins_s, lasts_s) == pytest.approx((MOVED / RATE_HZ, rest_s), abs=0.15)
    longer_ns = (on.end_ns - edge.start_ns) - (without[-1].end_ns - without[-1].start_ns)
    assert longer_ns == pytest.approx(rest_s * 1e9, abs=0.3e9)


def taking_off(seed: int, vibration_m: float) -> Poses:
    """Three seconds on the floor, in the last 1.4 s of which the motors run, and three of smooth flight."""
    rng, time_s = np.random.default_rng(seed), np.arange(600) / 100.0
    flown_s = np.clip(time_s - 3.0, 0.0, None)
    share = np.clip(flown_s, 0.0, 1.0) ** 3
    wander = share[:, None] * gaussian_filter1d(rng.normal(size=(600, 6)), 40.0, axis=0) * 12.0
    position_m = np.cumsum(wander[:, :3], axis=0) * 8e-4
    position_m[:, 2] += 0.3 * flown_s * share
    runs = (time_s > 1.6)[:, None] * vibration_m
    position_m += np.hypot(4e-5, runs) * rng.normal(size=(600, 3))
    turn = np.radians(2.0) * wander[:, 3:] + np.hypot(2e-3, 10.0 * runs) * rng.normal(size=(600, 3))
    quat_xyzw = Rotation.from_rotvec(turn).as_quat()
    return Poses(np.round(time_s * 1e9).astype(np.int64), position_m, quat_xyzw)


@pytest.mark.parametrize(("seed", "vibration_m"), [(1, 0.0), (4, 1.5e-4)])
def test_a_drone_takes_off_where_its_rest_ends(seed: int, vibration_m: float) -> None:
    """While it rests and its motors run it is not said to be free, and its label is the most probable
    state."""
    segmentation = segment(taking_off(seed, vibration_m), MODEL)
    segments, beliefs = segmentation.segments, segmentation.beliefs
    assert (beliefs.probability.argmax(axis=1) == beliefs.rows["contact"]).all()
    flight = next(one for one in segments if one.end_ns > 3.5e9)
    assert flight.contact is Contact.FREE
    assert flight.start_ns * 1e-9 == pytest.approx(3.0, abs=0.3)
    assert all(len(one.inseparable) == 6 for one in segments if one.end_ns < flight.start_ns)


def test_a_lid_that_opens_after_a_rest_longer_than_the_window_is_not_surely_flat():
    """The window has forgotten that no motion has shown the face; the belief before has not."""
    rng, time_s = np.random.default_rng(3), np.arange(0.0, 31.5, 0.01)
    angle = np.radians(60.0) * least_jerk((time_s - 30.0) / 1.5)
    turn = Rotation.from_rotvec(-angle[:, None] * np.eye(3)[1])
    poses = with_noise(rng, time_s, turn.apply([0.2, 0.0, 0.0]), turn, 1e-4, 1e-3)
    beliefs = [tick.belief for tick in forward(poses, MODEL, detail=Detail.FORMATION)]
    opening = [belief for belief in beliefs if belief.stamp_ns > 30.3e9]
    assert len(opening) > 8
    assert not [belief for belief in opening if belief.probability[Contact.FF.column] > 0.9]


@pytest.mark.parametrize("tip_s", [0.15, 0.25])
def test_a_quick_change_between_two_rests_is_where_it_is(tip_s: float) -> None:
    """A box slides on a face, stands, is tipped onto an edge, stands on that, and rocks about it."""
    rng, time_s = np.random.default_rng(0), np.arange(1800) / 100.0
    slid_s, rocked_s = np.minimum(time_s, 6.0), np.clip(time_s - 12.5, 0.0, None)
    tilt = 0.4 * np.clip((time_s - 9.0) / tip_s, 0.0, 1.0) + 0.2 * np.sin(2.0 * rocked_s)
    yaw = 0.6 * np.sin(1.1 * slid_s) + 0.3 * np.sin(0.9 * rocked_s)
    turn = Rotation.from_euler("ZY", np.column_stack([yaw, tilt]))
    edge_m = np.column_stack([0.2 * np.sin(0.8 * slid_s), 0.15 * np.sin(1.3 * slid_s), 0.0 * time_s])
    edge_m[:, :2] += 0.05 * np.column_stack([np.sin(1.2 * rocked_s), np.sin(0.7 * rocked_s)])
    poses = with_noise(rng, time_s, edge_m - turn.apply([0.1, 0.0, -0.05]), turn, 1e-4, 1e-3)
    segments = segment(poses, MODEL).segments
    on_edge = next(one for one in segments if one.contact is Contact.EF)
    assert on_edge.start_ns * 1e-9 == pytest.approx(9.1, abs=0.4), segments


# --- gaps in a stream: each is tracked for some seconds, tick by tick, in little time and memory ---
SECOND = 1_000_000_000


@pytest.mark.parametrize(("gap_s", "is_open"), [(1.5, False), (4.0, True)])
def test_in_a_long_gap_no_contact_is_certain(gap_s: float, is_open: bool) -> None:
    """A box slides on a table and is at another place of it after the gap: it may have been carried there."""
    rng, time_s = np.random.default_rng(0), np.arange(1400) / 100.0
    turn = Rotation.from_euler("Z", 0.6 * np.sin(1.1 * time_s)[:, None])
    position_m = 0.2 * np.column_stack([np.sin(0.8 * time_s), np.sin(1.3 * time_s), 0.0 * time_s])
    poses = with_noise(rng, time_s, position_m, turn, 3e-4, 1e-3)
    seen = np.abs(time_s - 7.0) > 0.5 * gap_s
    beliefs = segment(poses[seen], MODEL).beliefs
    assert (beliefs.rows["contact"] == Contact.FF.column).all()
    in_gap = np.abs(beliefs.stamp_ns * 1e-9 - 7.0) < 0.5 * gap_s - 0.2
    certain = beliefs.probability[:, Contact.FF.column] > 0.9
    assert certain[in_gap].any() != is_open
    assert beliefs.rows["inseparable"][in_gap].any() == is_open
    assert certain[~in_gap].mean() > 0.9


def test_thousands_of_gaps_are_not_all_filled() -> None:
    """A pair of poses every 5 s: a file of hours, nearly all of whose ticks are empty."""
    count = 600
    stamp_ns = (np.arange(count) // 2 * 5 * SECOND) + np.arange(count) % 2 * (SECOND // 50)
    position_m = 1e-3 * np.cumsum(np.random.default_rng(1).normal(size=(count, 3)), axis=0)
    poses = Poses(stamp_ns, position_m, np.tile([0.0, 0.0, 0.0, 1.0], (count, 1)))
    ticks = TickGrid(MODEL).add(poses)
    filled, used = sum(not tick.count for tick in ticks), sum(tick.count > 0 for tick in ticks)
    assert used == count // 2 - 1
    assert EMPTY_TICKS < filled <= EMPTY_TICKS + EMPTY_PER_TICK * used
    whole = TickGrid(MODEL).add(poses[:40])
    assert sum(not tick.count for tick in whole) == 19 * 49  # the gaps of an ordinary recording are filled
    grid, one_by_one = TickGrid(MODEL), list[int]()
    for row in range(count):
        one_by_one += [tick.stamp_ns for tick in grid.add(poses[row : row + 1])]
    assert one_by_one == [tick.stamp_ns for tick in ticks]
