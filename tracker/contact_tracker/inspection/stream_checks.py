"""Findings about a stream of poses for which labels would be wrong: two bodies on one topic, wrong units and
conventions.

All statistics are computed on blocks of poses counted from the first one, so that they do not depend on
batches. Repeated poses are left out.
"""

from math import inf, log, nan, pi, sqrt
from typing import Final, NamedTuple

import numpy as np

from contact_tracker.arrays import Array, Bools
from contact_tracker.geometry.linalg import between, rotation_vectors
from contact_tracker.motion.excursions import FAR_M_PER_S2
from contact_tracker.motion.poses import ARM_M, AS_GIVEN, NO_POSES, Poses, ReadAs
from contact_tracker.motion.sensor_noise import MEDIAN_OF_CHI_SQ, SCALE, independent_point

PIECE: Final = 10
POWERS: Final = 4
"""Number of coefficients of the cubic in time that is fitted to ``PIECE`` poses."""
ROUNDS: Final = 4
APART_M: Final = (0.002, 0.03)
"""Range of the distance (m) between the paths of two bodies. Well calibrated cameras agree better than its
lower end; ``returned`` finds distances above the upper one."""
APART_SIGMAS: Final = 9.0
CHANGES: Final = 0.35
"""Least share of poses that belong to the other body than the previous pose; one half in random order."""
LEAST_SHARE: Final = 0.25
"""Least share of the poses of the rarer body."""
BACK: Final = 8
"""Number of previous poses among which a pose is sought that the stream returns to."""
STEP_M: Final = 0.01
FAR_STEPS: Final = 8.0
RETURNED_SHARE: Final = 0.25
"""Largest distance from the pose returned to, as a share of the step."""
# Page's test: with returns in 13 % of the poses the sum drifts down, with 40 % it rises; the chance of a
# false alarm is about exp(-ALARM) a pose.
RETURN: Final = log(0.40 / 0.13)
NO_RETURN: Final = log(0.60 / 0.87)
ALARM: Final = 25.0


def returned(poses: Poses, interval_s: float) -> Bools:
    """(n,) whether each pose from the BACKth on is far from the last and close to another recent one."""
    position, quat = poses.position_m, poses.quat_xyzw
    step = _distance(position[BACK:], quat[BACK:], position[BACK - 1 : -1], quat[BACK - 1 : -1])
    far = step > max(STEP_M, FAR_M_PER_S2 * interval_s**2)  # slower alternation is motion
    if not far.any():
        return far
    rows = np.arange(len(poses) - BACK)[:, None] + np.arange(BACK)
    distance = _distance(position[BACK:, None], quat[BACK:, None], position[rows], quat[rows])
    nearest = distance.min(axis=1)
    far &= step > FAR_STEPS * np.median(nearest)
    return np.asarray(far & (nearest < RETURNED_SHARE * step) & (nearest > 0.0))


def page_sum(page: float, returns: Bools) -> tuple[float, bool]:
    """Page's cumulative sum (never below zero) after these poses, and whether it reached the alarm."""
    if not page and not returns.any():
        return 0.0, False
    path = np.append(page, np.where(returns, RETURN, NO_RETURN)).cumsum()
    excess = path - np.minimum(np.minimum.accumulate(path), 0.0)
    return float(excess[-1]), bool(excess.max() > ALARM)


def _distance(position: Array, quat: Array, other_position: Array, other_quat: Array) -> Array:
    """Distances (m) of poses; rotations count by the path of the lever arm."""
    path, cosine = other_position - position, (other_quat * quat).sum(axis=-1)
    turn_sq = 8.0 * np.maximum(1.0 - np.abs(cosine), 0.0)
    return np.asarray(np.sqrt(np.einsum("...i,...i->...", path, path) + ARM_M**2 * turn_sq))


def is_of_two_bodies(poses: Poses) -> bool:
    """Whether these poses (a multiple of PIECE) alternate between two paths."""
    shape = -1, PIECE
    time = (poses.stamp_ns - poses.stamp_ns[0]).reshape(shape).astype(float)
    time = 2.0 * (time - time[:, :1]) / (time[:, -1:] - time[:, :1]) - 1.0
    smooth, _ = np.linalg.qr(time[:, :, None] ** np.arange(POWERS))
    position = (poses.position_m - poses.position_m.mean(axis=0)).reshape(*shape, 3)
    off_path = _without(smooth, position)
    aside = np.linalg.svd(off_path.reshape(-1, 3), full_matrices=False)[2][0]
    side, step, residual = off_path @ aside > 0.0, aside, off_path
    for _ in range(ROUNDS):
        body = side - 0.5
        pattern = _without(smooth, body[..., None])[..., 0]
        if not pattern.any():
            return False
        step = (pattern[..., None] * off_path).sum(axis=(0, 1)) / (pattern * pattern).sum()
        residual = off_path - pattern[..., None] * step
        side = (residual + body[..., None] * step) @ step > 0.0
    apart_m = float(np.linalg.norm(step))
    sigma_m = float(np.sqrt((residual * residual).mean() * PIECE / (PIECE - POWERS)))
    share, changes = float(side.mean()), float(np.mean(np.diff(side.ravel())))
    are_mixed = min(share, 1.0 - share) > LEAST_SHARE and changes > CHANGES
    return are_mixed and max(APART_M[0], APART_SIGMAS * sigma_m) < apart_m < APART_M[1]


def _without(smooth: Array, values: Array) -> Array:
    """Values (n, PIECE, k) minus their projection on smooth paths in each piece."""
    return np.asarray(values - smooth @ (smooth.transpose(0, 2, 1) @ values))


BLOCK: Final = 50
"""Poses per block."""
KEPT: Final = BLOCK + BACK
"""Number of poses in memory beside those of the incomplete block."""

# Units: bounds that noise and motion of an object in metres never exceed together.
LEVER_M: Final = 3.0
"""Largest ratio (m/rad) of the noises of position and orientation: usually 0.03 to 0.5, of poor cameras 1."""
COARSE_M: Final = 0.01
"""Position noise (m) above which a larger ratio shows other units; mobile robots have a few mm."""
FAST_M_PER_S: Final = 15.0
TOSSED_CM_PER_S: Final = 500.0
USUAL_LEVER_M: Final = 0.12
SMALL_LEVER_M: Final = 0.0025
"""A smaller ratio (m/rad), at speeds below ``SLOW_M_PER_S``, occurs only if positions were divided by 100 or
1000: orientations come from markers or features that are centimetres apart."""
SLOW_M_PER_S: Final = 0.01
COARSE_RAD: Final = 0.03
"""Larger third differences of orientation are motion between poses at a low rate, not noise."""
ENOUGH_NOISE: Final = 40
"""Least number of third differences for an estimate of the noise."""

CONSTANT: Final = 1e-9
"""Smaller differences are rounding (m, or of a unit quaternion)."""
ENOUGH_CONSTANT: Final = 100
STILL: Final = "still"
ORIENTATION: Final = "orientation"
"""The kinds of the findings that the pose, or its position or orientation alone, never changes."""

# Histogram of squared third differences: four bins to a factor of 4, from 1e-15 to 3e6.
BINS: Final = 285
LOWEST: Final = -100.0


STEP_NS: Final = 100_000_000
SPAN: Final = 30
"""Time between poses, and number of poses per span."""
EXPLAINED: Final = 0.8
"""Least share of the origin's motion in a span that is rotation about a point."""
ALL_AXES: Final = 0.05
"""Least ratio of the smallest to the largest singular value of the changes of orientation in a span that
turns about more than one axis. An arm turns its tool about its first axis, as inverse poses turn about a
point: ratios are then up to 0.04. With 0.02 and 0.1 one of 132 right recordings each looks inverse, with 0.05
none, and of 71 inverse ones 66, 65 and 64 are found (0.8 m away; without, 9 and 66)."""
ENOUGH_SPANS: Final = 3
"""Least number of spans with rotation about a point; they are also at least half of those that turn about
more than one axis."""
FAR_M: Final = 0.6
TIMES_FARTHER: Final = 2.0
"""Poses look inverse if the point of rotation is farther from the body's origin than ``FAR_M``, and than this
many times its distance from the world's origin."""
SPANS_KEPT: Final = 200


class TurningPoints(NamedTuple):
    """The points about which an object rotates: near it (where it touches, or the hand), or for inverse poses
    near the world's origin. These are rigid motion as well, with the roles of object and surroundings
    exchanged: their point of rotation is as far from the body's origin as the object was from the world's.

    ``sparse`` poses of the current span, and ``distances`` (n, 2) of the spans before that turn about more
    than one axis: of the point of rotation from the origins of the body and of the world (m), nan if their
    motion is no rotation about a point."""

    sparse: Poses
    distances: Array

    @property
    def median_m(self) -> tuple[float, float]:
        """Median of both distances."""
        from_body_m, from_world_m = np.nanmedian(self.distances, axis=0).tolist()
        return from_body_m, from_world_m

    @property
    def are_inverse(self) -> bool:
        """Whether the poses look like poses of the world in the body."""
        count = int(np.isfinite(self.distances[:, 0]).sum())
        if count < max(ENOUGH_SPANS, len(self.distances) / 2):
            return False
        from_body_m, from_world_m = self.median_m
        return from_body_m > max(FAR_M, TIMES_FARTHER * from_world_m)


NO_TURNING_POINTS: Final = TurningPoints(NO_POSES, np.zeros((0, 2)))


def advance_turning(points: TurningPoints, poses: Poses) -> TurningPoints:
    """Advance by poses of the stream, in order."""
    sparse = points.sparse
    next_ns = int(sparse.stamp_ns[-1]) + STEP_NS if len(sparse) else int(poses.stamp_ns[0])
    while (row := int(np.searchsorted(poses.stamp_ns, next_ns))) < len(poses):
        sparse = Poses.join([sparse, poses[row : row + 1]])
        next_ns = int(poses.stamp_ns[row]) + STEP_NS
        if len(sparse) == SPAN:
            distances = np.concatenate([points.distances, turning_distances(sparse)])[-SPANS_KEPT:]
            points, sparse = points._replace(distances=distances), sparse[-1:]
    return points._replace(sparse=sparse)


def turning_distances(span: Poses) -> Array:
    """The ``distances`` (1, 2) of one span; (0, 2) if it turns about one axis at most."""
    turn, position = span.rotation, span.position_m
    about = (turn - turn.mean(axis=0)).reshape(-1, 3)
    moved = (position - position.mean(axis=0)).ravel()
    in_body, _, rank, _ = np.linalg.lstsq(-about, moved, rcond=ALL_AXES)
    if rank < 3:
        return np.zeros((0, 2))
    residual = moved + about @ in_body
    if residual @ residual > (1.0 - EXPLAINED) * (moved @ moved):
        return np.full((1, 2), nan)
    in_world = position.mean(axis=0) + turn.mean(axis=0) @ in_body
    return np.array([[np.linalg.norm(in_body), np.linalg.norm(in_world)]])


class Finding(NamedTuple):
    """One finding: ``text`` is one line with a remedy."""

    kind: str
    text: str
    doubts_labels: bool


class Inspection(NamedTuple):
    """Running statistics of a stream of poses; bounded in size.

    ``recent``: the last KEPT poses of the complete ``blocks``, and those of the incomplete block; ``first``:
    the first pose; ``total``, ``repeats``: numbers of new and of repeated poses; ``moved``: whether position
    and orientation have changed since the first pose; ``noise`` (2, BINS): histograms of the squared third
    differences of both; ``top_m_per_s``: speed of the fastest block; ``page``: Page's sum; ``share``: share
    of returns in the last block; ``turning``: points of rotation; ``units``, ``bodies``: whether these were
    found at any time; ``read_as``: how the user asked to read the poses.
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
    turning: TurningPoints = NO_TURNING_POINTS
    units: bool = False
    bodies: bool = False
    read_as: ReadAs = AS_GIVEN

    @property
    def sigma(self) -> tuple[float, float]:
        """Standard deviations (m, rad) of the noise of a pose, if it is white."""
        return _sigma(self.noise[0]), _sigma(self.noise[1])


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
    turning = advance_turning(inspection.turning, new)
    shift, turn = np.abs(new.position_m - first.position_m), np.abs(new.quat_xyzw - first.quat_xyzw)
    shifted, turned = bool(shift.max() > CONSTANT), bool(turn.max() > CONSTANT)
    moved = inspection.moved[0] or shifted, inspection.moved[1] or turned
    inspection = inspection._replace(first=first, total=total, moved=moved, turning=turning)
    end = len(recent) - (total - BLOCK * inspection.blocks)
    while total - BLOCK * inspection.blocks >= BLOCK:
        end += BLOCK
        inspection = _inspect_block(inspection, recent[max(end - KEPT, 0) : end])
    return inspection._replace(recent=recent[max(end - KEPT, 0) :])


def findings(inspection: Inspection, is_cut_short: bool = False) -> tuple[Finding, ...]:
    """Findings in the stream so far; ``is_cut_short``: the stream goes on, but is not read further."""
    result = list[Finding]()
    if inspection.units:
        result.append(Finding("units", _units_text(inspection), True))
    elif inspection.total >= ENOUGH_CONSTANT and all(inspection.moved):
        position, rotation = inspection.sigma
        is_small = 0.0 < position < SMALL_LEVER_M * rotation and rotation < COARSE_RAD
        if is_small and inspection.top_m_per_s < SLOW_M_PER_S:
            figures = f"noise {1e6 * position:.2g} um, {180.0 / pi * rotation:.2g} deg"
            figures += f"; speed up to {1e3 * inspection.top_m_per_s:.2g} mm/s"
            text = (
                f"positions look too small for metres ({figures}): check their unit (of a table: --unit); if "
                "that is right, orientations are rounded: record more of their digits"
            )
            result.append(Finding("units", text, False))
    if inspection.bodies:
        share = f" ({100.0 * inspection.share:.0f} % of the frames)" if inspection.share else ""
        text = (
            f"poses jump back and forth between two places{share}: two bodies on one topic? "
            "choose one with --topic or --frame, or record them on topics of their own"
        )
        result.append(Finding("bodies", text, True))
    how = "does not change in the first" if is_cut_short else "never changes in"
    unchanged = f"{how} {inspection.total + inspection.repeats} poses"
    if inspection.repeats >= ENOUGH_CONSTANT and not any(inspection.moved):
        fault = f"pose {unchanged}: is the object tracked, in this frame?"
        result.append(Finding(STILL, f"the {fault}", False))
    elif inspection.total >= ENOUGH_CONSTANT and not all(inspection.moved):
        # With known elements (--known) positions or orientations alone give labels that are sure and wrong.
        part, need = "position", "contacts need both"
        if inspection.moved[0]:
            part, need = "orientation", "contacts are recognised by rotation"
        fault = f"the {part} {unchanged}: is it recorded? {need}"
        result.append(Finding(ORIENTATION, fault, True))
    if inspection.turning.are_inverse and not inspection.read_as.frame_moves:
        from_body_m, from_world_m = inspection.turning.median_m
        text = (
            f"poses look inverse, of the world in the body (they turn about points {from_body_m:.1f} m from "
            f"the body's origin and {from_world_m:.1f} m from the world's): "
            "invert them, or, if the body's origin is that far from the object, give it one near the object"
        )
        result.append(Finding("inverse", text, True))
    return tuple(result)


def _units_text(inspection: Inspection) -> str:
    position, rotation = inspection.sigma
    lever = position / rotation if rotation else inspection.top_m_per_s
    small = lever > USUAL_LEVER_M * sqrt(1e2 * 1e3) or inspection.top_m_per_s > TOSSED_CM_PER_S
    unit = "mm" if small else "cm"
    figures = (
        f"(noise {1e3 * position:.3g} mm, {180.0 / pi * rotation:.2g} deg; "
        f"speed up to {inspection.top_m_per_s:.2g} m/s)"
    )
    remedy = f"convert them to metres, or, if they are of a table, take --unit {unit}"
    if inspection.read_as.path:
        remedy = f"read them by {inspection.read_as.command(unit=unit)}"
    text = f"positions are too noisy or too fast for metres {figures}"
    return f"{text}: check their unit and their source; if they are in {unit}, {remedy}"


def _inspect_block(previous: Inspection, window: Poses) -> Inspection:
    """Advance by the last BLOCK poses of ``window``, which the other poses precede."""
    blocks = previous.blocks + 1
    if previous.bodies:
        return previous._replace(blocks=blocks)
    time_s = 1e-9 * (window.stamp_ns - window.stamp_ns[0])
    interval_s = _median(np.diff(time_s))
    back = returned(window, interval_s)
    are_close = is_of_two_bodies(window[-BLOCK:])
    page, bodies = page_sum(previous.page, back | are_close)
    path = window.position_m[BACK:] - window.position_m[:-BACK]
    speed = np.sqrt(np.einsum("ni,ni->n", path, path)) / (time_s[BACK:] - time_s[:-BACK])
    top_m_per_s = max(previous.top_m_per_s, _median(speed))
    inspection = previous._replace(
        blocks=blocks, page=page, share=float(back.mean()), bodies=bodies, top_m_per_s=top_m_per_s
    )
    return _inspect_noise(inspection, window[-BLOCK - 4 :])


def _inspect_noise(previous: Inspection, window: Poses) -> Inspection:
    """Add the third differences that end in the last BLOCK poses of ``window``."""
    turns = rotation_vectors(between(window.quat_xyzw[:-1], window.quat_xyzw[1:])).cumsum(axis=0)
    smooth = np.concatenate([window.position_m[1:], turns], axis=1)
    inspection = previous._replace(noise=previous.noise + _histogram(smooth))
    if inspection.units or inspection.bodies or not _are_other_units(inspection):
        return inspection
    near = window.of_point(independent_point(window))  # an origin far away has the noise of the orientation
    smooth[:, :3] = near.position_m[1:]
    nearer = inspection._replace(noise=_histogram(smooth))
    return inspection._replace(units=_are_other_units(nearer))


def _median(values: Array) -> float:
    return float(np.partition(values, len(values) // 2)[len(values) // 2])


def _are_other_units(inspection: Inspection) -> bool:
    if inspection.noise[0].sum() < ENOUGH_NOISE or inspection.page > 0.5 * ALARM:
        return False
    position, rotation = inspection.sigma
    if position <= LEVER_M * rotation:
        return False
    return inspection.top_m_per_s > FAST_M_PER_S or (rotation > 0.0 and position > COARSE_M)


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
