"""Detection of positions and orientations that do not fit together, by how well contacts explain them.

Positions and orientations in different conventions are valid, each alone, but contacts explain hardly any of
their motion; in the right reading they explain much of it. So the motion is explained window by window in all
readings. A remedy is a reading in which contacts explain most windows to the noise.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import compress
from typing import Final, NamedTuple

import numpy as np

from contact_tracker.arrays import Array, Bools, Ints
from contact_tracker.checks.check import MIXED_UP, Check, Stream, has_doubts
from contact_tracker.checks.readings import (
    AS_THEY_ARE,
    DELAYS_MS,
    Given,
    Reading,
    readings_of,
    with_delay,
)
from contact_tracker.config.parameters import Model
from contact_tracker.geometry.lifted_pose import lift
from contact_tracker.geometry.linalg import matrices
from contact_tracker.inspection.stream_checks import Finding
from contact_tracker.motion.free_motion import can_be_compared
from contact_tracker.motion.poses import Poses
from contact_tracker.motion.window import DIRECTIONS, ONE_AXIS, Window, used_directions
from contact_tracker.states import CONTACTS

TICKS: Final = 20
"""Number of ticks of a window, between one more at either end for delays."""
REACH_M: Final = 0.3
"""Usual distance of a vertex from the origin of its frame."""
STEPS: Final = 8
"""Steps of the fit; with 16 no lead changes by more than 3 nats."""
MOVED: Final = 3.0
"""Least standard deviation of position and orientation in a window with motion, over the noise of a tick."""
FEWEST_DIRECTIONS: Final = DIRECTIONS - max(contact.codimension for contact in CONTACTS)
"""Number of directions in which two faces leave the object free, fewer than any other contact (T24). To
second order, motion in two agrees with a vertex on a face by chance: five coefficients, five parameters."""
LIFTED_SHARE: Final = 0.65
"""Largest share of the motion along the axis of the turns, in squares, that is made with a turn, of an object
that is lifted without. Of SCARA robots it is 0.0, or 0.3 to 0.6 if they turn before the lift ends; of objects
that slide, in readings with wrong axes, above 0.7 in 33 of 34 windows."""
TURNS: Final = 0.1
"""Least share of the fastest turn in a window that counts as a turn."""
_ROUNDING: Final = 1e-14
"""Share of the trace of a matrix that is lost in rounding."""
_INVERSE: Final = np.concatenate([np.arange(9).reshape(3, 3).T.ravel(), [12, 13, 14]])
_INVERSE_SIGN: Final = np.repeat([1.0, -1.0], [9, 3])


class Explained(NamedTuple):
    """Explanation of a window in K readings: log evidence ``nats`` (K,) of contacts against free motion, and
    ``misfit`` (K,), the mean square of the best contact's residuals over the noise. ``shows_contact``: the
    motion is in as many directions as a contact leaves, and no lift; other motion agrees by chance."""

    nats: Array
    misfit: Array
    shows_contact: bool


def explain(
    poses: Poses,
    tick_of: Ints,
    sigma: tuple[float, float],
    model: Model,
    readings: Sequence[Reading],
) -> Explained | None:
    """How well contacts explain a window in each reading, of which the first leaves poses as they are; None
    without motion.

    Two faces, and a vertex on a face in the world or in the body, stand for all six contacts: one of them
    holds in all but an edge on an edge. For a vertex p and a normal n the residual is n (R p + t) less its
    mean, linear in p for a given n and in n for a given p. Fits in all readings take few operations on sums
    over ticks.

    Parameters
    ----------
    poses : of ``TICKS`` + 2 ticks.
    tick_of : (N,) tick of each pose, from 0; no tick is empty.
    sigma : standard deviations of a pose (m, rad).
    """
    first = np.searchsorted(tick_of, np.arange(TICKS + 3))
    middle, starts = slice(first[1], first[-2]), first[1:-2] - first[1]
    per_tick = np.diff(first)[1:-1]
    variance = np.square(sigma) / np.median(per_tick)
    variance += np.square([model.noise.floor_position_m, model.noise.floor_rotation_rad])
    orientations, position_m = Given(poses), poses.position_m - poses.position_m.mean(axis=0)
    turn = matrices(orientations.quat_xyzw[middle])
    values = position_m[middle], turn.reshape(-1, 9)
    means = [np.add.reduceat(rows, starts) / per_tick[:, None] for rows in values]
    spread = [mean.var(axis=0).sum() for mean in means]
    if spread[0] < 3.0 * MOVED**2 * variance[0] or spread[1] < 6.0 * MOVED**2 * variance[1]:
        return None
    turns = [reading.turns(orientations) for reading in readings]
    axes = np.array([np.eye(3) if reading.axes is None else reading.axes for reading in readings])
    turn = matrices(np.array([turned.quat_xyzw[middle] for turned in turns]))
    moved = position_m[middle] @ np.swapaxes(axes, 1, 2)
    in_body = (moved[:, :, None] @ turn)[:, :, 0]
    stacked = np.concatenate([turn.reshape(*moved.shape[:2], 9), moved, in_body], axis=2)
    features = np.add.reduceat(stacked, starts, axis=1) / per_tick[:, None]
    volumes = np.array([turned.log_volume[middle] for turned in turns])
    log_volume = np.add.reduceat(volumes, starts, axis=1) @ (1.0 / per_tick)
    scales = np.cbrt(np.linalg.det(axes)), np.array([reading.turn_scale for reading in readings])
    nats, misfit = _gains(features, variance, *scales, model)
    rows = np.tile(variance, (TICKS, 1))
    moving = Window(np.arange(TICKS), lift(means[1].reshape(-1, 3, 3), means[0]), rows, rows / _ROUNDING)
    # stretched orientations are not rewarded: free motion is stretched as well
    nats = np.maximum(nats + np.minimum(log_volume, 0.0), 0.0)
    is_lifted = _is_lifted(means[0], means[1].reshape(-1, 3, 3), variance[0])
    return Explained(nats, misfit, used_directions(moving) >= FEWEST_DIRECTIONS and not is_lifted)


def _is_lifted(place_m: Array, turn: Array, variance_m2: float) -> bool:
    """Whether poses (T, 3), (T, 3, 3) turn about one axis only, and move along it without a turn, by more
    than the noise of their positions.

    A SCARA robot lifts a part, then carries it along a line with a turn. That is in a plane, as a face on a
    face moves in a reading with other axes, but such a face would turn while it moves in any direction.
    """
    step = turn[1:] @ np.swapaxes(turn[:-1], 1, 2)
    turned = np.column_stack([step[:, k, j] - step[:, j, k] for j, k in ((1, 2), (2, 0), (0, 1))])
    _, sizes, axes = np.linalg.svd(turned)
    along_sq, angle = np.square(np.diff(place_m, axis=0) @ axes[0]), np.abs(turned @ axes[0])
    with_turn = along_sq[angle > TURNS * angle.max()].sum()
    moves_along = along_sq.mean() > 2.0 * MOVED**2 * variance_m2
    return bool(moves_along and sizes[1] < ONE_AXIS * sizes[0] and with_turn < LIFTED_SHARE * along_sq.sum())


def _gains(
    features: Array, variance: Array, scale: Array, turn_scale: Array, model: Model
) -> tuple[Array, Array]:
    """Log evidence (K,) and misfit (K,) of the best contact in each reading.

    ``features`` (K, T, 15): rotation, position, and position in the body's axes; ``scale``, ``turn_scale``
    (K,): factors of positions and turns. Free motion is that of the poses as they are.
    """
    ticks, lever_sq = features.shape[1], model.motion.body_radius_m**2
    jumps = np.square(np.diff(features[0], 2, axis=0)).mean(axis=0)
    angle = turn_scale**2 * variance[1]
    distance = scale**2 * variance[0] + lever_sq * angle
    free_angle = np.maximum(turn_scale**2 * 0.5 * jumps[:9].sum(), angle)
    free_distance = np.maximum(scale**2 * jumps[9:12].mean() + lever_sq * free_angle, distance)
    mean = features.mean(axis=1)
    centred = features - mean[:, None]
    sums = np.swapaxes(centred, 1, 2) @ centred
    swapped = sums[:, _INVERSE][:, :, _INVERSE] * _INVERSE_SIGN[:, None] * _INVERSE_SIGN
    products = np.concatenate([sums[:, :12, :12], swapped])
    vertex = _vertex_on_face(products, np.tile(distance / REACH_M**2, 2)).reshape(2, -1).min(axis=0) / ticks
    # the normals that turn least against each other, in the world and in the body
    in_world, _, in_body = np.linalg.svd(mean[:, :9].reshape(-1, 3, 3))
    normal, body_normal = in_world[:, :, 0], in_body[:, 0]
    apart = np.einsum("ki,kij,kj->k", normal, sums[:, 9:12, 9:12], normal) / ticks
    tilted = np.einsum("ktij,kj->kti", centred[:, :, :9].reshape(-1, ticks, 3, 3), body_normal)
    tilt = 0.5 * np.square(tilted).sum(axis=2).mean(axis=1)
    faces = np.log(free_distance / (distance + apart)) + 2.0 * np.log(free_angle / (angle + tilt))
    corner = np.log(free_distance / (distance + vertex))
    misfit = np.where(faces > corner, (apart / distance + 2.0 * tilt / angle) / 3.0, vertex / distance)
    return 0.5 * ticks * np.maximum(faces, corner), misfit


def _vertex_on_face(sums: Array, ridge: Array) -> Array:
    """Least sums of squares (B,) of the distance of a body point p from a plane with normal n, plus ``ridge``
    (B,) times p squared; ``sums`` (B, 12, 12) of products of rotation and position, less their means.

    Starts are the three normals of the relaxed problem, in which n p' is any matrix. A step finds the best p
    for n, then the best n with p as a function of it (variable projection). With n and p in turn, 1000 steps
    are too few if the motion is small against the distance of p, and a right reading seems not to fit.
    """
    turns, cross, shift = sums[:, :9, :9], sums[:, :9, 9:], sums[:, 9:, 9:]
    eliminated = np.swapaxes(cross, 1, 2) @ np.linalg.solve(_held(turns, ridge), cross)
    _, normals = np.linalg.eigh(shift - eliminated)
    normal = np.swapaxes(normals, 1, 2).reshape(-1, 3)
    count = len(normal)
    # axes (body, world): products of two elements of R, and of an element of R with t
    turns = turns.reshape(-1, 3, 3, 3, 3).transpose(0, 2, 4, 1, 3).reshape(-1, 9, 9).repeat(3, axis=0)
    cross = cross.reshape(-1, 3, 3, 3).transpose(0, 2, 1, 3).reshape(-1, 3, 9).repeat(3, axis=0)
    shift, ridge, least = shift.repeat(3, axis=0), ridge.repeat(3), np.full(count, np.inf)
    for _ in range(STEPS):
        # R'n by elements of R, and by t
        by_turn = (normal[:, None, None] @ turns.reshape(-1, 9, 3, 3)).reshape(-1, 3, 3, 3)
        by_shift = (normal[:, None, None] @ cross.reshape(-1, 3, 3, 3))[:, :, 0]
        curvature = _held((by_turn @ normal[:, None, :, None])[..., 0], ridge)
        point = -np.linalg.solve(curvature, by_shift @ normal[:, :, None])[:, :, 0]
        by_point = (point[:, None, :] @ cross).reshape(count, 3, 3)
        points = (point[:, :, None] * point[:, None, :]).reshape(count, 1, 9)
        squares = (points @ turns).reshape(count, 3, 3) + by_point + np.swapaxes(by_point, 1, 2) + shift
        cost = np.einsum("bi,bij,bj->b", normal, squares, normal) + ridge * np.square(point).sum(axis=1)
        least = np.minimum(least, cost)
        mixed = (point[:, None, None] @ by_turn)[:, :, 0] + by_shift
        followed = squares - np.swapaxes(mixed, 1, 2) @ np.linalg.solve(curvature, mixed)
        # a step of inverse iteration for the eigenvector of the least eigenvalue
        rounding = _ROUNDING * np.trace(squares, axis1=1, axis2=2)  # of a difference of large numbers
        normal = np.linalg.solve(_held(followed, 1e-9 * ridge + rounding), normal[:, :, None])[:, :, 0]
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return np.asarray(least.reshape(-1, 3).min(axis=1))


def _held(matrices: Array, ridge: Array) -> Array:
    """Matrices (B, n, n) plus ``ridge`` (B,) times the unit matrix, and a little more, as poses without noise
    would make them singular."""
    trace = np.trace(matrices, axis1=1, axis2=2)
    return np.asarray(matrices + (ridge + _ROUNDING * trace)[:, None, None] * np.eye(matrices.shape[1]))


LEAST_TICK_S: Final = 0.1
"""Shorter ticks (s) are joined, so that contacts restrict the motion in a window."""
POSES_PER_TICK: Final = 8
"""Number of poses that are used in each tick; of more, every n-th."""
MOST_WINDOWS: Final = 30
"""Number of windows with motion, 60 s, after which the comparison ends."""
LIKELY_NATS: Final = 30.0
"""Lead (nats) of a reading that may soon be a remedy above which no label is certain, and the largest lead in
a window that poses as they are explain. In 166 right files, of single motions, robots in the air and
handling, no label is certain for 0.001 of the time; in 153 wrong ones for 0.6. Of these 87 are named and 35
more noticed; with 60 as the latter 88 and 35, but then a single window decides."""
BETTER_NATS: Final = 60.0
"""Least lead (nats) of a remedy, which also has to explain most windows to the noise. With 30, 37 instead of
32 late recordings are named, but also a mistake in a box that only slides and tilts."""
ODD_NATS: Final = 120.0
"""Lead (nats) from which positions and orientations do not fit together, even if no reading fits. In the 166
files and in 15 right recordings leads are at most 79 (free motion), but 110 to 120 in one of 12 more of a
hand in the air; mistakes lead by up to 40 in each window. Readings this far behind the best are not compared,
which saves 0.7 of the time."""
STANDS_OUT: Final = 4.5
"""Least lead of the best reading over the median one, in distances from that to the upper quartile. In free
motion that is smooth for 2 s, a vertex on a face fits some readings by chance in each window: the best of 88
leads by 50 to 90 nats, but by 2 to 6 such distances, and with mistakes by 10 in the median. Without this test
87 of the 153 mistakes are named and 35 more noticed, with 2.25, 4.5, 6 and 9 it is 87, 86, 82, 78 and 35, 35,
33, 28."""
FITS: Final = 3.0
"""Largest misfit of contacts that explain a window to the noise; 1 for the right contact."""
NEARLY_FITS: Final = 10.0
"""Largest misfit of windows that are compared: others are free motion, in which readings differ by chance
(leads of up to 170)."""
FITTING_SHARE: Final = 0.55
"""Least share of windows with motion that a remedy explains to the noise: for four contacts in turn it is 0.6
to 0.7 in the right reading and at most 0.5 in wrong ones."""
CLEARLY_MORE: Final = 2
"""Least number of windows that a suspected reading explains beyond poses as they are, if these explain most:
without ``STANDS_OUT``, with 0, 1, 2, 3 no label is certain for 0.008, 0.007, 0.002, 0.001 of the time of the
166 right files, and for 0.696, 0.695, 0.685, 0.677 of that of the wrong ones."""
FEWEST_WINDOWS: Final = 4
REFINED_WINDOWS: Final = 8
"""Number of windows by which a delay is refined to a millisecond; all would take 0.18 of the time."""
TIED_NATS: Final = 20.0
"""Readings at most this far (nats) behind the best are named as well: in turns about two axes the right one
is up to 12 behind."""
MOST_NAMED: Final = 4
NAMELESS: Final = (
    "position and orientation do not fit together: tried were the orders of quaternions and of three angles, "
    "rotation vectors, inverse orientations, swapped and mirrored axes of positions, delays up to 100 ms; "
    "none of them fits: check how both were exported, in which frame and with which clock"
)


@dataclass(frozen=True, eq=False)
class Conventions(Check):
    """State of the comparison.

    Parameters
    ----------
    waiting : poses of the incomplete window.
    kept : thinned poses of the windows with motion, with their ticks.
    nats, fitting : (K,) log evidence of contacts in each reading less that in poses as they are, up to when
        it was compared, and number of windows that it explains to the noise. A window that poses as they are
        explain adds at most ``LIKELY_NATS``: in it, readings differ by the kind of contact.
    is_settled : whether the comparison has ended.
    mistake : text of the mistake that was found, or empty.
    """

    suspicion = (
        "positions and orientations may not fit together (order of quaternions or angles, axes, or a delay)"
    )

    waiting: tuple[Poses, ...] = ()
    kept: tuple[tuple[Poses, Ints], ...] = ()
    nats: Array = field(default_factory=lambda: np.zeros(0))
    fitting: Array = field(default_factory=lambda: np.zeros(0))
    is_settled: bool = False
    mistake: str = ""

    def is_likely(self, stream: Stream) -> bool:
        """Also while a reading may soon be a remedy, which explains clearly more windows than poses as they
        are if these explain most, or while the lead nearly is one without."""
        leads, explained = self.leads, FITTING_SHARE * len(self.kept)
        needed = explained if (self.fitting[:1] < explained).all() else self.fitting[0] + CLEARLY_MORE
        may_be_named = float(leads[self.fitting >= needed].max(initial=0.0)) > LIKELY_NATS
        may_be = may_be_named or float(leads.max(initial=0.0)) > ODD_NATS - LIKELY_NATS
        return bool(self.mistake) or (may_be and not self.is_settled)

    @property
    def leads(self) -> Array:
        """Log evidence (K,); none is positive unless the best reading stands out."""
        if not len(self.nats):
            return self.nats
        median, quartile = np.quantile(self.nats, (0.5, 0.75))
        stands_out = self.nats.max() >= median + STANDS_OUT * (quartile - median)
        return self.nats if stands_out else np.minimum(self.nats, 0.0)

    def update(self, poses: Poses, stream: Stream) -> "Conventions":
        """Updated by poses; positions that look odd in metres are not compared."""
        model, sigma = stream.first, stream.sigma
        if self.is_settled or model is None or sigma is None:
            return self
        if stream.inspection.units or not can_be_compared(model):
            return replace(self, is_settled=True, mistake="")
        if not len(poses):
            return self
        tick_ns, waiting = round(1e9 * max(model.tick_s, LEAST_TICK_S)), (*self.waiting, poses)
        if int(poses.stamp_ns[-1]) - int(waiting[0].stamp_ns[0]) < (TICKS + 2) * tick_ns:
            return replace(self, waiting=waiting)
        state, joined_poses = self, Poses.join(waiting)
        readings = readings_of(stream.inspection.read_as)
        while len(joined_poses) and len(state.kept) < MOST_WINDOWS:
            tick_of = (joined_poses.stamp_ns - joined_poses.stamp_ns[0]) // tick_ns
            end, step = np.searchsorted(tick_of, [TICKS + 2, TICKS])
            if tick_of[-1] < TICKS + 2:
                return replace(state, waiting=(joined_poses,))
            state = state._after_window(joined_poses[:end], tick_of[:end], readings, model, sigma)
            joined_poses = joined_poses[step:]
        return replace(state, waiting=(), is_settled=True)

    def _after_window(
        self,
        window: Poses,
        tick_of: Ints,
        readings: Sequence[Reading],
        model: Model,
        sigma: tuple[float, float],
    ) -> "Conventions":
        """The state after a window, of which at most ``POSES_PER_TICK`` poses are used in each tick."""
        usual = np.median(np.bincount(tick_of, minlength=TICKS + 2))
        thinned = slice(None, None, max(int(usual) // POSES_PER_TICK, 1))
        window, tick_of = window[thinned], tick_of[thinned]
        if not np.bincount(tick_of, minlength=TICKS + 2).all():
            return self
        nats, fitting = (
            values.copy() if len(values) else np.zeros(len(readings)) for values in (self.nats, self.fitting)
        )
        compared = nats > nats.max() - ODD_NATS
        compared[0] = True
        explained = explain(window, tick_of, sigma, model, [*compress(readings, compared)])
        if explained is None:
            return self
        fits, near = explained.misfit < FITS, np.minimum(explained.misfit, explained.misfit[0]) < NEARLY_FITS
        leads = near * (explained.nats - explained.nats[0]) * explained.shows_contact
        nats[compared] += np.minimum(leads, LIKELY_NATS) if fits[0] else leads
        fitting[compared] += fits
        state = replace(self, kept=(*self.kept, (window, tick_of)), nats=nats, fitting=fitting)
        count = len(state.kept)
        has_doubled = count & (count - 1) == 0 or not state.mistake  # as naming takes time
        if has_doubled or count == MOST_WINDOWS or state.leads.max() < BETTER_NATS:
            return replace(state, mistake=_mistake(state, readings, model, sigma))
        return state

    def findings(self, stream: Stream, earlier: Sequence[Finding]) -> list[Finding]:
        if not self.mistake or has_doubts(earlier, *MIXED_UP):
            return []
        return [Finding("conventions", self.mistake, True)]


def _mistake(
    state: Conventions, readings: Sequence[Reading], model: Model, sigma: tuple[float, float]
) -> str:
    """Text of the mistake, with a remedy if a reading fits; empty without one."""
    nats, fitting = state.leads, state.fitting
    if nats.max() < BETTER_NATS or len(state.kept) < FEWEST_WINDOWS:
        return ""
    needed = FITTING_SHARE * len(state.kept)
    near = (nats > nats.max() - TIED_NATS).nonzero()[0]  # the best one first, then the most usual ones
    near = np.append(nats.argmax(), near[near != nats.argmax()])
    named, fit = [readings[i] for i in near], fitting[near] >= needed
    if named[0].delay_ms:
        named, fit = _refined(state, model, sigma, named[0].delay_ms)
    if fit.any():
        texts = [*dict.fromkeys(reading.text for reading, fits in zip(named, fit, strict=True) if fits)]
        return joined(texts[:MOST_NAMED]) + ("; or others" if len(texts) > MOST_NAMED else "")
    return NAMELESS if nats.max() > ODD_NATS else ""


def joined(texts: Sequence[str]) -> str:
    """Mistakes as one text; one that is that before it, with another remedy, is not said again."""
    said, last = list[str](), ""
    for text in texts:
        fault, _, remedy = text.partition(": ")
        said.append(remedy if fault == last else text)
        last = fault
    return "; or ".join(said)


def _refined(
    state: Conventions, model: Model, sigma: tuple[float, float], delay_ms: float
) -> tuple[list[Reading], Bools]:
    """The best delay near ``delay_ms`` in the latest windows, to a millisecond, and whether it fits; no
    reading at the ends of ``DELAYS_MS``."""
    latest = state.kept[-REFINED_WINDOWS:]
    index = DELAYS_MS.index(delay_ms)
    if index in (0, len(DELAYS_MS) - 1):
        return [], np.zeros(0, np.bool_)
    first, last = DELAYS_MS[index - 1], DELAYS_MS[index + 1]
    while True:
        step = max(round((last - first) / 8), 1)
        readings = [AS_THEY_ARE, *map(with_delay, range(first, last + 1, step))]
        fits = [explain(*window, sigma, model, readings) for window in latest]
        rows = [np.array([fit.nats, fit.misfit < FITS]) for fit in fits if fit is not None]
        nats, fitting = np.sum([np.zeros((2, len(readings))), *rows], axis=0)
        best = int(nats.argmax())
        if step == 1 or not best:
            return [readings[best]], np.array([best > 0 and fitting[best] >= FITTING_SHARE * len(latest)])
        middle = round(readings[best].delay_ms)
        first, last = middle - step, middle + step
