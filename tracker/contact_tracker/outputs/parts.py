"""What is known of the object and its surroundings, as parts to draw: a list for all outputs.

Known bodies are drawn whole. Of each other element what was touched is drawn: a face as the patch, an edge
as the segment, a vertex as the point. Where one touches that reaches farther than a point, such as a face on
a face, the patch is as large as the object.
"""

from collections.abc import Hashable, Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Final, NamedTuple, Self

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from contact_tracker.geometry.elements import (
    Array,
    ContactGeometry,
    Element,
    Line,
    Plane,
    Point,
    flat,
    nearest,
)
from contact_tracker.map.elements import KINDS, kind_of
from contact_tracker.map.map import EMPTY_MAP, Map
from contact_tracker.map.world_map import GrowingMap
from contact_tracker.motion.poses import Poses
from contact_tracker.outputs import scene
from contact_tracker.outputs.outcome import Outcome
from contact_tracker.outputs.scene import UNKNOWN_EXTENT, Extent, Mesh, poses_within
from contact_tracker.outputs.text import joint_name
from contact_tracker.tracking.belief import Segment

SIDES: Final = ("object", "surroundings")
MOST_POSES: Final = 40
"""Poses of one touch of which the places are drawn."""
MOST_KEPT: Final = 3_000
"""Poses that are kept; with more, every second one is dropped, and fewer are added from then on."""
MOST_TOUCHES: Final = 200
"""Latest contacts with listed elements of which the places are drawn."""
_EVERY_NS: Final = 100_000_000
_MARGIN: Final = 0.1
"""Margin about what was touched, and size of a vertex, by the object's radius."""
_RING: Final = np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False)
_RANK: Final[dict[type[Element], int]] = {Point: 0, Line: 1, Plane: 2}


Spans = Sequence[tuple[int, int]]
"""Times (ns) from when to when something was touched, in order."""


class Part(NamedTuple):
    """A known body or element, of the object in the body frame, else in the world frame.

    Parameters
    ----------
    side : 0 the object's, 1 of the surroundings.
    name : for display.
    mesh : its surface.
    outline : closed or open lines (N, 3) about it.
    label_m : (3,) where its name is.
    touched_ns : ``Spans`` in which it was touched.
    """

    side: int
    name: str
    mesh: Mesh
    outline: tuple[Array, ...]
    label_m: Array
    touched_ns: Spans = ()


class Touch(NamedTuple):
    """Two elements that touched from ``start_ns`` to ``end_ns``, and the keys of those to draw."""

    start_ns: int
    end_ns: int
    geometry: ContactGeometry
    keys: tuple[Hashable, Hashable]


class KnownParts:
    """Collects the poses and contacts of a recording, and gives all that is known so far.

    Parameters
    ----------
    known_map : bodies and elements that are listed.
    vertices_m : (V, 3) of the object in the body frame, if known otherwise.

    Attributes
    ----------
    bodies : the known bodies.
    object_extent : the size of the object, ``UNKNOWN_EXTENT`` unless it is a known body.
    """

    def __init__(self, known_map: Map = EMPTY_MAP, vertices_m: Array | None = None) -> None:
        bodies = list(_bodies(known_map))
        if vertices_m is not None and all(side != 0 for side, _, _ in bodies):
            bodies.insert(0, (0, SIDES[0], vertices_m))
        solids = [(side, name, scene.hull(corners_m)) for side, name, corners_m in bodies]
        known = [(side, name, *solid) for side, name, solid in solids if solid is not None]
        self.bodies = tuple(
            Part(side, name, mesh, tuple(edges), extent.centre_m) for side, name, mesh, edges, extent in known
        )
        self.object_extent = next((extent for side, *_, extent in known if side == 0), UNKNOWN_EXTENT)
        self._listed: dict[Hashable, tuple[int, str, Element]] = {
            (side, one.name): (side, one.name, one.element)
            for side, known in enumerate((known_map.listed_object, known_map.listed_environment))
            for one in known
            if one.solid is None
        }
        self._poses, self._every_ns, self._last_span = list[Poses](), _EVERY_NS, -(2**62)
        self._touches: dict[int, Touch] = {}
        self._segments: tuple[Segment, ...] = ()

    @classmethod
    def of(cls, outcome: Outcome) -> Self:
        """With all poses and contacts of a recording."""
        known = cls(outcome.known_map, outcome.trajectory.vertices_m)
        known.add_poses(outcome.trajectory.poses)
        for one in outcome.segments:
            known.add_contact(one.start_ns, one.end_ns, one.geometry)
        known._segments = outcome.segments
        return known

    def extent(self, world: GrowingMap | None) -> Extent:
        """The size of the object by all that is known of it."""
        if self.object_extent is not UNKNOWN_EXTENT:
            return self.object_extent
        elements = [one for side, _, one in (self._listed | self._elements_of(world)).values() if side == 0]
        feet_m = [nearest(one, np.zeros(3)) for one in elements if not _is_open(one)]
        if len(feet_m) < 2:
            return UNKNOWN_EXTENT
        centre_m = 0.5 * (np.min(feet_m, axis=0) + np.max(feet_m, axis=0))
        radius_m = float(np.max(np.linalg.norm(feet_m - centre_m, axis=1)))
        return Extent(centre_m, radius_m) if radius_m > 0.0 else UNKNOWN_EXTENT

    def add_poses(self, poses: Poses) -> None:
        """Add poses, of which up to ten per second are kept, and fewer of a long stream."""
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
        """Add a contact, or a later estimate of one; returns whether it is the first with a listed element
        that began then."""
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
        touched = {key: _near(one, about[key[0]]) for key, one in learned.items()}
        elements = {
            key: (side, name, _near(one, about[side]))
            for key, (side, name, one) in (self._listed | self._elements_of(world)).items()
        }
        touches += [
            Touch(start_ns, end_ns, ContactGeometry(touched[ours], touched[theirs]), (ours, theirs))
            for start_ns, end_ns, (ours, theirs) in (() if world is None else world.touches)
            if ours in touched and theirs in touched
        ]
        places, spans = dict[Hashable, list[Array]](), dict[Hashable, list[tuple[int, int]]]()
        for touch in touches:
            for key, where in zip(touch.keys, _touched(touch, poses, extent), strict=True):
                places.setdefault(key, []).append(where)
                spans.setdefault(key, []).append((touch.start_ns, touch.end_ns))
        found = []
        for key, (side, name, one) in elements.items():
            touched_m = places.get(key) or [_own(one, about[side], extent)]
            found.append(_of_element(side, name, one, touched_m, extent, sorted(spans.get(key, ()))))
        return (*self.bodies, *found, *_of_joints(self._segments, poses, extent))

    def _elements_of(self, world: GrowingMap | None) -> dict[Hashable, tuple[int, str, Element]]:
        """The elements of a map that are not, in each of their contacts, a listed one by its name.

        Of what touches a listed element the contact knows more than the map, which does not have that.
        """
        if world is None:
            return {}
        elements, listed = dict(world.learned.known), dict[Hashable, bool]()
        for start_ns, _, pair in world.touches:
            touch = self._touches.get(start_ns)
            for key in pair:
                own = touch and (touch.geometry.object, touch.geometry.environment)[key[0]]
                listed[key] = own is not None and own.name is not None and listed.get(key, True)
                if own is not None and key in elements:
                    elements[key] = replace(elements[key], covariance=own.covariance)
        return {
            key: (key[0], f"{KINDS[kind_of(one)]} {key[1]}", one)
            for key, one in elements.items()
            if not listed.get(key, False)
        }


def known_parts(outcome: Outcome) -> tuple[Part, ...]:
    """All that is known after a recording."""
    return KnownParts.of(outcome).parts(outcome.touched)


def _bodies(known_map: Map) -> Iterator[tuple[int, str, Array]]:
    """Known boxes and meshes: side, name and corners (V, 3)."""
    for side, known in enumerate((known_map.listed_object, known_map.listed_environment)):
        for number in dict.fromkeys(one.solid for one in known if one.solid is not None):
            corners = [one for one in known if one.solid == number and isinstance(one.element, Point)]
            if corners:
                name = corners[0].name.rpartition(KINDS["v"])[0].strip() or SIDES[side]
                places = [one.element.point_m for one in corners if isinstance(one.element, Point)]
                yield side, name, np.array(places)


def _is_open(element: Element) -> bool:
    """Whether the place of an element is less known than an object of unknown size is large."""
    if element.covariance is None:
        return False
    own = element.covariance[3:, 3:] if isinstance(element, Plane | Line) else element.covariance
    return float(np.sqrt(np.max(np.diag(own)))) > UNKNOWN_EXTENT.radius_m


def _near(element: Element, near_m: Array) -> Element:
    """An element whose place is not known, at ``near_m`` (3,): where it is estimated, it would make all else
    small; others as they are."""
    if not _is_open(element):
        return element
    if isinstance(element, Plane):
        return replace(element, offset_m=float(element.normal @ near_m))
    return replace(element, point_m=near_m)


def _own(element: Element, near_m: Array, extent: Extent) -> Array:
    """Points (N, 3) about the part of an element within the object's radius of ``near_m``."""
    foot, radius_m = nearest(element, near_m), extent.radius_m
    match element:
        case Plane(normal):
            return foot + radius_m * scene.circle(normal, _RING)
        case Line(direction):
            return foot + radius_m * np.array([[-1.0], [1.0]]) * direction
        case Point():
            return foot[None]


def _touched(touch: Touch, poses: Poses, extent: Extent) -> tuple[Array, Array]:
    """Where two elements touched: points (N, 3) in the body frame, and the same in the world frame."""
    within = poses_within(poses, touch.start_ns, touch.end_ns)
    within = within[:: 1 + len(within) // MOST_POSES]
    rotation, position_m = within.rotation, within.position_m
    ours, theirs = touch.geometry.object, touch.geometry.environment
    if isinstance(ours, Line) and isinstance(theirs, Line):
        # in the body frame, the points of the object's line that are nearest to the other line
        direction, arm = theirs.direction @ rotation, theirs.point_m - position_m
        arm = np.einsum("nij,ni->nj", rotation, arm) - ours.point_m
        along = ours.direction - (direction @ ours.direction)[:, None] * direction
        square = np.einsum("ni,ni->n", along, along)
        shift_m = np.einsum("ni,ni->n", along, arm) / np.where(square > 0.0, square, np.inf)
        in_body = ours.point_m + shift_m[:, None] * ours.direction
        return in_body, np.einsum("nij,nj->ni", rotation, in_body) + position_m
    if _RANK[type(ours)] <= _RANK[type(theirs)]:
        own = _own(ours, extent.centre_m, extent)
        return own, (np.einsum("nij,kj->nki", rotation, own) + position_m[:, None]).reshape(-1, 3)
    centres = rotation @ extent.centre_m + position_m
    in_world = np.stack([_own(theirs, centre, extent) for centre in centres])
    in_body = np.einsum("nij,nki->nkj", rotation, in_world - position_m[:, None])
    return in_body.reshape(-1, 3), in_world.reshape(-1, 3)


def _of_element(
    side: int, name: str, element: Element, touched: Sequence[Array], extent: Extent, spans: Spans
) -> Part:
    """The part of an element about the places, (N, 3) each, where it was touched during ``spans``."""
    places, margin_m = np.concatenate(touched), _MARGIN * extent.radius_m
    if _is_open(element):
        name = f"{name} (place not known)"
    match element:
        case Plane(normal):
            basis = scene.across(normal)
            ring = margin_m * np.stack([np.cos(_RING), np.sin(_RING)], axis=-1)
            flat = ((places @ basis)[:, None] + ring).reshape(-1, 2)  # the places need not lie in it
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


def _of_joints(segments: Iterable[Segment], poses: Poses, extent: Extent) -> Iterator[Part]:
    """The axes and centres of joints, in the body and in the world frame; each once, though a rest may have
    split its segment. One that is far away is named only, as it would make all else small."""
    joints = dict[tuple[str, str, str], list[Segment]]()
    for one in segments:
        if (joint := one.joint) is not None:
            key = joint.kind, str(flat(joint.object)), str(flat(joint.environment))
            joints.setdefault(key, []).append(one)
    for own in joints.values():
        joint, spans = own[0].joint, tuple((one.start_ns, one.end_ns) for one in own)
        assert joint is not None
        within = poses_within(poses, spans[0][0], spans[-1][1])
        centre_m = np.median(within.rotation @ extent.centre_m + within.position_m, axis=0)
        sides = (joint.object, extent.centre_m), (joint.environment, centre_m)
        for side, (element, near_m) in enumerate(sides):
            name, placed = joint_name(joint), replace(element, covariance=None)
            away_m = float(np.linalg.norm(nearest(placed, near_m) - near_m))
            if away_m > scene.LARGEST_M:
                yield Part(side, f"{name} ({away_m:.0f} m away)", scene.EMPTY, (), near_m, spans)
            else:
                yield _of_element(side, name, placed, [_own(placed, near_m, extent)], extent, spans)
