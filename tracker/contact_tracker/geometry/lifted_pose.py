"""The lifted pose: 25 numbers in which every contact residual is linear (docs/theory.md, T12).

``zeta = [vec R (9), t (3), u = R.T t (3), vec([t]x R) (9), 1]``, row-major ``vec``, of ``T_world_body``.
Because residuals are linear in zeta, they are linear in its mean over a tick as well: averaging frames
lowers the noise and keeps every constraint exact, which averaging poses would not.
"""

from typing import Final

import numpy as np

from contact_tracker.geometry.linalg import Array, cross_matrix

SIZE: Final = 25
R: Final = np.arange(0, 9)
T: Final = np.arange(9, 12)
U: Final = np.arange(12, 15)
TXR: Final = np.arange(15, 24)
ONE: Final = np.array([24])
NOISE_OF_PERTURBATION: Final = np.array([1, 1, 1, 0, 0, 0])
"""Index into (position, rotation) variances of each of the six ``perturbations`` of a pose."""
_INVERSE_ORDER: Final = np.concatenate(
    [
        R.reshape(3, 3).T.ravel(),
        U,
        T,
        TXR.reshape(3, 3).T.ravel(),
        ONE,
    ]
)
_INVERSE_SIGN: Final = np.concatenate([np.ones(9), -np.ones(6), np.ones(10)])


def lift(rotation: Array, position_m: Array) -> Array:
    """Lift poses with rotation (..., 3, 3) and position (..., 3) to zeta (..., 25)."""
    u = np.einsum("...ji,...j->...i", rotation, position_m)
    after, before = [1, 2, 0], [2, 0, 1]
    t = position_m[..., None]
    t_cross_r = t[..., after, :] * rotation[..., before, :] - t[..., before, :] * rotation[..., after, :]
    return np.concatenate(
        [
            rotation.reshape(*rotation.shape[:-2], 9),
            position_m,
            u,
            t_cross_r.reshape(*rotation.shape[:-2], 9),
            np.ones((*position_m.shape[:-1], 1)),
        ],
        axis=-1,
    )


def mean_lift(rotation: Array, position_m: Array) -> Array:
    """Mean (25,) of the lifts of N poses: rotation (N, 3, 3), position (N, 3).

    All numbers but the position are sums of products of one of R with 1 or one of t.
    """
    count, rows = len(position_m), rotation.reshape(-1, 9)
    r, t = rows.sum(axis=0) / count, position_m.sum(axis=0) / count
    t_r = position_m.T @ rows / count  # means of t_k R_ij
    return np.concatenate([r, t, t_r.ravel() @ _U_AND_TXR, [1.0]])


_U_AND_TXR: Final = np.concatenate(
    [lift(np.eye(9).reshape(9, 3, 3), np.tile(t, (9, 1)))[:, U[0] : ONE[0]] for t in np.eye(3)]
)
"""(27, 12): what each t_k R_ij adds to u and to vec([t]x R)."""


def perturbations() -> Array:
    """Six linear maps (6, 25, 25): the change of zeta by small perturbations of the pose.

    First turns about the body's axes, ``dR = R [e_i]x``, then shifts along the world's, ``dt = e_i``.
    """
    out = np.zeros((6, SIZE, SIZE))
    eye = np.eye(3)
    for axis, turn, shift in zip(eye, out[:3], out[3:], strict=True):
        cross = cross_matrix(axis)
        turn[np.ix_(R, R)] = turn[np.ix_(TXR, TXR)] = np.kron(eye, cross.T)
        turn[np.ix_(U, U)] = cross.T
        shift[np.ix_(T, ONE)] = axis[:, None]
        shift[np.ix_(U, R)] = np.kron(axis, eye)
        shift[np.ix_(TXR, R)] = np.kron(cross, eye)
    return out


def lift_of_inverse(zeta: Array) -> Array:
    """Lift of the inverse pose from the lift of the pose: a signed permutation of zeta."""
    return np.asarray(zeta.take(_INVERSE_ORDER, axis=-1) * _INVERSE_SIGN)
