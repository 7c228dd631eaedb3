"""The gate that poses pass: each rule by itself, and what holds whatever comes in."""

from collections import Counter
from collections.abc import Iterable
from itertools import pairwise
from math import inf, nan, sqrt

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from contact_tracker.gate import NORM_TOLERANCE, RANGE_M, RANGE_NS, RESET_RUN, PoseGate
from contact_tracker.poses import Pose, Poses

MS = 1_000_000
UNIT = (0.1, -0.7, 0.1, 0.7)


def pose(stamp_ns: int, x: float = 0.0, quat: tuple[float, float, float, float] = UNIT) -> Pose:
    return Pose(stamp_ns, (x, 0.0, 0.0), quat)


def pass_through(poses: list[Pose]) -> tuple[list[Pose], dict[str, int]]:
    gate = PoseGate()
    kept = [admitted for p in poses if (admitted := gate.admit(p)) is not None]
    return kept, dict(gate.counts)


@pytest.mark.parametrize("bad", [nan, inf, -inf])
def test_what_is_not_finite_is_dropped(bad: float) -> None:
    rows = [
        pose(0),
        Pose(1, (0.0, bad, 0.0), UNIT),
        Pose(2, (0.0, 0.0, 0.0), (0.0, 0.0, bad, 1.0)),
        pose(3, 1.0),
    ]
    kept, counts = pass_through(rows)
    assert [p.stamp_ns for p in kept] == [0, 3]
    assert counts == {"nonfinite": 2}


def test_infinities_of_both_signs_do_not_cancel() -> None:
    assert pass_through([Pose(0, (inf, -inf, 0.0), UNIT)]) == ([], {"nonfinite": 1})


def test_positions_too_large_to_square_are_dropped() -> None:
    kept, counts = pass_through([pose(0, 1e300), pose(1, -2 * RANGE_M), pose(2, RANGE_M)])
    assert [p.stamp_ns for p in kept] == [2]
    assert counts == {"out_of_range": 2}


def test_stamps_that_no_column_holds_are_dropped() -> None:
    stamps = [-(2**63) - 1, 0, 2**64, RANGE_NS, RANGE_NS + 1]
    kept, counts = pass_through([pose(stamp_ns, i) for i, stamp_ns in enumerate(stamps)])
    assert [p.stamp_ns for p in kept] == [0, RANGE_NS]
    assert counts == {"out_of_range": 3}
    gate = PoseGate()
    gate.admit(pose(RANGE_NS - 2))
    assert gate.admit_all(Poses.collect([pose(RANGE_NS - 1), pose(RANGE_NS)])) is not None
    assert gate.admit_all(Poses.collect([pose(RANGE_NS + 1)])) is None


@pytest.mark.parametrize(
    ("norm", "counted", "passes"),
    [
        (1.0 + 3e-5, {}, True),
        (1.02, {"renormalised": 1}, True),
        (0.97, {"renormalised": 1}, True),
        (1.06, {"bad_quaternion": 1}, False),
        (0.5, {"bad_quaternion": 1}, False),
        (0.0, {"bad_quaternion": 1}, False),
        (1e200, {"bad_quaternion": 1}, False),
    ],
)
def test_quaternions_become_unit_or_are_dropped(norm: float, counted: dict[str, int], passes: bool) -> None:
    x, y, z, w = (norm * c for c in UNIT)
    kept, counts = pass_through([pose(0, quat=(x, y, z, w))])
    assert counts == counted
    assert len(kept) == passes
    for p in kept:
        assert sqrt(sum(c * c for c in p.quat_xyzw)) == pytest.approx(1.0, abs=1e-15)


def test_signs_of_quaternions_become_continuous() -> None:
    flipped = tuple(-c for c in UNIT)
    kept, counts = pass_through([pose(0), Pose(1, (1.0, 0.0, 0.0), flipped), pose(2, 2.0)])
    assert len({p.quat_xyzw for p in kept}) == 1
    assert counts == {}


def test_repeated_and_late_stamps_are_dropped() -> None:
    stamps = [0, 5, 5, 10, 7, 15]
    kept, counts = pass_through([pose(s * MS, float(i)) for i, s in enumerate(stamps)])
    assert [p.stamp_ns // MS for p in kept] == [0, 5, 10, 15]
    assert counts == {"repeated_stamp": 1, "backward_stamp": 1}


def test_a_held_pose_is_kept_and_counted() -> None:
    kept, counts = pass_through([pose(0), pose(5 * MS), pose(10 * MS, 1.0)])
    assert len(kept) == 3
    assert counts == {"held": 1}


def test_a_gap_is_longer_than_half_a_second_and_ten_periods() -> None:
    fast = [0, 5, 10, 15, 515, 520, 1025]
    assert pass_through([pose(s * MS, float(s)) for s in fast])[1] == {"gap": 1}
    slow = [0, 100, 200, 1100, 2201]
    assert pass_through([pose(s * MS, float(s)) for s in slow])[1] == {"gap": 1}
    once_per_second = [0, 1000, 2000, 3000]
    assert pass_through([pose(s * MS, float(s)) for s in once_per_second])[1] == {}


def test_a_clock_that_is_set_back_goes_on_where_time_stood() -> None:
    before = [pose(1000 * MS + 5 * MS * i, float(i)) for i in range(50)]
    after = [pose(5 * MS * i, 50.0 + i) for i in range(60)]
    kept, counts = pass_through(before + after)
    assert counts == {"backward_stamp": RESET_RUN, "clock_reset": 1}
    assert len(kept) == 110 - RESET_RUN
    # As if the clock had never been touched: the position tells the time that really passed.
    assert [p.stamp_ns for p in kept] == [1000 * MS + 5 * MS * round(p.position_m[0]) for p in kept]


def test_two_clocks_on_one_topic_never_look_like_a_reset() -> None:
    mixed = [p for i in range(100) for p in (pose(10**9 + i * MS, float(i)), pose(i * MS, -1.0 - i))]
    kept, counts = pass_through(mixed)
    assert [p.stamp_ns for p in kept] == [10**9 + i * MS for i in range(100)]
    assert counts == {"backward_stamp": 100}


def test_stale_poses_without_order_never_look_like_a_reset() -> None:
    stale = [pose(100 * MS - i * MS, float(i)) for i in range(3 * RESET_RUN)]
    kept, counts = pass_through([pose(200 * MS, -1.0), *stale])
    assert len(kept) == 1
    assert counts == {"backward_stamp": 3 * RESET_RUN}


numbers = st.floats(-2.0, 2.0) | st.sampled_from([nan, inf, -inf, 1e308, 0.0, 1.0])
unit = st.tuples(*[st.floats(-1.0, 1.0)] * 4).filter(lambda q: np.linalg.norm(q) > 0.1)
scaled = st.builds(
    lambda q, k: tuple(float(c) for c in k * np.array(q) / np.linalg.norm(q)), unit, st.floats(0.9, 1.1)
)
quats = scaled | st.tuples(numbers, numbers, numbers, numbers)
any_pose = st.builds(Pose, st.integers(-(10**10), 10**10), st.tuples(numbers, numbers, numbers), quats)
forward = st.lists(st.tuples(st.integers(-2, 30), any_pose), max_size=80).map(
    lambda rows: [
        p._replace(stamp_ns=sum(step for step, _ in rows[: i + 1])) for i, (_, p) in enumerate(rows)
    ]
)


@given(st.lists(any_pose, max_size=80) | forward)
def test_whatever_comes_in_what_goes_on_is_sound(poses: list[Pose]) -> None:
    counts: Counter[str] = Counter()
    gate = PoseGate(counts)
    admitted = [gate.admit(p) for p in poses]
    kept = [p for p in admitted if p is not None]
    dropped = ("nonfinite", "out_of_range", "bad_quaternion", "repeated_stamp", "backward_stamp")
    assert len(kept) + sum(counts[kind] for kind in dropped) == len(poses)
    for source, p in zip(poses, admitted, strict=True):
        if p is None:
            continue
        assert p.position_m == source.position_m
        assert np.isfinite(p.position_m).all()
        quat = np.array(p.quat_xyzw)
        assert np.linalg.norm(quat) == pytest.approx(1.0, abs=1e-12)
        norm = np.linalg.norm(source.quat_xyzw)
        assert abs(norm - 1.0) <= NORM_TOLERANCE + 1e-12
        assert abs(quat @ np.array(source.quat_xyzw)) == pytest.approx(norm, rel=1e-12)  # same rotation
    for a, b in pairwise(kept):
        assert b.stamp_ns > a.stamp_ns
        assert np.dot(a.quat_xyzw, b.quat_xyzw) >= -1e-15
    if not counts["clock_reset"]:
        stamps = [p.stamp_ns for p in kept]
        assert stamps == [s.stamp_ns for s, p in zip(poses, admitted, strict=True) if p is not None]


mild = st.builds(
    Pose,
    st.sampled_from([1, 5, 5, 5, 5, 700 * MS, 0, -7]),
    st.sampled_from([(0.0, 0.0, 1.0), (0.1, 0.2, 0.3), (0.1, 0.2, 0.3), (2 * RANGE_M, 0.0, 0.0)]),
    st.sampled_from([UNIT, UNIT, (-0.1, 0.7, -0.1, -0.7), (0.0, 0.6, 0.0, -0.8), (0.0, -0.6, 0.0, 0.8)])
    | st.sampled_from([(1e-9, 0.0, 0.0, 1.0), (0.0, 0.0, 1.0, 0.0), (0.0, 0.0, 0.0, 1.01), (nan,) * 4]),
)
stream = st.lists(mild, max_size=60).map(
    lambda rows: [p._replace(stamp_ns=sum(step for step, *_ in rows[: i + 1])) for i, p in enumerate(rows)]
)


@given(stream | st.lists(any_pose, max_size=80), st.integers(1, 12))
def test_in_columns_the_same_passes_and_is_counted(poses: list[Pose], batch: int) -> None:
    """Many at once, or none of them and nothing has happened: then they go one by one."""
    one_by_one, gate = PoseGate(), PoseGate()
    for first in range(0, len(poses), batch):
        rows = poses[first : first + batch]
        expected = [p for row in rows if (p := one_by_one.admit(row)) is not None]
        columns: Iterable[Pose] | None = gate.admit_all(Poses.collect(rows))
        if columns is None:
            columns = [p for row in rows if (p := gate.admit(row)) is not None]
        assert list(columns) == expected
        assert gate.counts == one_by_one.counts
        assert vars(gate) == {**vars(one_by_one), "_raw": gate._raw}
        assert str(gate._raw) == str(one_by_one._raw)  # nan is not itself


def test_sound_poses_pass_in_columns() -> None:
    turn = np.linspace(0.0, 3.0, 50)
    sign = np.where(np.arange(50) % 7 < 3, -1.0, 1.0)
    quat = np.array([np.sin(turn), 0 * turn, 0 * turn, np.cos(turn)]).T * sign[:, None]
    poses = Poses(5 * MS * np.arange(50), np.ones((50, 3)), quat)
    gate = PoseGate()
    gate.admit(next(iter(poses)))
    columns = gate.admit_all(poses[1:])
    assert columns is not None
    kept, _ = pass_through(list(poses))
    assert list(columns) == kept[1:]
