"""The convex hull of a mesh file, STL or OBJ.

Triangles are not read by a library, as these take hours for some files, such as an STL of 20,000 solids.
"""

import re
from collections.abc import Callable, Iterable
from itertools import chain
from pathlib import Path
from typing import Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from contact_tracker.config.keys import SIZES_M
from contact_tracker.errors import KeyFault
from contact_tracker.files import read_regular
from contact_tracker.geometry.elements import Array
from contact_tracker.geometry.polyhedron import Polyhedron, TooManyFaces, convex

Ints = NDArray[np.int64]
Number = TypeVar("Number", np.int64, np.float64)

_HEADER: Final = 80
_RECORD: Final = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_NUMBERS: Final = rb"[ \t]+(\S+)[ \t]+(\S+)[ \t]+(\S+)"
_CORNER: Final = re.compile(rb"\bvertex" + _NUMBERS, re.IGNORECASE)
_VERTEX: Final = re.compile(rb"^[ \t]*v" + _NUMBERS, re.MULTILINE)
_VERTEX_LINE: Final = re.compile(rb"^[ \t]*v[ \t]", re.MULTILINE)
_FACE: Final = re.compile(rb"^[ \t]*f[ \t]([^\r\n#]*)", re.MULTILINE)
MOST_TRIANGLES: Final = 400_000


def triangles_of_stl(content: bytes) -> Array:
    """Corners (n, 3, 3) of the triangles of an STL file, binary or text, in its units.

    Raises
    ------
    ValueError : the file is invalid.
    """
    begin = _HEADER + 4
    count = int.from_bytes(content[_HEADER:begin], "little")
    whole = len(content) >= begin and len(content) - begin == count * _RECORD.itemsize
    if not whole and content.lstrip()[:5].lower() == b"solid":
        points = _points(_CORNER.findall(content))
        if len(points) % 3:
            raise ValueError("a triangle without three corners")
        return points.reshape(-1, 3, 3)
    if not whole:
        raise ValueError("its size is not that of its triangles")
    return np.asarray(np.frombuffer(content, _RECORD, count, begin)["corners"], float)


def triangles_of_obj(content: bytes) -> Array:
    """Corners (n, 3, 3) of the faces of an OBJ file, cut into triangles, in its units.

    Raises
    ------
    ValueError : the file is invalid.
    """
    content = content.replace(b"\\\r\n", b" ").replace(b"\\\n", b" ")  # a backslash continues the line
    points = _points(_VERTEX.findall(content))
    before = [found.start() for found in _VERTEX_LINE.finditer(content)]
    faces = _FACE.findall(content)
    corners = re.sub(rb"/\S*", b"", b" ".join(faces)).split()  # without indices of textures and normals
    if len(before) != len(points):
        raise ValueError("a vertex without three numbers")
    if len(corners) > 3 * MOST_TRIANGLES:
        raise ValueError(f"more than {MOST_TRIANGLES} triangles")
    sizes = np.fromiter(map(len, map(bytes.split, faces)), np.int64, len(faces))
    numbers = _coordinates(int, np.int64, corners, len(corners))
    if (numbers < 0).any():  # counted backward from the last vertex before the face
        starts = [found.start() for found in _FACE.finditer(content)]
        numbers += np.where(numbers < 0, np.repeat(np.searchsorted(before, starts), sizes) + 1, 0)
    if not ((numbers > 0) & (numbers <= len(points))).all():
        raise ValueError("a face with a vertex that is not there")
    return points[numbers[_fans(sizes)] - 1]


def _fans(sizes: Ints) -> Ints:
    """Corner indices (n, 3) of triangles that split consecutive faces with ``sizes`` corners."""
    triangles = np.maximum(sizes - 2, 0)
    first = np.repeat(np.cumsum(sizes) - sizes, triangles)
    number = np.arange(triangles.sum()) - np.repeat(np.cumsum(triangles) - triangles, triangles)
    return np.stack([first, first + number + 1, first + number + 2], axis=1)


def _points(found: list[tuple[bytes, bytes, bytes]]) -> Array:
    """Points (n, 3) as written."""
    if len(found) > 3 * MOST_TRIANGLES:
        raise ValueError(f"more than {MOST_TRIANGLES} triangles")
    return _coordinates(float, np.float64, chain.from_iterable(found), 3 * len(found)).reshape(-1, 3)


def _coordinates(
    parse: Callable[[bytes], float], kind: type[Number], words: Iterable[bytes], count: int
) -> NDArray[Number]:
    try:
        return np.fromiter(map(parse, words), kind, count)
    except (ValueError, OverflowError) as error:  # whose messages quote the whole word
        raise ValueError("something else than a number") from error


READERS: Final = {".stl": triangles_of_stl, ".obj": triangles_of_obj}
MOST_MESH_BYTES: Final = 20_000_000
"""Largest file (bytes): 400,000 triangles of a binary STL."""
COPLANAR: Final = 1e-4
"""Tolerance of coplanarity relative to the mesh's extent, for rounding and tessellation."""
HOLLOW: Final = 1e-3
"""Largest depth of a convex mesh below its hull, relative to its extent."""
MOST_FACES: Final = 60
_FARTHEST: Final = 1e30
"""Largest coordinate, whose square is finite."""


def read_mesh(path: Path, unit_m: float, wrong: Callable[[str, str], KeyFault]) -> tuple[Polyhedron, bool]:
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


def _triangles(path: Path, wrong: Callable[[str, str], KeyFault]) -> Array:
    """Corners (n, 3, 3) of the triangles, in the units of the file."""
    read = READERS.get(path.suffix.lower())
    if read is None:
        raise wrong("path", f"{path} is neither {' nor '.join(READERS)}")
    try:
        triangles = read(read_regular(path, MOST_MESH_BYTES))
    except OSError as error:
        raise wrong("path", f"cannot read {path}: {error.strerror or error}") from error
    except ValueError as error:  # also for a name with a zero byte
        raise wrong("path", f"{path} is no mesh: {error}") from error
    if not len(triangles) or not (np.abs(triangles) < _FARTHEST).all():
        raise wrong("path", f"{path} has no triangles, or endless ones")
    return triangles
