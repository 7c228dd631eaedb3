"""The convex hull of a mesh file (STL, OBJ), read with trimesh, an optional dependency."""

from collections.abc import Callable
from pathlib import Path
from typing import Final

import numpy as np

from contact_tracker.errors import KnowledgeError
from contact_tracker.geometry.elements import Array
from contact_tracker.geometry.polyhedron import Polyhedron, convex
from contact_tracker.prior_map_files.keys import SIZES_M

SUFFIXES: Final = (".stl", ".obj")
COPLANAR: Final = 1e-4
"""What leaves a face by less than this share of the mesh's extent is rounding, or tessellation."""
HOLLOW: Final = 1e-3
"""A mesh that lies deeper below its hull than this share of its extent is not convex."""
MOST_FACES: Final = 60


def read_mesh(
    path: Path, unit_m: float, wrong: Callable[[str, str], KnowledgeError]
) -> tuple[Polyhedron, bool]:
    """The hull of the mesh in ``path`` in metres, and whether the mesh is convex.

    ``wrong`` (key, reason) makes the error for what cannot be used.
    """
    corners, centres = (unit_m * points for points in _points(path, wrong))
    extent_m = float(np.ptp(corners, axis=0).max())
    if not SIZES_M[0] <= extent_m <= SIZES_M[1]:
        raise wrong("unit_m", f"makes {path} {extent_m:.3g} m large; is it in other units?")
    try:
        body = convex(corners, COPLANAR * extent_m)
    except ValueError as error:
        raise wrong("path", f"{path}: {error}") from error
    faces = len(body.of_kind("f"))
    if faces > MOST_FACES:
        reason = f"has {faces} faces, {MOST_FACES} are allowed: round bodies touch otherwise"
        raise wrong("path", f"{path} {reason}, coarser ones can be simplified")
    return body, bool(body.depth_m(centres).max() <= HOLLOW * extent_m)


def _points(path: Path, wrong: Callable[[str, str], KnowledgeError]) -> tuple[Array, Array]:
    """Corners and middles of the triangles, in the units of the file."""
    if path.suffix.lower() not in SUFFIXES:
        raise wrong("path", f"{path} is neither {' nor '.join(SUFFIXES)}")
    try:
        import trimesh
    except ImportError as error:
        raise wrong("path", "meshes need trimesh: pip install 'contact-tracker[mesh]'") from error
    try:
        with path.open("rb") as file:
            mesh = trimesh.load_mesh(file, file_type=path.suffix[1:].lower())
        triangles = np.asarray(mesh.triangles, float).reshape(-1, 3, 3)
    except OSError as error:
        raise wrong("path", f"cannot read {path}: {error.strerror or error}") from error
    except Exception as error:  # whatever a parser makes of a file that is no mesh
        raise wrong("path", f"{path} is no mesh: {type(error).__name__}") from error
    if not len(triangles) or not np.isfinite(triangles).all():
        raise wrong("path", f"{path} has no triangles, or endless ones")
    return np.unique(triangles.reshape(-1, 3), axis=0), triangles.mean(axis=1)
