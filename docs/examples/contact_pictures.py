"""Draws the pictures of the six contacts, ``docs/images/contact_*.png``, and one of all, ``contacts.png``.

python docs/examples/contact_pictures.py
"""

from pathlib import Path
from typing import Final, NamedTuple

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from matplotlib.image import imread, imsave
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from mpl_toolkits.mplot3d.axes3d import Axes3D
from numpy.typing import NDArray

from contact_tracker.geometry.polyhedron import Feature, Polyhedron, convex
from contact_tracker.states import CONTACTS, Contact
from contact_tracker_lab.simulate.plan import Chart
from drawing import OBJECT, SURROUNDINGS, draw_body, show_scene

Array = NDArray[np.float64]

FOLDER: Final = Path(__file__).resolve().parents[1] / "images"
CUBE: Final = convex(np.array(np.meshgrid(*[(-0.1, 0.1)] * 3)).reshape(3, -1).T)
DESK: Final = convex(
    np.array(np.meshgrid((-0.25, 0.25), (-0.2, 0.2), (-0.12, 0.0))).reshape(3, -1).T,
)
RIDGE: Final = convex(
    np.array(
        [(x, y, -0.14) for x in (-0.25, 0.25) for y in (-0.18, 0.18)] + [(x, 0.0, 0.0) for x in (-0.25, 0.25)]
    )
)
PYRAMID: Final = convex(
    np.array([(x, y, -0.16) for x in (-0.2, 0.2) for y in (-0.2, 0.2)] + [(0.0, 0.0, 0.0)])
)


class Scene(NamedTuple):
    """Which surroundings, and how the cube stands on them: its turn about the normal, and its tilt (rad)."""

    surroundings: Polyhedron
    spin_deg: float
    tilt: tuple[float, float]


SCENES: Final = {
    Contact.FF: Scene(DESK, 25.0, (0.0, 0.0)),
    Contact.EF: Scene(DESK, 25.0, (0.35, 0.0)),
    Contact.FE: Scene(RIDGE, 30.0, (0.25, 0.0)),
    Contact.VF: Scene(DESK, 10.0, (0.25, 0.1)),
    Contact.FV: Scene(PYRAMID, 20.0, (0.2, 0.1)),
    Contact.EE: Scene(RIDGE, 60.0, (0.2, 0.0)),
}


def feature_of(body: Polyhedron, kind: str, towards: Array) -> Feature:
    """The face, edge or vertex of ``body`` that lies farthest ``towards`` (3,)."""
    return max(body.of_kind(kind), key=lambda feature: float(feature.points.mean(axis=0) @ towards))


def draw_contact(contact: Contact) -> Figure:
    """The cube in contact, with the elements that touch."""
    scene = SCENES[contact]
    of_object = feature_of(CUBE, contact.value[0], np.array([0.1, 0.2, -1.0]))
    of_scene = feature_of(scene.surroundings, contact.value[2], np.array([0.0, 0.0, 1.0]))
    normal = tilted(of_scene, scene.tilt if contact.value[0] == "f" else (0.0, 0.0))
    object_normal = tilted(of_object, scene.tilt)
    chart = Chart(contact, of_object, of_scene)
    rotation = chart.rotation(normal[None], object_normal[None], np.radians([scene.spin_deg]))[0]
    shift = of_scene.points.mean(axis=0) - rotation @ of_object.points.mean(axis=0)
    placed = convex(CUBE.vertices @ rotation.T + shift)

    figure = Figure(figsize=(4.0, 3.4), layout="constrained")
    axes = figure.add_subplot(projection="3d", computed_zorder=False)
    assert isinstance(axes, Axes3D)
    draw_body(axes, scene.surroundings, "#9aa5b1", 0.35)
    draw_feature(axes, of_scene.points, SURROUNDINGS, contact.value[2])
    draw_body(axes, placed, "#f2c14e", 0.3)
    draw_feature(axes, of_object.points @ rotation.T + shift, OBJECT, contact.value[0])
    show_scene(axes, np.array([0.0, 0.0, 0.05]), 0.28, 18.0, -62.0)
    figure.text(0.03, 0.06, "object", color=OBJECT, weight="bold")
    figure.text(0.03, 0.01, "surroundings", color=SURROUNDINGS, weight="bold")
    figure.suptitle(f"{contact.value}", weight="bold")
    return figure


def tilted(feature: Feature, tilt: tuple[float, float]) -> Array:
    """The middle of its normal cone, turned within it by two angles (rad) as far as it has them."""
    ways = feature.tangents(feature.axis)
    turned = feature.axis + sum(
        (np.tan(angle) * way for angle, way in zip(tilt, ways, strict=False)), np.zeros(3)
    )
    return np.asarray(turned / np.linalg.norm(turned))


def draw_feature(axes: Axes3D, points: Array, colour: str, kind: str) -> None:
    match kind:
        case "f":
            axes.add_collection3d(Poly3DCollection([points], facecolor=colour, edgecolor=colour, alpha=0.45))
        case "e":
            axes.plot(*points.T, color=colour, linewidth=4, zorder=10)
        case _:
            axes.scatter(*points[0], color=colour, s=90, depthshade=False, zorder=11)


def path_of(contact: Contact) -> Path:
    """Where the picture of a contact is kept."""
    return FOLDER / f"contact_{contact.value.replace('-', '')}.png"


def main() -> None:
    matplotlib.use("agg")
    for contact in CONTACTS:
        draw_contact(contact).savefig(path_of(contact), dpi=110)
    pictures = [imread(path_of(contact)) for contact in CONTACTS]
    imsave(FOLDER / "contacts.png", np.vstack([np.hstack(pictures[:3]), np.hstack(pictures[3:])]))


if __name__ == "__main__":
    main()
