"""Maps in TOML files (docs/map.md) and tables of the same keys: loading with validation, of meshes in STL and
OBJ, too, and writing of what was learned."""

import math
import re
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from itertools import chain, product
from pathlib import Path
from typing import Any, Final, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from contact_tracker.arrays import Ints
from contact_tracker.config.keys import FARTHEST_M, SIZES_M, Keys, read_toml
from contact_tracker.contacts import CONTACT_MODELS
from contact_tracker.errors import KeyFault, KnowledgeError
from contact_tracker.files import read_regular, whole_file
from contact_tracker.geometry.elements import Array, Element, Line, Plane, Point
from contact_tracker.geometry.polyhedron import Polyhedron, TooManyFaces, convex
from contact_tracker.map.elements import (
    ANYWHERE_M,
    KINDS,
    MOST_CORNERS,
    NOTHING_LEARNED,
    PARALLEL,
    Key,
    LearnedElements,
    MapElement,
)
from contact_tracker.map.map import (
    Accuracy,
    Map,
    NamedElement,
    Up,
    axis_name,
    elements_of,
    known_to,
    mark_covered,
    number_name,
)
from contact_tracker.map.pairs import named_pairs
from contact_tracker.map.world_map import MOST_LEARNED
from contact_tracker.version import __version__

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
    is_whole = len(content) >= begin and len(content) - begin == count * _RECORD.itemsize
    if not is_whole and content.lstrip()[:5].lower() == b"solid":
        points = _points(_CORNER.findall(content))
        if len(points) % 3:
            raise ValueError("a triangle without three corners")
        return points.reshape(-1, 3, 3)
    if not is_whole:
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
    before = [match.start() for match in _VERTEX_LINE.finditer(content)]
    faces = _FACE.findall(content)
    corners = re.sub(rb"/\S*", b"", b" ".join(faces)).split()  # without indices of textures and normals
    if len(before) != len(points):
        raise ValueError("a vertex without three numbers")
    if len(corners) > 3 * MOST_TRIANGLES:
        raise ValueError(f"more than {MOST_TRIANGLES} triangles")
    sizes = np.fromiter(map(len, map(bytes.split, faces)), np.int64, len(faces))
    numbers = _coordinates(int, np.int64, corners, len(corners))
    if (numbers < 0).any():  # counted backward from the last vertex before the face
        starts = [match.start() for match in _FACE.finditer(content)]
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


def _points(texts: list[tuple[bytes, bytes, bytes]]) -> Array:
    """Points (n, 3) as written."""
    if len(texts) > 3 * MOST_TRIANGLES:
        raise ValueError(f"more than {MOST_TRIANGLES} triangles")
    return _coordinates(float, np.float64, chain.from_iterable(texts), 3 * len(texts)).reshape(-1, 3)


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

    Triangles are not read by a library, as these take hours for some files, such as an STL of 20,000 solids.
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


Note = Callable[[str], None]
MOST_ELEMENTS: Final = 200
"""Most elements of the object, and of its surroundings."""
MOST_PAIRS: Final = 3000
"""Most pairs of an element of the object and one of its surroundings, over all contacts. Each is compared in
every tick: these take up to 0.3 GB of memory, and up to twice as long as the recording lasts."""
MOST_PAIRS_OF_CONTACT: Final = 1100
"""Most of them that one contact may assume: many lines take the most time, since any two nearly cross."""


def read_map(path: str, note: Note = lambda _: None) -> Map:
    """Read a TOML file; ``note`` is called with one line for each warning.

    Raises
    ------
    KnowledgeError : names the key and the reason.
    """
    return map_from(read_table(path), Path(path).parent, note)


def read_table(path: str) -> dict[str, Any]:
    """The keys of a TOML file, not validated."""
    return read_toml(Path(path), KnowledgeError, path, f"cannot read {path}")


def files_named(path: str) -> list[Path]:
    """A map file and the meshes that it names.

    Raises
    ------
    KnowledgeError : the file cannot be read.
    """
    tables = [table for table in read_table(path).values() if isinstance(table, dict)]
    meshes = [table["mesh"] for table in tables if "mesh" in table]
    rows = [row for mesh in meshes for row in (mesh if isinstance(mesh, list) else [mesh])]
    names = [row.get("path") for row in rows if isinstance(row, dict)]
    return [Path(path), *(Path(path).parent / name for name in names if isinstance(name, str))]


def map_from(table: Mapping[str, Any], folder: Path = Path(), note: Note = lambda _: None) -> Map:
    """A map from the keys of a file; paths of meshes are relative to ``folder``."""
    keys = Keys(dict(table))
    up_keys, object_keys, environment_keys = map(keys.table, ("up", "object", "environment"))
    up = _up(up_keys) if "up" in keys else None
    learned = learned_from(keys.table("learned"))
    keys.finish()
    object, object_complete = _elements(object_keys, folder, note)
    environment, environment_complete = _elements(environment_keys, folder, note, solid_is_all=False)
    environment = mark_covered(environment)
    listed_map = Map(
        listed_environment=environment,
        listed_object=object,
        up=up,
        environment_complete=environment_complete,
        object_complete=object_complete,
        learned=learned,
    )
    pairs = {model.contact.value: len(named_pairs(listed_map, model)) for model in CONTACT_MODELS}
    for what, count, limit in (
        *((f" for {contact}", count, MOST_PAIRS_OF_CONTACT) for contact, count in pairs.items()),
        ("", sum(pairs.values()), MOST_PAIRS),
    ):
        if count > limit:
            advice = "list those that may touch"
            raise KnowledgeError(
                "", f"{count} pairs of elements{what} are too many; {limit} are allowed: {advice}"
            )
    return listed_map


def _up(keys: Keys) -> Up:
    direction = keys.direction("direction")
    spread = math.radians(keys.number("spread_deg", 2.0, 0.01, 60.0))
    keys.finish()
    return Up(direction, spread)


def _elements(
    keys: Keys, folder: Path, note: Note, solid_is_all: bool = True
) -> tuple[tuple[NamedElement, ...], bool]:
    """The elements of one frame, and whether they are complete."""
    found, complete, solids = list[NamedElement](), False, 0
    for kind in ("plane", "line", "point", "box", "mesh"):
        for number, row in enumerate(keys.tables(kind), start=1):
            if kind in ("box", "mesh"):
                elements, complete = _solid(row, kind, solids, folder, note)
                found, solids = [*found, *elements], solids + 1
            else:
                found.append(_listed(row, kind, number))
            if len(found) > MOST_ELEMENTS:
                raise keys.wrong(kind, f"{len(found)} elements are too many; {MOST_ELEMENTS} are allowed")
    complete = keys.flag("complete", complete and solids == 1 and solid_is_all)
    if complete and not found:
        raise keys.wrong("complete", "true, but nothing is listed: it could touch nothing")
    keys.finish()
    for name, count in Counter(element.name for element in found).items():
        if count > 1:
            raise keys.wrong("name", f"{name!r} is there twice")
    return tuple(found), complete


def _listed(keys: Keys, kind: str, number: int) -> NamedElement:
    """A plane, line or point that is listed by itself."""
    name, accuracy = keys.text("name", f"{kind} {number}"), _accuracy(keys)
    element: Element
    place: Array | None = None
    if kind == "plane":
        normal = keys.direction("normal")
        if ("offset_m" in keys) == ("point_m" in keys):
            raise keys.wrong("offset_m", "give either this or point_m")
        if "point_m" in keys:
            place = keys.vector("point_m")
            element = Plane(normal, float(normal @ place))
        else:
            element = Plane(normal, keys.number("offset_m", None, -FARTHEST_M, FARTHEST_M))
    elif kind == "line":
        element = Line(keys.direction("direction"), keys.vector("point_m"))
    else:
        element = Point(keys.vector("point_m"))
    keys.finish()
    return NamedElement(name, known_to(element, accuracy, place))


def _solid(
    keys: Keys, kind: str, solid: int, folder: Path, note: Note
) -> tuple[tuple[NamedElement, ...], bool]:
    """The elements of a box, or of a mesh's hull, and whether the body is convex."""
    name, accuracy, is_convex = keys.text("name", ""), _accuracy(keys), True
    if kind == "box":
        body = convex(0.5 * keys.lengths("size_m") * np.array(list(product((-1.0, 1.0), repeat=3))))
    else:
        path, unit_m = folder / keys.text("path", None), keys.number("unit_m", 1.0, 1e-6, 1e3)
    quat = keys.direction("quat_xyzw", 4, [0.0, 0.0, 0.0, 1.0])
    rotation, position_m = Rotation.from_quat(quat).as_matrix(), keys.vector("position_m", 3, [0.0] * 3)
    keys.finish()
    if kind == "mesh":
        body, is_convex = read_mesh(path, unit_m, keys.wrong)
    if not is_convex:
        note(f"{path} is not convex: its hull's elements are known, and others are looked for as well")
    named, prefix = axis_name if kind == "box" else number_name, f"{name} " if name else ""
    return elements_of(body, named, accuracy, rotation, position_m, prefix, solid, not is_convex), is_convex


def _accuracy(keys: Keys) -> Accuracy:
    usual = Accuracy()
    position_m = keys.number("sigma_position_m", usual.position_m, 1e-6, 1.0)
    rotation_deg = keys.number("sigma_rotation_deg", math.degrees(usual.rotation_rad), 1e-4, 60.0)
    return Accuracy(position_m, math.radians(rotation_deg))


def merged(tables: Iterable[Mapping[str, Any]]) -> dict[str, Any]:
    """Tables merged into one: arrays are concatenated, tables merged; contradictions are rejected."""
    result: dict[str, Any] = {}
    for table in tables:
        for key, value in table.items():
            if key not in result:
                result[key] = value
            elif isinstance(value, dict) and isinstance(result[key], dict):
                result[key] = merged((result[key], value))
            elif isinstance(value, list) and isinstance(result[key], dict | list):
                values = result[key] if isinstance(result[key], list) else [result[key]]
                result[key] = [*values, *value]
            else:
                raise KnowledgeError(key, "given twice, in the file and on the command line")
    return result


SIDES: Final = ("object", "environment")
_ROUNDING: Final = 1e-6
"""Largest share of an information matrix that rounding in a file makes asymmetric or negative."""


def learned_text(learned: LearnedElements) -> str:
    """The map as TOML, which ``learned_from`` reads."""
    lines = [
        f"# Learned by contact-tracker {__version__}: what contacts touched, for --known.",
        "# Lengths are in m. The information matrix is that of all elements together: do not edit it.",
        "[learned]",
        f"information = {_numbers(learned.information)}",
    ]
    variance = learned.covariance().diagonal()
    for (side, number), element in learned.elements.items():
        variances = variance[learned.slots[side, number]]
        lengths = variances if element.kind == "v" else variances[2:]
        lines += [
            "",
            "[[learned.element]]",
            f'name = "{SIDES[side]} {KINDS[element.kind]} {number}"',
            f'side = "{SIDES[side]}"',
            f'kind = "{KINDS[element.kind]}"',
            f"touched = {learned.counts[side, number]}",
        ]
        if element.kind != "v":
            deg = math.degrees(math.sqrt(max(float(variances[:2].max()), 0.0)))
            lines.append(f"direction = {_numbers(element.direction)}  # to {deg:.2g} deg")
        name = "offset_m" if element.kind == "f" else "point_m"
        place = element.place_m[0] if element.kind == "f" else element.place_m
        mm = 1e3 * math.sqrt(max(float(lengths.max()), 0.0))
        lines.append(f"{name} = {_numbers(place)}  # to {mm:.2g} mm")
        if (side, number) in learned.extents:
            lines.append(f"touched_m = {_numbers(learned.extents[side, number])}")
        if (side, number) in learned.outward:
            lines.append(f"outward = {_numbers(learned.outward[side, number])}  # the normal out of the body")
    return "\n".join(lines) + "\n"


def write_learned(path: Path, learned: LearnedElements) -> None:
    """Write a map to a file, atomically; raises OSError."""
    with whole_file(path) as temporary:
        temporary.write_text(learned_text(learned), encoding="utf-8")


def learned_from(keys: Keys) -> LearnedElements:
    """The map of the table ``learned`` of a file; raises KnowledgeError."""
    rows, elements, counts = keys.tables("element"), dict[Key, MapElement](), dict[Key, int]()
    extents, outward = dict[Key, Array](), dict[Key, Array]()
    if len(rows) > MOST_LEARNED:
        raise keys.wrong("element", f"{len(rows)} elements are too many; {MOST_LEARNED} are allowed")
    for number, row in enumerate(rows, start=1):
        side, kind = _one_of(row, "side", SIDES), _one_of(row, "kind", tuple(KINDS.values()))
        row.text("name", "")
        key, short = (SIDES.index(side), number), next(k for k, name in KINDS.items() if name == kind)
        counts[key] = round(row.number("touched", None, 1, 1e6))
        direction = np.zeros(3) if short == "v" else row.direction("direction")
        if short == "f":
            place_m = np.array([row.number("offset_m", None, -FARTHEST_M, FARTHEST_M)])
        else:
            place_m = row.vector("point_m")
        if short != "v" and "touched_m" in row:
            extents[key] = row.matrix("touched_m", 3, range(1, MOST_CORNERS + 1), FARTHEST_M)
        if short == "f" and "outward" in row:
            outward[key] = row.direction("outward")
            if abs(outward[key] @ direction) < PARALLEL:
                raise row.wrong("outward", "must be the direction or its opposite")
        row.finish()
        elements[key] = MapElement(short, direction, place_m)
    size = sum(element.size for element in elements.values())
    information = keys.matrix("information", size, range(size, size + 1)) if rows else np.zeros((0, 0))
    keys.finish()
    if not rows:
        return NOTHING_LEARNED
    return _sound(LearnedElements(elements, counts, information, extents, outward))


def _one_of(keys: Keys, key: str, choices: tuple[str, ...]) -> str:
    value = keys.text(key, None)
    if value not in choices:
        raise keys.wrong(key, f"must be {' or '.join(choices)}")
    return value


def _sound(learned: LearnedElements) -> LearnedElements:
    """The map with a symmetric matrix; raises KnowledgeError if it is not the information of a Gaussian."""
    sd = np.sqrt(learned.weak(ANYWHERE_M))
    scaled = sd[:, None] * learned.information * sd
    largest = float(np.abs(scaled).max())
    values, axes = np.linalg.eigh(0.5 * (scaled + scaled.T))
    is_even = np.abs(scaled - scaled.T).max() <= _ROUNDING * largest
    if not (is_even and values[0] >= -_ROUNDING * max(largest, 1.0)):
        raise KnowledgeError("learned.information", "is not symmetric with positive eigenvalues")
    return replace(learned, information=(axes * np.maximum(values, 0.0)) @ axes.T / (sd[:, None] * sd))


def _numbers(values: Array | float) -> str:
    return str(np.asarray(values, float).tolist())
