"""A report in one self-contained HTML file: ribbon, posteriors, geometry in 3D, notes.

The page includes ``report.js``, which draws its pictures in 3D.
"""

import json
from base64 import b64encode
from collections.abc import Iterable, Iterator, Sequence
from html import escape
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, DTypeLike

from contact_tracker.errors import printable
from contact_tracker.exports.figure import figure_svg
from contact_tracker.geometry.elements import Array
from contact_tracker.motion.poses import Poses
from contact_tracker.outputs import scene
from contact_tracker.outputs.outcome import Outcome
from contact_tracker.outputs.parts import SIDES, DrawnRecording, Part
from contact_tracker.outputs.scene import GREY, Drawing, Mesh
from contact_tracker.outputs.text import COLOUR, Colour, counted, describe_segment, table_rows
from contact_tracker.states import STATES
from contact_tracker.tracking.belief import Segment
from contact_tracker.version import __version__

_ABOUT_GEOMETRY: Final = (
    "<h2>Geometry, in the world frame</h2><p>Turn it with the mouse, move it with shift, zoom with the "
    "wheel; a double click resets. A click on a name shows or hides its shapes; at first only the longest "
    "contacts are visible, without those less probable than 0.5 or largely unobserved. The contact under the "
    "mouse is highlighted here, among the names, and in the table below.</p>"
)
_ABOUT_OBJECT: Final = (
    "<h2>The object, in the body frame</h2><p>Its known body, or the touched regions of its faces, edges and "
    "vertices.</p>"
)
MOST_PATH_POSES: Final = 3000
MOST_DRAWN: Final = 40
"""Number of segments whose elements are drawn, the longest ones."""
MOST_SHOWN: Final = 10
"""Number of drawn segments that are visible at first."""
_PROBABLE: Final = 0.5
_UNOBSERVED: Final = 2
"""Number of unobserved directions from which on an element may be far off."""
_ABOVE_OBJECT: Final = (1.0, 1.3, 0.9)
"""Direction from the object to the eye, in the body frame."""
_STYLE: Final = (
    "body{font:15px/1.45 system-ui,sans-serif;max-width:1180px;margin:24px auto;padding:0 16px;color:#222}"
    "h1{font-size:22px;margin:0 0 4px}h2{font-size:17px;margin:26px 0 6px}table{border-collapse:collapse}"
    "td,th{border-bottom:1px solid #e4e4e4;font-size:13px}th{white-space:nowrap}p{margin:4px 0}"
    "svg{width:100%;height:auto}.picture{display:flex}canvas{flex:1;min-width:0;cursor:grab;touch-action:none}"
    "ul{list-style:none;margin:0;padding:0;font-size:12px;overflow:auto;cursor:pointer}"
    "li{border-left:14px solid;padding-left:6px;margin-bottom:4px}.picked{background:#fff0b8}"
)
MOST_ROWS: Final = 200
_BANNER: Final = "border-left:4px solid #e08000;margin:3px 0;padding:2px 8px"
_CELL: Final = "padding:2px 10px 2px 0;text-align:left;vertical-align:top"
_BREAK: Final = np.full((1, 3), np.nan)
Shape = dict[str, Any]
"""Surface, lines and label of a picture in 3D; shapes of the same name are shown and hidden together."""


def write_report(outcome: Outcome, path: Path, _: str = ".html") -> None:
    """Write the report; OSError if the file cannot be written."""
    segments, trajectory, drawn = outcome.segments, outcome.trajectory, DrawnRecording.of(outcome)
    title = escape(printable(f"Contacts in {trajectory.name}"))
    poses, count = counted(len(trajectory), "pose"), counted(len(segments), "segment")
    facts = f"{poses}, {trajectory.duration_s:.2f} s of motion, {count}"
    facts += f"; {outcome.noise}" if outcome.noise else ""
    script = Path(__file__).with_name("report.js").read_text(encoding="utf-8")
    with path.open("w", encoding="utf-8") as file:
        file.write(f'<!DOCTYPE html><html lang="en"><head><meta charset="utf-8"><title>{title}</title>')
        file.write(f"<style>{_STYLE}</style><script>{script}</script></head><body><h1>{title}</h1>")
        file.write(warnings_html(outcome.warnings))
        file.write(f"<p>{escape(printable(facts))}</p>{counts_html(outcome.noted)}")
        file.write(f"<h2>Labels and probabilities</h2>{figure_svg(outcome)}")
        file.write(_ABOUT_GEOMETRY + _geometry(outcome, drawn))
        if any(part.side == 0 for part in drawn.parts):
            shapes = _known_shapes(drawn.parts, 0, segments)
            file.write(_ABOUT_OBJECT + _picture(shapes, _ABOVE_OBJECT, scene.UP, 420))
        file.write(f"<h2>Segments</h2>{table_html(segments, outcome.origin_ns)}<script>linkRows()</script>")
        file.write(f"<p>Made by contact-tracker {escape(__version__)}.</p></body></html>\n")


def _picture(shapes: Iterable[Shape], eye: ArrayLike, up: ArrayLike, height_px: int) -> str:
    """A picture in 3D, seen from the direction ``eye`` (3,)."""
    view = {"eye": np.asarray(eye).tolist(), "up": np.asarray(up).tolist(), "shapes": list(shapes)}
    data = json.dumps(view, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    return (
        f'<div class="picture" style="height:{height_px}px"><canvas></canvas><ul></ul></div>'
        f"<script>draw3d(document.currentScript.previousElementSibling,{data})</script>"
    )


def _geometry(outcome: Outcome, drawn: DrawnRecording) -> str:
    """The path of the body's origin, and the elements of the longest segments where they touched."""
    poses, segments = drawn.poses, outcome.segments
    shapes = [*_path_shapes(outcome), *_known_shapes(drawn.parts, 1, segments)]
    in_contact = [segment for segment in segments if segment.geometry is not None]
    longest = sorted(in_contact, key=lambda s: s.start_ns - s.end_ns)[:MOST_DRAWN]
    visible = [
        segment
        for segment in longest  # if the motion has determined the geometry
        if segment.geometry is not None
        and segment.probability >= _PROBABLE
        and len(segment.geometry.object.unobserved) < _UNOBSERVED
        and len(segment.geometry.environment.unobserved) < _UNOBSERVED
    ][:MOST_SHOWN]
    for number, segment in enumerate(segments):
        if segment in longest and segment.geometry is not None:
            within = scene.poses_within(poses, segment.start_ns, segment.end_ns)
            middle_ns, held = int(within.stamp_ns[len(within) // 2]), segment.parts
            touching = next((part for part in held if part.start_ns <= middle_ns <= part.end_ns), held[0])
            drawing = drawn.pairs(touching.geometries, segment.start_ns, segment.end_ns)
            assert drawing is not None
            start_s = (segment.start_ns - outcome.origin_ns) * 1e-9
            common = {
                "name": f"{segment.contact.value} from {start_s:.1f} s",
                "text": printable(describe_segment(segment)),
                "shown": segment in visible,
                "segments": [number],
            }
            shapes += _pair_shapes(common, COLOUR[segment.contact], within, drawing, drawn.parts)
    return _picture(shapes, *drawn.upward.eye(drawn.extent.radius_m), 620)


def _known_shapes(parts: Sequence[Part], side: int, segments: Sequence[Segment]) -> Iterator[Shape]:
    """The known parts of one side, in its frame, with the numbers of the segments that touched them."""
    for part in parts:
        if part.side == side:
            name = printable(part.name)
            spans = part.touched_ns
            touched = [
                number
                for number, segment in enumerate(segments)
                if any(start_ns < segment.end_ns and segment.start_ns < end_ns for start_ns, end_ns in spans)
            ]
            label = {"label": name, "label_m": part.label_m.round(5).tolist(), "segments": touched}
            title = f"{SIDES[side]}: {name}" if side else name
            yield _shape(title, GREY, part.mesh, 0.3, part.outline, **label)


def _path_shapes(outcome: Outcome) -> Iterator[Shape]:
    """A line per state, interrupted where the label is another state."""
    poses, segments = outcome.trajectory.poses, outcome.segments
    poses = poses[:: 1 + len(poses) // MOST_PATH_POSES]
    starts = np.array([segment.start_ns for segment in segments], np.int64)
    number = np.searchsorted(starts, poses.stamp_ns, side="right") - 1
    contacts = [segments[i].contact if 0 <= i < len(segments) else None for i in number]
    for state in STATES:
        is_here = np.array([contact is state for contact in contacts], bool)
        if is_here.any():
            place = np.where(is_here[:, None], poses.position_m, np.nan)
            yield _shape(f"path in {state.value}", COLOUR[state], strips=[place], width=2.5)


def _pair_shapes(
    common: Shape, colour: Colour, within: Poses, drawing: Drawing, parts: Sequence[Part]
) -> Iterator[Shape]:
    """The touching pair (``drawing``) and the known parts of the object, at the middle pose of ``within``."""
    middle = within[len(within) // 2 : len(within) // 2 + 1]
    rotation, position = middle.rotation[0], middle.position_m[0]
    on_object, _, on_environment, _ = drawing.meshes
    yield _shape(mesh=on_environment, colour=colour, opacity=0.45, **common)
    moved = on_object._replace(vertices=on_object.vertices @ rotation.T + position)
    yield _shape(mesh=moved, colour=colour, **common)
    strips = [strip @ rotation.T + position for part in parts if part.side == 0 for strip in part.outline]
    yield _shape(strips=strips, colour=GREY, **common)


def _shape(
    name: str,
    colour: Colour,
    mesh: Mesh = scene.EMPTY,
    opacity: float = 1.0,
    strips: Iterable[Array] = (),
    **entries: Any,
) -> Shape:
    """A surface and lines (N, 3), which NaN interrupts, with further ``entries``."""
    broken = np.concatenate([np.zeros((0, 3)), *(row for strip in strips for row in (strip, _BREAK))])
    is_gap = np.isnan(broken[:, 0])
    return {
        "name": name,
        "text": "",
        "segments": [],
        "shown": True,
        "colour": colour,
        "opacity": opacity,
        "width": 1,
        "vertices": _base64(mesh.vertices, "<f4"),
        "triangles": _base64(mesh.triangles, "<u4"),
        "lines": _base64(broken[~is_gap | ~np.roll(is_gap, 1)], "<f4"),
        **entries,
    }


def _base64(values: ArrayLike, kind: DTypeLike) -> str:
    return b64encode(np.asarray(values, kind).tobytes()).decode()


def table_html(segments: Sequence[Segment], origin_ns: int) -> str:
    """The rows of up to ``MOST_ROWS`` segments, with the numbers of these; times in seconds after
    ``origin_ns``."""
    titles = ("start s", "end s", "contact", "p", "the object's element on the surroundings'")
    head = "".join(f'<th style="{_CELL}">{escape(title)}</th>' for title in titles)
    rows = list[str]()
    for numbers, texts in table_rows(segments[:MOST_ROWS], origin_ns):
        cells = "".join(f'<td style="{_CELL}">{escape(printable(text))}</td>' for text in texts)
        joined = " ".join(map(str, numbers))
        rows.append(f'<tr data-segments="{joined}">{cells}</tr>')
    remaining = len(segments) - MOST_ROWS
    note = f"<p>and {counted(remaining, 'more segment')}</p>" if remaining > 0 else ""
    return f"<table><thead><tr>{head}</tr></thead><tbody>{''.join(rows)}</tbody></table>{note}"


def counts_html(noted: str) -> str:
    """A paragraph with the counts of dropped and repaired poses, in the words of ``counts_text``."""
    return f"<p>noted: {escape(noted)}</p>" if noted else ""


def warnings_html(warnings: Sequence[str]) -> str:
    """A paragraph for each warning."""
    return "".join(f'<p style="{_BANNER}"><b>warning:</b> {escape(printable(text))}</p>' for text in warnings)


def summary_html(outcome: Outcome) -> str:
    """The display of a result in a notebook."""
    body = figure_svg(outcome) + table_html(outcome.segments, outcome.origin_ns)
    return f"{warnings_html(outcome.warnings)}{body}{counts_html(outcome.noted)}"
