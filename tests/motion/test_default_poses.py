"""Default poses of trackers are dropped if they are away from the motion; poses of the motion never."""

from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from contact_tracker.motion.excursions import KNOWN_POSES, MOST_WAITING
from contact_tracker.motion.pose_validation import PoseGate
from contact_tracker.motion.poses import Pose, Poses
from mcap_logs import smooth_poses
from smooth_motion import least_jerk, pass_through

Array = NDArray[np.float64]
IDENTITY = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)
TURNED_ORIGIN = (0.0, 0.0, 0.0), (0.6, 0.0, 0.0, 0.8)
AWAY = np.array([0.1, 0.2, 0.3])
ELSEWHERE = (1.0, -2.0, 0.5), (0.5, -0.5, 0.5, 0.5)


def hidden(
    poses: Poses, where: Iterable[int], reported: tuple[tuple[float, ...], tuple[float, ...]]
) -> list[Pose]:
    """The poses with a default pose at some indices."""
    rows = list(poses)
    for i in where:
        rows[i] = Pose(rows[i].stamp_ns, *reported)  # type: ignore[arg-type]
    return rows


def far_from_the_origin(poses: Poses) -> Poses:
    return replace(poses, position_m=poses.position_m + np.array([0.5, 0.6, 0.7]))


def left_out(poses: Poses, where: Iterable[int]) -> list[int]:
    return list(np.delete(poses.stamp_ns, list(where)))


def motion(position_m: Array, rotation: Array | None = None, rate_hz: float = 200.0) -> Poses:
    """Poses at positions (N, 3) with rotation vectors (N, 3)."""
    count = len(position_m)
    turned = Rotation.from_rotvec(np.zeros((count, 3)) if rotation is None else rotation)
    stamps = np.round(np.arange(count) * 1e9 / rate_hz).astype(np.int64)
    return Poses(stamps, position_m, turned.as_quat(canonical=True))


def along(x: Array) -> Array:
    return np.array([x, 0.0 * x, 0.0 * x]).T


def smoothly(count: int) -> Array:
    return least_jerk(np.linspace(0.0, 1.0, count))


POSES = smooth_poses(1000)
STRETCHES = [*range(0, 300), *range(400, 401), *range(500, 580), *range(990, 1000)]


def test_the_origin_with_the_last_orientation_is_dropped() -> None:
    rows = list(POSES)
    for i in STRETCHES:
        rows[i] = rows[i]._replace(position_m=(0.0, 0.0, 0.0), quat_xyzw=rows[max(i - 1, 0)].quat_xyzw)
    kept, counts = pass_through(rows)
    assert [p.stamp_ns for p in kept] == left_out(POSES, STRETCHES)
    assert counts == {"default_pose": len(STRETCHES)}


@pytest.mark.parametrize("reported", [ELSEWHERE, (ELSEWHERE[0], IDENTITY[1])])
@pytest.mark.parametrize("every", [2, 3, 8])
def test_any_other_pose_is_dropped_when_it_comes_back(
    reported: tuple[tuple[float, ...], tuple[float, ...]], every: int
) -> None:
    where = range(100, 1000, every)
    kept, counts = pass_through(hidden(POSES, where, reported))
    assert [p.stamp_ns for p in kept] == left_out(POSES, where)
    assert counts == {"default_pose": len(where) - 1, "excursion": 1}


@given(
    st.lists(st.integers(0, 299), max_size=299, unique=True),
    st.sampled_from([IDENTITY, TURNED_ORIGIN]),
    st.sampled_from([30.0, 200.0, 1000.0]),
    st.integers(0, 10**6),
)
@example(where=[*range(0, 100), 150, *range(290, 300)], reported=IDENTITY, rate_hz=200.0, seed=1)
@example(where=[*range(1, 300, 2)], reported=IDENTITY, rate_hz=30.0, seed=1)
def test_the_origin_is_dropped_at_any_place_and_no_other_pose(
    where: list[int], reported: tuple[tuple[float, ...], tuple[float, ...]], rate_hz: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    poses = far_from_the_origin(smooth_poses(300, rate_hz, seed=seed))
    poses = replace(poses, position_m=poses.position_m + rng.normal(0.0, 0.001, (300, 3)))
    kept, counts = pass_through(hidden(poses, where, reported))
    assert [p.stamp_ns for p in kept] == left_out(poses, where)
    assert counts.get("default_pose", 0) == len(where)


def there_and_back(rest: int, count: int, reach_m: float) -> Array:
    """Rest at the origin, bit for bit, motion away and back, rest."""
    way = reach_m * smoothly(count)
    return along(np.concatenate([np.zeros(rest), way, way[::-1], np.zeros(rest)]))


def periodic(period: int, reach_m: float) -> Array:
    """The same poses repeatedly, bit for bit, exactly through the origin."""
    x = reach_m * np.sin(2 * np.pi * np.arange(period) / period)
    x[period // 2] = 0.0
    return along(np.tile(x, 6))


MOTIONS: dict[str, Callable[[float], Array]] = {
    "begins at the origin": lambda rate: along(0.5 * smoothly(int(2 * rate))),
    "rests at the origin": lambda rate: there_and_back(int(2 * rate), int(rate), 0.5),
    "rests at the origin for long": lambda rate: there_and_back(int(20 * rate), int(rate), 0.5),
    "never moves": lambda rate: along(np.zeros(int(30 * rate))),
    "one pose": lambda rate: along(np.zeros(1)),
    "passes through the origin": lambda rate: along(smoothly(2 * int(rate) + 1) - 0.5),
    "rests elsewhere": lambda rate: there_and_back(int(2 * rate), int(rate), 0.5) + AWAY,
    "is periodic": lambda rate: periodic(int(2 * rate), 0.3),
    "is periodic and fast": lambda rate: periodic(int(rate / 2), 0.3),
    "is periodic elsewhere": lambda rate: periodic(int(rate), 0.3) + AWAY,
    "is thrown": lambda rate: along(3.0 * np.arange(rate) / rate),
}


@pytest.mark.parametrize("name", MOTIONS)
@pytest.mark.parametrize(
    ("rate_hz", "turning", "frames"),
    [(10.0, True, None), (30.0, False, None), (200.0, False, None), (200.0, True, None), (100.0, False, 70)],
)
def test_exact_motion_loses_nothing(name: str, rate_hz: float, turning: bool, frames: int | None) -> None:
    """Also with dropouts of as many frames as there are between two of them."""
    position = MOTIONS[name](rate_hz)
    poses = motion(position, 2.0 * position if turning else None, rate_hz)
    if frames is not None:
        poses = poses[(np.arange(len(poses)) // frames) % 2 == 0]
    kept, counts = pass_through(poses)
    assert [p.stamp_ns for p in kept] == list(poses.stamp_ns)
    assert counts.keys() <= ({"held"} if frames is None else {"held", "gap"})


def test_an_object_that_only_turns_is_at_the_origin_all_the_time() -> None:
    turns = along(np.concatenate([np.zeros(100), 3.0 * smoothly(100), 3.0 * smoothly(100)[::-1]]))
    kept, _ = pass_through(poses := motion(0.0 * turns, turns))
    assert [p.stamp_ns for p in kept] == list(poses.stamp_ns)


def test_only_possible_default_poses_are_held() -> None:
    gate = PoseGate()
    assert [len(gate.admit(p)) for p in POSES] == [0, 1, 2] + [1] * 997
    gate, rows = PoseGate(), hidden(POSES, range(100), IDENTITY)
    passed = [len(gate.admit(p)) for p in rows]
    assert passed == [0] * (100 + KNOWN_POSES - 1) + [KNOWN_POSES] + [1] * (900 - KNOWN_POSES)


def test_the_wait_is_bounded() -> None:
    gate = PoseGate()
    passed = np.cumsum([len(gate.admit(p)) for p in motion(np.zeros((MOST_WAITING + 100, 3)))])
    assert passed[MOST_WAITING - 2] == 0
    assert passed[MOST_WAITING:].tolist() == list(range(MOST_WAITING + 1, MOST_WAITING + 101))


def test_after_a_gap_the_motion_may_be_anywhere() -> None:
    rows = [p._replace(stamp_ns=p.stamp_ns + (10**9 if i >= 500 else 0)) for i, p in enumerate(POSES)]
    rows[500:520] = [Pose(p.stamp_ns, *IDENTITY) for p in rows[500:520]]
    kept, counts = pass_through(rows)
    assert len(kept) == 980
    assert counts == {"gap": 1, "default_pose": 20}
