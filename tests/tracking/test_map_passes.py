"""Passes after the first one: at the pace of the recording, and what a map leaves open."""

from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d
from scipy.signal import butter, filtfilt
from scipy.spatial.transform import Rotation

import contact_tracker
from contact_tracker.geometry.linalg import unit
from contact_tracker.motion.poses import Poses
from contact_tracker.states import Contact
from contact_tracker.trajectory import Trajectory
from robot_moves import Robot, logged, pick_and_place
from smooth_motion import least_jerk

RECORDINGS = Path(__file__).parents[2] / "recordings"


def take(name: str) -> Trajectory:
    """The first or second take of the mug, up to the end of its first carry."""
    return contact_tracker.read(RECORDINGS / f"mug_{name}_take.mcap")[:27.0]


def set_down(higher_m: float, seed: int) -> contact_tracker.Trajectory:
    """An object that is pushed on a table, carried by a hand, and set down upright, ``higher_m`` above where
    it was."""
    rng, time_s = np.random.default_rng(seed), np.arange(0.0, 20.0, 0.01)
    push, carry = least_jerk((time_s - 2.0) / 6.0), least_jerk((time_s - 10.0) / 4.0)
    lifted, hand = np.sin(np.pi * carry), gaussian_filter1d(rng.normal(size=(len(time_s), 6)), 60, axis=0)
    hand *= lifted[:, None] / hand.std(axis=0)
    across = 0.25 * push + 0.1 * carry, 0.08 * np.sin(2.0 * np.pi * push)
    position_m = np.stack([*across, 0.1 * lifted + higher_m * carry], axis=1) + 0.02 * hand[:, :3]
    yaw = np.zeros((len(time_s), 3))
    yaw[:, 2] = 0.9 * np.sin(4.0 * push) + 0.3 * carry
    turn = Rotation.from_rotvec(yaw) * Rotation.from_rotvec(0.15 * hand[:, 3:])
    turn = Rotation.from_rotvec(rng.normal(0.0, 0.0017, yaw.shape)) * turn
    position_m += rng.normal(0.0, 2e-4, yaw.shape)
    return contact_tracker.Trajectory.from_arrays(time_s, position_m, turn, time_unit="s")


def test_a_pose_on_faces_that_other_motion_has_shown_is_contact() -> None:
    """The object does not move after it is set down: on the table where it was pushed its pose shows f-f."""
    trajectory = set_down(0.0, 0)
    segments = contact_tracker.segment(trajectory).segments
    pushed, rest = segments[0], segments[-1]
    assert pushed.contact is rest.contact is Contact.FF
    assert (rest.end_ns - rest.start_ns) * 1e-9 > 5.0
    assert rest.probability > 0.9
    assert not rest.inseparable
    for side in ("object", "environment"):
        normals = [getattr(segment.geometry, side).normal for segment in (pushed, rest)]
        assert normals[0] @ normals[1] == pytest.approx(1.0, abs=1e-5)  # to 0.3 deg
    tracker = contact_tracker.Tracker()
    poses = trajectory.stamp_ns, trajectory.position_m, trajectory.quat_xyzw
    *_, belief = (belief for belief in map(tracker.update, *poses) if belief is not None)
    assert belief.contact is Contact.FF
    assert not belief.inseparable


def test_a_lid_on_known_faces_is_not_contact_of_its_faces() -> None:
    """A box is pushed, and then opens like a lid about its lower edge; more than half of the time it lies."""
    rng, time_s = np.random.default_rng(0), np.arange(0.0, 34.0, 0.01)
    push, yaw, pitch = least_jerk((time_s - 2.0) / 5.0), np.zeros((3400, 3)), np.zeros((3400, 3))
    yaw[:, 2] = 0.9 * np.sin(4.0 * push)
    for opens_s in (10.0, 19.0, 28.0):
        since = (time_s - opens_s) / 1.5
        pitch[:, 1] += 0.35 * (least_jerk(since) - least_jerk(since - 1.0))
    lying, edge_m = Rotation.from_rotvec(yaw), np.array([0.06, 0.0, -0.05])
    turn = lying * Rotation.from_rotvec(pitch)
    position_m = np.stack([0.25 * push, 0.08 * np.sin(2.0 * np.pi * push), 0.0 * push], axis=1)
    position_m += lying.apply(edge_m) - turn.apply(edge_m) + rng.normal(0.0, 2e-4, (3400, 3))
    turn = Rotation.from_rotvec(rng.normal(0.0, 1.7e-3, (3400, 3))) * turn
    poses = contact_tracker.Trajectory.from_arrays(time_s, position_m, turn, time_unit="s")
    for segment in map(contact_tracker.segment(poses).at, (11.5, 20.5, 29.5)):
        assert segment.contact is not Contact.FF or (segment.inseparable and segment.probability <= 0.9)


TABLE: Final = {"environment": {"plane": [{"normal": [0.0, 0.0, 1.0], "offset_m": -0.05}]}}
BOX: Final = {"object": {"box": {"size_m": [0.1, 0.1, 0.1]}}}


@pytest.mark.parametrize(
    ("is_lifted", "known"),
    [
        (False, None),
        (True, None),
        (False, {"up": {"direction": [0.0, 0.0, 1.0]}}),
        (False, TABLE),
        (False, TABLE | BOX),
    ],
    ids=["in one plane", "also lifted", "up is given", "a table is given", "table and box are given"],
)
def test_motion_in_one_plane_alone_may_be_that_of_a_machine(is_lifted: bool, known: Any) -> None:
    """A gantry that moves a part in the air at one height moves it like a face on a table; its poses show
    which it is only if faces of both are given."""
    rng, time_s = np.random.default_rng(1), np.arange(0.0, 12.0, 0.01)
    position_m = np.stack([0.2 * np.sin(time_s), 0.1 * np.sin(1.7 * time_s), 0.0 * time_s], axis=1)
    turn = np.stack([0.0 * time_s, 0.0 * time_s, 0.8 * np.sin(1.3 * time_s)], axis=1)
    if is_lifted:
        hand = gaussian_filter1d(rng.normal(size=(len(time_s), 6)), 40, axis=0)
        hand *= np.clip(time_s - 8.0, 0.0, 1.0)[:, None] / hand.std(axis=0)
        position_m, turn = position_m + 0.05 * hand[:, :3], turn + 0.3 * hand[:, 3:]
    position_m += rng.normal(0.0, 1e-4, position_m.shape)
    noisy = Rotation.from_rotvec(rng.normal(0.0, 1e-3, turn.shape)) * Rotation.from_rotvec(turn)
    trajectory = contact_tracker.Trajectory.from_arrays(time_s, position_m, noisy, time_unit="s")
    flat, is_sure = (
        contact_tracker.segment(trajectory, known=known).at(5.0),
        is_lifted or known == TABLE | BOX,
    )
    assert flat.contact is Contact.FF
    assert flat.inseparable == (() if is_sure else (Contact.FREE,))
    assert (flat.probability > 0.9) == is_sure


@pytest.mark.parametrize("lift_m", [0.0, 0.1])
def test_an_arm_that_never_tilts_an_object_may_hold_it_in_the_air(lift_m: float) -> None:
    """An arm turns an object about one axis, in a plane or at several heights; errors depend on the place."""
    rng, time_s = np.random.default_rng(3), np.arange(0.0, 18.0, 0.008)
    goals = rng.uniform(-1.0, 1.0, (7, 3)) * [0.15, 0.15, 0.4]
    share = least_jerk((time_s[:, None] - np.arange(1.0, 19.0, 3.0)) / 1.6)
    path = goals[0] + share @ np.diff(goals, axis=0)
    path[:, 1] += 0.03 * np.sin(np.pi * share).sum(axis=1)
    waves = 4.0 * np.pi * path[:, [0, 1, 0]]
    shift, twist = (np.sin(waves + phase) for phase in ([1.0, 2.0, 0.5], [1.5, 0.0, -1.0]))
    height_m = lift_m * (share[:, 1] - share[:, 2] + share[:, 4])
    position_m = path * [1.0, 1.0, 0.0] + height_m[:, None] * [0.0, 0.0, 1.0]
    position_m += 2e-4 * shift + rng.normal(0.0, 1e-4, path.shape)
    error = Rotation.from_rotvec(9e-4 * (twist[:, [1, 0, 2]] + rng.normal(size=path.shape)))
    turn = error * Rotation.from_rotvec(path * [0.0, 0.0, 1.0])
    poses = contact_tracker.Trajectory.from_arrays(time_s, position_m, turn, time_unit="s")
    faces = [s for s in contact_tracker.segment(poses).segments if s.contact is Contact.FF]
    assert faces
    assert all(Contact.FREE in segment.inseparable and segment.probability <= 0.9 for segment in faces)


@pytest.mark.parametrize("higher_m", [0.003, 0.03])
def test_a_pose_beside_known_faces_shows_no_contact(higher_m: float) -> None:
    """It may stand on something else, or a hand may hold it parallel to the table."""
    rest = contact_tracker.segment(set_down(higher_m, 0)).segments[-1]
    assert Contact.FREE in rest.inseparable
    assert rest.probability <= 0.9


TABLE_NORMAL: Final = np.array([0.4224, -0.6437, 0.6382])
"""Of the table in the recordings of the mug, 0.5717 m from the origin."""


@pytest.mark.parametrize("tilt_deg", [0.0, 10.0])
def test_a_listed_table_begins_the_map(tilt_deg: float) -> None:
    """It has its name where contacts agree with it, and costs nothing where it is wrong. With both a
    smooth carry is free motion, open to two edges: these can be chosen such that they fit a part of it."""
    tilt = Rotation.from_rotvec(np.radians(tilt_deg) * np.array([0.0, 0.7, 0.7]))
    table = {"name": "table", "normal": list(unit(tilt.apply(TABLE_NORMAL))), "offset_m": 0.5717}
    result = contact_tracker.segment(take("second"), known={"environment": {"plane": [table]}})
    faces = [s for s in result.segments if s.contact is Contact.FF and s.probability > 0.9]
    assert sum(s.end_ns - s.start_ns for s in faces) > 8e9
    names = {s.geometry.environment.name for s in faces if s.geometry is not None}
    assert names == ({None} if tilt_deg else {"table"})
    assert any("no contact confirms" in line for line in result.warnings) == bool(tilt_deg)
    carried = result.at(24.7)
    assert carried.contact is Contact.FREE
    assert Contact.EE in carried.inseparable


@pytest.mark.parametrize("poses_are", ["exact", "noisy", "low-passed"])
def test_a_point_that_a_program_moves_in_a_plane_is_no_sure_contact(poses_are: str) -> None:
    """A robot that carries a part turns it about a point in a plane; poses of a hand are noisy, also where
    a filter hides it."""
    robot = Robot(125.0)
    rng = np.random.default_rng(1)
    for _ in range(6):
        to_m = robot.position_m + np.append(rng.uniform(-0.15, 0.15, 2), 0.0)
        robot.move(Contact.VF, 1.5, to_m, Rotation.from_rotvec(0.5 * rng.normal(size=3)))
    trajectory, _ = logged(robot, 0, (0.0, 0.0) if poses_are == "exact" else (3e-4, 2e-3))
    if poses_are == "low-passed":
        smooth = filtfilt(
            *butter(2, 10.0 / 62.5), np.column_stack([trajectory.position_m, trajectory.quat_xyzw]), axis=0
        )
        trajectory = Trajectory.from_arrays(
            trajectory.stamp_ns,
            smooth[:, :3],
            smooth[:, 3:] / np.linalg.norm(smooth[:, 3:], axis=1)[:, None],
            time_unit="ns",
        )
    result = contact_tracker.segment(trajectory)
    assert result.at(5.0).contact is Contact.VF
    assert (Contact.FREE in result.at(5.0).inseparable) == (poses_are == "exact")
    tracker = contact_tracker.Tracker()
    beliefs = [belief for pose in trajectory if (belief := tracker.update(*pose)) is not None]
    assert (Contact.FREE in beliefs[-1].inseparable) == (poses_are == "exact")


def test_smooth_moves_of_a_robot_in_contact_are_not_surely_free() -> None:
    """Four moves with an edge on a plane, between an approach and a retreat: with the least noise of ticks
    they are as predictable as free motion."""
    rng, time_s = np.random.default_rng(7), np.arange(0.0, 18.0, 1.0 / 240.0)
    begins_s, lasts_s = np.array([0.0, 1.5, 4.0, 7.0, 10.0, 13.0, 16.0]), [1.5, 2.5, 3.0, 3.0, 3.0, 3.0, 2.0]
    share = least_jerk((time_s[:, None] - begins_s) / lasts_s)
    steps_m = rng.uniform(-0.08, 0.08, (7, 3))
    steps_m[:, 2] = [0.0, -0.05, 0.0, 0.0, 0.0, 0.0, 0.1]
    tilt_rad, yaw_rad = (share @ np.radians(rng.uniform(-15.0, 15.0, 7)) for _ in range(2))
    turn = Rotation.from_rotvec(yaw_rad[:, None] * [0.0, 0.0, 1.0])
    turn *= Rotation.from_rotvec((tilt_rad[:, None] - 0.6) * [1.0, 0.0, 0.0])
    position_m = share @ steps_m - turn.apply([0.05, 0.03, -0.025]) + rng.normal(0.0, 2e-5, (len(time_s), 3))
    turn *= Rotation.from_rotvec(rng.normal(0.0, 1.4e-4, (len(time_s), 3)))
    result = contact_tracker.segment(Trajectory.from_arrays(time_s, position_m, turn, time_unit="s"))
    beliefs = result.beliefs.rows[np.abs(result.beliefs.stamp_ns * 1e-9 - 10.0) < 5.8]
    is_sure = (beliefs["contact"] == Contact.FREE.column) & (beliefs["probability"].max(axis=1) > 0.9)
    assert not is_sure.any()


def test_carries_of_a_robot_are_free_motion() -> None:
    """Up, over and down in a vertical plane: faces and edges of another wall each time fit as well."""
    trajectory, columns = logged(pick_and_place(125.0, 0), 0)
    result = contact_tracker.segment(trajectory)
    at = np.arange(len(columns)) / 125.0
    carried = at[columns == Contact.FREE.column][60::60]
    assert np.mean([result.at(float(time)).contact is Contact.FREE for time in carried]) > 0.8


@pytest.mark.long
def test_free_motion_is_not_open_to_all_if_contacts_agree_with_an_earlier_map() -> None:
    """The right map's price of new contacts hides none."""
    earlier = contact_tracker.segment(take("first")).map
    segments = contact_tracker.segment(take("second"), known=earlier).segments
    carried = max(segments, key=lambda segment: segment.end_ns - segment.start_ns)
    assert carried.contact is Contact.FREE
    assert not carried.inseparable
    assert carried.probability > 0.8


@pytest.mark.parametrize("seed", [2, 4])
def test_an_object_held_still_in_the_air_is_no_edge_on_an_edge(seed: int) -> None:
    """It sways by half a millimetre, and the poses are low-passed: a constraint of velocities fits by chance,
    and no direction of the edges is observed. Both were surely e-e for up to 18 of 20 s."""
    rng, time_s = np.random.default_rng(seed), np.arange(2000) / 100.0

    def low_passed(rows: np.ndarray, hz: float) -> np.ndarray:
        return np.asarray(filtfilt(*butter(2, hz / 50.0), rows, axis=0))

    def sway(size: float, hz: float) -> np.ndarray:
        way = low_passed(rng.normal(size=(2000, 3)), hz)
        return np.asarray(size * way / way.std(axis=0))

    position_m = sway(5e-4, 0.4) + sway(1e-4, 6.0) + 3e-4 * rng.normal(size=(2000, 3))
    turn = np.radians(sway(0.3, 0.4) + sway(0.05, 6.0) + 0.1 * rng.normal(size=(2000, 3)))
    position_m, turn = low_passed(position_m, 6.0), low_passed(turn, 6.0)
    held = Poses(np.rint(1e9 * time_s).astype(np.int64), position_m, Rotation.from_rotvec(turn).as_quat())
    result = contact_tracker.segment(Trajectory(held))
    assert all(Contact.FREE in (row.contact, *row.inseparable) for row in result.segments)
    tracker = contact_tracker.Tracker()
    beliefs = filter(None, (tracker.update(*pose) for pose in held))
    assert not any(belief.probability.max() > 0.9 and not belief.inseparable for belief in beliefs)
