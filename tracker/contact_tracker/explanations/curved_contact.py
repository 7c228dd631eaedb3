"""Contacts of curved surfaces, and their evidence against free motion (docs/theory.md, section 20).

They are not among the six contacts, and impose one constraint. Two elements are at a constant distance (a
vertex and a sphere or cylinder, an edge and either, two cylinders), or a rim (circle) is on a face. (A sphere
on a face is v-f with the sphere's centre, a cylinder on a face e-f with its axis.) Each residual takes
parameters (S, p) and poses of frame 1 in frame 2, as ``CONTACT_MODELS`` do.

Motion that none of the six contacts explains is labelled free, but may satisfy one of these constraints. They
have many parameters, so they are fitted to the first half of the motion and tested on the second half.
"""

from collections.abc import Callable, Sequence
from functools import cache, partial
from typing import Final, NamedTuple

import numpy as np

from contact_tracker.arrays import Array, Bools
from contact_tracker.explanations.conditional_contact import TINY
from contact_tracker.geometry.lifted_pose import R, T
from contact_tracker.geometry.linalg import adapted, dot
from contact_tracker.hypotheses.evidence import EvidenceParameters
from contact_tracker.motion.window import Window

PARALLEL: Final = 1e-3
"""Sine of the angle below which the nearest points of two lines are not unique."""


class Touch(NamedTuple):
    """Residuals of S elements and N poses: ``residual`` (S, N) in m, its ``normal`` (S, N, 3) in frame 2, the
    touching ``point`` (S, N, 3) in frame 1, and the ``jacobian`` (S, N, p)."""

    residual: Array
    normal: Array
    point: Array
    jacobian: Array


class CurvedContact(NamedTuple):
    """A kind of curved contact with ``size`` parameters.

    ``directions``: indices at which vectors begin whose length does not matter; the other parameters are in
    m. ``of_inverse``: poses are those of frame 2 in frame 1.
    """

    name: str
    size: int
    directions: tuple[int, ...]
    of_inverse: bool
    touch: Callable[[Array, Array, Array], Touch]


def points_or_lines(x: Array, rotation: Array, position: Array, lines: int) -> Touch:
    """A point q of frame 1 stays at distance r from a point c of frame 2, or from the line through c along d
    (one of ``lines``), or a line through q along e from that line (two), with the sign of its side;
    x = (q, c, d, e, r)."""
    q, c, r = x[:, None, :3], x[:, None, 3:6], x[:, -1:]
    offset = _in_frame_2(rotation, q) + position - c
    if lines < 2:
        point, gap, by_lines = q, offset, list[Array]()
        if lines:
            d, scale = _unit(x[:, None, 6:9])
            along = dot(offset, d)[..., None]
            gap = offset - along * d
        distance = _length(gap)
        normal = gap / distance
        if lines:
            by_lines.append(-along / scale * normal)
        in_1 = _in_frame_1(rotation, normal)
    else:
        (d, scale_d), (e_1, scale_e) = _unit(x[:, None, 6:9]), _unit(x[:, None, 9:12])
        e = _in_frame_2(rotation, e_1)
        normal = np.cross(e, d)
        sine = np.maximum(_length(normal), PARALLEL)
        normal = normal / sine
        cosine, by_e, by_d = (dot(a, b)[..., None] for a, b in ((e, d), (e, offset), (d, offset)))
        on_1 = (cosine * by_d - by_e) / sine**2  # positions of the nearest points along the lines
        on_2 = by_d + cosine * on_1
        point, distance, in_1 = q + on_1 * e_1, dot(normal, offset)[..., None], _in_frame_1(rotation, normal)
        by_lines = [-on_2 / scale_d * normal, on_1 / scale_e * in_1]
    columns = in_1, -normal, *by_lines, -np.ones_like(distance)
    point = np.broadcast_to(point, offset.shape)
    return Touch(distance[..., 0] - r, normal, point, np.concatenate(columns, axis=-1))


def rim_on_plane(x: Array, rotation: Array, position: Array) -> Touch:
    """A circle of frame 1, with radius r, centre q and axis a, stays on the plane of frame 2 through c with
    normal n; x = (q, c, n, a, r)."""
    q, c, r = x[:, None, :3], x[:, None, 3:6], x[:, 12:, None]
    (n, scale_n), (a, scale_a) = _unit(x[:, None, 6:9]), _unit(x[:, None, 9:12])
    normal_1 = np.einsum("nij,smi->snj", rotation, n)
    cosine = dot(normal_1, a)[..., None]
    down = cosine * a - normal_1
    sine = np.maximum(_length(down), PARALLEL)
    point = q + r * down / sine
    offset = _in_frame_2(rotation, point) + position - c
    residual = dot(n, offset)[..., None]
    columns = (
        *(normal_1, -np.broadcast_to(n, offset.shape), (offset - residual * n) / scale_n),
        *(r * cosine / sine * (normal_1 - cosine * a) / scale_a, -sine),
    )
    normal = np.broadcast_to(n, offset.shape)
    return Touch(residual[..., 0], normal, point, np.concatenate(columns, axis=-1))


RIMS: Final = (
    CurvedContact("rim on plane", 13, (6, 9), False, rim_on_plane),
    CurvedContact("plane on rim", 13, (6, 9), True, rim_on_plane),
)
CURVED_CONTACTS: Final = (
    CurvedContact("point at point", 7, (), False, partial(points_or_lines, lines=0)),
    CurvedContact("point at line", 10, (6,), False, partial(points_or_lines, lines=1)),
    CurvedContact("line at point", 10, (6,), True, partial(points_or_lines, lines=1)),
    CurvedContact("line at line", 13, (6, 9), False, partial(points_or_lines, lines=2)),
    *RIMS,
)
FaceNormals = tuple[Array, Array]
"""Normals (3,) of a face of the object (body frame) and of a face of the environment (world frame)."""


def _in_frame_2(rotation: Array, vectors: Array) -> Array:
    """Vectors (S, 1 or N, 3) of frame 1 in frame 2 (S, N, 3)."""
    return np.asarray((rotation @ vectors[..., None])[..., 0])


def _in_frame_1(rotation: Array, vectors: Array) -> Array:
    """Vectors (S, N, 3) of frame 2 in frame 1."""
    return np.asarray(np.einsum("nij,sni->snj", rotation, vectors))


def _length(vectors: Array) -> Array:
    """Lengths (..., 1)."""
    return np.asarray(np.sqrt(dot(vectors, vectors))[..., None] + TINY)


def _unit(vectors: Array) -> tuple[Array, Array]:
    """Unit vectors, and the lengths (..., 1)."""
    length = _length(vectors)
    return vectors / length, length


STARTS: Final = 16
BEST_STARTS: Final = 3
"""Number of starts, which are followed on every second tick, and of those of them that are then followed on
all."""
STEPS: Final = 15
MOST_TICKS: Final = 60
SURFACE_M: Final = 1e-4
"""Standard deviation of surfaces from their ideal shape, and of the mean of a tick from its arc."""


def curved_evidence(window: Window, scales: EvidenceParameters, touched: Sequence[FaceNormals] = ()) -> float:
    """Log evidence (nats) of the best curved contact against free motion.

    A round object is often tilted on the rim of a face on which it stands, so rims of ``touched`` faces are
    tried, too: random starts seldom find a rim.

    The evidence is as in T17 and T19, except that the first half of the motion determines the elements and
    contributes no gain, and that the variance of free motion is that of the whole displacement: known
    elements cannot follow smooth motion.
    """
    rows = np.linspace(0, len(window) - 1, min(len(window), MOST_TICKS)).astype(int)
    excess = np.maximum(window.innovation_excess, window.travel)[rows]
    zeta, variance, best_evidence = window.zeta[rows], window.variance[rows], -np.inf
    tried: list[tuple[CurvedContact, Array | None]] = [(contact, None) for contact in CURVED_CONTACTS]
    tried += [(rim, _rim_of_faces(rim, zeta, touched, scales.reach_m)) for rim in RIMS if touched]
    for contact, start in tried:
        deviation = np.full(contact.size, scales.reach_m)
        for number in contact.directions:
            deviation[number : number + 3] = 1.0
        problem = _Problem(contact, *_in_frames(contact, zeta), variance, deviation**-2.0)
        if start is None:
            start = deviation * _draws(contact.size)
            rotation, position, noise = problem.rotation[::2], problem.position[::2], problem.variance[::2]
            sparse = problem._replace(rotation=rotation, position=position, variance=noise)
            x, cost = sparse.minimised(start, start)
            best = np.argsort(cost)[:BEST_STARTS]
            start, x = start[best], x[best]
        else:
            x = start
        x, _ = problem.minimised(x, start)
        best_evidence = max(best_evidence, float(problem.evidence(x, excess, scales).max()))
    return best_evidence


def _rim_of_faces(
    contact: CurvedContact, lifts: Array, touched: Sequence[FaceNormals], reach_m: float
) -> Array:
    """The rim (1, 13) of one face that stays nearest to the plane of the other, of all pairs ``touched``.

    With the directions known, the distances are linear in the rim's centre and radius and in the plane's
    place, which have zero mean and the standard deviation ``reach_m``.
    """
    rotation, position = _in_frames(contact, lifts)
    body, world = (np.array(normals) for normals in zip(*touched, strict=True))  # (S, 3) each
    axis, normal = (world, body) if contact.of_inverse else (body, world)
    normal_1 = np.einsum("nij,si->snj", rotation, normal)
    cosine = (normal_1 @ axis[..., None])[..., 0]
    sine = np.sqrt(np.maximum(1.0 - cosine**2, PARALLEL**2))
    rows = np.concatenate([normal_1, -np.ones((*sine.shape, 1)), -sine[..., None]], axis=-1)
    distance = -normal @ position.T
    away = np.eye(rows.shape[-1]) * (SURFACE_M / reach_m) ** 2
    transposed = rows.transpose(0, 2, 1)
    places = np.linalg.solve(transposed @ rows + away, transposed @ distance[..., None])
    misfit = (((rows @ places)[..., 0] - distance) ** 2).sum(axis=1)
    best = int(misfit.argmin())
    q, h, r = np.split(places[best, :, 0], (3, 4))
    return np.concatenate([q, h * normal[best], normal[best], axis[best], r])[None]


def _in_frames(contact: CurvedContact, lifts: Array) -> tuple[Array, Array]:
    """Rotations (N, 3, 3) and positions (N, 3) of frame 1 in frame 2; those in the world are relative to
    their mean."""
    rotation = lifts[:, R].reshape(-1, 3, 3)
    position = lifts[:, T] - lifts[:, T].mean(axis=0)
    if not contact.of_inverse:
        return rotation, position
    rotation = rotation.transpose(0, 2, 1)
    return rotation, -(rotation @ position[..., None])[..., 0]


class _Problem(NamedTuple):
    """The fit of one ``contact`` with the prior ``information`` (p,), for poses ``rotation`` (N, 3, 3),
    ``position`` (N, 3) of frame 1 in frame 2 with noise ``variance`` (N, 2)."""

    contact: CurvedContact
    rotation: Array
    position: Array
    variance: Array
    information: Array

    def minimised(self, x: Array, centre: Array) -> tuple[Array, Array]:
        """x (S, p) after Levenberg-Marquardt steps, with the prior mean ``centre`` (S, p), and its cost
        (S,)."""
        touch, noise, cost = self.residuals(x, centre)
        damping = np.ones(len(x))
        for _ in range(STEPS):
            hessian, gradient = _quadratic(touch, noise)
            gradient += self.information * (x - centre)
            damped = hessian * (1.0 + damping[:, None, None] * np.eye(self.contact.size))
            step = np.linalg.solve(damped + np.diag(self.information), gradient[..., None])[..., 0]
            trial, trial_noise, trial_cost = self.residuals(x - step, centre)
            better = trial_cost < cost
            damping = adapted(damping, better)
            x, cost = np.where(better[:, None], x - step, x), np.where(better, trial_cost, cost)
            noise = np.where(better[:, None], trial_noise, noise)
            touch = Touch(*(_where(better, *parts) for parts in zip(trial, touch, strict=True)))
        return x, cost

    def residuals(self, x: Array, centre: Array) -> tuple[Touch, Array, Array]:
        """Residuals at x, their noise (S, N), and the cost (S,), which includes the log of the noise, else
        long levers would lower it."""
        touch = self.contact.touch(x, self.rotation, self.position)
        noise = self.along_normal(touch, self.variance) + SURFACE_M**2
        misfit = (touch.residual**2 / noise + np.log(noise / SURFACE_M**2)).sum(axis=1)
        away = (self.information * (x - centre) ** 2).sum(axis=1)
        return touch, noise, 0.5 * (misfit + away)

    def along_normal(self, touch: Touch, pose_variance: Array) -> Array:
        """Variance (S, N) of the distance, for the variances ``pose_variance`` (N, 2) of the pose (T16)."""
        arm = (self.rotation @ touch.point[..., None])[..., 0]  # from the origin about which the body turns
        if self.contact.of_inverse:
            arm = arm + self.position
        lever_sq = dot(arm, arm) - dot(arm, touch.normal) ** 2
        return np.asarray(pose_variance[:, 0] + pose_variance[:, 1] * lever_sq)

    def evidence(self, x: Array, excess: Array, scales: EvidenceParameters) -> Array:
        """Log evidence (S,) of x; free motion has variances ``excess`` (N, 2) beyond the noise."""
        touch, noise, _ = self.residuals(x, x)
        free = noise + scales.body_radius_m**2 * excess[:, 1] + self.along_normal(touch, excess)
        gain, half = 0.5 * np.log(free / noise), len(excess) // 2
        misfit = 0.5 * touch.residual**2 * (1.0 / noise - 1.0 / free)
        parts = (touch, noise), (Touch(*(part[:, :half] for part in touch)), noise[:, :half])
        prior = np.diag(self.information)
        log_det, first_log_det = (np.linalg.slogdet(_quadratic(*part)[0] + prior)[1] for part in parts)
        ratio = gain[:, half:].sum(axis=1) - misfit.sum(axis=1) - 0.5 * (log_det - first_log_det)
        return np.asarray(scales.likelihood_exponent * ratio)


def _quadratic(touch: Touch, noise: Array) -> tuple[Array, Array]:
    """Hessian (S, p, p) and gradient (S, p) of the misfit."""
    weighted = (touch.jacobian / noise[..., None]).transpose(0, 2, 1)
    return weighted @ touch.jacobian, (weighted @ touch.residual[..., None])[..., 0]


@cache
def _draws(size: int) -> Array:
    return np.random.default_rng(7).normal(size=(STARTS, size))


def _where(chosen: Bools, new: Array, old: Array) -> Array:
    return np.where(chosen.reshape(-1, *(1 for _ in new.shape[1:])), new, old)
