"""The paper's Fig. 4 and Fig. 5, drawn of replicated experiments."""

import json
from collections.abc import Sequence
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.axes3d import Axes3D
from numpy.typing import NDArray

from contact_tracker.geometry.elements import ContactGeometry, Element, Line, Plane, Point
from contact_tracker.geometry.polyhedron import convex
from contact_tracker.outputs.text import COLOUR
from contact_tracker.states import STATES, Contact
from contact_tracker_lab.evaluation.geometry_errors import places
from drawing import OBJECT, SURROUNDINGS, draw_body, draw_element, show_scene
from paper_replication import MOVED, STEP, ContactSequence, SingleContact

Array = NDArray[np.float64]
Colour = tuple[float, float, float]

PANELS: Final = ((Contact.FF, Contact.EF), (Contact.VF, Contact.EE))
"""The contacts that the paper's Fig. 5 has in (a) and in (b)."""


def draw_geometry(recordings: Sequence[SingleContact]) -> Figure:
    """Fig. 4: the cube in the middle of each recording, with the elements that were found.

    Solid lines are the tracker's, dashed ones SLSQP's; black dots are the true elements.
    """
    figure = Figure(figsize=(9.0, 8.0), layout="constrained")
    for place, (recording, letter) in enumerate(zip(recordings, "abcd", strict=False)):
        axes = figure.add_subplot(2, 2, place + 1, projection="3d", computed_zorder=False)
        assert isinstance(axes, Axes3D)
        draw_recording(axes, recording)
        axes.set_title(f"({letter}) {recording.contact.value}")
    figure.text(0.02, 0.03, "object's element", color=OBJECT, weight="bold")
    figure.text(0.02, 0.01, "surroundings' element", color=SURROUNDINGS, weight="bold")
    figure.text(0.4, 0.01, "solid: tracker, dashed: SLSQP, black: true")
    return figure


def draw_recording(axes: Axes3D, recording: SingleContact) -> None:
    """Of both methods, in the world, turned so that the true surroundings' face or the desk is below."""
    poses = recording.simulated.poses
    truth = recording.simulated.truth.intervals[0].geometry
    assert truth is not None
    rotation, position = poses.rotation[len(poses) // 2], poses.position_m[len(poses) // 2]
    scene = convex(np.array(json.loads(recording.simulated.metadata["surroundings_vertices_m"])))
    upright = turned_to_z(top_normal(np.asarray(scene.vertices)))
    body = np.array(json.loads(recording.simulated.metadata["object_vertices_m"])) @ rotation.T + position
    in_body, _ = places(truth, poses)
    touch = rotation @ in_body + position

    def view(points: Array) -> Array:
        return np.asarray((points - touch) @ upright.T)

    draw_body(axes, convex(view(body)), "#f2c14e", 0.2)
    estimates = [(recording.slsqp, "--"), *([(recording.tracker, "-")] if recording.tracker else [])]
    for geometry, style in estimates:
        for element, colour in elements_in_world(geometry, rotation, position):
            turned = facing(moved(element, upright, -upright @ touch), -1.0 if colour is OBJECT else 1.0)
            draw_element(axes, turned, np.zeros(3), colour, style)
    for element, _ in elements_in_world(truth, rotation, position):
        draw_true(axes, moved(element, upright, -upright @ touch))
    show_scene(axes, np.array([0.0, 0.0, 0.08]), 0.2, 18.0, -60.0)


def elements_in_world(
    geometry: ContactGeometry, rotation: Array, position: Array
) -> list[tuple[Element, str]]:
    return [(moved(geometry.object, rotation, position), OBJECT), (geometry.environment, SURROUNDINGS)]


def moved(element: Element, rotation: Array, shift: Array) -> Element:
    """The element where ``x -> rotation x + shift`` takes it."""
    match element:
        case Plane(normal, offset_m):
            return Plane(rotation @ normal, float(offset_m + rotation @ normal @ shift))
        case Line(direction, point_m):
            return Line(rotation @ direction, rotation @ point_m + shift)
        case Point(point_m):
            return Point(rotation @ point_m + shift)


def facing(element: Element, up: float) -> Element:
    """A face whose normal looks ``up`` (1) or down (-1): which of the two, motion does not tell."""
    match element:
        case Plane(normal, offset_m) if normal[2] * up < 0.0:
            return Plane(-normal, -offset_m)
    return element


def draw_true(axes: Axes3D, element: Element) -> None:
    match element:
        case Plane(normal):
            axes.plot(*np.outer(normal, [0.0, 0.14]), color="black", linestyle=":")
        case Line(direction, point_m):
            along = point_m - direction * (direction @ point_m)
            axes.plot(*(along[:, None] + np.outer(direction, [-0.14, 0.14])), color="black", linestyle=":")
        case Point(point_m):
            axes.scatter(*point_m, color="black", s=12, depthshade=False, zorder=12)


def top_normal(vertices: Array) -> Array:
    """Normal of the desk's top: its shape is a box whose last coordinate is the height."""
    lower, upper = vertices[0::2].mean(axis=0), vertices[1::2].mean(axis=0)
    return np.asarray((upper - lower) / np.linalg.norm(upper - lower))


def turned_to_z(normal: Array) -> Array:
    """A rotation (3, 3) that turns ``normal`` upwards."""
    others = np.linalg.svd(normal[None])[2][1:]
    rotation = np.array([others[0], np.cross(normal, others[0]), normal])
    return rotation


def draw_sequence(sequence: ContactSequence) -> Figure:
    """Fig. 5, and below it what the tracker says on the same axis.

    (a), (b): the paper's curves, with dots where SLSQP was run. (c): the online posterior. (d): the smoothed
    one. A window stands at its last pose.
    """
    figure = Figure(figsize=(10.0, 9.5), layout="constrained")
    first, second, online, offline = figure.subplots(4, 1, sharex=True)
    windows = np.arange(len(sequence.windows.stamp_ns))
    for axes, letter, contacts in zip((first, second), "ab", PANELS, strict=True):
        for contact in contacts:
            column = MOVED.index(contact)
            axes.plot(windows, sequence.curves[:, column], color=colour_of(contact), label=contact.value)
            axes.plot(
                sequence.slsqp_window,
                sequence.slsqp_points[:, column],
                ".",
                color=colour_of(contact),
                markersize=5,
            )
        axes.set(ylabel=f"({letter}) objective / maximum", ylim=(-0.02, 1.02))
        axes.legend(loc="upper left", frameon=False)
    posteriors = (
        (online, "c", "online", sequence.segmentation.filtered),
        (offline, "d", "smoothed", sequence.segmentation.beliefs),
    )
    for axes, letter, name, beliefs in posteriors:
        at = sequence.window_at(beliefs.stamp_ns)
        for state in STATES:
            axes.plot(at, beliefs.probability[:, state.column], color=colour_of(state), label=state.value)
        axes.set(ylabel=f"({letter}) {name} posterior", ylim=(-0.02, 1.02))
    offline.set(xlabel=f"window (ends at pose 500 + {STEP} n)", xlim=(0, windows[-1]))
    offline.legend(loc="center left", bbox_to_anchor=(0.01, 0.5), frameon=False, fontsize="small")
    changes = np.flatnonzero(np.diff(sequence.truth)) + 1
    for axes in (first, second, online, offline):
        mark_changes(axes, sequence.window_at(sequence.poses.stamp_ns[changes]))
    return figure


def mark_changes(axes: Axes, at: Array) -> None:
    for window in at:
        axes.axvline(window, color="black", linestyle=":", linewidth=1)


def colour_of(state: Contact) -> Colour:
    red, green, blue = COLOUR[state]
    return red / 300.0, green / 300.0, blue / 300.0  # a little darker than in the viewer: the paper is white
