"""The paper's objective functions as sums over frames: equations (5), (10), (15), (19) and their swaps.

All take the motion ``rotation`` (N, 3, 3), ``p`` (N, 3) with ``x_body = R x_world + p`` and return the sum
over the N frames. Units: rad^2 and m^2 (and m^2 rad^2) are added up as the paper adds them.
"""

from collections.abc import Mapping
from typing import Final

import numpy as np

from contact_tracker.arrays import Array
from contact_tracker.states import Contact


def motion(rotation_world_body: Array, position_m: Array) -> tuple[Array, Array]:
    """The paper's pair of ``T_world_body``, its inverse: ``R = R_wb.T`` and ``p = -R_wb.T t``.

    Parameters
    ----------
    rotation_world_body : (..., 3, 3).
    position_m : (..., 3).

    Returns
    -------
    rotation (..., 3, 3) and p (..., 3). Applied to its own result it gives ``T_world_body`` back.
    """
    rotation = np.swapaxes(rotation_world_body, -1, -2)
    return rotation, -np.einsum("...ij,...j->...i", rotation, position_m)


def direct(contact: Contact, rotation: Array, p: Array, obj: Array, environment: Array) -> float:
    """The objective function of ``contact``, summed frame by frame.

    The paper gives f-e and f-v by exchanging the frames: e-f and v-f with the inverse motion.
    """
    match contact:
        case Contact.FF:
            return face_face(rotation, p, obj, environment)
        case Contact.EF:
            return edge_face(rotation, p, obj, environment)
        case Contact.FE:
            return edge_face(*motion(rotation, p), environment, obj)
        case Contact.VF:
            return vertex_face(rotation, p, obj, environment)
        case Contact.FV:
            return vertex_face(*motion(rotation, p), environment, obj)
        case Contact.EE:
            return edge_edge(rotation, p, obj, environment)
        case Contact.FREE:
            raise ValueError("free motion has no objective function")


def face_face(rotation: Array, p: Array, plane_o: Array, plane_e: Array) -> float:
    """Equation (5): the line in which the planes meet vanishes."""
    normal, offset = _plane_in_body(rotation, p, plane_e)
    meet = offset[:, None] * plane_o[:3] - plane_o[3] * normal
    return _sum_of_squares(meet, np.cross(plane_o[:3], normal))


def edge_face(rotation: Array, p: Array, line_o: Array, plane_e: Array) -> float:
    """Equation (10): the point in which line and plane meet vanishes."""
    normal, offset = _plane_in_body(rotation, p, plane_e)
    meet = np.cross(normal, line_o[3:]) + offset[:, None] * line_o[:3]
    return _sum_of_squares(meet, normal @ line_o[:3])


def vertex_face(rotation: Array, p: Array, point_o: Array, plane_e: Array) -> float:
    """Equation (15), ``h_e`` with its sign corrected: point and plane span no volume."""
    normal, offset = _plane_in_body(rotation, p, plane_e)
    return _sum_of_squares(normal @ point_o[:3] - point_o[3] * offset)


def edge_edge(rotation: Array, p: Array, line_o: Array, line_e: Array) -> float:
    """Equation (19): the lines span no volume, which is their distance times the sine of their angle."""
    direction = rotation @ line_e[:3]
    moment = rotation @ line_e[3:] - np.cross(direction, p)
    return _sum_of_squares(moment @ line_o[:3] + direction @ line_o[3:])


def _plane_in_body(rotation: Array, p: Array, plane: Array) -> tuple[Array, Array]:
    """A plane of the world seen from the body: normals (N, 3) and offsets (N,)."""
    normal = rotation @ plane[:3]
    return normal, np.einsum("ni,ni->n", normal, p) + plane[3]


def _sum_of_squares(*residuals: Array) -> float:
    return float(sum(np.sum(r**2) for r in residuals))


UNREPORTED: Final = float("nan")
REPORTED_ERRORS: Final[Mapping[tuple[Contact, str], tuple[float, float]]] = {
    (Contact.FF, "object"): (0.12, UNREPORTED),
    (Contact.FF, "environment"): (0.12, UNREPORTED),
    (Contact.EF, "object"): (0.76, 5.6),
    (Contact.EF, "environment"): (0.72, UNREPORTED),
    (Contact.VF, "object"): (UNREPORTED, 9.4),
    (Contact.VF, "environment"): (0.14, UNREPORTED),
    (Contact.EE, "object"): (0.43, 6.3),
    (Contact.EE, "environment"): (0.15, 4.0),
}
"""Angle (deg) and distance (mm) by contact and side; nan where the paper gives no figure."""
