"""Messages for Foxglove: beliefs to plot, frames and the touching elements, added to a recording.

Their types are from foxglove-sdk (extra ``foxglove``).
"""

import json
from bisect import bisect_right
from collections.abc import Iterator
from heapq import merge
from pathlib import Path
from typing import Any, Final

from foxglove import messages as fox
from scipy.spatial.transform import Rotation

import contact_tracker.recording as recording
from contact_tracker.contacts.task_frame import T_world_body, contact_frame
from contact_tracker.errors import UsageError
from contact_tracker.geometry.elements import Array
from contact_tracker.outputs.outcome import Outcome
from contact_tracker.outputs.parts import SIDES, DrawnRecording
from contact_tracker.outputs.scene import GREY, OBJECT, Mesh
from contact_tracker.outputs.text import COLOUR, Colour
from contact_tracker.recording import Channel, RawMessage, write_beside
from contact_tracker.states import STATES

WORLD: Final = "world"
BODY: Final = "object"
"""Default frames of poses without names."""
_FRAME_NS: Final = 10_000_000
"""Shortest interval between frames: 100 Hz."""
_OPAQUE: Final = 0.8
_PALE: Final = 0.2
_RANGE_NS: Final = 2**32 * 1_000_000_000
_LINE_PX: Final = 1.5
_KNOWN: Final = (OBJECT, GREY)
_ORIGIN: Final = fox.Pose(position=fox.Vector3(), orientation=fox.Quaternion(w=1.0))
_TEXT_SIZE: Final = 0.2
"""Height of text relative to the object's radius."""


def write_mcap(outcome: Outcome, path: Path, _: str = ".mcap") -> None:
    """Write a copy of the recording with beliefs, frames and scene at the log times of its poses; only these
    if the recording cannot be read again. Raises UsageError for stamps outside of 0 to 2^32 s."""
    poses, log_offset_ns = outcome.trajectory.poses, outcome.trajectory.log_offset_ns
    if len(poses) and not 0 <= poses.stamp_ns[0] + min(log_offset_ns, 0) <= poses.stamp_ns[-1] < _RANGE_NS:
        raise UsageError("stamps of an MCAP file for Foxglove lie between 0 and 2^32 s")
    frames = outcome.trajectory.frames[0] or WORLD, outcome.trajectory.frames[1] or BODY
    drawn = DrawnRecording.of(outcome)
    added = merge(
        _beliefs(outcome),
        _frames(outcome, frames),
        _known_scene(drawn, frames),
        _scene(outcome, frames, drawn),
        key=lambda message: message.log_time_ns,
    )
    shifted = (message._replace(log_time_ns=message.log_time_ns + log_offset_ns) for message in added)
    write_beside(path, outcome.log, shifted)


def _beliefs(outcome: Outcome) -> Iterator[RawMessage]:
    text, number, integer, item = ({"type": kind} for kind in ("string", "number", "integer", "object"))
    texts, numbers, items = ({"type": "array", "items": kind} for kind in (text, number, item))
    points = dict.fromkeys(("axis", "point_m", "axis_sd", "point_sd_m"), numbers)
    element = {**item, "properties": {"type": text, "name": text, **points, "unobserved": text}}
    properties = {
        "stamp_ns": integer,
        "contact": text,
        "probability": {**item, "properties": {state.value: number for state in STATES}},
        "onset_ns": integer,
        "inseparable": texts,
        "geometry": item,
        "contacts": items,
        "constraints": integer,
        "joint": item,
        "inseparable_names": text,
        "object": element,
        "environment": element,
    }
    schema = json.dumps({**item, "properties": properties}).encode()
    channel = Channel(recording.BELIEF_TOPIC, "json", "contact_tracker.Belief", "jsonschema", schema)
    for belief in outcome.beliefs:
        yield RawMessage(channel, belief.stamp_ns, json.dumps(belief.to_json(), allow_nan=False).encode())


def _frames(outcome: Outcome, frames: tuple[str, ...]) -> Iterator[RawMessage]:
    """Transforms of the body, and, on a topic of its own, of the task frame: of the joint if there is one,
    else of the labelled contact if its elements are known."""
    channels = (
        _channel(recording.FRAMES_TOPIC, fox.FrameTransforms),
        _channel(recording.TASK_TOPIC, fox.FrameTransforms),
    )
    segments, next_ns = outcome.segments, None
    starts_ns = [segment.start_ns for segment in segments]
    joints = [None if s.joint is None else s.joint.task_frame.T_world_task for s in segments]
    for stamp_ns, position_m, quat_xyzw in outcome.trajectory:
        if next_ns is not None and stamp_ns < next_ns:
            continue
        next_ns = stamp_ns + _FRAME_NS
        yield _transform(channels[0], stamp_ns, frames, position_m, quat_xyzw)
        number = bisect_right(starts_ns, stamp_ns) - 1
        if number < 0 or segments[number].end_ns < stamp_ns:
            continue
        segment, task = segments[number], joints[number]
        if task is None and segment.geometry is not None:
            task = contact_frame(segment.contact, segment.geometry, T_world_body(position_m, quat_xyzw))
        if task is not None:
            names, turn = (frames[0], f"{frames[1]}/task"), Rotation.from_matrix(task[:3, :3])
            yield _transform(channels[1], stamp_ns, names, task[:3, 3], turn.as_quat())


def _transform(
    channel: Channel, stamp_ns: int, frames: tuple[str, ...], position_m: Any, quat_xyzw: Any
) -> RawMessage:
    transform = fox.FrameTransform(
        timestamp=_timestamp(stamp_ns),
        parent_frame_id=frames[0],
        child_frame_id=frames[1],
        translation=_xyz(fox.Vector3, position_m),
        rotation=fox.Quaternion(**dict(zip("xyzw", map(float, quat_xyzw), strict=True))),
    )
    return RawMessage(channel, stamp_ns, fox.FrameTransforms(transforms=[transform]).encode())


def _scene(outcome: Outcome, frames: tuple[str, ...], drawn: DrawnRecording) -> Iterator[RawMessage]:
    """The drawn contacts at each change; each message replaces the previous one."""
    channel, size_m = _channel(recording.SCENE_TOPIC, fox.SceneUpdate), _TEXT_SIZE * drawn.extent.radius_m
    world, body = frames
    for segment in outcome.segments:
        labels = {"contact": segment.contact.value, "probability": f"{segment.probability:.3f}"}
        metadata = [fox.KeyValuePair(key=key, value=value) for key, value in labels.items()]
        for part in segment.parts:
            stamp_ns, colour, entities = part.start_ns, COLOUR[segment.contact], list[fox.SceneEntity]()
            drawing = drawn.pairs(part.geometries, stamp_ns, part.end_ns)
            if drawing is not None:
                styles = (OBJECT, _OPAQUE), (OBJECT, _PALE), (colour, _OPAQUE), (colour, _PALE)
                shapes = [_triangles(m, *style) for m, style in zip(drawing.meshes, styles, strict=True)]
                kinds = " + ".join((segment.contact, *(further.contact for further in part.further)))
                named = " on ".join(name for name in segment.touching if name) or kinds
                texts = [_text(drawing.label_m, size_m, colour, named)]
                on_body = {"metadata": metadata, "triangles": shapes[0] + shapes[1]}
                on_world = {"metadata": metadata, "triangles": shapes[2] + shapes[3], "texts": texts}
                entities = [
                    _entity(stamp_ns, body, "object element", on_body),
                    _entity(stamp_ns, world, "environment element", on_world),
                ]
            everything = fox.SceneEntityDeletionType.All
            deletion = fox.SceneEntityDeletion(timestamp=_timestamp(stamp_ns), type=everything)
            update = fox.SceneUpdate(deletions=[deletion], entities=entities)
            yield RawMessage(channel, stamp_ns, update.encode())


def _known_scene(drawn: DrawnRecording, frames: tuple[str, ...]) -> Iterator[RawMessage]:
    """The known parts, from the first pose on, on their own topic, as each message of the scene replaces the
    previous one."""
    if not drawn.parts or not len(drawn.poses):
        return
    stamp_ns, entities = int(drawn.poses.stamp_ns[0]), list[fox.SceneEntity]()
    for number, part in enumerate(drawn.parts):
        colour = _KNOWN[part.side]
        shapes = {
            "triangles": _triangles(part.mesh, colour, _PALE),
            "lines": [_line(strip, colour) for strip in part.outline],
            "texts": [_text(part.label_m, _TEXT_SIZE * drawn.extent.radius_m, colour, part.name)],
        }
        name = f"{number} {SIDES[part.side]} {part.name}"
        entities.append(_entity(stamp_ns, frames[1 - part.side], name, shapes))
    channel = _channel(recording.MAP_TOPIC, fox.SceneUpdate)
    yield RawMessage(channel, stamp_ns, fox.SceneUpdate(entities=entities).encode())


def _entity(stamp_ns: int, frame: str, name: str, shapes: dict[str, Any]) -> fox.SceneEntity:
    """Shapes that move with a frame."""
    return fox.SceneEntity(
        timestamp=_timestamp(stamp_ns), frame_id=frame, id=name, frame_locked=True, **shapes
    )


def _line(strip: Array, colour: Colour) -> fox.LinePrimitive:
    return fox.LinePrimitive(
        pose=_ORIGIN,
        type=fox.LinePrimitiveLineType.LineStrip,
        thickness=_LINE_PX,
        scale_invariant=True,
        points=[_xyz(fox.Point3, place_m) for place_m in strip],
        color=_rgba(colour, 1.0),
    )


def _triangles(mesh: Mesh, colour: Colour, opacity: float) -> list[fox.TriangleListPrimitive]:
    """The triangles of a mesh, if it has any."""
    if not len(mesh.triangles):
        return []
    points, indices = (
        [_xyz(fox.Point3, place_m) for place_m in mesh.vertices],
        mesh.triangles.ravel().tolist(),
    )
    shape = fox.TriangleListPrimitive(
        pose=_ORIGIN, points=points, color=_rgba(colour, opacity), indices=indices
    )
    return [shape]


def _text(place_m: Array, size_m: float, colour: Colour, text: str) -> fox.TextPrimitive:
    return fox.TextPrimitive(
        pose=fox.Pose(position=_xyz(fox.Vector3, place_m), orientation=fox.Quaternion(w=1.0)),
        billboard=True,
        font_size=size_m,
        color=_rgba(colour, 1.0),
        text=text,
    )


def _xyz(kind: Any, place_m: Any) -> Any:
    """A ``Point3`` or ``Vector3``."""
    return kind(**dict(zip("xyz", map(float, place_m), strict=True)))


def _rgba(colour: Colour, opacity: float) -> fox.Color:
    red, green, blue = (part / 255.0 for part in colour)
    return fox.Color(r=red, g=green, b=blue, a=opacity)


def _timestamp(stamp_ns: int) -> fox.Timestamp:
    return fox.Timestamp(*divmod(stamp_ns, 1_000_000_000))


def _channel(topic: str, message: Any) -> Channel:
    schema = message.get_schema()
    return Channel(topic, "protobuf", schema.name, schema.encoding, schema.data)
