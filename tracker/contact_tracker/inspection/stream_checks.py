"""Findings in a stream of poses that the user has to know, because labels would be wrong otherwise.

All statistics are computed on blocks of poses counted from the first one, so that they do not depend on
batches. Repeated poses are left out.
"""

from collections.abc import Sequence
from math import inf, pi, sqrt
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.geometry.rotation import between, rotation_vectors
from contact_tracker.inspection import turning_point
from contact_tracker.inspection.turning_point import NO_TURNING_POINTS, TurningPoints
from contact_tracker.inspection.two_bodies import ALARM, BACK, is_of_two_bodies, page_sum, returned
from contact_tracker.inspection.whiteness import NOTHING_COMPARED, REACH, Whiteness, compare, is_filtered
from contact_tracker.motion.poses import AS_GIVEN, NO_POSES, Poses, ReadAs
from contact_tracker.motion.sensor_noise import MEDIAN_OF_CHI_SQ, SCALE, independent_point

Array = NDArray[np.float64]

BLOCK: Final = 50
"""Poses per block."""
BEGINNING: Final = 40
"""Number of first blocks of which all poses count for the noise; later every fourth does."""
KEPT: Final = BLOCK + REACH + 1

# Units: bounds that noise and motion of an object in metres never exceed together.
LEVER_M: Final = 3.0
"""Noise of position over that of orientation (m/rad): 0.03 to 0.5 of usual sensors, 1 of poor cameras."""
COARSE_M: Final = 0.01
"""Position noise above which such a ratio occurs only in other units; that of a mobile robot is a few mm."""
FAST_M_PER_S: Final = 15.0
TOSSED_CM_PER_S: Final = 500.0
USUAL_LEVER_M: Final = 0.12
SMALL_LEVER_M: Final = 0.0025
"""Such a ratio below, at a speed below ``SLOW_M_PER_S``, occurs only where positions are divided by 100 or
1000: orientation comes from markers or features that are centimetres apart."""
SLOW_M_PER_S: Final = 0.01
COARSE_RAD: Final = 0.03
"""Larger third differences of orientation are motion between poses at a low rate, not noise."""
ENOUGH_NOISE: Final = 40
"""Third differences that are needed for the noise."""

CONSTANT: Final = 1e-9
"""Smaller differences are rounding (m, or of a unit quaternion)."""
ENOUGH_CONSTANT: Final = 100
STILL: Final = "still"
"""The kind of the finding that the pose never changes."""

# Histogram of squared third differences: four bins to a factor of 4, from 1e-15 to 3e6.
BINS: Final = 285
LOWEST: Final = -100.0


class Finding(NamedTuple):
    """One finding: ``text`` is one line with a remedy."""

    kind: str
    text: str
    doubts_labels: bool


class Inspection(NamedTuple):
    """Running statistics of a stream of poses; bounded in size.

    ``recent`` are the last KEPT poses of the ``blocks`` before, and those of the incomplete block. ``first``
    is the first of ``total`` poses, ``repeats`` the number of others; ``moved`` says whether position and
    orientation have changed since.
    ``noise`` (2, BINS) is a histogram of squared third differences of both; ``top_m_per_s`` the speed of the
    fastest block. ``page`` is the sum of Page's test, ``share`` the share of returns in the last block.
    ``turning`` has the points of rotation. ``units``, ``bodies`` and ``filtered`` say what was found at any
    time. ``read_as``: how the poses were read, as the user asked.
    """

    recent: Poses = NO_POSES
    first: Poses = NO_POSES
    total: int = 0
    repeats: int = 0
    blocks: int = 0
    moved: tuple[bool, bool] = (False, False)
    noise: Array = np.zeros((2, BINS))
    top_m_per_s: float = 0.0
    page: float = 0.0
    share: float = 0.0
    whiteness: Whiteness = NOTHING_COMPARED
    turning: TurningPoints = NO_TURNING_POINTS
    units: bool = False
    bodies: bool = False
    filtered: bool = False
    read_as: ReadAs = AS_GIVEN


NOTHING_INSPECTED: Final = Inspection()


def inspect(inspection: Inspection, poses: Poses) -> Inspection:
    """Advance by the next poses (at least one) that have passed the gate."""
    last = inspection.recent[-1:]
    new = Poses.join([last, poses]).fresh[len(last) :]
    inspection = inspection._replace(repeats=inspection.repeats + len(poses) - len(new))
    if not len(new):
        return inspection
    first = inspection.first if inspection.total else new[np.zeros(1, int)]
    total, recent = inspection.total + len(new), Poses.join([inspection.recent, new])
    turning = turning_point.advance(inspection.turning, new)
    moved = _moved(inspection.moved, first, new)
    inspection = inspection._replace(first=first, total=total, moved=moved, turning=turning)
    end = len(recent) - (total - BLOCK * inspection.blocks)
    while total - BLOCK * inspection.blocks >= BLOCK:
        end += BLOCK
        inspection = _inspect_block(inspection, recent[max(end - BLOCK - KEPT, 0) : end])
    return inspection._replace(recent=recent[max(end - KEPT, 0) :])


def findings(inspection: Inspection, fitting_units: Sequence[str] = ()) -> tuple[Finding, ...]:
    """Findings in the stream so far; ``fitting_units`` of positions are those in which contacts explain the
    motion, unlike in metres."""
    found = list[Finding]()
    if inspection.units:
        found.append(Finding("units", _units_text(inspection, fitting_units), True))
    elif _are_too_small(inspection):
        found.append(Finding("units", _too_small_text(inspection), False))
    if inspection.bodies:
        share = f" ({100.0 * inspection.share:.0f} % of the frames)" if inspection.share else ""
        text = (
            f"poses jump back and forth between two places{share}: two bodies on one topic? "
            "choose one with --topic or --frame, or record them on topics of their own"
        )
        found.append(Finding("bodies", text, True))
    if inspection.repeats >= ENOUGH_CONSTANT and not any(inspection.moved):
        found.append(Finding(STILL, "the pose never changes: is the object tracked, in this frame?", False))
    elif inspection.total >= ENOUGH_CONSTANT and not all(inspection.moved):
        # With known elements (--known) either half of the poses alone gives labels that are sure and wrong.
        what, hint = ("position", "contacts need both") if inspection.moved[1] else ("orientation", _ROTATION)
        found.append(Finding("orientation", f"the {what} never changes: is it recorded? {hint}", True))
    if inspection.turning.are_inverse and not inspection.read_as.frame_moves:
        from_body_m, from_world_m = inspection.turning.median_m
        text = (
            f"poses look inverse, of the world in the body (they turn about points {from_body_m:.1f} m from "
            f"the body's origin and {from_world_m:.1f} m from the world's): "
            "invert them, or, if the body's origin is that far from the object, give it one near the object"
        )
        found.append(Finding("inverse", text, True))
    if inspection.filtered and not inspection.bodies:
        found.append(Finding("filtered", _FILTERED, False))
    return tuple(found)


_ROTATION: Final = "contacts are recognised by rotation"
_FILTERED: Final = (
    "poses look filtered, interpolated or rounded (successive errors are correlated): the noise of a tick is "
    "judged by evidence; record raw poses if you can, or give the noise with --noise"
)


def _units_text(inspection: Inspection, fitting_units: Sequence[str]) -> str:
    position, rotation = _sigma(inspection.noise[0]), _sigma(inspection.noise[1])
    lever = position / rotation if rotation else inspection.top_m_per_s
    small = lever > USUAL_LEVER_M * sqrt(1e2 * 1e3) or inspection.top_m_per_s > TOSSED_CM_PER_S
    name, unit = ("millimetres", "mm") if small else ("centimetres", "cm")
    figures = (
        f"(noise {1e3 * position:.3g} mm, {180.0 / pi * rotation:.2g} deg; "
        f"speed up to {inspection.top_m_per_s:.2g} m/s)"
    )
    if unit not in fitting_units:
        return f"positions are too noisy or too fast for metres {figures}: check their unit and their source"
    return (
        f"positions look like {name} {figures}: convert them to metres, or, if they are of a table, take "
        f"--unit {unit}"
    )


def _too_small_text(inspection: Inspection) -> str:
    position, rotation = _sigma(inspection.noise[0]), _sigma(inspection.noise[1])
    return (
        f"positions look too small for metres (noise {1e6 * position:.2g} um, "
        f"{180.0 / pi * rotation:.2g} deg; speed up to {1e3 * inspection.top_m_per_s:.2g} mm/s): check their "
        "unit (of a table: --unit); if that is right, orientations are rounded: record more of their digits"
    )


def _moved(moved: tuple[bool, bool], first: Poses, new: Poses) -> tuple[bool, bool]:
    if all(moved):
        return moved
    position = bool(np.abs(new.position_m - first.position_m).max() > CONSTANT)
    turned = bool(np.abs(new.quat_xyzw - first.quat_xyzw).max() > CONSTANT)
    return moved[0] or position, moved[1] or turned


def _inspect_block(before: Inspection, window: Poses) -> Inspection:
    """Advance by the last BLOCK poses of ``window``; the others are those before."""
    blocks = before.blocks + 1
    if before.bodies:
        return before._replace(blocks=blocks)
    near = window[-BLOCK - BACK :]
    time_s = 1e-9 * (near.stamp_ns - near.stamp_ns[0])
    interval_s = _median(np.diff(time_s))
    back = returned(near, interval_s)
    are_close = is_of_two_bodies(window[-BLOCK:])
    page, bodies = page_sum(before.page, back | are_close)
    top_m_per_s = max(before.top_m_per_s, _speed(near.position_m, time_s))
    after = before._replace(
        blocks=blocks, page=page, share=float(back.mean()), bodies=bodies, top_m_per_s=top_m_per_s
    )
    if blocks <= 2:
        return _inspect_noise(after, window[-BLOCK - 4 :], BLOCK, interval_s)
    if blocks % (2 if blocks <= BEGINNING else 8) == 0:
        return _inspect_noise(after, window, 2 * BLOCK, interval_s)
    return after


def _inspect_noise(before: Inspection, window: Poses, new: int, interval_s: float) -> Inspection:
    """Add the third differences that end in the last ``new`` poses of ``window``."""
    turns = rotation_vectors(between(window.quat_xyzw[:-1], window.quat_xyzw[1:])).cumsum(axis=0)
    smooth = np.concatenate([window.position_m[1:], turns], axis=1)
    after = before._replace(noise=before.noise + _histogram(smooth[-new - 3 :]))
    if not before.filtered and len(smooth) >= REACH + new:
        whiteness = compare(before.whiteness, smooth, new, interval_s)
        after = after._replace(whiteness=whiteness, filtered=is_filtered(whiteness))
    if after.units or after.bodies or not _are_other_units(after):
        return after
    near = window.of_point(independent_point(window))  # an origin far away has the noise of the orientation
    smooth[:, :3] = near.position_m[1:]
    return after._replace(units=_are_other_units(after._replace(noise=_histogram(smooth[-new - 3 :]))))


def _median(values: Array) -> float:
    return float(np.partition(values, len(values) // 2)[len(values) // 2])


def _are_other_units(inspection: Inspection) -> bool:
    if inspection.noise[0].sum() < ENOUGH_NOISE or inspection.page > 0.5 * ALARM:
        return False
    position, rotation = _sigma(inspection.noise[0]), _sigma(inspection.noise[1])
    if position <= LEVER_M * rotation:
        return False
    return inspection.top_m_per_s > FAST_M_PER_S or (rotation > 0.0 and position > COARSE_M)


def _are_too_small(inspection: Inspection) -> bool:
    if inspection.total < ENOUGH_CONSTANT or not all(inspection.moved):
        return False
    position, rotation = _sigma(inspection.noise[0]), _sigma(inspection.noise[1])
    is_small = 0.0 < position < SMALL_LEVER_M * rotation and rotation < COARSE_RAD
    return is_small and inspection.top_m_per_s < SLOW_M_PER_S


def _speed(position: Array, time_s: Array) -> float:
    """Median distance over the poses, each from the one BACK before it."""
    path = position[BACK:] - position[:-BACK]
    return _median(np.sqrt(np.einsum("ni,ni->n", path, path)) / (time_s[BACK:] - time_s[:-BACK]))


def _histogram(smooth: Array) -> Array:
    """Histogram (2, BINS) of the squared third differences of position and orientation, scaled to the
    noise."""
    third = np.diff(smooth, 3, axis=0) / SCALE
    length_sq = np.square(third).reshape(-1, 2, 3).sum(axis=2)
    with np.errstate(divide="ignore"):
        rows = np.clip(2.0 * np.log2(length_sq) - LOWEST, 0, BINS - 1).astype(int)
    return np.array([np.bincount(row, minlength=BINS) for row in rows.T], float)


def _sigma(counts: Array) -> float:
    """Standard deviation per axis from the median of the squares; 0 where they are zero."""
    total = counts.cumsum()
    middle = int(np.searchsorted(total, 0.5 * total[-1]))
    if middle == 0:
        return 0.0 if total[-1] else inf
    share = (0.5 * total[-1] - total[middle - 1]) / counts[middle]
    return sqrt(2.0 ** (0.5 * (LOWEST + middle + share)) / MEDIAN_OF_CHI_SQ)
