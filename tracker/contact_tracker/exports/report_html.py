"""A report in one self-contained HTML file: ribbon, posteriors, geometry in 3D, notes.

The file includes plotly, which draws it (extra ``report``).
"""

from collections.abc import Iterable, Iterator, Sequence
from html import escape
from pathlib import Path
from typing import Any, Final

import numpy as np
from plotly.graph_objects import Figure, Mesh3d, Scatter, Scatter3d

from contact_tracker import __version__
from contact_tracker.errors import printable
from contact_tracker.exports.summary_html import counts_html, ribbon_html, table_html, warnings_html
from contact_tracker.geometry.elements import Array, ContactGeometry
from contact_tracker.motion.poses import Poses
from contact_tracker.outputs.outcome import Outcome
from contact_tracker.outputs.text import COLOUR, Colour, describe
from contact_tracker.states import STATES
from contact_tracker.tracking.belief import Segment
from contact_tracker.viewer.parts import SIDES, Part, known_parts
from contact_tracker.viewer.scene import GREY, Drawing, Eye, Upward, draw_all, extent_of, poses_within

_ABOUT_GEOMETRY: Final = (
    "<h2>Geometry, in the world frame</h2><p>Turn it with the mouse. A click in the legend shows or hides; "
    "what is less probable than 0.5, or largely unobserved, is hidden at first.</p>"
)
_ABOUT_OBJECT: Final = (
    "<h2>The object, in the body frame</h2><p>What is known of it: a known body, or of each face, edge and "
    "vertex what was touched.</p>"
)
MOST_TICKS: Final = 4000
"""Most ticks in the plot of the posteriors; more are thinned out."""
MOST_PATH_POSES: Final = 3000
MOST_DRAWN: Final = 60
"""Number of longest segments whose elements are drawn."""
_PROBABLE: Final = 0.5
_UNOBSERVED: Final = 2
"""Elements with this many unobserved directions may be far off."""
_LEFT_PX: Final = 50
_RIGHT_PX: Final = 10
"""Margins of the plot of the posteriors, and of the ribbon above it, so that their times are aligned."""
_SPACE: Final[dict[str, Any]] = {
    "margin": {"l": 0, "r": 0, "t": 10, "b": 0},
    "legend": {"y": 0.93},
    "scene": {"aspectmode": "data", **{f"{a}axis": {"title": f"{a} (m)"} for a in "xyz"}},
    "template": "plotly_white",
}
_STYLE: Final = (
    "body{font:15px/1.45 system-ui,sans-serif;max-width:1180px;margin:24px auto;padding:0 16px;color:#222}"
    "h1{font-size:22px;margin:0 0 4px}h2{font-size:17px;margin:26px 0 6px}table{border-collapse:collapse}"
    "td,th{border-bottom:1px solid #e4e4e4;font-size:13px}p{margin:4px 0}"
)


def write_report(outcome: Outcome, path: Path, _: str = ".html") -> None:
    """Write the report; OSError if the file cannot be written."""
    segments, trajectory, parts = outcome.segments, outcome.trajectory, known_parts(outcome)
    title = escape(printable(f"Contacts in {trajectory.name}"))
    facts = f"{len(trajectory)} poses, {trajectory.duration_s:.2f} s of motion, {len(segments)} segments"
    facts += f"; {outcome.noise}" if outcome.noise else ""
    legend = " ".join(
        f'<span style="background:rgb{COLOUR[state]};padding:1px 7px">{state.value}</span>'
        for state in STATES
    )
    settings = {"include_plotlyjs": False, "full_html": False, "config": {"displaylogo": False}}
    with path.open("w", encoding="utf-8") as file:
        file.write(f'<!DOCTYPE html><html lang="en"><head><meta charset="utf-8"><title>{title}</title>')
        file.write(f"<style>{_STYLE}</style><script>{_plotly_js()}</script></head><body><h1>{title}</h1>")
        file.write(warnings_html(outcome.warnings))
        file.write(f"<p>{escape(printable(facts))}</p>{counts_html(outcome.counts)}")
        ribbon = f'<div style="margin:0 {_RIGHT_PX}px 0 {_LEFT_PX}px">{ribbon_html(segments)}</div>'
        file.write(f"<h2>Labels</h2>{ribbon}<p>{legend}</p>")
        file.write("<h2>Probabilities</h2>" + _posteriors(outcome).to_html(**settings))
        file.write(_ABOUT_GEOMETRY + _geometry(outcome, parts).to_html(**settings))
        if any(one.side == 0 for one in parts):
            file.write(_ABOUT_OBJECT + _object(parts).to_html(**settings))
        file.write(f"<h2>Segments</h2>{table_html(segments, outcome.origin_ns)}")
        file.write(f"<p>Made by contact-tracker {escape(__version__)}.</p></body></html>\n")


def _plotly_js() -> str:
    from plotly.offline import get_plotlyjs

    return str(get_plotlyjs())


def _posteriors(outcome: Outcome) -> Figure:
    beliefs, segments = outcome.beliefs, outcome.segments
    every = 1 + len(beliefs) // MOST_TICKS
    seconds = ((beliefs.stamp_ns - outcome.origin_ns) * 1e-9)[::every]
    figure = Figure()
    for column, state in enumerate(STATES):
        share = beliefs.probability[::every, column]
        line = {"color": _rgb(COLOUR[state]), "width": 1.6}
        figure.add_trace(Scatter(x=seconds, y=share.round(4), name=state.value, mode="lines", line=line))
    figure.update_layout(
        height=300,
        margin={"l": _LEFT_PX, "r": _RIGHT_PX, "t": 40, "b": 45},
        xaxis={"title": "time (s)", "automargin": False},
        yaxis={"title": "probability", "range": [0.0, 1.02], "automargin": False},
        hovermode="x",
        legend={"orientation": "h", "x": 0.0, "y": 1.02, "yanchor": "bottom"},
        template="plotly_white",
    )
    if segments:
        ends_ns = np.array([segments[0].start_ns, segments[-1].end_ns]) - outcome.origin_ns
        figure.update_xaxes(range=(ends_ns * 1e-9).tolist())
    return figure


def _geometry(outcome: Outcome, parts: Sequence[Part]) -> Figure:
    """The path of the body's origin, and the elements of the longest segments where they touched."""
    poses, segments = outcome.trajectory.poses, outcome.segments
    extent = extent_of(outcome.trajectory.vertices_m)
    figure, upward = Figure([*_path(outcome), *_known(parts, 1)]), Upward(extent)
    longest = sorted(segments, key=lambda s: s.start_ns - s.end_ns)[:MOST_DRAWN]
    for segment in sorted(longest, key=lambda s: s.start_ns):
        if segment.geometry is not None:
            within = poses_within(poses, segment.start_ns, segment.end_ns)
            drawing = draw_all(_touching(segment, within), within, extent, upward.direction)
            assert drawing is not None
            upward.add(segment.geometry, within, segment.end_ns - segment.start_ns)
            figure.add_traces(list(_elements(segment, within, drawing, parts, outcome.origin_ns)))
    figure.update_layout(height=620, **_SPACE)
    if len(poses):
        figure.update_layout(scene_camera=_camera(upward.eye(extent.radius_m)))
    return figure


def _object(parts: Sequence[Part]) -> Figure:
    return Figure([*_known(parts, 0)]).update_layout(height=420, **_SPACE)


def _known(parts: Sequence[Part], side: int) -> Iterator[Mesh3d | Scatter3d]:
    """What is known of one side, in its frame."""
    for number, part in enumerate(one for one in parts if one.side == side):
        name = f"{SIDES[side]}: {printable(part.name)}" if side else printable(part.name)
        group = {"name": name, "legendgroup": f"{SIDES[side]} {number}"}
        if len(part.mesh.triangles):
            yield _mesh(part.mesh.vertices, part.mesh.triangles, GREY, 0.3, hoverinfo="name", **group)
        yield _lines(part.outline or (part.label_m[None],), GREY, showlegend=True, **group)


def _camera(eye: Eye) -> dict[str, Any]:
    """Camera in plotly's units, in which the scene has about size one."""
    place = 1.9 * eye[0] / np.linalg.norm(eye[0])
    return {
        "eye": dict(zip("xyz", place.tolist(), strict=True)),
        "up": dict(zip("xyz", eye[1].tolist(), strict=True)),
    }


def _touching(segment: Segment, within: Poses) -> tuple[ContactGeometry, ...]:
    """The touching elements in the middle of a segment."""
    at_ns = int(within.stamp_ns[len(within) // 2])
    parts = segment.parts
    return next((one for one in parts if one.start_ns <= at_ns <= one.end_ns), parts[0]).geometries


def _path(outcome: Outcome) -> Iterator[Scatter3d]:
    """A line per state, with breaks where others hold."""
    poses, segments = outcome.trajectory.poses, outcome.segments
    poses = poses[:: 1 + len(poses) // MOST_PATH_POSES]
    starts = np.array([segment.start_ns for segment in segments], np.int64)
    number = np.searchsorted(starts, poses.stamp_ns, side="right") - 1
    contacts = [segments[i].contact if 0 <= i < len(segments) else None for i in number]
    for state in STATES:
        is_here = np.array([contact is state for contact in contacts], bool)
        if not is_here.any():
            continue
        place = np.where(is_here[:, None], poses.position_m, np.nan)
        line = {"color": _rgb(COLOUR[state]), "width": 4}
        x, y, z = place.T.round(5)
        name = f"path in {state.value}"
        yield Scatter3d(x=x, y=y, z=z, mode="lines", line=line, name=name, connectgaps=False)


def _elements(
    segment: Segment, within: Poses, drawing: Drawing, parts: Sequence[Part], origin_ns: int
) -> Iterator[Mesh3d | Scatter3d]:
    """The touching pair, and what is known of the object, at the middle of the segment.

    ``within`` are the segment's poses, ``drawing`` the drawing of the pair.
    """
    assert segment.geometry is not None
    middle = within[len(within) // 2 : len(within) // 2 + 1]
    rotation, position = middle.rotation[0], middle.position_m[0]
    on_object, _, on_environment, _ = drawing.meshes
    start_s = (segment.start_ns - origin_ns) * 1e-9
    name = f"{segment.contact.value} from {start_s:.1f} s"
    text = printable(describe(segment.geometry, segment.inseparable)).replace(" on ", "<br>on ")
    common: dict[str, Any] = {
        "name": name,
        "legendgroup": name,
        "hovertext": escape(text, quote=False).replace("&lt;br&gt;", "<br>"),
        "visible": True if _is_determined(segment) else "legendonly",
    }
    colour = COLOUR[segment.contact]
    yield _mesh(on_environment.vertices, on_environment.triangles, colour, 0.45, showlegend=True, **common)
    moved = on_object.vertices @ rotation.T + position
    yield _mesh(moved, on_object.triangles, colour, 0.9, **common)
    strips = [strip @ rotation.T + position for one in parts if one.side == 0 for strip in one.outline]
    if strips:
        shown = {"legendgroup": name, "visible": common["visible"]}
        yield _lines(strips, GREY, showlegend=False, hoverinfo="skip", **shown)


def _is_determined(segment: Segment) -> bool:
    """Whether the motion has determined the contact's geometry."""
    pair = (segment.geometry.object, segment.geometry.environment) if segment.geometry else ()
    return segment.probability >= _PROBABLE and all(len(one.unobserved) < _UNOBSERVED for one in pair)


def _mesh(vertices: Any, triangles: Any, colour: Colour, opacity: float, **more: Any) -> Mesh3d:
    x, y, z = np.asarray(vertices, float).reshape(-1, 3).T.round(5)
    i, j, k = np.asarray(triangles).reshape(-1, 3).T
    return Mesh3d(x=x, y=y, z=z, i=i, j=j, k=k, color=_rgb(colour), opacity=opacity, flatshading=True, **more)


def _lines(strips: Iterable[Array], colour: Colour, **more: Any) -> Scatter3d:
    """Lines (N, 3); one point is a marker."""
    broken = np.concatenate([row for strip in strips for row in (strip, np.full((1, 3), np.nan))])
    x, y, z = broken.T.round(5)
    style = {"line": {"color": _rgb(colour), "width": 2}, "marker": {"color": _rgb(colour), "size": 4}}
    return Scatter3d(x=x, y=y, z=z, mode="lines" if len(broken) > 2 else "markers", **style, **more)


def _rgb(colour: Colour) -> str:
    return "rgb({},{},{})".format(*colour)
