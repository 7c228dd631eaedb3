"""Corners of the triangles of a mesh file, STL or OBJ.

Not read by a library, as these take hours for some files, such as an STL of 20,000 solids.
"""

import re
from collections.abc import Callable, Iterable
from itertools import chain
from typing import Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from contact_tracker.geometry.elements import Array

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
    numbers = _numbers(int, np.int64, corners, len(corners))
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
    return _numbers(float, np.float64, chain.from_iterable(found), 3 * len(found)).reshape(-1, 3)


def _numbers(
    parse: Callable[[bytes], float], kind: type[Number], words: Iterable[bytes], count: int
) -> NDArray[Number]:
    try:
        return np.fromiter(map(parse, words), kind, count)
    except (ValueError, OverflowError) as error:  # whose messages quote the whole word
        raise ValueError("something else than a number") from error
