"""A figure for papers and notebooks, drawn by matplotlib."""

from collections.abc import Sequence
from io import StringIO
from pathlib import Path
from textwrap import fill
from typing import Any, Final

import numpy as np
from matplotlib import get_backend, pyplot, rc_context
from matplotlib.axes import Axes as Axes
from matplotlib.figure import Figure as Figure
from matplotlib.figure import FigureBase
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke
from matplotlib.textpath import TextPath
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d import Axes3D
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from mpl_toolkits.mplot3d.axis3d import Axis as Axis3D
from mpl_toolkits.mplot3d.proj3d import proj_transform
from scipy.spatial.transform import Rotation

from contact_tracker.errors import printable
from contact_tracker.geometry.elements import Array, flat
from contact_tracker.outputs.joint_runs import JointRun, joint_runs
from contact_tracker.outputs.outcome import Outcome
from contact_tracker.outputs.parts import SIDES, Part, known_parts
from contact_tracker.outputs.scene import UP
from contact_tracker.outputs.text import COLOUR, joint_name
from contact_tracker.paper.window_curves import curves
from contact_tracker.states import CONTACTS, STATES
from contact_tracker.tracking.belief import Segment

SHADE: Final = {state: tuple(part / 255.0 for part in rgb) for state, rgb in COLOUR.items()}
NAME_SIZE: Final = 9.0
"""Font size of names in ribbons (points)."""
_LEAST_SIZE: Final = 5.0
_PART_SIZE: Final = 8.0
"""Font size of names of known parts (points)."""
_IN_FRONT: Final = 1000
"""Drawing order of names: after all parts."""
_NOTE_WIDTH: Final = 150
"""Largest number of characters in a line of a warning."""
_ROW: Final = 3.2
_MAP: Final = 4.6
"""Heights (inches) of a plot over time, and of the known parts."""
DOTS_PER_INCH: Final = 200
_PAD: Final = 1.0
"""Margin of the background of a name (points)."""
_VERTEX_VIEW: Final = 10.0
"""Least size of the view about a vertex, relative to its mesh."""
_SPAN_RATIO: Final = 1.2
"""Least width of a span with a name, relative to the name."""
_PAGE: Final[Any] = {"svg.fonttype": "none", "svg.hashsalt": "report", "path.simplify_threshold": 0.5}
"""Options for SVG: text as text, reproducible files, and curves within half a pixel."""
PLAIN_TEXT: Final = rc_context({"text.parse_math": False})
"""Decorator for functions that write names, in which dollars do not mark formulas."""
_VIEW_DEG: Final = (30.0, -60.0)
"""Elevation and azimuth of the eye, from which no axis is seen end-on if z is upward."""
_ZOOM: Final = 0.75
"""Zoom that leaves room for the names of axes, which matplotlib's layout ignores."""
_PLACES: Final = 33
"""Number of places on a line that a name may hide."""
_SPANS: Final = 4
"""Largest number of times of touch that are listed for a part."""
_MOST_LISTED: Final = 8
"""Largest number of parts of a side for which times of touch are listed."""
_RIBBON: Final = (1.04, 1.18)
_LANE: Final = 0.03
"""Largest height of a further contact, in the lower part of its segment."""
_TRUTH: Final = (1.22, 1.32)
"""Ends of the ribbons of labels and truth on the vertical axis, above the probabilities."""


@PLAIN_TEXT
def draw_figure(outcome: Outcome, with_curves: bool = False) -> Figure:
    """A figure of segments and probabilities, with ``with_curves`` also of the paper's objective functions
    over windows, and of the known parts of the object and its surroundings."""
    window_curves, parts = curves(outcome.trajectory.poses) if with_curves else None, known_parts(outcome)
    plots = 1 if window_curves is None or not len(window_curves.stamp_ns) else 2
    height = 1.0 + _ROW * plots
    figure = pyplot.figure(figsize=(10.0, height + _MAP * bool(parts)), layout="constrained")
    doubts = [fill(printable(text), _NOTE_WIDTH, break_on_hyphens=False) for text in outcome.doubts]
    if doubts:
        text = "\n".join(f"warning: {doubt}" for doubt in doubts)
        figure.suptitle(text, fontsize=_PART_SIZE, color="darkred")
    over_time: FigureBase = figure
    if parts:
        over_time, below_it = figure.subfigures(2, 1, squeeze=False, height_ratios=(height, _MAP))[:, 0]
        up = None if outcome.known_map.up is None else outcome.known_map.up.direction
        _draw_parts(below_it, parts, outcome.origin_ns, up)
    upper, *below = over_time.subplots(plots, 1, sharex=True, squeeze=False)[:, 0]
    draw_on(upper, outcome)
    if below and window_curves is not None:  # as in the paper's Fig. 5, values are at the ends of windows
        upper.set_xlabel("")
        seconds = (window_curves.stamp_ns - outcome.origin_ns) * 1e-9
        for contact, curve in zip(CONTACTS, window_curves.normalised.T, strict=True):
            below[0].plot(seconds, curve, color=SHADE[contact], label=contact.value)
        below[0].set(xlabel="time (s)", ylabel="objective / its maximum", ylim=(0.0, 1.02))
    if "inline" in get_backend():  # a notebook would show an open figure a second time
        pyplot.close(figure)
    return figure


@PLAIN_TEXT
def draw_on(axes: Axes, outcome: Outcome) -> None:
    """Draw the probabilities of all states, above them the segments with their further contacts, with names
    that fit, hatched if the motion fits several contacts, and on top the truth if it is known."""
    beliefs, segments, origin_ns, truth = outcome.beliefs, outcome.segments, outcome.origin_ns, outcome.truth
    seconds = (beliefs.stamp_ns - origin_ns) * 1e-9
    spans = [((s.start_ns - origin_ns) * 1e-9, (s.end_ns - s.start_ns) * 1e-9) for s in segments]
    first_s = min([*seconds[:1], *(start_s for start_s, _ in spans)], default=0.0)
    if len(seconds) and seconds[-1] > first_s:
        axes.set_xlim(first_s, seconds[-1])
    low, high = _RIBBON
    is_labelled = truth is not None and len(seconds) > 0
    axes.set(ylabel="probability", xlabel="time (s)", ylim=(0.0, (_TRUTH[1] if is_labelled else high) + 0.02))
    joints = _runs_in_one_contact(segments)
    with_joint = {number for joint in joints for number in range(joint.first, joint.last + 1)}
    for number, (segment, (start_s, duration_s)) in enumerate(zip(segments, spans, strict=True)):
        names = [] if number in with_joint else [segment.contact.value]
        draw_segment(axes, segment, start_s, duration_s, _RIBBON, names)
        runs = [  # spans of the same contact are in the same lane
            (further.contact, str(flat(further.geometry.object)), str(flat(further.geometry.environment)))
            for further in segment.further
        ]
        numbers = {run: i for i, run in enumerate(dict.fromkeys(runs))}
        lane_height = min(_LANE, (high - low) / max(1, len(numbers)))
        for further, run in zip(segment.further, runs, strict=True):
            first_s = (max(further.start_ns, segment.start_ns) - origin_ns) * 1e-9
            end_ns = segment.end_ns if further.end_ns is None else min(further.end_ns, segment.end_ns)
            lane = low + numbers[run] * lane_height, lane_height
            span = first_s, (end_ns - origin_ns) * 1e-9 - first_s
            axes.broken_barh([span], lane, fc=SHADE[further.contact], ec="white")
    for joint in joints:  # one name for all segments of a joint
        first, start_s, of_joint = segments[joint.first], spans[joint.first][0], joint_name(joint.joint)
        duration_s, kind = sum(spans[joint.last]) - start_s, of_joint.rpartition(" ")[0]
        names = [*(f"{first.contact.value} {what}" for what in (of_joint, kind)), kind, first.contact.value]
        _write_in_bar(axes, start_s, duration_s, _RIBBON, names, _colour_of(first))
    for state, share in zip(STATES, np.transpose(beliefs.probability), strict=True):
        axes.plot(seconds, share, color=SHADE[state], label=state.value)
    axes.set_yticks(np.linspace(0.0, 1.0, 6))
    if truth is not None and is_labelled:
        for interval in truth.between(*beliefs.stamp_ns[[0, -1]].tolist()).intervals:
            start_s = (interval.start_ns - origin_ns) * 1e-9
            duration_s = (interval.end_ns - interval.start_ns) * 1e-9
            shade = "white" if interval.contact is None else SHADE[interval.contact]
            name = interval.contact if interval.coarse is None else interval.coarse.name
            if name is not None:
                bar: dict[str, Any] = {"facecolor": shade, "edgecolor": "grey", "linewidth": 0.5}
                axes.broken_barh([(start_s, duration_s)], (_TRUTH[0], _TRUTH[1] - _TRUTH[0]), **bar)
                _write_in_bar(axes, start_s, duration_s, _TRUTH, (name,), "none")
        for name, ribbon in (("truth", _TRUTH), ("found", _RIBBON)):
            style: dict[str, Any] = {"ha": "right", "va": "center", "fontsize": NAME_SIZE}
            axes.text(-0.01, 0.5 * sum(ribbon), name, transform=axes.get_yaxis_transform(), **style)
    handles, _ = axes.get_legend_handles_labels()
    if any(segment.inseparable for segment in segments):
        handles.append(open_patch())
    axes.legend(handles=handles, ncols=1, loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)


def _runs_in_one_contact(segments: Sequence[Segment]) -> list[JointRun]:
    """The joints with the segments that they hold for; with each alone if their contacts differ."""
    runs = list[JointRun]()
    for run in joint_runs(segments):
        numbers = range(run.first, run.last + 1)
        if len({segments[number].contact for number in numbers}) == 1:
            runs.append(run)
        else:
            runs += [JointRun(run.joint, number, number) for number in numbers if segments[number].joint]
    return runs


def draw_segment(
    axes: Axes,
    segment: Segment,
    start_s: float,
    duration_s: float,
    ribbon: tuple[float, float],
    names: Sequence[str],
) -> None:
    """Draw a bar in the colour of the contact, pale if improbable, hatched if several contacts fit, with the
    first of the names that fits into it."""
    colour, hatch = _colour_of(segment), "///" if segment.inseparable else None
    bar: dict[str, Any] = {"facecolor": colour, "edgecolor": "white", "linewidth": 0.0, "hatch": hatch}
    axes.broken_barh([(start_s, duration_s)], (ribbon[0], ribbon[1] - ribbon[0]), **bar)
    if names:
        _write_in_bar(axes, start_s, duration_s, ribbon, names, colour)


def _colour_of(segment: Segment) -> tuple[float, ...]:
    share = 0.25 + 0.75 * segment.probability
    return tuple(1.0 - share * (1.0 - part) for part in SHADE[segment.contact])


def _write_in_bar(
    axes: Axes,
    start_s: float,
    duration_s: float,
    ribbon: tuple[float, float],
    names: Sequence[str],
    background: Any,
) -> None:
    """Write the first of the names that fits into a bar, else the last name upright, else no name. A
    ``background`` with a colour hides the hatching behind the name."""
    size = axes.get_window_extent()
    points = 72.0 / axes.get_figure(root=True).dpi  # type: ignore[union-attr]
    (first_s, last_s), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    width = duration_s / (last_s - first_s) * points * size.width
    height = (ribbon[1] - ribbon[0]) / (top - bottom) * points * size.height
    for text in map(printable, names):
        extent = TextPath((0.0, 0.0), text, size=NAME_SIZE).get_extents()
        text_width, text_height = _SPAN_RATIO * extent.width, _SPAN_RATIO * extent.height
        is_level = width > text_width
        if is_level:
            break
    scale = 1.0 if is_level else min(1.0, height / text_width, width / text_height)
    if scale * NAME_SIZE >= _LEAST_SIZE:
        axes.text(
            start_s + 0.5 * duration_s,
            0.5 * sum(ribbon),
            text,
            fontsize=scale * NAME_SIZE,
            rotation="horizontal" if is_level else "vertical",
            ha="center",
            va="center",
            clip_on=True,
            bbox={"facecolor": background, "edgecolor": "none", "pad": _PAD},
        )


def open_patch() -> Patch:
    """The entry of a legend for hatched segments."""
    return Patch(facecolor="white", edgecolor="grey", hatch="///", label="open: others fit")


def _draw_parts(figure: FigureBase, parts: Sequence[Part], origin_ns: int, up: Array | None = None) -> None:
    """Draw the object in the body frame and its surroundings in the world frame, with ``up`` (3,) upward if
    known, and write when parts were touched."""
    drawn = list[tuple[Axes3D, list[Part]]]()
    halves = figure.subfigures(1, 2, squeeze=False)[0]
    for side, (within, name, frame) in enumerate(zip(halves, SIDES, ("body", "world"), strict=True)):
        drawn_parts = [part._replace(name=printable(part.name)) for part in parts if part.side == side]
        if not drawn_parts:
            continue
        axes = within.add_subplot(projection="3d")
        assert isinstance(axes, Axes3D)
        for number, part in enumerate(drawn_parts):
            colour = f"C{number % 10}"
            faces = part.mesh.vertices[part.mesh.triangles]
            axes.add_collection3d(Poly3DCollection(faces, alpha=0.3, facecolor=colour, linewidth=0.0))
            for strip in part.outline:
                axes.plot(*strip.T, color=colour, linewidth=1.0)
            if part.touched_ns:
                spans = [
                    f"{(a - origin_ns) * 1e-9:.1f} to {(b - origin_ns) * 1e-9:.1f}"
                    for a, b in part.touched_ns
                ]
                times = ", ".join(spans[:_SPANS]) + (", ..." if len(spans) > _SPANS else "")
                axes.plot([], [], color=colour, label=f"{part.name}: {times} s")
        places = [strip for part in drawn_parts for strip in (part.label_m[None], *part.outline)]
        places += [
            part.label_m + _VERTEX_VIEW * (part.mesh.vertices - part.label_m)
            for part in drawn_parts
            if not part.outline  # a vertex
        ]
        points = np.concatenate(places)
        low, high = points.min(axis=0), points.max(axis=0)
        half = max(0.5 * float((high - low).max()), 1e-3)
        for axis, middle in zip("xyz", 0.5 * (low + high), strict=True):
            axes.set(**{f"{axis}lim": (middle - half, middle + half), f"{axis}label": f"{axis} (m)"})
            place: Axis3D = getattr(axes, f"{axis}axis")
            place.set_major_locator(MaxNLocator(3))
            place.labelpad = _PART_SIZE
            axes.tick_params(axis, labelsize=_PART_SIZE)
        axes.view_init(*_view_of(UP if up is None or side == 0 else up))
        axes.set_box_aspect((1.0, 1.0, 1.0), zoom=_ZOOM)
        axes.set_title(f"{name} ({frame} frame)", fontsize=10)
        if 0 < len(axes.get_legend_handles_labels()[0]) <= _MOST_LISTED:
            within.legend(loc="outside lower center", frameon=False, fontsize=7)
        drawn.append((axes, drawn_parts))
    figure.get_figure(root=True).draw_without_rendering()
    for axes, drawn_parts in drawn:
        _write_names(axes, drawn_parts)


def _view_of(up: Array = UP) -> tuple[float, float, float]:
    """The view (elevation, azimuth and roll, degrees) with the unit vector ``up`` (3,) upward."""
    elevation, azimuth = np.radians(_VIEW_DEG)
    level = np.cos(elevation)
    eye = np.array([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)])
    view = Rotation.align_vectors(up[None], UP[None])[0].apply(eye)
    azimuth = np.arctan2(view[1], view[0])
    right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    roll = np.arctan2(right @ up, np.cross(view, right) @ up)
    elevation_deg, azimuth_deg, roll_deg = np.degrees([np.arcsin(view[2]), azimuth, roll]).tolist()
    return elevation_deg, azimuth_deg, roll_deg


def _write_names(axes: Axes3D, parts: Sequence[Part]) -> None:
    """Write the names of parts at their places, those of lines where the fewest other lines pass, or lower
    where they would overlap."""
    points, taken = 72.0 / axes.get_figure(root=True).dpi, list[tuple[float, float, float]]()

    def on_page(places: Array) -> Array:
        drawn = np.column_stack(proj_transform(*places.T, axes.get_proj())[:2])
        return np.asarray(points * axes.transData.transform(drawn))

    lines = {number: part.outline[0] for number, part in enumerate(parts) if _is_line(part)}
    shares = np.linspace(0.0, 1.0, _PLACES)[:, None]
    strips = {number: on_page(a + shares * (b - a)) for number, (a, b) in lines.items()}
    for number, part in enumerate(parts):
        half = 0.5 * TextPath((0.0, 0.0), part.name, size=_PART_SIZE).get_extents().width
        others = np.concatenate([np.zeros((0, 2)), *(s for n, s in strips.items() if n != number)])
        choices = [on_page(part.label_m[None])[0]]
        if number in strips:  # the middle, and near both ends
            choices += [strips[number][_PLACES // 8], strips[number][-1 - _PLACES // 8]]
        best = None
        for choice in choices:
            x, y = choice.tolist()
            while any(abs(x - u) < half + width and abs(y - v) < 1.2 * _PART_SIZE for u, v, width in taken):
                y -= 0.5 * _PART_SIZE
            is_hidden = (np.abs(others - (x, y)) < (half, _PART_SIZE)).all(axis=1)
            cost = int(is_hidden.sum()) + float(choice[1] - y) / _PART_SIZE
            if best is None or cost < best[0]:
                best = cost, x, y, choice
        assert best is not None
        _, x, y, choice = best
        taken.append((x, y, half))
        axes.annotate(
            part.name,
            axes.transData.inverted().transform(choice / points),
            (0.0, y - choice[1]),
            textcoords="offset points",
            color=f"C{number % 10}",
            fontsize=_PART_SIZE,
            ha="center",
            path_effects=[withStroke(linewidth=2.0, foreground="white")],
            zorder=_IN_FRONT,
        )


def _is_line(part: Part) -> bool:
    return len(part.outline) == 1 and len(part.outline[0]) == 2


def write_figure(outcome: Outcome, path: Path, suffix: str) -> None:
    """Write the figure in the format of a suffix."""
    save_figure(draw_figure(outcome), path, suffix)


def save_figure(figure: Figure, path: Path, suffix: str) -> None:
    """Write a figure in the format of a suffix, and close it."""
    try:
        figure.savefig(path, format=suffix.lower().removeprefix("."), dpi=DOTS_PER_INCH)
    finally:
        pyplot.close(figure)


def figure_svg(outcome: Outcome) -> str:
    """The segments and their probabilities as an SVG element for a page."""
    figure, axes = pyplot.subplots(figsize=(11.8, _ROW), layout="constrained")
    draw_on(axes, outcome)
    text = StringIO()
    with rc_context(_PAGE):
        figure.savefig(text, format="svg", metadata={"Date": None})
    pyplot.close(figure)
    return text.getvalue()[text.getvalue().index("<svg") :]
