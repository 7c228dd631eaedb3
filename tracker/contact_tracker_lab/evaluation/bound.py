"""The Cramer-Rao bound of the errors of a contact's elements, for poses with white noise.

The true poses are unknown as well, except that they satisfy the contact. Per frame, to first order, noise e
of the pose causes the residuals ``(dr/dpose) e``, an error of the geometry ``(dr/dtheta) dtheta``: a frame's
information on theta is the second in units of the first (docs/theory.md, T25). Derivatives are finite
differences of the contact's exact residuals at the true poses and elements, independent of any fit.
"""

from collections.abc import Iterator
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from contact_tracker.arrays import Array
from contact_tracker.contacts import ContactModel
from contact_tracker.geometry.elements import ContactGeometry, Plane, numbers
from contact_tracker.geometry.lifted_pose import lift
from contact_tracker.motion.poses import Poses
from contact_tracker.states import Contact
from contact_tracker_lab.evaluation.geometry_errors import error_at, places

DRAWS: Final = 400
_STEP: Final = 1e-5


def errors(estimate: ContactGeometry, true: ContactGeometry, true_poses: Poses) -> tuple[Array, Array]:
    """Errors of the object's and of the environment's element at the contact, as in ``error_at``.

    For f-f motion determines both normals, but only the difference of the offsets: (2,) for the object's face
    and (3,) for the environment's, with the object's face moved to the body's origin.
    """
    estimate, true = _identifiable(estimate, true_poses), _identifiable(true, true_poses)
    in_body, in_world = places(true, true_poses)
    object_error = error_at(estimate.object, true.object, in_body)
    world_error = error_at(estimate.environment, true.environment, in_world)
    return object_error[:2] if _are_faces(true) else object_error, world_error


def cramer_rao(
    model: ContactModel, true: ContactGeometry, true_poses: Poses, sigma: tuple[float, float]
) -> tuple[Array, Array]:
    """Least covariances (d, d) of the object's and environment's ``errors`` in unbiased estimates.

    Parameters
    ----------
    true_poses : poses without noise, one for each measured frame.
    sigma : white noise (m, rad) per axis of a measured frame.
    """
    pair = _identifiable(true, true_poses)
    first, second = (pair.object, pair.environment) if model.body_in_1 else (pair.environment, pair.object)
    x = np.concatenate([numbers(first)[:3] if _are_faces(pair) else numbers(first), numbers(second)])
    anchors = model.anchors(true_poses.position_m.mean(axis=0))
    x = model.family.normalise(x, anchors)
    tangent = model.family.tangent(x, anchors)
    steps = np.concatenate([tangent.T, -tangent.T]) * _STEP
    around = model.family.normalise(x + steps, anchors)
    information = _information(model, x, around, true_poses, sigma)
    zeros = np.zeros((len(x), len(x)))
    moved = [errors(model.geometry(x_moved, zeros, 0.0), true, true_poses) for x_moved in around]
    half = len(moved) // 2
    bounds = []
    for side in range(2):
        rows = np.array([pair[side] for pair in moved])
        jacobian = (rows[:half] - rows[half:]).T / (2.0 * _STEP)
        bounds.append(jacobian @ np.linalg.solve(information, jacobian.T))
    return bounds[0], bounds[1]


def angles_and_distances(contact: Contact, side: int, size: int) -> Iterator[tuple[str, slice]]:
    """Slices of the ``size`` entries of ``errors``: angles (rad) and distances (m).

    ``side`` is 0 for the object's element and 1 for the environment's.
    """
    angles = 0 if contact.value[2 * side] == "v" else 2
    if angles:
        yield "angle", slice(0, angles)
    if size > angles:
        yield "distance", slice(angles, size)


def errors_at_bound(bound: Array) -> Array:
    """Norms (n, 400) of drawn errors with covariances at the bounds (n, d, d)."""
    drawn = np.random.default_rng(0).normal(size=(len(bound), DRAWS, bound.shape[1]))
    return np.asarray(np.linalg.norm(drawn @ np.linalg.cholesky(bound).swapaxes(1, 2), axis=2))


def _information(
    model: ContactModel, x: Array, around: Array, true_poses: Poses, sigma: tuple[float, float]
) -> Array:
    """Fisher information (P, P) of x along its free directions.

    ``around`` (2 P, S) has x after a step forward, then after one backward, along each direction.
    """
    rotation, position = true_poses.rotation, true_poses.position_m

    def residuals(x: Array, shift: Array, turn: Array) -> Array:
        turned = rotation @ Rotation.from_rotvec(turn).as_matrix()
        return model.measure(x, lift(turned, position + shift)).residual

    by_geometry = residuals(around, np.zeros(3), np.zeros(3))
    half = len(around) // 2
    j_theta = (by_geometry[:half] - by_geometry[half:]) / (2.0 * _STEP)  # (P, K, N)
    noise = 0.0
    for axis in np.eye(3) * _STEP:
        for scale, shift, turn in ((sigma[0], axis, 0 * axis), (sigma[1], 0 * axis, axis)):
            change = residuals(x[None], shift, turn) - residuals(x[None], -shift, -turn)
            j = change[0] * scale / (2.0 * _STEP)
            noise = noise + np.einsum("kn,ln->nkl", j, j)
    weighted = np.linalg.solve(noise, np.moveaxis(j_theta, -1, 0).swapaxes(1, 2))  # (N, K, P)
    return np.asarray(np.einsum("pkn,nkq->pq", j_theta, weighted))


def _are_faces(pair: ContactGeometry) -> bool:
    return isinstance(pair.object, Plane) and isinstance(pair.environment, Plane)


def _identifiable(pair: ContactGeometry, poses: Poses) -> ContactGeometry:
    """The pair; for two faces the offset of the object's face is added to that of the environment's."""
    match pair.object, pair.environment:
        case Plane(m, object_offset_m), Plane(n, offset_m):
            sign = np.sign(np.mean(poses.rotation @ m, axis=0) @ n)
            return ContactGeometry(Plane(m, 0.0), Plane(n, float(offset_m - sign * object_offset_m)))
    return pair
