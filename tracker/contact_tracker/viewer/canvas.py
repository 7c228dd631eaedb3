"""Entities of the views, their rows for rerun (many at once offline, single ones live), and the layout: 3D
and events on the left, plots over time on the right."""

import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Final
from uuid import uuid4

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from contact_tracker.geometry.elements import Array, ContactGeometry
from contact_tracker.motion.poses import Pose, Poses
from contact_tracker.outputs.parts import Part
from contact_tracker.outputs.scene import EMPTY, GREY, OBJECT, Drawing, Eye, Mesh, circle, join
from contact_tracker.outputs.text import COLOUR, COLOURS, OPEN_OFFSET, Colour, alternatives, describe
from contact_tracker.states import CONTACTS, STATES, Contact
from contact_tracker.tracking.belief import FurtherContact
from contact_tracker.tracking.informative_motion import InformativeMotion

Stamps = NDArray[np.int64]

APPLICATION: Final = "contact-tracker"
TIMELINE: Final = "t"
STAMP: Final = "stamp"
BODY: Final = "world/body"
TRAIL: Final = "world/trail"
KNOWN: Final = ("world/body/known", "world/surroundings/known")
"""Known parts of the object and of the surroundings; each with ``/outline`` and ``/names``."""
CENTRE: Final = "world/body/centre"
"""The middle of the object, which the view follows."""
SUGGESTED: Final = "world/suggested"
"""Suggested motion: the axis or direction, and the arc about it."""
LEGEND: Final = "legend"
TRUTH: Final = "state/truth"
SMOOTHED: Final = "state/smoothed"
FILTERED: Final = "state/filtered"
INSEPARABLE: Final = "state/inseparable"
"""Contacts that the motion does not distinguish from the label."""
P_SMOOTHED: Final = "probability/smoothed"
P_FILTERED: Final = "probability/filtered"
RESIDUAL: Final = "minima/residual"
MOTION: Final = "motion"
MOTION_SERIES: Final = {"slip": COLOUR[Contact.VF], "3 standard deviations": COLOUR[Contact.FREE]}
"""Colours of the speed at the touching point, and of three standard deviations of its noise."""
EVENTS: Final = "events"

NOTHING: Final = (EMPTY,) * 4
OPACITY: Final = (1.0, 0.15, 1.0, 0.2)
"""Opacities of the four meshes of a ``Drawing``; ``NOTHING`` are empty meshes."""
SHEET: Final = 0.55
"""Opacity of faces of the surroundings; it leaves objects below visible."""
OPEN: Final = 0.35
"""Opacity of open contacts relative to decided ones."""
_ROWS: Final = 1000
"""Number of rows that are sent together: fewer double the file, more are displayed slowly."""
Columns = Iterable[rr.ComponentColumn]

_KNOWN: Final = (OBJECT, GREY)
_FAINT: Final = 25
"""Opacity of known parts, of 255, below that of the touching pair."""
_VERTEX_UI: Final = 3.5

_LEGEND: Final = """\
- **white, round**: the object's element; a wheel is a face, a rod an edge, a ball a vertex
- **coloured, square**: the element it touches, in the colour of the contact; a sheet, a bar, a cube
- **faint, with an outline**: known bodies and touched parts of elements; the pointer shows their names
- **grey arrow**: `live --suggest`, the most informative small motion: along it, or about it by the arc
- **translucent**: two standard deviations; **thin needle**: position along it unknown
- **e-f 0.97 or v-f**: the object's edge on a face, and its probability; pale, as v-f fits the motion as well
"""


def touching(number: int = 0) -> tuple[str, ...]:
    """The entities of the labelled touching pair (0) or of further contact ``number``: the meshes of a
    ``Drawing``, and the label."""
    end = f"_{number + 1}" if number else ""
    pair = f"world/body/element{end}", f"world/surroundings/element{end}"
    meshes = (f"{side}{part}" for side in pair for part in ("", "/uncertainty"))
    return (*meshes, f"world/surroundings/label{end}")


def further_lane(number: int) -> str:
    """The entity of the state of further contact ``number`` (from 1) over time."""
    return "state/further" if number == 1 else f"state/further_{number}"


def new_recording(name: str | None = None) -> rr.RecordingStream:
    """A stream that has only the timelines of the data; ``name`` is shown in the viewer."""
    recording = rr.RecordingStream(APPLICATION, recording_id=uuid4())
    if name is not None:
        recording.send_recording_name(name)
    recording.set_log_time_enabled(False)
    recording.set_log_tick_enabled(False)
    return recording


class Canvas:
    """Writes rows into ``recording``; times count from ``origin_ns``, the first pose.

    Data that rerun does not accept raise an error, instead of a warning.
    """

    def __init__(self, recording: rr.RecordingStream, origin_ns: int, axes_m: float) -> None:
        self._recording = recording
        self._origin_ns = origin_ns
        self._static(BODY, rr.TransformAxes3D(axes_m))
        for entity in (TRUTH, SMOOTHED, FILTERED):
            self._lane(entity)
        for entity in (P_SMOOTHED, P_FILTERED):
            self._lines(entity, {state.value: COLOUR[state] for state in STATES})
        self._lines(RESIDUAL, {contact.value: COLOUR[contact] for contact in CONTACTS})
        self._lines(MOTION, MOTION_SERIES)
        self._static(LEGEND, rr.TextDocument(_LEGEND, media_type=rr.MediaType.MARKDOWN))
        self.most_further = 0
        self._labelled: set[str] = set()
        self._state_names: list[str] = []
        self._last_texts: dict[str, str | None] = {}

    def pose(self, pose: Pose) -> None:
        """Draw one pose, with the least cost per row."""
        self._set_time(pose.stamp_ns)
        quaternion = rr.Quaternion(xyzw=pose.quat_xyzw)
        placed = rr.Transform3D(translation=pose.position_m, quaternion=quaternion)
        self._recording.log(BODY, placed, strict=True)

    def poses(self, poses: Poses) -> None:
        places = {"translation": poses.position_m, "quaternion": poses.quat_xyzw}
        self._send(BODY, poses.stamp_ns, rr.Transform3D.columns, **places)

    def known(self, parts: Sequence[Part], stamp_ns: int | None = None) -> None:
        """Draw the known parts from a stamp on, in place of earlier ones; at all times without a stamp."""
        if stamp_ns is not None:
            self._set_time(stamp_ns)
        for side, entity in enumerate(KNOWN):
            drawn, colour = [part for part in parts if part.side == side], _KNOWN[side]
            mesh = join([EMPTY, *(part.mesh for part in drawn)])
            faces = rr.Mesh3D(
                vertex_positions=mesh.vertices,
                triangle_indices=mesh.triangles,
                albedo_factor=(*colour, _FAINT),
            )
            strips = [strip for part in drawn for strip in part.outline]
            lines = rr.LineStrips3D(strips, colors=colour, radii=rr.Radius.ui_points(0.8))
            radii = rr.Radius.ui_points([0.0 if part.outline else _VERTEX_UI for part in drawn])
            places = np.reshape([part.label_m for part in drawn], (-1, 3))
            labels = [part.name for part in drawn]  # hidden, as many labels cover each other
            names = rr.Points3D(places, labels=labels, show_labels=False, colors=colour, radii=radii)
            for end, archetype in (("", faces), ("/outline", lines), ("/names", names)):
                self._recording.log(f"{entity}{end}", archetype, static=stamp_ns is None, strict=True)

    def suggest(self, stamp_ns: int, motion: InformativeMotion | None, length_m: float) -> None:
        """Draw the suggested motion from a stamp on, in place of an earlier one: the direction of a shift, or
        the axis of a turn with the arc about it."""
        self._set_time(stamp_ns)
        arrow, arc, style = rr.Arrows3D(vectors=[]), rr.LineStrips3D([]), rr.Radius.ui_points(2.5)
        if motion is not None:
            turn, shift = motion.turn_world_rad, motion.shift_world_m
            label = f"to decide: {motion.allowed_by} or {motion.forbidden_by}"
            along = turn if turn.any() else shift
            vector, origin = along * length_m / np.linalg.norm(along), motion.point_world_m
            arrow = rr.Arrows3D(vectors=[vector], origins=[origin], colors=GREY, radii=style, labels=label)
            if turn.any():
                angle = float(np.linalg.norm(turn))
                strip = origin + length_m * circle(turn / angle, np.linspace(0.0, angle, 16))
                arc = rr.LineStrips3D([strip], colors=GREY, radii=style)
        self._recording.log(SUGGESTED, arrow, strict=True)
        self._recording.log(f"{SUGGESTED}/arc", arc, strict=True)

    def trail(self, stamp_ns: Stamps, strips: Sequence[Array], contacts: Sequence[Contact]) -> None:
        """The path (N, 3) of the body's origin up to each stamp, coloured by contact."""
        colours = [COLOUR[contact] for contact in contacts]
        self._send(TRAIL, stamp_ns, rr.LineStrips3D.columns, strips=strips, colors=colours)

    def states(self, entity: str, stamp_ns: Stamps, contacts: Sequence[Contact | None]) -> None:
        """The contact from each stamp on; None if unknown."""
        # in rerun an empty text ends a state
        self._texts(entity, stamp_ns, ["" if contact is None else contact.value for contact in contacts])

    def _texts(self, entity: str, stamp_ns: Stamps, texts: Sequence[str]) -> None:
        """The text of a state from each stamp on, written where it changes."""
        previous = [self._last_texts.get(entity), *texts]
        changes = [i for i, text in enumerate(texts) if text != previous[i]]
        self._last_texts[entity] = previous[-1]
        self._send(entity, stamp_ns[changes], rr.StateChange.columns, state=[texts[i] for i in changes])

    def further(self, stamp_ns: Stamps, held: Sequence[Sequence[FurtherContact | None]]) -> None:
        """State, label and opacity of the further contacts that hold from each stamp on, in order; None for a
        contact that does not hold."""
        while self.most_further < max(map(len, held), default=0):
            self.most_further += 1
            self._lane(further_lane(self.most_further))
        for number in range(1, self.most_further + 1):
            row = [further[number - 1] if number <= len(further) else None for further in held]
            self.states(further_lane(number), stamp_ns, [None if f is None else f.contact for f in row])
            rows = [i for i, further in enumerate(row) if further is not None]
            named = [further for further in row if further is not None]
            if named:
                probability = np.array([further.probability for further in named])
                texts = [f"+ {caption(f.contact, f.probability, f.inseparable)}" for f in named]
                contacts, are_open = [f.contact for f in named], [bool(f.inseparable) for f in named]
                self.fade(stamp_ns[rows], contacts, probability, are_open, texts, number)

    def scalars(self, entity: str, stamp_ns: Stamps, values: Array) -> None:
        """Values (N, K) of the K series of an entity; nan is a gap."""
        self._send(entity, stamp_ns, rr.Scalars.columns, scalars=values)

    def inseparable(self, stamp_ns: Stamps, contacts: Sequence[Sequence[Contact]]) -> None:
        """The contacts that the motion does not distinguish from the label, from each stamp on."""
        texts = [f"or {alternatives(states)}" if states else "" for states in contacts]
        new = sorted({text for text in texts if text} - set(self._state_names))
        if new:
            self._state_names += new
            names, greys = self._state_names, [GREY] * len(self._state_names)
            self._static(INSEPARABLE, rr.StateConfiguration(values=names, labels=names, colors=greys))
        self._texts(INSEPARABLE, stamp_ns, texts)

    def centre(self, centre_m: Array) -> None:
        """Set the middle (3,) of the object in the body frame."""
        self._static(CENTRE, rr.Points3D([centre_m], radii=rr.Radius.ui_points(0.0)))

    def drawings(self, stamp_ns: Stamps, drawings: Sequence[Drawing | None], number: int = 0) -> None:
        """Draw touching pair ``number`` from each stamp on; None clears it."""
        *entities, label = touching(number)
        if label not in self._labelled:
            self._labelled.add(label)
            style = rr.Points3D.from_fields(radii=rr.Radius.ui_points(0.0), show_labels=True)
            self._static(label, style)
        meshes = [NOTHING if d is None else d.meshes for d in drawings]
        for entity, meshes_of_entity in zip(entities, zip(*meshes, strict=True), strict=True):
            self._send(entity, stamp_ns, _mesh_columns, meshes=meshes_of_entity)
        places = [np.zeros((0, 3)) if d is None else d.label_m[None] for d in drawings]
        self._send(label, stamp_ns, _point_columns, places=places)

    def fade(
        self,
        stamp_ns: Stamps,
        contacts: Sequence[Contact],
        probability: Array,
        are_open: Sequence[bool],
        captions: Sequence[str],
        number: int = 0,
    ) -> None:
        """Colour, opacity and caption of touching pair ``number`` from each stamp on."""
        strength = np.clip(probability, 0.0, 1.0) * np.where(are_open, OPEN, 1.0)
        *entities, label = touching(number)
        colours = np.array([COLOUR[contact] for contact in contacts], np.uint8)
        white = np.broadcast_to(np.array(OBJECT, np.uint8), colours.shape)
        shades = (white, white, colours, colours)
        for entity, shade, opacity in zip(entities, shades, OPACITY, strict=True):
            alpha = 255.0 * opacity * strength
            if entity == entities[2]:
                alpha = alpha * np.where([contact.value.endswith("-f") for contact in contacts], SHEET, 1.0)
            rgba = np.column_stack([shade, np.round(alpha).astype(np.uint8)])
            self._send(entity, stamp_ns, rr.Mesh3D.columns, albedo_factor=rgba)
        self._send(label, stamp_ns, rr.Points3D.columns, labels=captions, colors=colours)

    def events(self, stamp_ns: Stamps, contacts: Sequence[Contact], texts: Sequence[str]) -> None:
        colours = [COLOUR[contact] for contact in contacts]
        levels = [contact.value for contact in contacts]
        self._send(EVENTS, stamp_ns, rr.TextLog.columns, text=texts, level=levels, color=colours)

    def _lines(self, entity: str, colours: Mapping[str, Colour]) -> None:
        widths = [1.6] * len(colours)
        lines = rr.SeriesLines(colors=[*colours.values()], names=[*colours], widths=widths)
        self._static(entity, lines)

    def _lane(self, entity: str) -> None:
        names = [state.value for state in STATES]
        self._static(entity, rr.StateConfiguration(values=names, labels=names, colors=COLOURS))

    def _static(self, entity: str, archetype: rr.AsComponents) -> None:
        self._recording.log(entity, archetype, static=True, strict=True)

    def _set_time(self, stamp_ns: int) -> None:
        self._recording.set_time(TIMELINE, duration=np.timedelta64(stamp_ns - self._origin_ns, "ns"))
        self._recording.set_time(STAMP, timestamp=np.datetime64(stamp_ns, "ns"))

    def _send(
        self,
        entity: str,
        stamp_ns: Stamps,
        columns: Callable[..., Columns],
        **values: Sequence[Any] | NDArray[Any],
    ) -> None:
        """Send ``columns`` of values, a row per stamp."""
        for begin in range(0, len(stamp_ns), _ROWS):
            rows = slice(begin, begin + _ROWS)
            since = (stamp_ns[rows] - self._origin_ns).astype("timedelta64[ns]")
            times = [
                rr.TimeColumn(TIMELINE, duration=since),
                rr.TimeColumn(STAMP, timestamp=stamp_ns[rows].astype("datetime64[ns]")),
            ]
            batch = columns(**{name: rows_of_name[rows] for name, rows_of_name in values.items()})
            self._recording.send_columns(entity, times, batch, strict=True)


def _point_columns(places: Sequence[Array]) -> Columns:
    return rr.Points3D.columns(positions=np.concatenate(places)).partition(list(map(len, places)))


def _mesh_columns(meshes: Sequence[Mesh]) -> Columns:
    vertices, triangles, normals = (np.concatenate(part) for part in zip(*meshes, strict=True))
    per_vertex, per_triangle = ([len(m[i]) for m in meshes] for i in (0, 1))
    yield from rr.Mesh3D.columns(vertex_positions=vertices, vertex_normals=normals).partition(per_vertex)
    yield from rr.Mesh3D.columns(triangle_indices=triangles).partition(per_triangle)


def caption(
    contact: Contact, probability: float, inseparable: Sequence[Contact] = (), is_open: bool = False
) -> str:
    """``f-f  0.97 or e-f``; ``is_open``: the position of the faces along their normal is unknown."""
    suffix = f" or {alternatives(inseparable)}" if inseparable else ""
    return f"{contact.value}  {probability:.2f}{suffix}{f', {OPEN_OFFSET}' if is_open else ''}"


def event(
    since_ns: int, probability: float, geometry: ContactGeometry | None, inseparable: Sequence[Contact] = ()
) -> str:
    """Time (``since_ns`` after the first pose), probability, geometry and alternatives of a contact.

    The contact itself is the row's level.
    """
    return f"{since_ns * 1e-9:7.2f} s  p {probability:.2f}  {describe(geometry, inseparable)}".rstrip()


def further_event(since_ns: int, further: FurtherContact, joins: bool) -> str:
    """The text of an event: the begin (``joins``) or end of a further contact."""
    how = "joins " if joins else "leaves"
    elements = describe(further.geometry, further.inseparable) if joins else ""
    return f"{since_ns * 1e-9:7.2f} s  p {further.probability:.2f}  {how}  {elements}".rstrip()


BACKGROUND = (25, 28, 33)
"""Colour behind the 3D scene, dark in light themes as well, as the object's elements are white."""
TRAIL_S = 4.0
LIVE_S = 10.0
_RESIDUAL = "Residual over 24 ticks of motion (1 = noise)"


def offline_layout(eye: Eye, is_one_of_several: bool = False) -> rrb.Blueprint:
    """Layout of a whole recording; the list of recordings is open if there are several."""
    everything = rr.TimeRange(start=rr.TimeRangeBoundary.infinite(), end=rr.TimeRangeBoundary.infinite())
    smoothed = _plot(P_SMOOTHED, "Probability, smoothed (all data)", everything, 1.05)
    filtered = _plot(P_FILTERED, "Probability, filtered (data so far)", everything, 1.05, legend=False)
    residual = _plot(RESIDUAL, _RESIDUAL, everything, 3.0)
    motion = _plot(MOTION, "Slip at the touching point (m/s)", everything, None)
    views = _states(everything), smoothed, filtered, rrb.Tabs(residual, motion)
    over_time = rrb.Vertical(*views, row_shares=[15, 14, 7, 12])
    recordings = rrb.BlueprintPanel(state="expanded" if is_one_of_several else "collapsed")
    return _blueprint(eye, over_time, recordings, rrb.TimePanel(state="collapsed", timeline=TIMELINE))


def live_layout(eye: Eye) -> rrb.Blueprint:
    """Layout of a live view: the last seconds before the cursor, which follows the data."""
    recent = _recent(LIVE_S)
    probability = _plot(P_FILTERED, "Probability", recent, 1.05)
    views = _states(recent), probability, _plot(RESIDUAL, _RESIDUAL, recent, 3.0)
    panel = rrb.TimePanel(state="collapsed", timeline=TIMELINE, play_state="following")
    return _blueprint(eye, rrb.Vertical(*views), rrb.BlueprintPanel(state="collapsed"), panel)


def _recent(seconds: float) -> rr.TimeRange:
    """The time range of the last ``seconds`` before the cursor."""
    start, end = (rr.TimeRangeBoundary.cursor_relative(seconds=offset_s) for offset_s in (-seconds, 0.0))
    return rr.TimeRange(start=start, end=end)


def _blueprint(
    eye: Eye, over_time: rrb.Container, recordings: rrb.BlueprintPanel, time: rrb.TimePanel
) -> rrb.Blueprint:
    # The text has the time, as the viewer's column of time is too narrow.
    hidden = [rrb.encodings.TimelineColumn(name, visible=False) for name in (TIMELINE, STAMP)]
    columns = rrb.TextLogColumns(timeline_columns=hidden, text_log_columns=["LogLevel", "Body"])
    events = rrb.TextLogView(origin=EVENTS, name="Changes of contact", columns=columns)
    controls = rrb.EyeControls3D(
        kind=rrb.Eye3DKind.Orbital,
        position=eye[0],
        look_target=(0.0, 0.0, 0.0),
        eye_up=eye[1],
        tracking_entity=CENTRE,  # the place of the eye is relative to it
    )
    # The world frame need not be level, so the viewer's ground grid would mislead.
    space = rrb.Spatial3DView(
        origin="world",
        contents="world/**",
        name="Object and contact",
        background=BACKGROUND,
        line_grid=False,
        eye_controls=controls,
        overrides={TRAIL: rrb.VisibleTimeRanges(rr.VisibleTimeRange(TIMELINE, _recent(TRAIL_S)))},
    )
    legend = rrb.TextDocumentView(origin=LEGEND, name="Legend")
    left_column = rrb.Vertical(space, legend, events, row_shares=[18, 5, 5])
    return rrb.Blueprint(
        rrb.Horizontal(left_column, over_time, column_shares=[11, 9]),
        recordings,
        rrb.SelectionPanel(state="collapsed"),
        time,
        auto_views=False,
    )


def _states(time_range: rr.TimeRange) -> rrb.View:
    options: dict[str, Any] = {}
    if "time_view" in inspect.signature(rrb.StateTimelineView.__init__).parameters:  # not yet in 0.38
        options["time_view"] = rrb.TimeAxis(view_range=time_range)
    return rrb.StateTimelineView(origin="state", name="Contact", **options)


def _plot(
    entity: str, name: str, time_range: rr.TimeRange, top: float | None, legend: bool = True
) -> rrb.View:
    return rrb.TimeSeriesView(
        origin=entity,
        name=name,
        axis_x=rrb.TimeAxis(view_range=time_range),
        axis_y=None if top is None else rrb.ScalarAxis(range=(0.0, top)),
        plot_legend=rrb.PlotLegend(rrb.Corner2D.LeftTop, visible=legend),
    )
