"""Stream checks: warnings for streams with known mistakes, none for correct recordings."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from contact_tracker.config.table_reading import TableReading
from contact_tracker.inspection.stream_checks import (
    BLOCK,
    KEPT,
    NOTHING_INSPECTED,
    Inspection,
    findings,
    inspect,
)
from contact_tracker.motion.poses import Poses, ReadAs
from contact_tracker.recording import open_log
from distortions import default_where
from short_recordings import shipped
from smooth_motion import START_NS, moving, smooth

PAPER = shipped("paper_experiment")


def recorded(path):
    return Poses.join(list(open_log(str(path)).batches()))


def until(poses, seconds):
    return poses[poses.stamp_ns <= poses.stamp_ns[0] + seconds * 1e9]


def inspected(poses, batch=100, before=NOTHING_INSPECTED) -> Inspection:
    for first in range(0, len(poses), batch):
        before = inspect(before, poses[first : first + batch])
    return before


def kinds(poses, batch=100):
    return [finding.kind for finding in findings(inspected(poses, batch))]


def scaled(poses, factor):
    return Poses(poses.stamp_ns, poses.position_m * factor, poses.quat_xyzw)


def late(poses, offset_m, late_ns):
    return Poses(poses.stamp_ns + late_ns, poses.position_m + offset_m, poses.quat_xyzw)


def with_shifts(poses, shift_m):
    return late(poses, shift_m, 0)


def merged(*streams):
    every = Poses.join(streams)
    return every[np.argsort(every.stamp_ns, kind="stable")]


@pytest.mark.long
@pytest.mark.parametrize("part", ["cube_tosses", "physics/paper", "physics/hard", "physics/singular"])
def test_other_recordings_have_no_warnings(shared_recordings, part):
    for path in sorted((shared_recordings / part).glob("*.mcap")):
        assert kinds(recorded(path)) == [], path.name


@pytest.mark.parametrize(
    ("name", "factor", "unit"),
    [
        ("paper_experiment", 1e3, "mm"),
        ("all_states", 1e2, "cm"),
        ("robot_1khz", 1e2, "cm"),
        ("vision_30hz", 1e3, "mm"),
    ],
)
def test_other_units_are_found_at_once(name, factor, unit):
    """At rest by their noise, in motion also by their speed; and metres in columns of smaller units."""
    poses = shipped(name)
    state = inspected(until(scaled(poses, factor), 2.0))
    (finding,) = findings(state)
    assert finding.kind == "units"
    assert finding.doubts_labels
    assert "check their unit" in finding.text, "no remedy that was not tried"
    read_as = ReadAs(table=TableReading(euler="xyz:deg"), path="take.csv")
    (asked,) = findings(state._replace(read_as=read_as))
    assert asked.text.endswith(f"segment take.csv --unit {unit} --euler xyz:deg")
    rest = inspected(poses[len(poses) // 2 :][:400], before=inspected(scaled(poses[:400], factor)))
    assert any(finding.doubts_labels for finding in findings(rest)), "a finding is permanent"
    (finding,) = findings(inspected(scaled(poses, 1.0 / factor)))
    assert finding.kind == "units"
    assert finding.text.startswith("positions look too small for metres")
    assert not finding.doubts_labels


@pytest.mark.parametrize("name", ["all_states", "vision_30hz"])
def test_an_object_far_from_its_origin_is_in_metres(name):
    """The origin moves with the errors of the orientation, here by 20 to 120 mm."""
    far = shipped(name).of_point(10.0 * np.array([0.6, -0.48, 0.64]))
    (finding,) = findings(inspected(far))  # the same motion as that of the world in a body
    assert finding.kind == "inverse"
    assert "if the body's origin is that far from the object" in finding.text
    assert "units" in kinds(scaled(far, 1e3))


def by_hand(seed, seconds, rate_hz, sigma_m, sigma_rad, **more):
    return lambda _: moving(np.random.default_rng(seed), seconds, rate_hz, sigma_m, sigma_rad, **more)


def odometry(rate_hz, sigma_m, sigma_rad):
    """A mobile robot: some 2 m/s over tens of metres."""
    rng, time_s = np.random.default_rng(0), np.arange(round(60 * rate_hz)) / rate_hz
    yaw = np.cumsum(smooth(rng, time_s, 0.3, 0.2)[:, 0]) / rate_hz
    way = np.stack([np.cos(yaw), np.sin(yaw), 0.0 * yaw], axis=1)
    way *= (1.2 + 0.8 * np.sin(0.3 * time_s))[:, None]
    turn = np.outer(yaw + rng.normal(size=len(yaw)) * sigma_rad, (0.0, 0.0, 1.0))
    position = np.cumsum(way, axis=0) / rate_hz + rng.normal(size=(len(yaw), 3)) * (sigma_m, sigma_m, 0.0)
    stamp_ns = START_NS + np.rint(1e9 * time_s).astype(np.int64)
    return Poses(stamp_ns, position, Rotation.from_rotvec(turn).as_quat())


def turning_about_its_origin(rate_hz):
    """Fast, at a low rate."""
    rng, time_s = np.random.default_rng(0), np.arange(0.0, 60.0, 1.0 / rate_hz)
    turns = np.stack([0.4 * np.sin(2.0 * np.pi * hz * time_s) for hz in (1.5, 1.1, 0.7)], axis=1)
    stamp_ns = START_NS + np.round(1e9 * time_s).astype(np.int64)
    return Poses(stamp_ns, 5e-5 * rng.normal(size=(len(time_s), 3)), Rotation.from_rotvec(turns).as_quat())


def swinging_arm():
    """Its tool, 0.7 m from the world's origin, turns about the first axis, as inverse poses turn about a
    point."""
    rng, time_s = np.random.default_rng(0), np.arange(0.0, 12.0, 0.01)
    angle = 0.8 * np.sin(1.1 * time_s)
    turn = Rotation.from_rotvec(angle[:, None] * [0.0, 0.0, 1.0] + 1e-3 * rng.normal(size=(1200, 3)))
    place_m = turn.apply([0.7, 0.0, 0.3]) + 1e-4 * rng.normal(size=(1200, 3))
    return Poses(np.arange(1200) * 10_000_000, place_m, turn.as_quat())


def with_outliers(poses):
    rng = np.random.default_rng(0)
    off = rng.random(len(poses)) < 0.1
    return with_shifts(poses, off[:, None] * rng.normal(size=(len(poses), 3)))


def with_default_poses(poses):
    return default_where(poses, np.random.default_rng(0).random(len(poses)) < 0.1)


def vibrating(poses):
    """By 2 mm at 37 Hz."""
    phase = 2e-9 * np.pi * 37.0 * (poses.stamp_ns - poses.stamp_ns[0])
    return with_shifts(poses[::2], 2e-3 * np.sin(phase)[::2, None] * [0.0, 0.6, 0.8])


def of_two_cameras(poses):
    """They take turns, and hardly differ."""
    poses = poses[::2]
    return with_shifts(poses, 1e-3 * (np.arange(len(poses)) % 2)[:, None] * [0.6, -0.5, 0.62])


def held(poses):
    rows = np.arange(len(poses)) // 3 * 3
    return Poses(poses.stamp_ns, poses.position_m[rows], poses.quat_xyzw[rows])


VALID = {
    "as it is": lambda poses: poses,
    "outliers": with_outliers,
    "default poses": with_default_poses,
    "a vibration": vibrating,
    "two cameras": of_two_cameras,
    "dropped poses": lambda poses: poses[np.random.default_rng(0).random(len(poses)) < 0.5],
    "held poses": held,
}
OTHERS = {
    **{name: lambda _, name=name: shipped(name) for name in ("all_states", "robot_1khz", "vision_30hz")},
    "places measured much better than turns": by_hand(0, 20.0, 100.0, 1e-6, np.radians(0.5)),
    "calibration of a tip": by_hand(0, 20.0, 100.0, 5e-5, np.radians(0.15), rms_m=1e-4),
    "calibration of a tip with more noise": by_hand(0, 20.0, 100.0, 3e-4, np.radians(0.15), rms_m=1e-4),
    "turns at 5 Hz": lambda _: turning_about_its_origin(5),
    "turns at 10 Hz": lambda _: turning_about_its_origin(10),
    "a robot at 5 Hz": lambda _: odometry(5, 0.003, 1e-4),
    "a robot at 30 Hz": lambda _: odometry(30, 0.005, 1e-5),
    "a robot at 200 Hz": lambda _: odometry(200, 0.003, 2e-3),
    "an arm": lambda _: swinging_arm(),
    "a robot without noise": lambda _: odometry(30, 0.0, 0.0),
    # with any share of motion in the third differences
    "motion without noise at 10 Hz": by_hand(3, 60.0, 10, 0.0, 0.0),
    "motion of little noise at 30 Hz": by_hand(3, 60.0, 30, 1e-7, 5e-7),
    "motion of some noise at 200 Hz": by_hand(3, 60.0, 200, 1e-5, 5e-5),
    "motion of much noise at 30 Hz": by_hand(3, 60.0, 30, 1e-3, 5e-3),
}


@pytest.mark.parametrize("make", [pytest.param(make, id=name) for name, make in (VALID | OTHERS).items()])
def test_valid_streams_have_no_warnings(make):
    assert kinds(make(PAPER)) == []


@pytest.mark.parametrize("batch", [7, 100])
def test_a_pose_that_never_changes_is_reported_until_it_does(batch):
    """As of a static transform, or of an object that is not tracked."""
    poses = moving(np.random.default_rng(0), 3.0, 100.0, 3e-4, 1e-3)
    still_ns = poses.stamp_ns - 10**10
    before = Poses(still_ns, poses.position_m[:1].repeat(300, 0), poses.quat_xyzw[:1].repeat(300, 0))
    (finding,) = findings(still := inspected(before, batch))
    assert finding.text.startswith("the pose never changes")
    assert not finding.doubts_labels, "no label is certain without motion"
    assert findings(inspected(poses, batch, still)) == ()


@pytest.mark.parametrize(("first_hz", "second_hz"), [(30, 30), (200, 60), (1000, 1000)])
def test_two_bodies_that_take_turns_are_found(first_hz, second_hz):
    rates = enumerate([first_hz, second_hz])
    first, second = (moving(np.random.default_rng(i), 2.0, rate, 3e-4, 2e-3) for i, rate in rates)
    (finding,) = findings(inspected(merged(first, late(second, [0.3, 0.2, 0.0], round(3e8 / first_hz)))))
    assert finding.kind == "bodies"
    assert finding.doubts_labels


@pytest.mark.parametrize(
    ("apart_mm", "every", "in_turns"),
    [(3, 2, True), (5, 8, True), (20, 4, True), (5, 2, False), (300, 4, False)],
)
def test_two_bodies_close_to_each_other_are_found_in_motion(apart_mm, every, in_turns):
    """Two bodies that move together, at up to 0.3 m/s, with 0.3 mm of noise."""
    poses = PAPER[1100::every]
    numbers = np.arange(len(poses)) if in_turns else np.random.default_rng(4).permutation(len(poses))
    aside = 1e-3 * apart_mm * np.array([0.6, -0.5, 0.62]) * (numbers % 2)[:, None]
    found = inspected(with_shifts(poses, aside)[: 200 if in_turns else 800])
    assert found.bodies
    assert any(finding.doubts_labels for finding in findings(found))


def test_an_orientation_or_position_that_never_changes():
    poses = PAPER[:1000]
    unturned = Poses(poses.stamp_ns, poses.position_m, np.tile([0.0, 0.0, 0.0, 1.0], (len(poses), 1)))
    unmoved = Poses(poses.stamp_ns, np.zeros((len(poses), 3)), poses.quat_xyzw)
    for stream, word in ((unturned, "orientation"), (unmoved, "position")):
        (finding,) = findings(inspected(stream))
        assert finding.kind == "orientation"
        assert finding.doubts_labels
        assert f"the {word} never changes" in finding.text
        assert kinds(stream[:99]) == []
        assert kinds(merged(stream, late(poses, 0.0, 10**10))) == []
    assert kinds(Poses(unturned.stamp_ns, unmoved.position_m, unturned.quat_xyzw)) == ["still"]


STREAMS = {
    "as it is": lambda poses: poses,
    "millimetres": lambda poses: scaled(poses, 1e3),
    "two bodies": lambda poses: merged(poses, late(poses[::2], [0.3, 0.0, 0.0], 10**6)),
}


@pytest.mark.parametrize("change", STREAMS.values(), ids=STREAMS)
@given(sizes=st.lists(st.integers(1, 700), min_size=1, max_size=30))
@settings(max_examples=2)
def test_results_do_not_depend_on_how_the_stream_is_split(change, sizes):
    poses = change(PAPER[:1500])
    whole, state, first = inspect(NOTHING_INSPECTED, poses), NOTHING_INSPECTED, 0
    for size in [*sizes, len(poses)]:
        if first < len(poses):
            state = inspect(state, poses[first : first + size])
            first += size
    assert findings(state) == findings(whole)
    for part, other in zip(_numbers(state), _numbers(whole), strict=True):
        np.testing.assert_allclose(part, other, rtol=1e-9, atol=1e-12)


def _numbers(state):
    for value in state:
        if isinstance(value, Poses):
            yield from value.columns
        elif isinstance(value, tuple):
            yield from _numbers(value)
        elif not isinstance(value, TableReading | str):
            yield value


def test_memory_is_bounded():
    state = NOTHING_INSPECTED
    for batch in shipped("robot_1khz").batches():
        state = inspect(state, batch)
        assert len(state.recent) < KEPT + BLOCK
        assert len(state.first) == 1
