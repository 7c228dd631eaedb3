"""Exact motions in contact, from geometry only, and the cost of geometries written out: references of
incidence and of fits."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from contact_tracker.states import Contact

Array = NDArray[np.float64]


class Touching(NamedTuple):
    """Poses of frame 1 in frame 2 and the touching elements, as the paper's arrays.

    plane ``[n, h]``, line ``[d, q x d]``, point ``[q, 1]``.
    """

    rotation: Array
    position_m: Array
    object: Array
    environment: Array


def touching(contact: Contact, rng: np.random.Generator, frames: int = 60, swing: float = 0.8) -> Touching:
    """Random elements and N random poses ``T_world_body`` that keep them in contact to rounding."""
    match contact:
        case Contact.FE:
            return _swapped(touching(Contact.EF, rng, frames, swing))
        case Contact.FV:
            return _swapped(touching(Contact.VF, rng, frames, swing))
        case Contact.FREE:
            raise ValueError("nothing touches")
    rotation = (Rotation.random(random_state=rng) * _swings(rng, frames, swing)).as_matrix()
    position = rng.normal(size=(frames, 3)) * 0.1 + rng.normal(size=3) * 0.5
    n, d, m = _unit(rng), _unit(rng), _unit(rng)
    q, q2, h = rng.normal(size=3) * 0.1, rng.normal(size=3), float(rng.normal())
    plane_e = np.append(n, h)
    match contact:
        case Contact.FF:
            rotation = _turn_onto(rotation @ m, n) @ rotation
            h_o = float(rng.normal() * 0.1)
            position = _lift_onto(plane_e, position, rotation @ (m * h_o))
            return Touching(rotation, position, np.append(m, h_o), plane_e)
        case Contact.EF:
            edge = rotation @ d
            flat = edge - (edge @ n)[:, None] * n
            rotation = _turn_onto(edge, flat / np.linalg.norm(flat, axis=1, keepdims=True)) @ rotation
            return Touching(rotation, _lift_onto(plane_e, position, rotation @ q), line(d, q), plane_e)
        case Contact.VF:
            return Touching(rotation, _lift_onto(plane_e, position, rotation @ q), np.append(q, 1.0), plane_e)
        case _:
            along = rng.normal(size=(2, frames, 1)) * 0.1
            d2 = m
            position = q2 + along[0] * d2 - rotation @ q - along[1] * (rotation @ d)
            return Touching(rotation, position, line(d, q), line(d2, q2))


def line(direction: Array, point: Array) -> Array:
    return np.append(direction, np.cross(point, direction))


def point_of(line: Array) -> Array:
    """The line's foot: its point nearest to the origin."""
    return np.cross(line[:3], line[3:])


def _swapped(t: Touching) -> Touching:
    rotation = np.swapaxes(t.rotation, 1, 2)
    position = -np.einsum("nij,nj->ni", rotation, t.position_m)
    return Touching(rotation, position, t.environment, t.object)


def _swings(rng: np.random.Generator, frames: int, swing: float) -> Rotation:
    return Rotation.from_rotvec(rng.uniform(-swing, swing, size=(frames, 3)))


def _lift_onto(plane: Array, position: Array, arm: Array) -> Array:
    """Positions moved along the normal until ``position + arm`` lies on the plane."""
    height = (position + arm) @ plane[:3] - plane[3]
    return position - height[:, None] * plane[:3]


def _turn_onto(start: Array, end: Array) -> Array:
    """The shortest rotations (N, 3, 3) that take unit vectors ``start`` (N, 3) to ``end``."""
    end = np.broadcast_to(end, start.shape)
    axis = np.cross(start, end)
    sine = np.linalg.norm(axis, axis=1)
    angle = np.arctan2(sine, np.einsum("ni,ni->n", start, end))
    return Rotation.from_rotvec(axis * (angle / sine)[:, None]).as_matrix()


def _unit(rng: np.random.Generator) -> Array:
    v = rng.normal(size=3)
    return v / np.linalg.norm(v)


def elements_of(contact, x):
    """The object's and the world's element of x as the paper's arrays; of f-f the object's offset is zero."""
    match contact:
        case Contact.FF:
            first, second = np.append(x[:3], 0.0), x[3:7]
        case Contact.EF | Contact.FE:
            first, second = line(x[:3], x[3:6]), x[6:10]
        case Contact.VF | Contact.FV:
            first, second = np.append(x[:3], 1.0), x[3:7]
        case _:
            first, second = line(x[:3], x[3:6]), line(x[6:9], x[9:12])
    return (second, first) if contact in (Contact.FE, Contact.FV) else (first, second)


def x_of(contact, obj, environment):
    """The true elements as x."""
    first, second = (environment, obj) if contact in (Contact.FE, Contact.FV) else (obj, environment)
    match contact:
        case Contact.FF:
            # the height of the body's origin: motion does not determine the position of the faces
            return np.concatenate([first[:3], second[:3], [second[3] - first[3]]])
        case Contact.EF | Contact.FE:
            return np.concatenate([first[:3], point_of(first), second])
        case Contact.VF | Contact.FV:
            return np.concatenate([first[:3], second])
        case _:
            return np.concatenate([first[:3], point_of(first), second[:3], point_of(second)])


def every_cost(family, moments, row_weight, prior, x):
    """Cost (N, B) in nats of each of N geometries x (N, S) on each of B windows."""
    c = family.rows(x)
    squares = np.einsum("nkc,bcd,nkd->nkb", c, moments, c)
    squares[:, -1] /= family.scale_sq(x[:, None], moments[None])
    pull = 0.5 * np.einsum("ns,bst,nt->nb", x, prior.precision, x) - x @ prior.information.T + prior.constant
    return 0.5 * np.einsum("nkb,bk->nb", squares, row_weight) + pull
