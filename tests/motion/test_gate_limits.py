"""Limits of the pose gate: for each number, single poses, columns, and the validation of given poses."""

from collections import Counter
from itertools import pairwise
from math import inf, nan

import numpy as np
import pytest

from contact_tracker.config.quantities import RANGE_NS
from contact_tracker.errors import InvalidPose
from contact_tracker.motion.pose_validation import RANGE_M, gate, require_valid
from contact_tracker.motion.poses import Pose, Poses
from smooth_motion import pass_through

MS = 1_000_000
UNIT = (0.5, -0.5, 0.5, 0.5)
SOUND = Pose(0, (0.1, -0.2, 0.3), UNIT)


def put(values: tuple[float, ...], row: int, value: float) -> tuple[float, ...]:
    return (*values[:row], value, *values[row + 1 :])


def scaled(norm: float) -> Pose:
    return SOUND._replace(quat_xyzw=tuple(norm * c for c in UNIT))  # type: ignore[arg-type]


def positions(value: float) -> list[Pose]:
    """Poses, one of whose coordinates is the value."""
    return [SOUND._replace(position_m=put(SOUND.position_m, row, value)) for row in range(3)]  # type: ignore[arg-type]


def quaternions(value: float) -> list[Pose]:
    return [SOUND._replace(quat_xyzw=put(UNIT, row, value)) for row in range(4)]  # type: ignore[arg-type]


LARGE = (1.1 * RANGE_M, -1.1 * RANGE_M, 1.7e308)
REFUSED = [
    *((pose, "nonfinite") for value in (nan, inf, -inf) for pose in (*positions(value), *quaternions(value))),
    *((pose, "out_of_range") for value in LARGE for pose in positions(value)),
    *((pose, "bad_quaternion") for value in (0.0, 0.6) for pose in quaternions(value)),
    *((scaled(norm), "bad_quaternion") for norm in (1.06, 0.5, 0.0, 1e200)),
    *((scaled(norm), "renormalised") for norm in (1.0015, 0.9985, 1.02, 0.97)),
    *((SOUND._replace(stamp_ns=ns), "out_of_range") for ns in (RANGE_NS + 1, -RANGE_NS - 1)),
]
TAKEN = [
    *(pose for value in (RANGE_M, -RANGE_M, 0.0) for pose in positions(value)),
    *(pose for value in (-0.5, 0.5) for pose in quaternions(value)),
    *map(scaled, (1.0009, 0.9991, 1.0 + 3e-5)),
    SOUND._replace(stamp_ns=RANGE_NS),
    SOUND._replace(stamp_ns=-RANGE_NS),
]


@pytest.mark.parametrize(("pose", "kind"), REFUSED, ids=str)
def test_poses_that_the_gate_drops_or_changes_are_refused_elsewhere(pose: Pose, kind: str) -> None:
    kept, counts = pass_through([pose])
    assert counts == {kind: 1}
    assert len(kept) == (kind == "renormalised")
    for one in kept:
        assert np.linalg.norm(one.quat_xyzw) == pytest.approx(1.0, abs=1e-15)
    with pytest.raises(InvalidPose, match="pose 0 of 1 "):
        require_valid(Poses.collect([pose]), None)


@pytest.mark.parametrize("pose", TAKEN, ids=str)
def test_poses_that_the_gate_passes_are_accepted(pose: Pose) -> None:
    assert pass_through([pose])[1] == {}
    require_valid(Poses.collect([pose]), None)


def test_the_first_of_many_that_is_wrong_is_named() -> None:
    poses = [SOUND._replace(stamp_ns=n) for n in range(6)]
    poses[4] = poses[4]._replace(position_m=(0.0, nan, 0.0))
    with pytest.raises(InvalidPose, match="pose 4 of 6 has a position"):
        require_valid(Poses.collect(poses), None)
    poses[4] = poses[4]._replace(position_m=(0.0, 0.0, 0.0), stamp_ns=3)
    with pytest.raises(InvalidPose, match="pose 4 of 6 has a stamp that is not after"):
        require_valid(Poses.collect(poses), -1)


@pytest.mark.parametrize("wide", ["position_m", "quat_xyzw"])
def test_columns_of_another_shape_are_refused(wide: str) -> None:
    columns = {"position_m": np.zeros((1, 3)), "quat_xyzw": np.array([UNIT])}
    columns[wide] = np.zeros((1, 5))
    with pytest.raises(InvalidPose, match="three coordinates"):
        require_valid(Poses(np.zeros(1, np.int64), **columns), None)


def turning(axis: int, step_rad: float, count: int = 120, first: int = 0) -> list[Pose]:
    """A body that turns about one axis; every third quaternion has the other sign."""
    poses = []
    for n in range(first, first + count):
        quat = [0.0] * 4
        quat[axis], quat[3] = np.sin(0.5 * step_rad * n), np.cos(0.5 * step_rad * n)
        sign = -1.0 if n % 3 == 1 else 1.0
        poses.append(Pose(5 * MS * n, (0.4, 0.001 * n, -0.3), tuple(sign * c for c in quat)))  # type: ignore[arg-type]
    return poses


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("step_rad", [0.04, 1.9])
def test_signs_follow_on_each_other_about_every_axis(axis: int, step_rad: float) -> None:
    """Also with steps so long that products of components differ in sign."""
    given = turning(axis, step_rad)
    kept, _ = pass_through(given)
    assert [pose.stamp_ns for pose in kept] == [pose.stamp_ns for pose in given]
    for before, after in pairwise(kept):
        assert np.dot(before.quat_xyzw, after.quat_xyzw) > 0.0


def test_columns_pass_as_their_poses_do_one_by_one() -> None:
    poses, counts = turning(0, 0.01), Counter[str]()
    poses[70] = poses[70]._replace(position_m=(0.0, 0.0, 0.0))
    poses[80] = poses[80]._replace(stamp_ns=poses[80].stamp_ns - 25 * MS)
    expected, counted = pass_through(poses)
    assert list(gate(Poses.collect(poses), counts)) == list(gate(iter(poses))) == expected
    assert counts == counted == {"default_pose": 1, "backward_stamp": 1}
