"""What a stream of poses shows of itself that the user has to know, because labels would be wrong otherwise.

Everything is computed from blocks of poses that are counted from the first one, so that nothing depends on how
the stream is cut into batches. Poses that are held are left out.
"""

from math import inf, log, pi, sqrt
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.noise import MEDIAN_OF_CHI_SQ, SCALE
from contact_tracker.poses import NO_POSES, Poses
from contact_tracker.quaternions import between, rotation_vectors
from contact_tracker.whiteness import NOTHING_COMPARED, REACH, Whiteness, compare, is_filtered

Array = NDArray[np.float64]

BLOCK: Final = 64
"""Poses that are looked at together."""

# Units: what noise and motion of an object in metres never show together.
LEVER_M: Final = 3.0
"""Noise of position over that of orientation (m/rad): 0.03 to 0.5 of usual sensors, 1 of poor cameras."""
COARSE_M: Final = 0.01
"""Noise of position that comes with a lever that long in other units only; a mobile robot's is a few mm."""
FAST_M_PER_S: Final = 15.0
FAST_BLOCKS: Final = 2
USUAL_LEVER_M: Final = 0.12
ENOUGH_NOISE: Final = 96
"""Third differences before the noise is known."""

# Bodies: returns to one of the last few poses after a step that is far for all of them.
BACK: Final = 8
"""So many poses back."""
ARM_M: Final = 0.1
"""A rotation moves by this much per radian."""
FAR_M: Final = 0.01
FAR_STEPS: Final = 8.0
FAR_M_PER_S2: Final = 50.0
"""No hand shakes an object faster than that."""
CLOSE: Final = 0.25
"""Of the step, the distance from the pose that is returned to."""
# Page's test: with returns in 15 % of the poses the sum drifts down, with 45 % it rises; the chance of a false
# alarm is about exp(-ALARM) a pose.
RETURN: Final = log(0.45 / 0.15)
NO_RETURN: Final = log(0.55 / 0.85)
ALARM: Final = 25.0

CONSTANT: Final = 1e-9
"""Less is rounding (m, or of a unit quaternion)."""
ENOUGH_CONSTANT: Final = 100

# Histogram of squared third differences: four bins to a factor of 4, from 1e-15 to 3e6.
BINS: Final = 285
LOWEST: Final = -100.0


class Finding(NamedTuple):
    """One thing to say: ``text`` is one line, with what to try."""

    kind: str
    text: str
    doubts_labels: bool


class Inspection(NamedTuple):
    """Running sums of a stream of poses; bounded.

    ``recent`` are the last poses of the blocks before and those that wait for their block to be full.
    ``first`` is the first pose, of ``count``; ``moved`` says whether position and orientation have changed
    since. ``noise`` (2, BINS) counts squared third differences of position and orientation; ``fast_blocks``
    were fast, ``top_m_per_s`` the fastest. ``returns`` of ``steps`` went back; ``page`` is the sum of Page's
    test. ``units`` and ``bodies`` were found at some time.
    """

    recent: Poses
    waiting: int
    first: Poses
    count: int
    moved: tuple[bool, bool]
    noise: Array
    fast_blocks: int
    top_m_per_s: float
    steps: int
    returns: int
    page: float
    whiteness: Whiteness
    units: bool
    bodies: bool


NOTHING_INSPECTED: Final = Inspection(
    recent=NO_POSES,
    waiting=0,
    first=NO_POSES,
    count=0,
    moved=(False, False),
    noise=np.zeros((2, BINS)),
    fast_blocks=0,
    top_m_per_s=0.0,
    steps=0,
    returns=0,
    page=0.0,
    whiteness=NOTHING_COMPARED,
    units=False,
    bodies=False,
)


def inspect(inspection: Inspection, poses: Poses) -> Inspection:
    """Take in the next poses of the stream, at least one, as the gate passes them on."""
    known = len(inspection.recent)
    joined = Poses.join([inspection.recent, poses]).fresh
    new = joined[known:]
    if not len(new):
        return inspection
    first = inspection.first if inspection.count else new[:1]
    inspection = inspection._replace(
        recent=joined,
        waiting=inspection.waiting + len(new),
        first=first,
        count=inspection.count + len(new),
        moved=_moved(inspection.moved, first, new),
    )
    while inspection.waiting >= BLOCK:
        end = len(inspection.recent) - inspection.waiting + BLOCK
        inspection = _inspect_block(inspection, inspection.recent[max(end - BLOCK - REACH, 0) : end])
        inspection = inspection._replace(waiting=inspection.waiting - BLOCK)
    return inspection._replace(recent=inspection.recent[-REACH - inspection.waiting :])


def findings(inspection: Inspection) -> tuple[Finding, ...]:
    """What is to be said of the stream so far."""
    found = list[Finding]()
    if inspection.units:
        found.append(Finding("units", _units_text(inspection), True))
    if inspection.bodies:
        share = 100.0 * inspection.returns / inspection.steps
        text = (
            f"poses jump back and forth between two places ({share:.0f} % of all frames): two bodies on one "
            "topic? choose one with --topic or --frame, or record them on topics of their own"
        )
        found.append(Finding("bodies", text, True))
    if inspection.count >= ENOUGH_CONSTANT and not all(inspection.moved):
        what, hint = ("position", "contacts need both") if inspection.moved[1] else ("orientation", _ROTATION)
        found.append(Finding("orientation", f"the {what} never changes: is it recorded? {hint}", True))
    if not inspection.bodies and is_filtered(inspection.whiteness):
        found.append(Finding("filtered", _FILTERED, False))
    return tuple(found)


def is_in_doubt(inspection: Inspection) -> bool:
    """Whether something was found that makes labels wrong."""
    return any(finding.doubts_labels for finding in findings(inspection))


_ROTATION: Final = "contacts are told by rotation"
_FILTERED: Final = (
    "poses look filtered or interpolated (successive errors are correlated): the noise of a tick is judged by "
    "evidence; record raw poses if you can, or give the noise with --noise"
)


def _units_text(inspection: Inspection) -> str:
    position, rotation = _sigma(inspection.noise[0]), _sigma(inspection.noise[1])
    lever = position / rotation if rotation else inspection.top_m_per_s
    unit = "millimetres" if lever > USUAL_LEVER_M * sqrt(1e2 * 1e3) else "centimetres"
    return (
        f"positions look like {unit} (noise {1e3 * position:.3g} mm, {180.0 / pi * rotation:.2g} deg; "
        f"speed up to {inspection.top_m_per_s:.2g} m/s): convert to metres"
    )


def _moved(moved: tuple[bool, bool], first: Poses, new: Poses) -> tuple[bool, bool]:
    if all(moved):
        return moved
    position = np.abs(new.position_m - first.position_m).max() > CONSTANT
    return moved[0] or bool(position), moved[1] or bool(np.abs(new.quat_xyzw - first.quat_xyzw).max() > CONSTANT)


def _inspect_block(before: Inspection, window: Poses) -> Inspection:
    """Take in the last BLOCK poses of ``window``; the others came before."""
    if before.bodies:
        return before
    position, quat, time_s = window.position_m, window.quat_xyzw, 1e-9 * (window.stamp_ns - window.stamp_ns[0])
    steps_s = time_s[-BLOCK + 1 :] - time_s[-BLOCK:-1]
    interval_s = float(np.partition(steps_s, len(steps_s) // 2)[len(steps_s) // 2])
    turns = rotation_vectors(between(quat[:-1], quat[1:]))
    smooth = np.concatenate([position, np.append(np.zeros((1, 3)), turns.cumsum(axis=0), axis=0)], axis=1)
    whiteness = before.whiteness
    if len(window) == REACH + BLOCK:
        whiteness = compare(whiteness, smooth, BLOCK, interval_s)
    speed = _speed(position[-BLOCK - BACK :], time_s[-BLOCK - BACK :])
    returned = _returned(window[-BLOCK - BACK :], interval_s)
    page, bodies = _page(before.page, returned)
    after = before._replace(
        noise=before.noise + _histogram(smooth[-BLOCK - 3 :]),
        fast_blocks=before.fast_blocks + (speed > FAST_M_PER_S),
        top_m_per_s=max(before.top_m_per_s, speed),
        steps=before.steps + len(returned),
        returns=before.returns + int(returned.sum()),
        page=page,
        whiteness=whiteness,
        bodies=bodies,
    )
    return after if after.units or bodies else after._replace(units=_are_other_units(after))


def _are_other_units(inspection: Inspection) -> bool:
    if inspection.noise[0].sum() < ENOUGH_NOISE or inspection.page > 0.5 * ALARM:
        return False
    position, rotation = _sigma(inspection.noise[0]), _sigma(inspection.noise[1])
    if position <= LEVER_M * rotation:
        return False
    return inspection.fast_blocks >= FAST_BLOCKS or (rotation > 0.0 and position > COARSE_M)


def _speed(position: Array, time_s: Array) -> float:
    """Median over the poses, each from the one BACK before it."""
    paths = np.sqrt(np.square(position[BACK:] - position[:-BACK]).sum(axis=1))
    speeds = paths / (time_s[BACK:] - time_s[:-BACK])
    return float(np.partition(speeds, len(speeds) // 2)[len(speeds) // 2])


def _returned(poses: Poses, interval_s: float) -> NDArray[np.bool_]:
    """Which poses from the BACKth on (n) are far from the last one and close to another of the last few."""
    rows = np.arange(len(poses) - BACK)[:, None] + np.arange(BACK)
    path = poses.position_m[rows] - poses.position_m[BACK:, None]
    cosine = (poses.quat_xyzw[rows] @ poses.quat_xyzw[BACK:, :, None])[..., 0]
    turn_sq = 8.0 * np.maximum(1.0 - np.abs(cosine), 0.0)
    distance = np.sqrt(np.einsum("nij,nij->ni", path, path) + ARM_M**2 * turn_sq)
    step, nearest = distance[:, -1], distance.min(axis=1)
    usual = np.partition(nearest, len(nearest) // 2)[len(nearest) // 2]
    far = step > max(FAR_M, FAR_STEPS * usual, FAR_M_PER_S2 * interval_s**2)
    return np.asarray(far & (nearest < CLOSE * step) & (nearest > 0.0))


def _page(page: float, returned: NDArray[np.bool_]) -> tuple[float, bool]:
    """Page's sum, which never falls below zero, and whether it rose to the alarm."""
    path = np.append(page, np.where(returned, RETURN, NO_RETURN)).cumsum()
    above = path - np.minimum(np.minimum.accumulate(path), 0.0)
    return float(above[-1]), bool(above.max() > ALARM)


def _histogram(smooth: Array) -> Array:
    """Counts (2, BINS) of the squared third differences of position and orientation, at noise's scale."""
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
