"""Features of two convex bodies that touch at a pose: the truth of motion from a physics engine.

Bodies do not overlap along the axis of largest separation, which is a normal of a face of either, or of two
edges. At contact their separation is zero, and the vertices nearest to each other along the axis belong to
the touching features. A contact is reported only if both tolerances ``TOLERANCES_M`` agree.
"""

from collections.abc import Sequence
from itertools import groupby
from typing import Final, NamedTuple

import numpy as np

from contact_tracker.arrays import Array, Bools, Ints
from contact_tracker.geometry.polyhedron import Feature, Polyhedron
from contact_tracker.ground_truth import TruthInterval
from contact_tracker.states import Contact
from contact_tracker_lab.simulate.plan import Chart, Rigid

TOLERANCES_M: Final = (0.00015, 0.0005)
"""Tolerances (m) of the gap between two bodies, and of the distance of a feature's vertices from the common
plane: above the 0.05 mm that the engine's soft contacts leave, and below the resolution of cameras."""
SHORTEST_NS: Final = 30_000_000
"""Shorter contacts, as the bounces when an object is put down, are not reported: a choice of the scenario,
three poses at 100 Hz."""
_PARALLEL: Final = 1e-3
"""Sine of the angle below which edges count as parallel: a choice; faces then give the axis."""


class Touch(NamedTuple):
    """``contact``: FREE, or a contact of two features, or None for any other; features of object and
    scene."""

    contact: Contact | None
    object: Feature | None = None
    environment: Feature | None = None


def touch_at(object: Polyhedron, bodies: Sequence[Polyhedron], rotation: Array, translation: Array) -> Touch:
    """The features of ``object``, at a pose in the scene (3, 3) and (3,), and of ``bodies`` that touch."""
    moved, touches = object.vertices @ rotation.T + translation, set[Touch]()
    for tolerance_m in TOLERANCES_M:
        by_body = [_touched(object, moved, rotation, body, tolerance_m) for body in bodies]
        touching = [touch for touch in by_body if touch.contact is not Contact.FREE]
        touches.add(touching[0] if len(touching) == 1 else Touch(None if touching else Contact.FREE))
    return touches.pop() if len(touches) == 1 else Touch(None)


def _touched(
    object: Polyhedron, moved: Array, rotation: Array, body: Polyhedron, tolerance_m: float
) -> Touch:
    moving, fixed = (np.array([f.normals[0] for f in shape.of_kind("f")]) for shape in (object, body))
    faces = np.concatenate([fixed, -moving @ rotation.T])
    gap = _separations(faces, moved, body)
    if gap.max() > tolerance_m:
        return Touch(Contact.FREE)
    axis, best = faces[gap.argmax()], float(gap.max())
    edges, fixed_edges = (np.array([e.span[0] for e in shape.of_kind("e")]) for shape in (object, body))
    crossed = np.cross((edges @ rotation.T)[:, None], fixed_edges).reshape(-1, 3)
    length = np.linalg.norm(crossed, axis=1)
    crossed = crossed[length > _PARALLEL] / length[length > _PARALLEL, None]
    crossed = np.concatenate([crossed, -crossed])
    gap = _separations(crossed, moved, body)
    if gap.max() > best + tolerance_m:
        axis, best = crossed[gap.argmax()], float(gap.max())
    if best > tolerance_m:
        return Touch(Contact.FREE)
    heights, below = moved @ axis, body.vertices @ axis
    lowest = _feature(object, heights < heights.min() + tolerance_m)
    highest = _feature(body, below > below.max() - tolerance_m)
    name = "" if lowest is None or highest is None else f"{lowest.kind}-{highest.kind}"
    return Touch(Contact(name), lowest, highest) if name in set(Contact) else Touch(None)


def _separations(axes: Array, moved: Array, body: Polyhedron) -> Array:
    return np.asarray((axes @ moved.T).min(axis=1) - (axes @ body.vertices.T).max(axis=1))


def _feature(shape: Polyhedron, is_near: Bools) -> Feature | None:
    """The feature with exactly these vertices."""
    indices = frozenset(np.flatnonzero(is_near).tolist())
    return next((feature for feature in shape.features if feature.indices == indices), None)


def intervals(
    stamp_ns: Ints, touches: Sequence[Touch], motion: Sequence[str], body: Rigid, world: Rigid
) -> list[TruthInterval]:
    """Intervals in which the touching features and the ``motion`` of the hand stay the same at poses (N,).

    ``body``, ``world``: transforms from the object's and the scene's frame to the recording's frames.
    """
    lasting, start = list[Touch](), 0
    for touch, run in groupby(touches):
        end = start + len([*run])
        lasts = stamp_ns[min(end, len(stamp_ns) - 1)] - stamp_ns[start] >= SHORTEST_NS
        lasting += [touch if lasts else Touch(None)] * (end - start)
        start = end
    result, start = list[TruthInterval](), 0
    for (touch, how), group in groupby(zip(lasting, motion, strict=True)):
        end = start + len([*group])
        geometry = None
        if touch.contact is not None and touch.object is not None and touch.environment is not None:
            chart = Chart(touch.contact, touch.object, touch.environment)
            middles = (feature.points.mean(axis=0) for feature in (touch.object, touch.environment))
            geometry = chart.geometry(body, world, *middles)
        span = int(stamp_ns[start]), int(stamp_ns[end - 1])
        result.append(TruthInterval(*span, touch.contact, how, geometry=geometry))
        start = end
    return result
