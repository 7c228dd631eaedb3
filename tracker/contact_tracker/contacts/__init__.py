"""The six contacts behind one contract, in the order of ``CONTACTS``."""

from dataclasses import dataclass
from functools import cached_property
from importlib import import_module
from importlib.util import find_spec
from typing import Final, cast

import numpy as np
from numpy.typing import NDArray

from contact_tracker.contacts import face_face
from contact_tracker.contacts.family import Array, Family, Frames, Measurement
from contact_tracker.geometry import lifted_pose
from contact_tracker.geometry.elements import ContactGeometry
from contact_tracker.geometry.lifted_pose import lift_of_inverse
from contact_tracker.states import CONTACTS, Contact

__all__ = ["CONTACT_MODELS", "ContactModel"]


@dataclass(frozen=True, eq=False)
class ContactModel:
    """One contact: a family, and whether frame 1 is the body (f-f, e-f, v-f, e-e) or the world (f-e, f-v)."""

    contact: Contact
    family: Family
    body_in_1: bool = True

    @property
    def needed(self) -> float:
        """Number of poses that determine the geometry: free directions of x over residuals per pose."""
        return self.family.PARAMETERS / self.family.ROWS

    @cached_property
    def _order(self) -> tuple[NDArray[np.int64], Array]:
        columns = np.asarray(self.family.COLUMNS)
        if self.body_in_1:
            return columns, np.ones(len(columns))
        inverse = lift_of_inverse(np.arange(1.0, lifted_pose.SIZE + 1))[columns]
        return np.abs(inverse).astype(np.int64) - 1, np.sign(inverse)

    def lifted(self, zeta: Array) -> Array:
        """The C entries (..., C) of zeta (..., 25), or of the inverse pose's, that the family reads."""
        index, sign = self._order
        return np.asarray(zeta[..., index] * sign)

    @cached_property
    def moves(self) -> Array:
        """Linear maps (6, C, C): the change of the family's entries by small turns about the body's axes and
        shifts along the world's, as row vectors times a map."""
        select = self.lifted(np.eye(lifted_pose.SIZE)).T
        return np.asarray(select @ lifted_pose.perturbations() @ select.T)

    def anchors(self, position_m: Array) -> Array:
        """Where the body is in frames 1 and 2, (..., 6); in the world it is at ``position_m`` (..., 3)."""
        pair = [np.zeros_like(position_m), position_m]
        return np.concatenate(pair if self.body_in_1 else pair[::-1], axis=-1)

    def turned(self, x: Array, turn: Array) -> Array:
        """x (..., S) with its direction in the world, if it has one, turned by ``turn`` (3, 3)."""
        first = self.family.FORM.d2 if self.body_in_1 else self.family.FORM.d1
        out = np.array(x)
        if first >= 0:
            out[..., first : first + 3] = x[..., first : first + 3] @ turn.T
        return out

    def faced(self, x: Array, given: NDArray[np.bool_], turn: Array) -> Array:
        """x (..., S) of f-f, with a normal that is not ``given`` (..., S) derived from one that is: they are
        parallel at the orientation ``turn`` (3, 3) of the body.

        Residuals do not depend on the sign of a normal, but a prior on the height does, and a fit that starts
        with the wrong sign does not recover.
        """
        if self.family is not face_face:
            return x
        m, n, out = face_face.M, face_face.N, np.array(x)
        first, second = given[..., m][..., :1], given[..., n][..., :1]  # a direction is given as a whole
        out[..., m] = np.where(second & ~first, x[..., n] @ turn, x[..., m])
        out[..., n] = np.where(first & ~second, x[..., m] @ turn.T, x[..., n])
        return out

    def measure(self, x: Array, zeta: Array) -> Measurement:
        """Exact residuals and lever arms of hypotheses x (B, S) on lifted poses zeta (T, 25)."""
        of_1_in_2 = zeta if self.body_in_1 else lift_of_inverse(zeta)
        return self.family.measure(x, Frames.of(of_1_in_2, self.body_in_1))

    def geometry(self, x: Array, covariance: Array, reach_m: float) -> ContactGeometry:
        """Object's and environment's elements of one x (S,) with the covariance (S, S) of x."""
        first, second = self.family.elements(x, covariance, reach_m)
        return ContactGeometry(first, second) if self.body_in_1 else ContactGeometry(second, first)


def _model_of(contact: Contact) -> ContactModel:
    """The contact of the family whose module is named after its elements, or after those of its mirror."""
    first, second = contact.value[0], contact.value[2]
    for one, other in ((first, second), (second, first)):
        name = f"{__name__}.{_ELEMENTS[one]}_{_ELEMENTS[other]}"
        if find_spec(name) is not None:
            return ContactModel(contact, cast(Family, import_module(name)), body_in_1=one == first)
    raise ImportError(f"no family has the elements of {contact.value}")


_ELEMENTS: Final = {"f": "face", "e": "edge", "v": "vertex"}
CONTACT_MODELS: Final = tuple(map(_model_of, CONTACTS))
"""All contacts in the order of ``CONTACTS``."""
