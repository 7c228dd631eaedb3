"""The pose gate: each rule, and invariants for any input."""

from collections import Counter
from collections.abc import Iterable
from itertools import pairwise
from math import inf, nan
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from contact_tracker.motion.pose_validation import NORM_TOLERANCE, RESET_RUN, PoseGate
from contact_tracker.motion.poses import Pose
from smooth_motion import pass_through

MS = 1_000_000
UNIT = (0.1, -0.7, 0.1, 0.7)


def pose(stamp_ns: int, x: float = 0.0, quat: tuple[float, float, float, float] = UNIT) -> Pose:
    return Pose(stamp_ns, (x, 0.1, 0.0), quat)


def places(poses: Iterable[Pose]) -> list[tuple[int, tuple[float, float, float]]]:
    return [(p.stamp_ns, p.position_m) for p in poses]


def regular(count: int, first: int = 0) -> list[Pose]:
    """Poses at 200 Hz whose position is the time in periods."""
    return [pose(5 * MS * i, 0.001 * i) for i in range(first, first + count)]


def test_repeated_and_late_stamps_are_dropped() -> None:
    stamps = [0, 5, 5, 10, 7, 15]
    kept, counts = pass_through([pose(s * MS, float(i)) for i, s in enumerate(stamps)])
    assert [p.stamp_ns // MS for p in kept] == [0, 5, 10, 15]
    assert counts == {"repeated_stamp": 1, "backward_stamp": 1}


def test_another_body_at_the_same_stamp_is_passed_on_and_no_third_pose() -> None:
    """One nanosecond later; a pose no farther than a step of the motion is dropped."""
    stamps = [0, 5, 10, 15, 15, 15, 20, 20, 25]
    places = [0.0, 0.004, 0.008, 0.012, 0.1, 0.2, 0.016, 0.017, 0.02]
    kept, counts = pass_through([pose(s * MS, x) for s, x in zip(stamps, places, strict=True)])
    assert [p.stamp_ns for p in kept] == [0, 5 * MS, 10 * MS, 15 * MS, 15 * MS + 1, 20 * MS, 25 * MS]
    assert counts == {"simultaneous": 1, "repeated_stamp": 2}


def test_a_held_pose_is_kept_and_counted() -> None:
    kept, counts = pass_through([pose(0), pose(5 * MS), pose(10 * MS, 1.0)])
    assert len(kept) == 3
    assert counts == {"held": 1}


def test_a_gap_is_longer_than_half_a_second_and_ten_periods() -> None:
    fast = [0, 5, 10, 15, 515, 520, 1025, 1030]
    assert pass_through([pose(s * MS, float(s)) for s in fast])[1] == {"gap": 1}
    slow = [0, 100, 200, 1100, 2201, 2301]
    assert pass_through([pose(s * MS, float(s)) for s in slow])[1] == {"gap": 1}
    once_per_second = [0, 1000, 2000, 3000]
    assert pass_through([pose(s * MS, float(s)) for s in once_per_second])[1] == {}


def test_after_a_clock_is_set_back_stamps_continue() -> None:
    before = [pose(1000 * MS + 5 * MS * i, float(i)) for i in range(50)]
    after = [pose(5 * MS * i, 50.0 + i) for i in range(60)]
    kept, counts = pass_through(before + after)
    assert counts == {"backward_stamp": RESET_RUN, "clock_reset": 1}
    assert len(kept) == 110 - RESET_RUN
    # as without the reset: the position is the true time
    assert [p.stamp_ns for p in kept] == [1000 * MS + 5 * MS * round(p.position_m[0]) for p in kept]


def test_two_clocks_on_one_topic_are_no_reset() -> None:
    mixed = [p for i in range(100) for p in (pose(10**9 + i * MS, float(i)), pose(i * MS, -1.0 - i))]
    kept, counts = pass_through(mixed)
    assert [p.stamp_ns for p in kept] == [10**9 + i * MS for i in range(100)]
    assert counts == {"backward_stamp": 100}


@pytest.mark.parametrize("ahead", [31 * MS, 10**9, 3600 * 10**9])
@pytest.mark.parametrize(("before", "leading"), [(0, 1), (1, 1), (2, 1), (30, 1), (30, 3)])
def test_leading_stamps_drop_no_other_pose(ahead: int, before: int, leading: int) -> None:
    ahead = max(ahead, 10**9) if leading > 1 else ahead  # three that are nearer pass for a gap
    bad = [pose(5 * MS * (before + i) + ahead, -1.0) for i in range(leading)]
    kept, counts = pass_through([*regular(before), *bad, *regular(40, before + leading)])
    assert places(kept) == places(regular(before) + regular(40, before + leading))
    assert counts == {"leading_stamp": leading}


@pytest.mark.parametrize("when", range(1, 25, 3))
@pytest.mark.parametrize("late", [31, 100, 250])
def test_one_late_pose_does_not_undo_a_run_after_a_gap(when: int, late: int) -> None:
    rows = regular(30) + regular(40, 300)
    rows.insert(30 + max(when, 2), pose(5 * MS * late + 1, -1.0))
    kept, counts = pass_through(rows)
    assert places(kept) == places(regular(30) + regular(40, 300))
    assert counts == {"gap": 1, "backward_stamp": 1}


def test_poses_are_held_no_longer_than_needed() -> None:
    gate = PoseGate()
    assert [len(gate.admit(p)) for p in regular(6)] == [0, 1, 2, 1, 1, 1]
    assert [len(gate.admit(p)) for p in regular(3, 26)] == [0, 0, 3]  # 0.1 s: two have to follow
    after_a_gap = [len(gate.admit(p)) for p in regular(30, 10_000)]
    assert after_a_gap == [0] * 20 + [21] + [1] * 9  # 0.1 s
    gate = PoseGate()
    slow = [pose(400 * MS * i, 0.001 * i) for i in (0, 1, 2, 3, 4, 100, 101, 102, 103)]
    assert [len(gate.admit(p)) for p in slow] == [0, 1, 0, 3, 1, 0, 0, 3, 1]


def test_at_the_end_one_leading_stamp_is_dropped_and_two_are_not() -> None:
    for count in (1, 2, 5):
        kept, counts = pass_through(regular(30) + regular(count, 300))
        assert len(kept) == 30 + (count if count > 1 else 0)
        assert counts == ({"gap": 1} if count > 1 else {"leading_stamp": 1})
    for stamps in ([7], [0, 10], [0, 10**12]):  # without periods to compare with
        assert len(pass_through([pose(ns, i / 1000) for i, ns in enumerate(stamps)])[0]) == len(stamps)


def test_a_clock_set_back_while_a_pose_is_held_is_a_reset() -> None:
    rows = [*regular(30, 1000), pose(10**10, -1.0), *regular(50)]
    kept, counts = pass_through(rows)
    assert counts == {"leading_stamp": 1, "backward_stamp": RESET_RUN, "clock_reset": 1}
    assert len(kept) == 30 + 50 - RESET_RUN


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


def mostly(usual: list[Any], odd: list[Any]) -> st.SearchStrategy[Any]:
    return st.integers(0, 60).flatmap(lambda i: st.sampled_from(usual if i else odd))


smooth_step = st.tuples(
    mostly([5 * MS, 5 * MS, 6 * MS], [k * MS for k in (24, 26, 80, 700, 1000, 0, -5, -1000)]),
    mostly([0.0, 0.001, 0.002, -0.002], [0.02, 0.5]),
    mostly([1.0, 1.0, -1.0], [1.01, 1.2]),
    mostly([None], [(0.0, 0.0, 0.0), (0.5, 0.0, 1.0), (nan, 0.0, 0.0)]),
)


def moving(rows: list[tuple[int, float, float, tuple[float, float, float] | None]]) -> list[Pose]:
    """Mostly smooth motion with regular stamps, with all faults of trackers and clocks."""
    poses, stamp_ns, x = list[Pose](), 0, 0.003
    for step_ns, step_m, factor, elsewhere in rows:
        stamp_ns, x = stamp_ns + step_ns, x + step_m
        a, b, c, d = (factor * component for component in ((0.0, 0.0, 0.0, 1.0) if elsewhere else UNIT))
        poses.append(Pose(stamp_ns, elsewhere or (x, 0.0, 0.0), (a, b, c, d)))
    return poses


motion = st.lists(smooth_step, min_size=20, max_size=120).map(moving)
DROPPED = (
    "nonfinite",
    "out_of_range",
    "bad_quaternion",
    "repeated_stamp",
    "backward_stamp",
    "leading_stamp",
    "excursion",
    "default_pose",
)


@given(st.lists(any_pose, max_size=80) | forward | motion)
def test_any_input_gives_valid_poses(poses: list[Pose]) -> None:
    counts: Counter[str] = Counter()
    gate = PoseGate(counts)
    kept = [p for row in poses for p in gate.admit(row)]
    kept += gate.finish()
    assert gate.finish() == ()
    assert len(kept) + sum(counts[kind] for kind in DROPPED) == len(poses)
    assert all(counts.values())  # kinds that do not occur stay absent
    sources = iter(poses)
    for p in kept:  # in the order in which they came, each once
        assert any(is_same(p, source, bool(counts["clock_reset"])) for source in sources)
        assert np.isfinite(p.position_m).all()
        assert np.linalg.norm(p.quat_xyzw) == pytest.approx(1.0, abs=1e-12)
    for a, b in pairwise(kept):
        assert b.stamp_ns > a.stamp_ns
        assert np.dot(a.quat_xyzw, b.quat_xyzw) >= -1e-15


def is_same(passed: Pose, source: Pose, shifted: bool) -> bool:
    """Whether both are the same pose, up to the norm and sign of the quaternion and, if ``shifted``, a stamp
    shifted by 1 ns."""
    if passed.position_m != source.position_m or not np.abs(source.quat_xyzw).max() < 2.0:
        return False
    norm = float(np.linalg.norm(source.quat_xyzw))
    same = abs(np.dot(passed.quat_xyzw, source.quat_xyzw)) == pytest.approx(norm, rel=1e-12)
    sound = abs(norm - 1.0) <= NORM_TOLERANCE + 1e-12
    return bool(same) and sound and (shifted or passed.stamp_ns - source.stamp_ns in (0, 1))
