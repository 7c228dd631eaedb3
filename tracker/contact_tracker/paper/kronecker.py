"""The same objectives with the elements outside the sum: ``F = (x (x) y).T K (x (x) y)``.

K sums over frames once, so that a minimiser's steps cost nothing per frame. Equations (6)-(8), (11)-(13),
(16)-(17) and (20)-(21) with (7), (13) and (21) corrected (docs/theory.md, T7 and errata).
"""

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from contact_tracker.paper.objectives import motion
from contact_tracker.states import Contact

Array = NDArray[np.float64]
Kind = Literal["plane", "line", "point"]

SIZE: Final[dict[Kind, int]] = {"plane": 4, "line": 6, "point": 4}


@dataclass(frozen=True)
class Form:
    """Which elements the factors x and y are, in which order.

    Parameters
    ----------
    x, y : kinds of the first and the second factor.
    object_first : whether x is the object's element.
    swapped : whether the frames are exchanged (f-e is e-f of the inverse motion).
    """

    x: Kind
    y: Kind
    object_first: bool
    swapped: bool = False

    @property
    def size(self) -> int:
        """Length of ``x (x) y``: 16, 24 or 36."""
        return SIZE[self.x] * SIZE[self.y]

    def factors(self, obj: Array, environment: Array) -> tuple[Array, Array]:
        """Object and environment as (x, y); given (x, y) it returns (object, environment)."""
        return (obj, environment) if self.object_first else (environment, obj)


_FORMS: Final[dict[Contact, Form]] = {
    Contact.FF: Form("plane", "plane", object_first=True),
    Contact.EF: Form("line", "plane", object_first=True),
    Contact.FE: Form("line", "plane", object_first=False, swapped=True),
    Contact.VF: Form("point", "plane", object_first=True),
    Contact.FV: Form("point", "plane", object_first=False, swapped=True),
    Contact.EE: Form("line", "line", object_first=False),
}


def form(contact: Contact) -> Form:
    """The factors of a contact's Kronecker product."""
    return _FORMS[contact]


def matrix(contact: Contact, rotation: Array, p: Array) -> Array:
    """K (..., n, n), summed over the frames.

    Parameters
    ----------
    rotation, p : (..., N, 3, 3) and (..., N, 3); leading axes are independent sums.
    """
    a = rows(contact, rotation, p)
    a = a.reshape(*p.shape[:-2], -1, a.shape[-1])
    k: Array = np.swapaxes(a, -1, -2) @ a
    return k


def value(contact: Contact, k: Array, obj: Array, environment: Array) -> float:
    """The objective function, from K."""
    v = np.kron(*form(contact).factors(obj, environment))
    return float(v @ k @ v)


def rows(contact: Contact, rotation: Array, p: Array) -> Array:
    """Rows A (..., N, r, n) of each frame: its residuals are ``A @ kron(x, y)``."""
    if form(contact).swapped:
        flat = motion(rotation.reshape(-1, 3, 3), p.reshape(-1, 3))
        rotation, p = flat[0].reshape(rotation.shape), flat[1].reshape(p.shape)
    match contact:
        case Contact.FF:
            return _face_face(rotation, p)
        case Contact.EF | Contact.FE:
            return _edge_face(rotation, p)
        case Contact.VF | Contact.FV:
            return _vertex_face(rotation, p)
        case _:
            return _edge_edge(rotation, p)


def _face_face(rotation: Array, p: Array) -> Array:
    """(7) over (8), ``p_sb`` with its sign corrected: 6 rows on plane (x) plane."""
    a = np.zeros((*p.shape[:-1], 6, 4, 4))
    a[..., :3, :3, :] = _offsets(rotation, p)
    a[..., :3, 3, :3] = -rotation
    a[..., 3:, :3, :3] = _cross_rows(rotation)
    return a.reshape(*p.shape[:-1], 6, 16)


def _edge_face(rotation: Array, p: Array) -> Array:
    """(12) with (13) negated, and ``vec(R.T)``: 4 rows on line (x) plane."""
    a = np.zeros((*p.shape[:-1], 4, 6, 4))
    a[..., :3, :3, :] = _offsets(rotation, p)
    a[..., :3, 3:, :3] = -_cross_rows(rotation)
    a[..., 3, :3, :3] = rotation
    return a.reshape(*p.shape[:-1], 4, 24)


def _vertex_face(rotation: Array, p: Array) -> Array:
    """(17): 1 row on point (x) plane."""
    a = np.zeros((*p.shape[:-1], 1, 4, 4))
    a[..., 0, :3, :3] = rotation
    a[..., 0, 3, :3] = -np.einsum("...ij,...i->...j", rotation, p)
    a[..., 0, 3, 3] = -1.0
    return a.reshape(*p.shape[:-1], 1, 16)


def _edge_edge(rotation: Array, p: Array) -> Array:
    """(21) with columns for rows of R: 1 row on environment's line (x) object's line."""
    columns = np.swapaxes(rotation, -1, -2)
    a = np.zeros((*p.shape[:-1], 1, 6, 6))
    a[..., 0, :3, :3] = np.cross(p[..., None, :], columns)
    a[..., 0, :3, 3:] = columns
    a[..., 0, 3:, :3] = columns
    return a.reshape(*p.shape[:-1], 1, 36)


def _offsets(rotation: Array, p: Array) -> Array:
    """(..., 3, 3, 4): row k takes ``v_k ((R n) . p + h)`` from ``v (x) [n, h]``."""
    plane = np.concatenate([np.einsum("...ij,...i->...j", rotation, p), np.ones((*p.shape[:-1], 1))], axis=-1)
    return np.asarray(np.einsum("kl,...j->...klj", np.eye(3), plane))


def _cross_rows(rotation: Array) -> Array:
    """(8), (..., 3, 3, 3): row k takes ``(v x R n)_k`` from ``v (x) n``."""
    return np.asarray(np.einsum("klm,...mj->...klj", _LEVI_CIVITA, rotation))


_LEVI_CIVITA: Final = np.zeros((3, 3, 3))
for _i, _j, _k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
    _LEVI_CIVITA[_i, _j, _k], _LEVI_CIVITA[_i, _k, _j] = 1.0, -1.0
