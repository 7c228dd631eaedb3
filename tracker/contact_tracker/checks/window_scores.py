"""How well contacts explain a window of poses in each of its readings.

Two faces, and a vertex on a face in the world or in the body, stand for all six contacts: one of them holds
in all but an edge on an edge. For a vertex p and a normal n the residual is n (R p + t) less its mean, linear
in p for a given n and in n for a given p. Fits in all readings take few operations on sums over ticks.
"""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.checks.readings import Given, Reading, read_turns
from contact_tracker.config.parameters import Model
from contact_tracker.geometry.rotation import matrices
from contact_tracker.motion.poses import Poses

Array = NDArray[np.float64]

TICKS: Final = 20
"""Ticks of a window that count, between one at either end for delays."""
REACH_M: Final = 0.3
"""Usual distance of a vertex from the origin of its frame."""
STEPS: Final = 8
"""Steps of the fit; with 12 no lead changes by more than a few nats."""
MOVED: Final = 3.0
"""There is motion if position and orientation vary by more than this many deviations of a tick's noise."""
_ROUNDING: Final = 1e-14
"""Share of the trace of a matrix that is lost in rounding."""
_INVERSE: Final = np.concatenate([np.arange(9).reshape(3, 3).T.ravel(), [12, 13, 14]])
_INVERSE_SIGN: Final = np.repeat([1.0, -1.0], [9, 3])


class Explained(NamedTuple):
    """Of K readings: the log evidence ``nats`` (K,) of contacts against free motion, and the ``misfit`` (K,),
    the mean square of residuals of the best contact in variances of noise."""

    nats: Array
    misfit: Array


def explain(
    poses: Poses,
    tick_of: NDArray[np.int64],
    sigma: tuple[float, float],
    model: Model,
    readings: Sequence[Reading],
) -> Explained | None:
    """How well contacts explain a window in each reading, the first being that of poses as they are; None
    without motion.

    Parameters
    ----------
    poses : of ``TICKS`` + 2 ticks.
    tick_of : (N,) tick of each pose, from 0; no tick is empty.
    sigma : standard deviations of a pose (m, rad).
    """
    first = np.searchsorted(tick_of, np.arange(TICKS + 3))
    middle, at = slice(first[1], first[-2]), first[1:-2] - first[1]
    per_tick = np.diff(first)[1:-1]
    variance = np.square(sigma) / np.median(per_tick)
    variance += np.square([model.noise.floor_position_m, model.noise.floor_rotation_rad])
    given, position_m = Given(poses), poses.position_m - poses.position_m.mean(axis=0)
    turn = matrices(given.quat_xyzw[middle])
    spread = [
        (np.add.reduceat(one, at) / per_tick[:, None]).var(axis=0).sum()
        for one in (position_m[middle], turn.reshape(-1, 9))
    ]
    if spread[0] < 3.0 * MOVED**2 * variance[0] or spread[1] < 6.0 * MOVED**2 * variance[1]:
        return None
    turns = [read_turns(reading, given) for reading in readings]
    axes = np.array([np.eye(3) if reading.axes is None else reading.axes for reading in readings])
    turn = matrices(np.array([one.quat_xyzw[middle] for one in turns]))
    moved = position_m[middle] @ np.swapaxes(axes, 1, 2)
    in_body = (moved[:, :, None] @ turn)[:, :, 0]
    whole = np.concatenate([turn.reshape(*moved.shape[:2], 9), moved, in_body], axis=2)
    features = np.add.reduceat(whole, at, axis=1) / per_tick[:, None]
    volumes = np.array([one.log_volume[middle] for one in turns])
    log_volume = np.add.reduceat(volumes, at, axis=1) @ (1.0 / per_tick)
    nats, misfit = _gains(features, variance, np.cbrt(np.linalg.det(axes)), model)
    # stretched orientations are not rewarded: free motion is stretched as well
    return Explained(np.maximum(nats + np.minimum(log_volume, 0.0), 0.0), misfit)


def _gains(features: Array, variance: Array, scale: Array, model: Model) -> tuple[Array, Array]:
    """Log evidence and misfit (K,) of the best contact.

    ``features`` (K, T, 15) are the rotation, the position, and the position in the body's axes; ``scale``
    (K,) that of positions. Free motion is that of the poses as they are.
    """
    ticks, lever_sq = features.shape[1], model.motion.body_radius_m**2
    jumps = np.square(np.diff(features[0], 2, axis=0)).mean(axis=0)
    angle, distance = variance[1], scale**2 * variance[0] + lever_sq * variance[1]
    free_angle = max(0.5 * float(jumps[:9].sum()), angle)
    free_distance = np.maximum(scale**2 * jumps[9:12].mean() + lever_sq * free_angle, distance)
    mean = features.mean(axis=1)
    centred = features - mean[:, None]
    sums = np.swapaxes(centred, 1, 2) @ centred
    swapped = sums[:, _INVERSE][:, :, _INVERSE] * _INVERSE_SIGN[:, None] * _INVERSE_SIGN
    both = np.concatenate([sums[:, :12, :12], swapped])
    vertex = _vertex_on_face(both, np.tile(distance / REACH_M**2, 2)).reshape(2, -1).min(axis=0) / ticks
    # the normals that turn least against each other, in the world and in the body
    in_world, _, in_body = np.linalg.svd(mean[:, :9].reshape(-1, 3, 3))
    normal, own = in_world[:, :, 0], in_body[:, 0]
    apart = np.einsum("ki,kij,kj->k", normal, sums[:, 9:12, 9:12], normal) / ticks
    tilted = np.einsum("ktij,kj->kti", centred[:, :, :9].reshape(-1, ticks, 3, 3), own)
    tilt = 0.5 * np.square(tilted).sum(axis=2).mean(axis=1)
    of_faces = np.log(free_distance / (distance + apart)) + 2.0 * np.log(free_angle / (angle + tilt))
    of_vertex = np.log(free_distance / (distance + vertex))
    misfit = np.where(of_faces > of_vertex, (apart / distance + 2.0 * tilt / angle) / 3.0, vertex / distance)
    return 0.5 * ticks * np.maximum(of_faces, of_vertex), misfit


def _vertex_on_face(sums: Array, ridge: Array) -> Array:
    """Least sums of squares (B,) of the distance of a point of the body from a plane, plus ``ridge`` (B,)
    times its square; ``sums`` (B, 12, 12) of products of rotation and position, less their means.

    It starts from the three normals of the relaxed problem, in which n p' is any matrix, and fits p and n in
    turn.
    """
    turns, cross, shift = sums[:, :9, :9], sums[:, :9, 9:], sums[:, 9:, 9:]
    eliminated = np.swapaxes(cross, 1, 2) @ np.linalg.solve(_held(turns, ridge), cross)
    _, normals = np.linalg.eigh(shift - eliminated)
    normal = np.swapaxes(normals, 1, 2).reshape(-1, 3)
    count = len(normal)
    # (body axes, world axes): products of two elements of R, and of one with t
    turns = turns.reshape(-1, 3, 3, 3, 3).transpose(0, 2, 4, 1, 3).reshape(-1, 9, 9).repeat(3, axis=0)
    cross = cross.reshape(-1, 3, 3, 3).transpose(0, 2, 1, 3).reshape(-1, 3, 9).repeat(3, axis=0)
    shift, ridge = shift.repeat(3, axis=0), ridge.repeat(3)
    for _ in range(STEPS):
        pairs = (normal[:, :, None] * normal[:, None, :]).reshape(count, 9, 1)
        curvature = _held((turns @ pairs).reshape(count, 3, 3), ridge)
        point = -np.linalg.solve(curvature, cross @ pairs)[:, :, 0]
        by_point = (point[:, None, :] @ cross).reshape(count, 3, 3)
        points = (point[:, :, None] * point[:, None, :]).reshape(count, 1, 9)
        squares = (points @ turns).reshape(count, 3, 3) + by_point + np.swapaxes(by_point, 1, 2) + shift
        # a step of the inverse iteration for the least eigenvector
        normal = np.linalg.solve(_held(squares, 1e-9 * ridge), normal[:, :, None])[:, :, 0]
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    cost = np.einsum("bi,bij,bj->b", normal, squares, normal) + ridge * np.square(point).sum(axis=1)
    return np.asarray(cost.reshape(-1, 3).min(axis=1))


def _held(matrices: Array, ridge: Array) -> Array:
    """Matrices (B, n, n) plus ``ridge`` (B,) times the unit matrix, at least so much that poses without noise
    do not make them singular."""
    trace = np.trace(matrices, axis1=1, axis2=2)
    return np.asarray(matrices + (ridge + _ROUNDING * trace)[:, None, None] * np.eye(matrices.shape[1]))
