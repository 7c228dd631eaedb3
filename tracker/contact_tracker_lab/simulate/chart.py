"""Coordinates in which a contact holds by construction.

A contact of two convex bodies has a common normal n (world frame, out of the environment) and a touching
point. Object and environment do not overlap if -n, in the body frame, lies in the normal cone of the
object's feature, n in that of the environment's, and both features contain the touching point. So a pose is
given by two normals, the spin about them and the touching point on either feature. Any values within the
features give exact contact without overlap.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contact_tracker.geometry.elements import ContactGeometry
from contact_tracker.geometry.polyhedron import Feature, unit
from contact_tracker.states import Contact

Array = NDArray[np.float64]

_FACING = np.diag([1.0, -1.0, -1.0])  # the normals of touching surfaces are opposite


@dataclass(frozen=True, eq=False)
class Chart:
    """The two features of a contact, each with the reference direction of the spin.

    For two edges whose references are their directions, the spin is the angle at which they cross.
    """

    contact: Contact
    object: Feature
    environment: Feature
    object_reference: Array
    environment_reference: Array

    @classmethod
    def of(cls, contact: Contact, object: Feature, environment: Feature) -> "Chart":
        return cls(contact, object, environment, object.reference, environment.reference)

    def rotation(self, normal: Array, object_normal: Array, spin: Array) -> Array:
        """Rotations (N, 3, 3) from normals (N, 3) and spin (N,) in rad."""
        c, s, o = np.cos(spin), np.sin(spin), np.zeros_like(spin)
        about = np.stack([c, -s, o, s, c, o, o, o, o + 1.0], axis=-1).reshape(*spin.shape, 3, 3)
        environment = _frame(normal, self.environment_reference)
        object_frame = _frame(object_normal, self.object_reference)
        return np.asarray(environment @ about @ _FACING @ np.swapaxes(object_frame, -1, -2), float)

    def spin(self, rotation: Array, normal: Array, object_normal: Array) -> float:
        """The spin (rad) whose rotation with these normals is nearest to ``rotation`` (3, 3)."""
        environment = _frame(normal, self.environment_reference)
        about = environment.T @ rotation @ _frame(object_normal, self.object_reference) @ _FACING
        return float(np.arctan2(about[1, 0] - about[0, 1], about[0, 0] + about[1, 1]))

    def geometry(
        self, body: "Rigid", world: "Rigid", touch_object: Array, touch_scene: Array
    ) -> ContactGeometry:
        """The touching elements, transformed by ``body`` and ``world``."""
        return ContactGeometry(
            self.object.element(body.rotation, body.translation, touch_object),
            self.environment.element(world.rotation, world.translation, touch_scene),
        )


@dataclass(frozen=True, eq=False)
class Rigid:
    """Rigid motions x -> R x + t: ``rotation`` (..., 3, 3), ``translation`` (..., 3)."""

    rotation: Array
    translation: Array

    def __matmul__(self, other: "Rigid") -> "Rigid":
        moved = np.einsum("...ij,...j->...i", self.rotation, other.translation)
        return Rigid(self.rotation @ other.rotation, moved + self.translation)

    def inverse(self) -> "Rigid":
        back = np.swapaxes(self.rotation, -1, -2)
        return Rigid(back, -np.einsum("...ij,...j->...i", back, self.translation))


def _frame(normal: Array, reference: Array) -> Array:
    """Right-handed frames (..., 3, 3) with columns x, y, normal; x is ``reference`` made orthogonal."""
    x = unit(reference - (normal @ reference)[..., None] * normal)
    return np.stack([x, np.cross(normal, x), normal], axis=-1)
