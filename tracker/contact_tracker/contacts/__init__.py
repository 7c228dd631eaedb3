"""Models of the six contacts with one interface, in the order of ``CONTACTS``."""

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from contact_tracker.contacts import edge_edge, edge_face, face_face, vertex_face
from contact_tracker.contacts.family import Array, Family, Frames, Measurement
from contact_tracker.geometry import lifted_pose
from contact_tracker.geometry.elements import ContactGeometry
from contact_tracker.geometry.lifted_pose import lift_of_inverse
from contact_tracker.states import Contact

__all__ = ["CONTACT_MODELS", "ContactModel"]


@dataclass(frozen=True, eq=False)
class ContactModel:
    """A contact: its family, and whether frame 1 is the body (f-f, e-f, v-f, e-e) or the world (f-e, f-v)."""

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
        """The entries (..., C) that the family reads, of zeta (..., 25) or of the inverse pose's lift."""
        index, sign = self._order
        return np.asarray(zeta[..., index] * sign)

    @cached_property
    def moves(self) -> Array:
        """Maps (6, C, C): the family's entries, as row vectors, times a map are their derivatives by turns
        about the body's axes and shifts along the world's."""
        select = self.lifted(np.eye(lifted_pose.SIZE)).T
        return np.asarray(select @ lifted_pose.perturbations() @ select.T)

    def anchors(self, position_m: Array) -> Array:
        """Position of the body in frames 1 and 2 (..., 6); in the world it is ``position_m`` (..., 3)."""
        pair = [np.zeros_like(position_m), position_m]
        return np.concatenate(pair if self.body_in_1 else pair[::-1], axis=-1)

    def turned(self, x: Array, turn: Array) -> Array:
        """x (..., S) with the direction of its element in the world, if any, turned by ``turn`` (3, 3)."""
        d = self.family.FORM.d2 if self.body_in_1 else self.family.FORM.d1
        out = np.array(x)
        if d >= 0:
            out[..., d : d + 3] = x[..., d : d + 3] @ turn.T
        return out

    def faced(self, x: Array, is_given: NDArray[np.bool_], turn: Array) -> Array:
        """x (..., S) of f-f; if only one of its normals is given, the other is derived from it, as they are
        parallel at the orientation ``turn`` (3, 3) of the body. Other contacts' x is unchanged.

        Residuals do not depend on the sign of a normal, but a prior on the height does, and a fit that starts
        with the wrong sign does not recover.

        Parameters
        ----------
        is_given : (..., S) whether each entry of x is given.
        """
        if self.family is not face_face:
            return x
        m, n, out = face_face.M, face_face.N, np.array(x)
        m_given, n_given = is_given[..., m][..., :1], is_given[..., n][..., :1]  # directions are given whole
        out[..., m] = np.where(n_given & ~m_given, x[..., n] @ turn, x[..., m])
        out[..., n] = np.where(m_given & ~n_given, x[..., m] @ turn.T, x[..., n])
        return out

    def measure(self, x: Array, zeta: Array) -> Measurement:
        """Exact residuals and lever arms of hypotheses x (B, S) on lifted poses zeta (T, 25)."""
        of_1_in_2 = zeta if self.body_in_1 else lift_of_inverse(zeta)
        return self.family.measure(x, Frames.of(of_1_in_2, self.body_in_1))

    def geometry(self, x: Array, covariance: Array, reach_m: float) -> ContactGeometry:
        """Elements of the object and the environment for x (S,) with the covariance (S, S)."""
        element_1, element_2 = self.family.elements(x, covariance, reach_m)
        if self.body_in_1:
            return ContactGeometry(element_1, element_2)
        return ContactGeometry(element_2, element_1)


CONTACT_MODELS: Final = (
    ContactModel(Contact.FF, face_face),
    ContactModel(Contact.EF, edge_face),
    ContactModel(Contact.FE, edge_face, body_in_1=False),
    ContactModel(Contact.VF, vertex_face),
    ContactModel(Contact.FV, vertex_face, body_in_1=False),
    ContactModel(Contact.EE, edge_edge),
)
"""The models of all contacts in the order of ``CONTACTS``."""
