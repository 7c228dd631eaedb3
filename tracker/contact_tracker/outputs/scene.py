"""Drawing of touching pairs: meshes of elements, their places, the eye, and the object's hull.

Meshes are round for the object, square for the surroundings. An object's face is a wheel, its edge a round
rod, its vertex a ball; a face of the surroundings is a square sheet, an edge a square bar, a vertex a cube.
Uncertainty is the surface at two standard deviations: a pair of bowls about a plane, a tube that widens along
a line, an ellipsoid about a point.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from contact_tracker.geometry.elements import Array, ContactGeometry, Element, Line, Plane, Point, nearest
from contact_tracker.motion.poses import Poses
from contact_tracker.outputs.text import Colour
from contact_tracker.tracking.belief import Segment

GREY: Final[Colour] = (170, 176, 186)
OBJECT: Final[Colour] = (244, 240, 228)
"""Colour of the object's elements; those of the surroundings have the colour of the contact."""

SIGMAS: Final = 2.0
_ROUND: Final = np.linspace(0.0, 2.0 * np.pi, 36, endpoint=False)
FEW: Final = _ROUND[::4]
SQUARE: Final = 0.25 * np.pi + np.linspace(0.0, 2.0 * np.pi, 4, endpoint=False)
"""Angles (rad) of the corners of a square section; ``FEW`` and ``_ROUND``: of a round one."""
_CORNER: Final = np.sqrt(2.0)
"""Distance of a square's corners from its middle, relative to half its side."""
_ROD: Final = 0.04
_BAR: Final = 0.05
_VERTEX: Final = 0.1
_RIM: Final = 0.02
_NEEDLE: Final = 0.01
"""Dimensions relative to the drawn half size."""
_SPOKES: Final = 3


class Mesh(NamedTuple):
    """``vertices`` (V, 3) in metres, ``triangles`` (T, 3) of their indices, ``normals`` (V, 3)."""

    vertices: NDArray[np.float32]
    triangles: NDArray[np.uint32]
    normals: NDArray[np.float32]


EMPTY: Final = Mesh(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint32), np.zeros((0, 3), np.float32))


def solid(is_round: bool, element: Element, centre: Array, half_m: float) -> Mesh:
    """The mesh of an element, of the object if it ``is_round``, within ``half_m`` of its point ``centre``;
    EMPTY if it is not finite."""
    match element:
        case Plane(normal) if is_round:
            thick, around = _RIM * half_m, FEW[:, None]
            out = circle(normal, np.append(_ROUND, _ROUND[:1]))
            section = np.cos(around) * out[:, None] + np.sin(around) * normal
            rim = _mesh(centre + (half_m - thick) * out[:, None] + thick * section)
            ways = circle(normal, np.pi * np.arange(_SPOKES) / _SPOKES)
            return join([rim, *(rod(way, centre, half_m, 0.5 * thick, FEW) for way in ways)])
        case Plane(normal):
            return _mesh(_disc(normal, centre, half_m, 2, SQUARE))
        case Line(direction) if is_round:
            return rod(direction, centre, half_m, _ROD * half_m)
        case Line(direction):
            return _faceted(rod(direction, centre, half_m, _BAR * _CORNER * half_m, SQUARE))
        case Point():
            return point(is_round, centre, _VERTEX * half_m)


def uncertainty(element: Element, centre: Array, half_m: float, angles: Array = _ROUND) -> Mesh:
    """The surface at two standard deviations; EMPTY if the covariance is unknown.

    Its width is limited to ``half_m``. A drawn plane has corners at ``angles``.
    """
    covariance = element.covariance
    if covariance is None or not np.all(np.isfinite(covariance)):
        return EMPTY
    match element:
        case Plane(normal):
            disc = _disc(normal, centre, half_m, 5, angles)
            shift = np.minimum(SIGMAS * distance_sd_m(element, disc), half_m)[..., None] * normal
            return join((_mesh(disc + shift), _mesh(disc - shift)))
        case Line(direction):
            along, basis = np.linspace(-half_m, half_m, 7), across(direction)
            dd, dp, pp = covariance[:3, :3], covariance[:3, 3:], covariance[3:, 3:]
            spread = pp + along[:, None, None] * (dp + dp.T) + along[:, None, None] ** 2 * dd
            return _mesh(_tube(direction, centre, along, _root(basis.T @ spread @ basis, half_m), _ROUND))
        case Point():
            return _mesh(_ball(centre, _root(covariance, half_m)))


def distance_sd_m(plane: Plane, points: Array) -> Array:
    """Standard deviations (...) of the distances of points (..., 3) from ``plane``; it has a covariance."""
    assert plane.covariance is not None
    lifted = np.concatenate([points, -np.ones((*points.shape[:-1], 1))], axis=-1)
    variance = np.einsum("...i,ij,...j->...", lifted, plane.covariance, lifted)
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)))


def rod(direction: Array, centre: Array, half_m: float, radius_m: float, angles: Array = _ROUND) -> Mesh:
    """A closed rod about the middle ``centre``, with corners at ``angles``."""
    along = half_m * np.array([-1.0, -1.0, 1.0, 1.0])
    radii = radius_m * np.array([0.0, 1.0, 1.0, 0.0])
    return _mesh(_tube(direction, centre, along, radii[:, None, None] * np.eye(2), angles))


def point(is_round: bool, centre: Array, radius_m: float) -> Mesh:
    """A ball, or a cube."""
    if is_round:
        return _mesh(_ball(centre, np.eye(3) * radius_m))
    return _faceted(rod(UP, centre, radius_m, _CORNER * radius_m, SQUARE))


def _root(covariance: Array, widest: float) -> Array:
    """Two symmetric square roots of ``covariance``, no axis longer than ``widest``."""
    variance, axes = np.linalg.eigh(covariance)
    axis = np.minimum(SIGMAS * np.sqrt(np.maximum(variance, 0.0)), widest)
    return np.asarray(axes * axis[..., None, :] @ np.swapaxes(axes, -1, -2))


def _disc(normal: Array, centre: Array, radius_m: float, rings: int, angles: Array) -> Array:
    """Rings (K, M, 3) of a disc about ``centre``, the first ring a point; a square for four angles."""
    return centre + np.linspace(0.0, radius_m, rings)[:, None, None] * circle(normal, angles)


def _tube(direction: Array, centre: Array, along_m: Array, sections: Array, angles: Array) -> Array:
    """Rings (K, M, 3) at ``along_m`` (K,): the unit circle, transformed by ``sections`` (K or 1, 2, 2)."""
    unit_circle = np.stack([np.cos(angles), np.sin(angles)])
    rings = np.swapaxes(across(direction) @ sections @ unit_circle, -1, -2)
    return np.asarray(centre + along_m[:, None, None] * direction + rings)


def _ball(centre: Array, axes: Array) -> Array:
    """Rings (K, M, 3) of the unit sphere, transformed by ``axes`` (3, 3)."""
    latitude = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 9)[:, None]
    level = np.cos(latitude)
    sphere = level * np.cos(_ROUND), level * np.sin(_ROUND), np.sin(latitude) + 0.0 * _ROUND
    return np.asarray(centre + np.stack(sphere, axis=-1) @ axes.T)


def circle(axis: Array, angles: Array) -> Array:
    """Points (N, 3) of the unit circle about the unit vector ``axis``."""
    return np.asarray(np.stack([np.cos(angles), np.sin(angles)], axis=-1) @ across(axis).T)


def across(axis: Array) -> Array:
    """Two unit vectors (3, 2) that complete the unit vector ``axis`` to a basis: not ``sphere_tangent``, so
    that sheets on upright walls have level sides."""
    first = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    first = first / np.linalg.norm(first)
    return np.stack([first, np.cross(axis, first)], axis=-1)


def _mesh(rings: Array) -> Mesh:
    """The surface through closed ``rings`` (K, M, 3); EMPTY if they are not finite."""
    if not np.all(np.isfinite(rings)):
        return EMPTY
    count, size = rings.shape[:2]
    at = np.arange(count * size).reshape(count, size)
    following = np.roll(at, -1, axis=1)
    low, up = np.stack([at[:-1], following[:-1], at[1:]]), np.stack([at[1:], following[:-1], following[1:]])
    triangles = np.concatenate([low.reshape(3, -1), up.reshape(3, -1)], axis=1).T
    vertices = rings.reshape(-1, 3)
    return Mesh(vertices.astype(np.float32), triangles.astype(np.uint32), _normals(vertices, triangles))


def _normals(vertices: Array, triangles: NDArray[np.intp]) -> NDArray[np.float32]:
    """The unit mean (V, 3) of the adjoining triangles' normals, weighted by area."""
    a, b, c = np.moveaxis(vertices[triangles], 1, 0)
    sums = np.zeros_like(vertices)
    np.add.at(sums, triangles, np.cross(b - a, c - a)[:, None])
    length = np.linalg.norm(sums, axis=1, keepdims=True)
    return (sums / np.where(length > 0.0, length, 1.0)).astype(np.float32)


def _faceted(mesh: Mesh) -> Mesh:
    """The mesh with separate vertices for each triangle, so that its sides look flat."""
    if mesh is EMPTY:
        return EMPTY
    corners = mesh.vertices[mesh.triangles].reshape(-1, 3)
    apart = np.arange(len(corners)).reshape(-1, 3)
    return Mesh(corners, apart.astype(np.uint32), _normals(corners.astype(float), apart))


def join(meshes: Sequence[Mesh]) -> Mesh:
    """Several meshes as one."""
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])[:-1]
    shifted = [mesh.triangles + np.uint32(start) for mesh, start in zip(meshes, starts, strict=True)]
    return Mesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate(shifted),
        np.concatenate([mesh.normals for mesh in meshes]),
    )


ENOUGH_POSES: Final = 200
LARGEST_M: Final = 2.0
"""Largest radius (m) of an object of unknown size."""
_CUBE_ABOVE: Final = 0.25
_CORNER_LABEL: Final = 0.7
_WHEEL: Final = 0.65
"""Size of an object's face relative to the sheet of the touched face."""
UP: Final = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class Extent:
    """Size of the object: ``centre_m`` (3,) in the body frame, ``radius_m`` around it.

    ``vertices_m`` are (V, 3) of its hull in the body frame; without them the extent is an estimate, which is
    enlarged to reach contacts.
    """

    centre_m: Array
    radius_m: float
    vertices_m: Array | None = None


UNKNOWN_EXTENT: Final = Extent(np.zeros(3), 0.1)


class Drawing(NamedTuple):
    """The drawing of a touching pair.

    Parameters
    ----------
    meshes : the object's element and its uncertainty in the body frame, the surroundings' in the world frame.
    label_m : (3,) position of the label in the world frame.
    is_open : whether the position of two faces along their normal is unknown.
    """

    meshes: tuple[Mesh, ...]
    label_m: Array
    is_open: bool


def poses_within(poses: Poses, start_ns: int, end_ns: int) -> Poses:
    """The poses between two stamps, at least one."""
    first, last = np.searchsorted(poses.stamp_ns, [start_ns, end_ns + 1])
    first = min(int(first), len(poses) - 1)
    return poses[first : max(int(last), first + 1)]


def draw(geometry: ContactGeometry, poses: Poses, extent: Extent, up: Array = UP) -> Drawing:
    """Draw the pair where it touches during ``poses``: of the object's size, along the whole sliding path.

    If only the distance of two faces is known, they are drawn at the lower end of the hull, and their
    uncertainty as a needle along the normal.

    Parameters
    ----------
    poses : during the contact, at least one.
    up : (3,) upward in the world.
    """
    poses = poses[:: 1 + len(poses) // ENOUGH_POSES]
    rotation, position = poses.rotation, poses.position_m
    body, world, radius_m = geometry.object, geometry.environment, extent.radius_m
    resting = _resting(geometry, poses, extent, up)
    if resting is not None:
        body, world = resting
    on_object = extent.centre_m if isinstance(body, Plane) else body.point_m
    touched = rotation @ on_object + position
    touching = on_object[None]
    if not isinstance(world, Plane):
        touching = np.einsum("nij,ni->nj", rotation, world.point_m - position)
    middle, inner = _centre(world, touched), _centre(body, touching)
    if isinstance(body, Plane) and not isinstance(world, Plane):
        reach_m = float(np.median(np.linalg.norm(touching - extent.centre_m, axis=1)))
    else:
        reach_m = float(np.linalg.norm(inner - extent.centre_m))
    if extent.vertices_m is None and radius_m < reach_m <= LARGEST_M:  # the radius is an estimate
        radius_m = reach_m
    half_m = _half_m(world, touched, middle, radius_m)
    object_m = _half_m(body, touching, inner, radius_m) * (_WHEEL if isinstance(body, Plane) else 1.0)
    if resting is None:
        spreads = uncertainty(body, inner, object_m), uncertainty(world, middle, half_m, SQUARE)
    else:
        spreads = EMPTY, rod(resting[1].normal, middle, radius_m, _NEEDLE * radius_m)
    solids = solid(True, body, inner, object_m), solid(False, world, middle, half_m)
    match world:  # the label is at a corner of a sheet, an end of a bar, or below a cube
        case Plane(normal):
            away = _CORNER_LABEL * circle(normal, SQUARE)[0]
        case Line(direction):
            away = direction if direction @ up < 0.0 else -direction
        case Point():
            away = -_CUBE_ABOVE * up
    meshes = solids[0], spreads[0], solids[1], spreads[1]
    return Drawing(meshes, middle + half_m * away, resting is not None)


def side(plane: Plane, points: Array, radius_m: float) -> float:
    """The side of ``plane`` on which ``points`` (N, 3) are: 1 along its normal, -1 opposite, 0 if unknown."""
    if plane.covariance is not None:
        middle = np.median(points, axis=0)
        if not SIGMAS * float(distance_sd_m(plane, middle)) < radius_m:  # also for nan
            return 0.0
    return float(np.sign(np.median(points @ plane.normal) - plane.offset_m))


def _resting(
    geometry: ContactGeometry, poses: Poses, extent: Extent, up: Array
) -> tuple[Plane, Plane] | None:
    """Two faces, if only their distance is known, shifted along their normal to the lower end of the hull, if
    there is a hull; None for other pairs."""
    on_object, on_world = geometry.object, geometry.environment
    if not isinstance(on_object, Plane) or not isinstance(on_world, Plane):
        return None
    rotation = poses.rotation
    if not all(geometry.has_open_offset):
        if on_world.covariance is None:
            return None
        sd_m = distance_sd_m(on_world, rotation @ extent.centre_m + poses.position_m)
        if not SIGMAS * float(np.median(sd_m)) > extent.radius_m:
            return None
    if extent.vertices_m is None:
        return on_object, on_world
    outward = rotation[len(rotation) // 2] @ on_object.normal
    heights = extent.vertices_m @ on_object.normal
    lowest = float(heights.min() if outward @ up >= 0.0 else heights.max())
    along = (lowest - on_object.offset_m) * float(np.sign(outward @ on_world.normal))
    return replace(on_object, offset_m=lowest), replace(on_world, offset_m=on_world.offset_m + along)


def _half_m(element: Element, partner: Array, centre: Array, radius_m: float) -> float:
    """Distance (m) from ``centre`` up to which an element is drawn, for a ``partner`` at positions (N, 3)."""
    reach = float(np.max(np.linalg.norm(partner - centre, axis=1))) if isinstance(element, Plane) else 0.0
    return radius_m + min(reach, 3.0 * radius_m)


def _centre(element: Element, partner: Array) -> Array:
    """The centre of a drawn element, for a ``partner`` at positions (N, 3) in the element's frame."""
    return nearest(element, partner.mean(axis=0)) if isinstance(element, Plane) else element.point_m


def hull(vertices_m: Array) -> tuple[Mesh, Array, Extent] | None:
    """The convex hull in the body frame with its edges (E, 2, 3) in metres, and its size; None if
    ``vertices_m`` (V, 3) do not span a solid."""
    try:
        convex = ConvexHull(vertices_m)
    except (QhullError, ValueError):
        return None
    centre = vertices_m[convex.vertices].mean(axis=0)
    radius = float(np.max(np.linalg.norm(vertices_m[convex.vertices] - centre, axis=1)))
    edges = [
        vertices_m[sorted(set(convex.simplices[a]) & set(convex.simplices[b]))]
        for a, row in enumerate(convex.neighbors)
        for b in row
        if a < b and not np.allclose(convex.equations[a], convex.equations[b], atol=1e-6)
    ]
    places = vertices_m.astype(np.float32)
    mesh = Mesh(places, convex.simplices.astype(np.uint32), np.zeros_like(places))
    lines = np.array(edges, np.float32).reshape(-1, 2, 3).astype(float)
    return mesh, lines, Extent(centre, radius, vertices_m)


_BACK: Final = 3.9
_ABOVE: Final = 2.2
"""Distances of the eye behind and above the object, in radii of the object."""
_AHEAD: Final = np.array([0.2, 1.0, 0.1])
"""Direction in the world; the view is along the nearest level direction."""
_LEAST_COSINE: Final = np.cos(np.radians(10.0))


Eye = tuple[Array, Array]
"""Position (3,) in metres relative to the object, which is in the middle of the view, and up (3,)."""


class Upward:
    """Estimates upward as the direction away from the planes that were touched longest; z without planes.

    ``extent`` is the object's. If the side of the object is not known, a plane counts towards z.
    """

    def __init__(self, extent: Extent) -> None:
        self._extent = extent
        self._sum = np.zeros(3)  # sum of the normals on the object's side, weighted by time (s)

    @classmethod
    def of(cls, segments: Iterable[Segment], poses: Poses, extent: Extent) -> Self:
        """The estimate from the segments of a whole recording."""
        upward = cls(extent)
        for segment in segments:
            if segment.geometry is not None:
                within = poses_within(poses, segment.start_ns, segment.end_ns)
                upward.add(segment.geometry, within, segment.end_ns - segment.start_ns)
        return upward

    def add(self, geometry: ContactGeometry, poses: Poses, lasted_ns: int) -> bool:
        """Add a contact of duration ``lasted_ns``; returns whether the direction has changed."""
        if not isinstance(geometry.environment, Plane):
            return False
        previous, normal = self.direction, geometry.environment.normal
        centres = poses.rotation @ self._extent.centre_m + poses.position_m
        sign = side(geometry.environment, centres, self._extent.radius_m)
        sign = sign or (1.0 if normal @ previous >= 0.0 else -1.0)
        self._sum = self._sum + 1e-9 * lasted_ns * sign * normal
        return not previous @ self.direction > _LEAST_COSINE

    @property
    def direction(self) -> Array:
        """(3,) upward in the world."""
        length = float(np.linalg.norm(self._sum))
        return self._sum / length if length > 0.0 else UP

    def eye(self, radius_m: float) -> Eye:
        """The eye for an object of this size."""
        up = self.direction
        ahead = _AHEAD - (_AHEAD @ up) * up
        return radius_m * (_ABOVE * up - _BACK * ahead / np.linalg.norm(ahead)), up
