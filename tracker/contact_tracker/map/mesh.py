"""The convex hull of a mesh file (STL, OBJ)."""

from collections.abc import Callable
from pathlib import Path
from typing import Final

import numpy as np

from contact_tracker.errors import KnowledgeError
from contact_tracker.files import read_regular
from contact_tracker.geometry.elements import Array
from contact_tracker.geometry.polyhedron import Polyhedron, TooManyFaces, convex
from contact_tracker.map.keys import SIZES_M
from contact_tracker.map.triangles import triangles_of_obj, triangles_of_stl

READERS: Final = {".stl": triangles_of_stl, ".obj": triangles_of_obj}
MOST_BYTES: Final = 20_000_000
"""Largest file (bytes): 400,000 triangles of a binary STL."""
COPLANAR: Final = 1e-4
"""Tolerance of coplanarity relative to the mesh's extent, for rounding and tessellation."""
HOLLOW: Final = 1e-3
"""Largest depth of a convex mesh below its hull, relative to its extent."""
MOST_FACES: Final = 60
_FARTHEST: Final = 1e30
"""Largest coordinate, whose square is finite."""


def read_mesh(
    path: Path, unit_m: float, wrong: Callable[[str, str], KnowledgeError]
) -> tuple[Polyhedron, bool]:
    """The hull of the mesh in ``path`` in metres, and whether the mesh is convex.

    ``wrong`` (key, reason) makes the error for an unusable mesh.
    """
    triangles = unit_m * _triangles(path, wrong)
    corners = triangles.reshape(-1, 3)
    extent_m = float(np.ptp(corners, axis=0).max())
    if not SIZES_M[0] <= extent_m <= SIZES_M[1]:
        raise wrong("unit_m", f"makes {path} {extent_m:.3g} m large; is it in other units?")
    try:
        body = convex(corners, COPLANAR * extent_m, MOST_FACES)
    except TooManyFaces as error:
        reason = "round bodies touch otherwise, coarser ones can be simplified"
        raise wrong("path", f"{path} has more than {MOST_FACES} faces: {reason}") from error
    except ValueError as error:
        raise wrong("path", f"{path}: {error}") from error
    return body, bool(body.depth_m(triangles.mean(axis=1)).max() <= HOLLOW * extent_m)


def _triangles(path: Path, wrong: Callable[[str, str], KnowledgeError]) -> Array:
    """Corners (n, 3, 3) of the triangles, in the units of the file."""
    read = READERS.get(path.suffix.lower())
    if read is None:
        raise wrong("path", f"{path} is neither {' nor '.join(READERS)}")
    try:
        triangles = read(read_regular(path, MOST_BYTES))
    except OSError as error:
        raise wrong("path", f"cannot read {path}: {error.strerror or error}") from error
    except ValueError as error:  # also for a name with a zero byte
        raise wrong("path", f"{path} is no mesh: {error}") from error
    if not len(triangles) or not (np.abs(triangles) < _FARTHEST).all():
        raise wrong("path", f"{path} has no triangles, or endless ones")
    return triangles
