"""The known parts of the object and its surroundings, as all outputs draw them.

Known bodies are drawn whole, other elements only where they were touched: a patch of a face, a segment of an
edge, or a vertex. If the touching element is extended, as a face on a face, this region is as large as the
object.
"""

from collections.abc import Collection, Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, NamedTuple, Self

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from contact_tracker.explanations.joint_evidence import Joint
from contact_tracker.geometry.elements import (
    Array,
    ContactGeometry,
    Element,
    Line,
    Plane,
    Point,
    nearest,
)
from contact_tracker.map.elements import (
    KINDS,
    MOST_CORNERS,
    NOTHING_LEARNED,
    Key,
    LearnedElements,
    kind_of,
)
from contact_tracker.map.map import EMPTY_MAP, Map
from contact_tracker.map.world_map import GrowingMap
from contact_tracker.motion.poses import Poses
from contact_tracker.outputs import scene
from contact_tracker.outputs.joint_runs import is_same_joint, joint_runs
from contact_tracker.outputs.outcome import Outcome
from contact_tracker.outputs.scene import UNKNOWN_EXTENT, Drawing, Extent, Mesh, Upward, draw, poses_within
from contact_tracker.outputs.text import joint_name
from contact_tracker.tracking.belief import Segment
from contact_tracker.tracking.located_faces import located

SIDES: Final = ("object", "surroundings")
MOST_POSES: Final = 40
"""Largest number of poses from which the touched region of a contact is drawn."""
MOST_KEPT: Final = 3_000
"""Largest number of stored poses; beyond it every second pose is dropped, and the sampling rate is halved."""
MOST_TOUCHES: Final = 200
"""Number of contacts with listed elements, the latest ones, whose touched regions are drawn."""
_EVERY_NS: Final = 100_000_000
_MARGIN: Final = 0.1
"""Margin about a touched region, and size of a vertex, relative to the object's radius."""
_LEAVING_NS: Final = 3_000_000_000
"""Time before and after a contact in which it shows the side of a face. Of 86 faces of 38
recordings with truth it shows 39, of which none is wrong; with half of it 43, with double 38."""
_LIFTED_M: Final = 0.01
"""Least distance (m) to which a touching element leaves a face. With half of it the
same faces have a side, with double two more."""
_RING: Final = np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False)
_RANK: Final[dict[type[Element], int]] = {Point: 0, Line: 1, Plane: 2}


Spans = Sequence[tuple[int, int]]
"""Intervals (start and end, ns) in which a part was touched, in order."""


class Part(NamedTuple):
    """A known body or element, of the object in the body frame, or of the surroundings in the world frame.

    Parameters
    ----------
    side : 0 for the object, 1 for the surroundings.
    name : for display.
    mesh : its surface.
    outline : its closed or open outlines (N, 3).
    label_m : (3,) position of its name.
    touched_ns : ``Spans`` in which it was touched.
    """

    side: int
    name: str
    mesh: Mesh
    outline: tuple[Array, ...]
    label_m: Array
    touched_ns: Spans = ()


class Touch(NamedTuple):
    """Two elements that touched from ``start_ns`` to ``end_ns``, and the keys of the parts to draw."""

    start_ns: int
    end_ns: int
    geometry: ContactGeometry
    keys: tuple[Any, Any]


class KnownParts:
    """Collects the poses and contacts of a recording, and makes the parts known so far.

    Parameters
    ----------
    known_map : lists bodies and elements.
    vertices_m : (V, 3) of the object in the body frame, if the map does not list them.

    Attributes
    ----------
    bodies : the known bodies.
    object_extent : the size of the object, ``UNKNOWN_EXTENT`` unless it is a known body.
    """

    def __init__(self, known_map: Map = EMPTY_MAP, vertices_m: Array | None = None) -> None:
        bodies = list(_known_bodies(known_map))
        if vertices_m is not None and all(side != 0 for side, _, _ in bodies):
            bodies.insert(0, (0, SIDES[0], vertices_m))
        solids = [(side, name, scene.hull(corners_m)) for side, name, corners_m in bodies]
        hulls = [(side, name, *solid) for side, name, solid in solids if solid is not None]
        self.bodies = tuple(
            Part(side, name, mesh, tuple(edges), extent.centre_m) for side, name, mesh, edges, extent in hulls
        )
        self.object_extent = next((extent for side, *_, extent in hulls if side == 0), UNKNOWN_EXTENT)
        self._listed: dict[Hashable, tuple[int, str, Element]] = {
            (side, element.name): (side, element.name, element.element)
            for side, elements in enumerate((known_map.listed_object, known_map.listed_environment))
            for element in elements
            if element.solid is None
        }
        self._is_fixed = known_map.fixes_elements
        self._poses, self._every_ns, self._last_span = list[Poses](), _EVERY_NS, -(2**62)
        self._touches: dict[int, Touch] = {}
        self._segments: tuple[Segment, ...] = ()

    @classmethod
    def of(cls, outcome: Outcome) -> Self:
        """The collection of all poses and contacts of a recording."""
        collector = cls(outcome.known_map, outcome.trajectory.vertices_m)
        collector.add_poses(outcome.trajectory.poses)
        for segment in outcome.segments:
            collector.add_contact(segment.start_ns, segment.end_ns, segment.geometry)
        collector._segments = outcome.segments
        return collector

    def extent(self, world: GrowingMap | None) -> Extent:
        """The size of the object, from its body if known, else from its listed and touched elements."""
        if self.object_extent is not UNKNOWN_EXTENT:
            return self.object_extent
        elements = (self._listed | self._map_elements(world)).values()
        feet_m = [nearest(e, np.zeros(3)) for side, _, e in elements if side == 0 and not _is_open(e)]
        if len(feet_m) < 2:
            return UNKNOWN_EXTENT
        centre_m = 0.5 * (np.min(feet_m, axis=0) + np.max(feet_m, axis=0))
        radius_m = float(np.max(np.linalg.norm(feet_m - centre_m, axis=1)))
        return Extent(centre_m, radius_m) if radius_m > 0.0 else UNKNOWN_EXTENT

    def add_poses(self, poses: Poses) -> None:
        """Add poses; at most ten per second are stored, fewer in a long stream."""
        span = poses.stamp_ns // self._every_ns
        kept = poses[np.diff(span, prepend=self._last_span) > 0]
        if not len(kept):
            return
        self._poses.append(kept)
        self._last_span = int(span[-1])
        while sum(map(len, self._poses)) > MOST_KEPT:
            self._poses, self._every_ns = [Poses.join(self._poses)[::2]], 2 * self._every_ns
            self._last_span //= 2

    def add_contact(self, start_ns: int, end_ns: int, geometry: ContactGeometry | None) -> bool:
        """Add a contact, or a later estimate of one; returns whether it is new and has a listed element."""
        if geometry is None or geometry.names == (None, None):
            return False
        keys = (0, geometry.names[0]), (1, geometry.names[1])
        is_new = start_ns not in self._touches
        if is_new and len(self._touches) == MOST_TOUCHES:
            del self._touches[min(self._touches)]
        self._touches[start_ns] = Touch(start_ns, end_ns, geometry, keys)
        return is_new and any(key in self._listed for key in keys)

    def parts(self, world: GrowingMap | None) -> tuple[Part, ...]:
        """The known bodies, and all elements that are listed or that contacts have touched (``world``)."""
        if not self._poses:
            return self.bodies
        poses, touches, extent = Poses.join(self._poses), [*self._touches.values()], self.extent(world)
        centres = poses.rotation @ extent.centre_m + poses.position_m
        about = extent.centre_m, np.median(centres, axis=0)
        learned = {} if world is None else world.learned.known
        touched = {key: _located(element, about[key[0]]) for key, element in learned.items()}
        elements = {
            key: (side, name, _located(element, about[side]))
            for key, (side, name, element) in (self._listed | self._map_elements(world)).items()
        }
        touches += _touches_of(world, touched)
        places, spans = dict[Hashable, list[Array]](), dict[Hashable, list[tuple[int, int]]]()
        if world is not None:
            places |= {key: [points_m] for key, points_m in world.learned.extents.items()}
        for touch in touches:
            for key, points in zip(touch.keys, _touched_points(touch, poses, extent), strict=True):
                places.setdefault(key, []).append(points)
                spans.setdefault(key, []).append((touch.start_ns, touch.end_ns))
        parts, places_known = [], self._places_known(world)
        for key, (side, name, element) in elements.items():
            if _is_open(element) or (
                key in touched and isinstance(element, Plane) and key not in places_known
            ):
                name = f"{name} (place not known)"
            touched_m = places.get(key) or [_region(element, about[side], extent)]
            parts.append(_element_part(side, name, element, touched_m, extent, sorted(spans.get(key, ()))))
        return (*self.bodies, *parts, *_joint_parts(self._segments, poses, extent))

    def _places_known(self, world: GrowingMap | None) -> Collection[Hashable]:
        """The learned elements whose places contacts show; of a stream, all."""
        if world is None:
            return ()
        return located(self._segments, world) if self._segments else world.elements

    def learned(self, world: GrowingMap | None) -> LearnedElements:
        """The elements that contacts have touched, for another recording, with the touched regions and, where
        the motion shows the side, the normals of faces out of the bodies."""
        if world is None or not self._poses:
            return NOTHING_LEARNED
        learned, poses, extent = world.learned, Poses.join(self._poses), self.extent(world)
        if extent is UNKNOWN_EXTENT:
            extent = replace(extent, radius_m=0.0)
        elements, directions = learned.known, {key: e.direction for key, e in learned.elements.items()}
        places = {key: [points_m] for key, points_m in learned.extents.items()}
        sides = {key: {float(np.sign(way @ directions[key]))} for key, way in learned.outward.items()}
        shown = self._places_known(world)
        for touch in _touches_of(world, elements):
            points = _touched_points(touch, poses, extent)
            free_sides = _free_sides(touch, poses, points, world.touches)
            for key, points_m, side in zip(touch.keys, points, free_sides, strict=True):
                places.setdefault(key, []).append(points_m)
                sides.setdefault(key, set()).update(side)
        return replace(
            learned,
            extents={
                key: _corners(elements[key], np.concatenate(places[key]))
                for key in places
                if not isinstance(elements[key], Point) and not _is_open(elements[key])
            },
            outward={
                key: sum(signs) * directions[key]
                for key, signs in sides.items()
                if abs(sum(signs)) == 1.0 and key in shown  # and not contradicted
            },
        )

    def _map_elements(self, world: GrowingMap | None) -> dict[Hashable, tuple[int, str, Element]]:
        """The elements of a map, without those that are a listed element in each of their contacts.

        An element that touches a fixed one has the covariance of the contact, as the map lacks that one.
        """
        if world is None:
            return {}
        elements, listed = dict(world.learned.known), dict[Hashable, bool]()
        for start_ns, _, pair in world.touches:
            touch = self._touches.get(start_ns)
            for key in pair:
                element = touch and (touch.geometry.object, touch.geometry.environment)[key[0]]
                listed[key] = element is not None and element.name is not None and listed.get(key, True)
                if self._is_fixed and element is not None and key in elements:
                    elements[key] = replace(elements[key], covariance=element.covariance)
        return {
            key: (key[0], f"{KINDS[kind_of(learned)]} {key[1]}", learned)
            for key, learned in elements.items()
            if not listed.get(key, False)
        }


def known_parts(outcome: Outcome) -> tuple[Part, ...]:
    """The known parts after a recording."""
    return KnownParts.of(outcome).parts(outcome.touched)


@dataclass(frozen=True, eq=False)
class DrawnRecording:
    """What the viewer, reports and Foxglove draw of a recording.

    Parameters
    ----------
    poses : of the object.
    parts : the known parts.
    extent, full_extent : size of the object, as its known body shows it, and as its touched elements do, too.
    upward : the estimate of upward.
    """

    poses: Poses
    parts: tuple[Part, ...]
    extent: Extent
    full_extent: Extent
    upward: Upward

    @classmethod
    def of(cls, outcome: Outcome) -> Self:
        known, poses, world = KnownParts.of(outcome), outcome.trajectory.poses, outcome.touched
        extent = known.object_extent
        upward = Upward.of(outcome.segments, poses, extent)
        return cls(poses, known.parts(world), extent, known.extent(world), upward)

    def pairs(
        self, geometries: Iterable[ContactGeometry | None], start_ns: int, end_ns: int
    ) -> Drawing | None:
        """Simultaneous touching pairs during a time, with label and ``is_open`` of the first; None without
        pairs."""
        within, up = poses_within(self.poses, start_ns, end_ns), self.upward.direction
        drawings = [draw(pair, within, self.extent, up) for pair in geometries if pair is not None]
        if not drawings:
            return None
        meshes = zip(*(drawing.meshes for drawing in drawings), strict=True)
        return drawings[0]._replace(meshes=tuple(map(scene.join, meshes)))


def _touches_of(world: GrowingMap | None, elements: Mapping[Key, Element]) -> Iterator[Touch]:
    """The touches of a map between two of these elements."""
    for start_ns, end_ns, keys in () if world is None else world.touches:
        if elements.keys() >= {*keys}:
            body, environment = (elements[key] for key in keys)
            yield Touch(start_ns, end_ns, ContactGeometry(body, environment), keys)


def _known_bodies(known_map: Map) -> Iterator[tuple[int, str, Array]]:
    """Side, name and corners (V, 3) of known boxes and meshes."""
    for side, elements in enumerate((known_map.listed_object, known_map.listed_environment)):
        for number in dict.fromkeys(element.solid for element in elements if element.solid is not None):
            listed = [(e.name, e.element) for e in elements if e.solid == number]
            corners = [(name, point.point_m) for name, point in listed if isinstance(point, Point)]
            if corners:
                name = corners[0][0].rpartition(KINDS["v"])[0].strip() or SIDES[side]
                yield side, name, np.array([point_m for _, point_m in corners])


def _is_open(element: Element) -> bool:
    """Whether the position of an element is less certain than the size of an unknown object."""
    if element.covariance is None:
        return False
    block = element.covariance[3:, 3:] if isinstance(element, Plane | Line) else element.covariance
    return float(np.sqrt(np.max(np.diag(block)))) > UNKNOWN_EXTENT.radius_m


def _located(element: Element, near_m: Array) -> Element:
    """An element, moved to ``near_m`` (3,) if its position is open: far away it would shrink the picture."""
    if not _is_open(element):
        return element
    if isinstance(element, Plane):
        return replace(element, offset_m=float(element.normal @ near_m))
    return replace(element, point_m=near_m)


def _region(element: Element, near_m: Array, extent: Extent) -> Array:
    """Points (N, 3) about the region of an element within the object's radius of ``near_m``."""
    foot, radius_m = nearest(element, near_m), extent.radius_m
    match element:
        case Plane(normal):
            return foot + radius_m * scene.circle(normal, _RING)
        case Line(direction):
            return foot + radius_m * np.array([[-1.0], [1.0]]) * direction
        case Point():
            return foot[None]


def _touched_points(touch: Touch, poses: Poses, extent: Extent) -> tuple[Array, Array]:
    """Touched points (N, 3) of two elements in the body frame, and in the world frame."""
    within = poses_within(poses, touch.start_ns, touch.end_ns)
    within = within[:: 1 + len(within) // MOST_POSES]
    rotation, position_m = within.rotation, within.position_m
    body, world = touch.geometry.object, touch.geometry.environment
    if isinstance(body, Line) and isinstance(world, Line):
        # in the body frame, the points of the object's line that are nearest to the line of the world
        direction, arm = world.direction @ rotation, world.point_m - position_m
        arm = np.einsum("nij,ni->nj", rotation, arm) - body.point_m
        along = body.direction - (direction @ body.direction)[:, None] * direction
        square = np.einsum("ni,ni->n", along, along)
        shift_m = np.einsum("ni,ni->n", along, arm) / np.where(square > 0.0, square, np.inf)
        in_body = body.point_m + shift_m[:, None] * body.direction
        return in_body, np.einsum("nij,nj->ni", rotation, in_body) + position_m
    if _RANK[type(body)] <= _RANK[type(world)]:
        points = _region(body, extent.centre_m, extent)
        return points, (np.einsum("nij,kj->nki", rotation, points) + position_m[:, None]).reshape(-1, 3)
    centres = rotation @ extent.centre_m + position_m
    in_world = np.stack([_region(world, centre, extent) for centre in centres])
    in_body = np.einsum("nij,nki->nkj", rotation, in_world - position_m[:, None])
    return in_body.reshape(-1, 3), in_world.reshape(-1, 3)


def _free_sides(
    touch: Touch,
    poses: Poses,
    points: tuple[Array, Array],
    touches: Iterable[tuple[int, int, tuple[Key, Key]]],
) -> tuple[set[float], set[float]]:
    """Of each element of a contact that is a face, the sides of the space in front of it: 1 along its normal,
    -1 opposite, both if the motion contradicts itself; ``points`` as of ``_touched_points``.

    It is the side to which the touching element leaves the face, or from which it came, but not while the
    object touches something else: it may then hang over the edge of the face.
    """
    body, world = touch.geometry.object, touch.geometry.environment
    around = poses_within(poses, touch.start_ns - _LEAVING_NS, touch.end_ns + _LEAVING_NS)
    rotation, position_m = around.rotation, around.position_m
    during = (around.stamp_ns >= touch.start_ns) & (around.stamp_ns <= touch.end_ns)

    def side(heights_m: Array, key: Hashable) -> set[float]:
        if not during.any():
            return set()
        heights_m = heights_m - np.median(heights_m[during])
        for start_ns, end_ns, keys in touches:
            if key not in keys:
                heights_m = np.where(
                    (around.stamp_ns < start_ns) | (around.stamp_ns > end_ns), heights_m, 0.0
                )
        left_m = {1.0: float(heights_m.max()), -1.0: -float(heights_m.min())}
        return {sign for sign, by_m in left_m.items() if by_m >= _LIFTED_M}

    in_body, in_world = (part.mean(axis=0) for part in points)
    world_side = (
        side((rotation @ in_body + position_m) @ world.normal, touch.keys[1])
        if isinstance(world, Plane)
        else set[float]()
    )
    if not isinstance(body, Plane):
        return set(), world_side
    if isinstance(world, Plane):  # they face each other
        facing = np.median(rotation @ body.normal @ world.normal)
        return {-sign * float(np.sign(facing)) for sign in world_side}, world_side
    return side(
        np.einsum("nij,ni->nj", rotation, in_world - position_m) @ body.normal, touch.keys[0]
    ), world_side


def _corners(element: Element, places_m: Array) -> Array:
    """The points (N, 3), ``MOST_CORNERS`` at most, of an edge or a face around these places (M, 3)."""
    if isinstance(element, Line):
        along = (places_m - element.point_m) @ element.direction
        ends = np.array([[along.min()], [along.max()]])
        return np.asarray(element.point_m + ends * element.direction)
    assert isinstance(element, Plane)
    angles = 2.0 * np.pi * np.arange(MOST_CORNERS) / MOST_CORNERS
    outermost = (places_m @ scene.circle(element.normal, angles).T).argmax(axis=0)
    corners_m = places_m[outermost[np.sort(np.unique(outermost, return_index=True)[1])]]
    off_m = corners_m @ element.normal - element.offset_m
    return np.asarray(corners_m - off_m[:, None] * element.normal)


def _element_part(
    side: int, name: str, element: Element, touched: Sequence[Array], extent: Extent, spans: Spans
) -> Part:
    """The part of an element about the points, (N, 3) each, at which it was touched during ``spans``."""
    places, margin_m = np.concatenate(touched), _MARGIN * extent.radius_m
    match element:
        case Plane(normal):
            basis = scene.across(normal)
            ring = margin_m * np.stack([np.cos(_RING), np.sin(_RING)], axis=-1)
            flat = ((places @ basis)[:, None] + ring).reshape(-1, 2)  # the points need not lie in it
            try:
                flat = flat[ConvexHull(flat).vertices]
            except QhullError:  # far away, where the margin is lost in rounding
                flat = flat[: len(ring)]
            rim, mesh = np.asarray(flat @ basis.T + element.offset_m * normal), scene.EMPTY
            if not _is_open(element):
                fan = np.array([(0, i, i + 1) for i in range(1, len(rim) - 1)], np.uint32)
                normals = np.broadcast_to(normal, rim.shape).astype(np.float32)
                mesh = Mesh(rim.astype(np.float32), fan, normals)
            return Part(side, name, mesh, (np.concatenate([rim, rim[:1]]),), rim.mean(axis=0), (*spans,))
        case Line(direction, point_m):
            along = (places - point_m) @ direction
            ends = point_m + direction * np.array([[along.min() - margin_m], [along.max() + margin_m]])
            middle = ends.mean(axis=0)
            half_m = 0.5 * float(along.max() - along.min()) + margin_m
            rod = scene.rod(direction, middle, half_m, 0.2 * margin_m, scene.FEW)
            return Part(side, name, rod, (ends,), middle, (*spans,))
        case Point(point_m):
            return Part(side, name, scene.point(side == 0, point_m, 0.5 * margin_m), (), point_m, (*spans,))


def _joint_parts(segments: Iterable[Segment], poses: Poses, extent: Extent) -> Iterator[Part]:
    """The axes and centres of joints, in the body and in the world frame; each once, though a rest may have
    split its segment. Only the name of a far one is drawn, as it would shrink the picture."""
    joints = list[tuple[Joint, list[tuple[int, int]]]]()
    ordered = [*segments]
    for run in joint_runs(ordered):
        span = ordered[run.first].start_ns, ordered[run.last].end_ns
        same = next((spans for joint, spans in joints if is_same_joint(joint, run.joint)), None)
        if same is None:
            joints.append((run.joint, [span]))
        else:
            same.append(span)
    for joint, spans in joints:
        within = poses_within(poses, spans[0][0], spans[-1][1])
        centre_m = np.median(within.rotation @ extent.centre_m + within.position_m, axis=0)
        sides = (joint.object, extent.centre_m), (joint.environment, centre_m)
        for side, (element, near_m) in enumerate(sides):
            name, placed = joint_name(joint), replace(element, covariance=None)
            away_m = float(np.linalg.norm(nearest(placed, near_m) - near_m))
            if away_m > scene.LARGEST_M:
                yield Part(side, f"{name} ({away_m:.0f} m away)", scene.EMPTY, (), near_m, (*spans,))
            else:
                yield _element_part(side, name, placed, [_region(placed, near_m, extent)], extent, spans)
