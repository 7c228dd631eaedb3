"""Remarks on poses that the gate drops: how many of which kind, and the likely cause where they are many."""

from collections.abc import Mapping, Sequence
from math import sqrt
from types import MappingProxyType
from typing import Final

import numpy as np
from numpy.typing import NDArray

from contact_tracker.motion.pose_validation import NORM_TOLERANCE, RESET_RUN
from contact_tracker.motion.poses import NO_OUTLIERS, Outliers

MANY_BACKWARD: Final = 0.2
"""Share of poses out of order that single wrong stamps do not explain."""
MOST_REPEATED: Final = 0.6
"""Largest share of poses with the time of another pose where each is published twice."""
_BACKWARD: Final = "sort them by time; if they are of several bodies, record each on a topic of its own"


def counts_text(counts: Mapping[str, int], outliers: Outliers = NO_OUTLIERS, origin_ns: int = 0) -> str:
    """``gap 1, outlier 9 (at 1.25, 3.10, 7.00 s, ...)``: numbers by kind, and the times of the first
    ``outliers`` in seconds after ``origin_ns``."""
    at_s = ", ".join(f"{1e-9 * (stamp_ns - origin_ns):.2f}" for stamp_ns in outliers.first_stamps_ns)
    dots = ", ..." if outliers.total > len(outliers.first_stamps_ns) else ""
    places = {"outlier": f" (at {at_s} s{dots})"} if at_s else {}
    return ", ".join(f"{kind} {count}{places.get(kind, '')}" for kind, count in counts.items() if count)


def remarks_on(counts: Mapping[str, int], total: int) -> tuple[str, ...]:
    """Warnings, one line for each reason for which many of ``total`` poses were dropped; none if most were,
    see ``remark_on_loss``."""
    if remark_on_loss(counts, total) is not None:
        return ()
    backward = counts.get("backward_stamp", 0) - RESET_RUN * counts.get("clock_reset", 0)
    text = f"{backward} of {total} poses are earlier than one before them and are left out: {_BACKWARD}"
    return tuple(
        filter(None, (text if backward > MANY_BACKWARD * total else None, remark_on_excursions(counts)))
    )


_CAUSES: Final[Mapping[str, str]] = MappingProxyType(
    {
        "nonfinite": "they are no numbers, as where the object is hidden",
        "out_of_range": "they are beyond 1000 km or 146 years: is the unit of the stamps or positions right? "
        "Subtract a constant from coordinates of a map (UTM)",
        "repeated_stamp": "they have the time of the one before: write more digits, if times are rounded; if "
        "they are of several bodies, read those of one",
        "backward_stamp": f"they are earlier than one before them: {_BACKWARD}",
        "leading_stamp": "their times jump ahead, and back",
        "default_pose": "one pose comes back bit for bit, as where the object is hidden",
        "excursion": "they jump away and back, as those of another body",
        "undecodable": "the messages do not match their definition",
        "no_parent": "they are before or after the poses of the frame that they are relative to",
        "parent_gap": "the frame that they are relative to was not known for more than a second",
    }
)
"""Why poses are dropped, by kind; of quaternions see ``_cause_of_norm``."""
_BEFORE_THE_GATE: Final = "undecodable", "no_parent", "parent_gap"
"""Kinds of poses that do not reach the gate, which counts the others."""


def remark_on_loss(
    counts: Mapping[str, int], total: int, refused_xyzw: Sequence[float] | None = None
) -> str | None:
    """One line with the likely cause if more than half of ``total`` poses were dropped.

    Poses that are published twice are no loss. ``refused_xyzw`` is the first quaternion of a wrong norm.
    """
    lost = {kind: counts.get(kind, 0) for kind in (*_CAUSES, "bad_quaternion")}
    lost["backward_stamp"] -= RESET_RUN * counts.get("clock_reset", 0)
    total += sum(lost[kind] for kind in _BEFORE_THE_GATE)
    if lost["repeated_stamp"] <= MOST_REPEATED * total:
        total -= lost.pop("repeated_stamp")
    dropped = sum(lost.values())
    if 2 * dropped <= total:
        return None
    kind = max(lost, key=lambda kind: lost[kind])
    cause = _CAUSES[kind] if kind in _CAUSES else _cause_of_norm(refused_xyzw)
    return f"{dropped} of {total} poses are left out, {lost[kind]} of them as {kind}: {cause}"


def _cause_of_norm(quat_xyzw: Sequence[float] | None) -> str:
    """The likely cause of quaternions that have another norm than 1, by one of them."""
    if quat_xyzw is None:
        return "the norm of quaternions is 1"
    norm = sqrt(sum(part * part for part in quat_xyzw))
    norm_text = f"the norm of ({' '.join(f'{part:.6g}' for part in quat_xyzw)}) is {norm:.6g}, not 1"
    w = quat_xyzw[3]
    twice = next((name for name, part in zip("xyz", quat_xyzw, strict=False) if part == w != 0.0), None)
    if norm == 0.0:
        return (
            "the quaternions are zero, or matrices are no rotations: is the orientation recorded, unscaled?"
        )
    if twice is not None:
        return f"{norm_text}, and w equals {twice}: is one column taken for both?"
    if norm > 2.0 and all(map(float.is_integer, map(float, quat_xyzw))):
        return f"{norm_text}: if these are integers that stand for fractions, divide them by their scale"
    return f"{norm_text}: are they the four parts of one quaternion?"


def first_refused(quat_xyzw: NDArray[np.float64]) -> Sequence[float] | None:
    """The first of some quaternions (n, 4) with a wrong norm."""
    with np.errstate(all="ignore"):
        is_wrong = np.abs(np.linalg.norm(quat_xyzw, axis=1) - 1.0) > NORM_TOLERANCE
    return quat_xyzw[is_wrong.argmax()].tolist() if is_wrong.any() else None


def remark_on_excursions(counts: Mapping[str, int]) -> str | None:
    """One line if there are long excursions."""
    count = counts.get("long_excursion", 0)
    if not count:
        return None
    return (
        "the poses jump to another place, for half a second or more, and back as no motion does "
        f"(stretches: {count}, poses left out: {counts.get('excursion', 0)}): another body or marker in the "
        "place of this one? give each a topic, frame or name of its own"
    )
