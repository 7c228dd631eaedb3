"""Bodies and touching elements in 3D, by matplotlib: the object's element is red, the surroundings' blue."""

from typing import Final

import numpy as np
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from mpl_toolkits.mplot3d.axes3d import Axes3D
from numpy.typing import NDArray

from contact_tracker.geometry.elements import Element, Line, Plane, Point
from contact_tracker.geometry.polyhedron import Polyhedron
from contact_tracker_lab.evaluation.geometry_errors import nearest

Array = NDArray[np.float64]

OBJECT: Final = "#d62728"
SURROUNDINGS: Final = "#1f77b4"
HALF_M: Final = 0.12
"""Half the length of a drawn edge, and of the side of a drawn face."""


def draw_body(axes: Axes3D, body: Polyhedron, colour: str, alpha: float) -> None:
    """Its faces, transparent, and its edges."""
    faces = [feature.points for feature in body.of_kind("f")]
    axes.add_collection3d(Poly3DCollection(faces, facecolor=colour, edgecolor=(0, 0, 0, 0.35), alpha=alpha))


def draw_element(
    axes: Axes3D, element: Element, near: Array, colour: str, style: str = "-", half_m: float = HALF_M
) -> None:
    """A square of a face with its normal, a piece of an edge, or a vertex, at the point nearest ``near``."""
    middle = nearest(element, near)
    match element:
        case Plane(normal):
            across = np.linalg.svd(normal[None])[2][1:] * half_m
            corners = [
                middle + a * across[0] + b * across[1] for a, b in ((1, 1), (1, -1), (-1, -1), (-1, 1))
            ]
            axes.add_collection3d(Poly3DCollection([corners], facecolor=colour, alpha=0.25, edgecolor=colour))
            tip = middle + normal * half_m
            axes.plot(*np.transpose([middle, tip]), color=colour, linestyle=style, linewidth=2)
            axes.scatter(*tip, color=colour, marker="^", s=25, depthshade=False)
        case Line(direction):
            ends = np.transpose([middle - direction * half_m, middle + direction * half_m])
            axes.plot(*ends, color=colour, linestyle=style, linewidth=3)
        case Point():
            axes.scatter(*middle, color=colour, s=60, depthshade=False)


def show_scene(axes: Axes3D, middle: Array, half_m: float, elevation_deg: float, azimuth_deg: float) -> None:
    """Look at a cube about ``middle``, without axes."""
    axes.set_axis_off()
    for limit, centre in zip((axes.set_xlim, axes.set_ylim, axes.set_zlim), middle, strict=True):
        limit(centre - half_m, centre + half_m)
    axes.set_box_aspect((1, 1, 1), zoom=1.3)
    axes.view_init(elevation_deg, azimuth_deg)
