"""Prior-map files: complete, or refused with key and reason; bodies are split into elements."""

import math
import re
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from contact_tracker import Trajectory, segment
from contact_tracker.errors import KnowledgeError, UsageError
from contact_tracker.geometry.elements import Line, Plane, Point
from contact_tracker.map.file import map_from, read_map
from smooth_motion import slid_and_tilted

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "map.md").read_text(encoding="utf-8")
ALL = """
[up]
direction = [0, 0, 1]
spread_deg = 3

[[environment.plane]]
name = "table"
normal = [0, 0, 1]
offset_m = 0.7
sigma_position_m = 0.002
sigma_rotation_deg = 0.5

[[environment.plane]]
normal = [1, 0, 0]
point_m = [1, 2, 3]

[[environment.line]]
direction = [0, 1, 0]
point_m = [0.4, 0, 0.7]

[[environment.point]]
name = "pin"
point_m = [0, 0, 1]

[object.box]
size_m = [0.1, 0.2, 0.3]
"""
CORNERS = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n"
EXTENT_M = np.array([0.1, 0.2, 0.3])


def loaded(tmp_path, text, note=lambda _: None):
    path = tmp_path / "known.toml"
    path.write_text(text, encoding="utf-8")
    return read_map(str(path), note)


def refused(tmp_path, text):
    """The error that a file with this text raises."""
    with pytest.raises(KnowledgeError) as caught:
        loaded(tmp_path, text)
    assert isinstance(caught.value, UsageError)
    assert "\n" not in str(caught.value)
    assert caught.value.key in str(caught.value)
    return caught.value


def by_name(elements):
    return {known.name: known.element for known in elements}


def test_a_file_defines_a_map(tmp_path):
    known = loaded(tmp_path, ALL)
    assert known.up.direction.tolist() == [0, 0, 1]
    assert known.up.spread_rad == pytest.approx(math.radians(3))
    environment = by_name(known.listed_environment)
    assert list(environment) == ["table", "plane 2", "line 1", "pin"]
    assert environment["table"].offset_m == 0.7
    assert environment["plane 2"].offset_m == 1.0
    assert isinstance(environment["line 1"], Line)
    assert environment["pin"].point_m.tolist() == [0, 0, 1]
    assert len(known.listed_object) == 6 + 12 + 8
    assert known.object_complete
    assert not known.environment_complete
    assert not loaded(tmp_path, "")
    world = loaded(tmp_path, "[environment.box]\nsize_m = [1, 1, 1]\n[[object.point]]\npoint_m = [0, 0, 0]")
    assert not world.environment_complete
    assert not world.object_complete
    told = "[environment]\ncomplete = true\n[[environment.point]]\npoint_m = [0, 0, 0]\n"
    known = loaded(tmp_path, f"{told}[object]\ncomplete = false\n[object.box]\nsize_m = [1, 1, 1]")
    assert known.environment_complete
    assert not known.object_complete
    assert loaded(tmp_path, "[up]\ndirection = [0, 0, 1]").lists_elements


def test_the_file_of_the_documentation_is_read(tmp_path):
    """It has all keys except those of other kinds of elements."""
    trimesh.creation.box((80, 60, 40)).export(tmp_path / "part.stl")
    (text,) = re.findall(r"^```toml\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)
    known = loaded(tmp_path, text)
    assert known.up is not None
    assert len(known.listed_object) == 26
    assert {k.name for k in known.listed_environment} >= {"table", "line 1", "point 1", "block face +x"}
    assert (known.object_complete, known.environment_complete) == (True, False)


def test_elements_of_a_box_lie_where_their_names_say(tmp_path):
    quat, shift = [0.5, 0.5, 0.5, 0.5], np.array([1.0, 2.0, 3.0])
    text = f"[object.box]\nsize_m = {EXTENT_M.tolist()}\nquat_xyzw = {quat}\nposition_m = {shift.tolist()}"
    elements = by_name(loaded(tmp_path, text).listed_object)
    turn = Rotation.from_quat(quat)
    for name, element in elements.items():
        kind, *faces = name.split()
        assert len(faces) == {"face": 1, "edge": 2, "vertex": 3}[kind]
        outward = np.zeros(3)
        for face in faces:
            outward["xyz".index(face[1])] = 1.0 if face[0] == "+" else -1.0
        middle = turn.apply(outward * EXTENT_M / 2) + shift
        match element:
            case Plane(normal, offset_m):
                np.testing.assert_allclose(normal, turn.apply(outward), atol=1e-12)
                assert offset_m == pytest.approx(normal @ middle)
            case Line(direction, point_m):
                np.testing.assert_allclose(np.abs(turn.inv().apply(direction)), outward == 0, atol=1e-12)
                np.testing.assert_allclose(point_m, middle, atol=1e-12)
            case Point(point_m):
                np.testing.assert_allclose(point_m, middle, atol=1e-12)


def test_the_accuracy_of_a_plane_is_that_at_its_point(tmp_path):
    accuracy = "sigma_position_m = 0.001\nsigma_rotation_deg = 1.0"
    place, normal = np.array([1.0, -2.0, 0.5]), np.array([0.6, 0.0, 0.8])
    text = f"[[object.plane]]\nnormal = {normal.tolist()}\npoint_m = {place.tolist()}\n{accuracy}"
    (known,) = loaded(tmp_path, text).listed_object
    plane = known.element
    rng = np.random.default_rng(0)
    for point, sigma_m in (
        (place, 1e-3),
        (place + np.array([0, 0.3, 0]), math.hypot(1e-3, 0.3 * math.radians(1.0))),
    ):
        height = np.append(point, -1.0)  # of the point over the plane, by (normal, offset)
        assert math.sqrt(height @ plane.covariance @ height) == pytest.approx(sigma_m, rel=1e-6)
    drawn = rng.multivariate_normal(np.zeros(4), plane.covariance, 1000)
    assert np.abs(drawn[:, :3] @ normal).max() < 1e-6


def numbers(known):
    """Parameters of planes and points, in an order independent of names."""
    planes = [[*k.element.normal, k.element.offset_m] for k in known if isinstance(k.element, Plane)]
    points = [k.element.point_m.tolist() for k in known if not isinstance(k.element, Plane)]
    return [np.array(sorted((np.round(rows, 6) + 0.0).tolist())) for rows in (planes, points)]


@pytest.mark.parametrize("suffix", ["stl", "obj", "STL"])
def test_a_mesh_of_a_box_is_the_box(tmp_path, suffix):
    """For any triangulation, and in the units of the file."""
    mesh = trimesh.creation.box(1e3 * EXTENT_M).subdivide().subdivide()
    mesh.export(tmp_path / f"box.{suffix}", file_type=suffix.lower())
    notes = []
    from_mesh = loaded(tmp_path, f'[object.mesh]\npath = "box.{suffix}"\nunit_m = 0.001', notes.append)
    from_box = loaded(tmp_path, f"[object.box]\nsize_m = {EXTENT_M.tolist()}")
    assert from_mesh.object_complete
    assert not notes
    for ours, theirs in zip(numbers(from_mesh.listed_object), numbers(from_box.listed_object), strict=True):
        np.testing.assert_allclose(ours, theirs, atol=2e-6)


def test_edges_and_vertices_of_a_mesh_are_called_after_their_faces(tmp_path):
    trimesh.creation.cone(0.05, 0.1, sections=8).export(tmp_path / "cone.stl")
    elements = by_name(loaded(tmp_path, '[object.mesh]\npath = "cone.stl"').listed_object)
    assert len(elements) == 9 + 16 + 9
    for name, element in elements.items():
        kind, *faces = name.split()
        for plane in (elements[f"face {face}"] for face in faces if kind != "face"):
            assert plane.normal @ element.point_m == pytest.approx(plane.offset_m, abs=1e-6)


def test_a_nonconvex_mesh_is_reported_and_not_complete(tmp_path):
    neck, head = trimesh.creation.box((1, 0.2, 0.2)), trimesh.creation.box((0.2, 1, 1))
    head.apply_translation((0.6, 0, 0))
    trimesh.util.concatenate([neck, head]).export(tmp_path / "hammer.stl")
    notes = []
    known = loaded(tmp_path, '[object.mesh]\npath = "hammer.stl"', notes.append)
    assert not known.object_complete
    (note,) = notes
    assert "hammer.stl" in note
    assert "not convex" in note


@pytest.mark.parametrize(
    ("content", "name", "key", "reason"),
    [
        (b"solid nothing\nendsolid nothing\n", "nothing.stl", "path", "nothing.stl"),
        (b"\xff" * 500, "noise.stl", "path", "noise.stl"),
        (b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "flat.obj", "path", "no solid"),
        (b"v a b c\nf 1 2 3\n", "words.obj", "path", "words.obj"),
        (b"f 1 2 3\n", "corners.obj", "path", "not there"),
        (CORNERS + b"f 1 2 -5\n", "before.obj", "path", "not there"),
        (CORNERS + b"f 1 2 " + b"9" * 99 + b"\n", "huge.obj", "path", "number"),
        (CORNERS + b"f 1 2 " + b"x" * 9999 + b"\n", "text.obj", "path", "number"),
        (CORNERS + b"v 1 2\nf 1 2 3\n", "short.obj", "path", "three numbers"),
        (b"v 1e300 0 0\nv -1e300 0 0\nv 0 1e300 0\nf 1 2 3\n", "endless.obj", "path", "endless"),
        (b"solid x\nvertex 0 0 0\nvertex 0 0 1\n", "two.stl", "path", "three corners"),
        (b"\0" * 80 + b"\xff" * 4 + b"\0" * 500, "count.stl", "path", "size"),
        (b"", "mesh.step", "path", "neither"),
        (None, "gone.stl", "path", "gone.stl"),
        (trimesh.creation.icosphere(3, 0.1).export(file_type="stl"), "ball.stl", "path", "60 faces"),
        (trimesh.creation.box((100, 100, 1e5)).export(file_type="stl"), "mm.stl", "unit_m", "mm.stl"),
    ],
)
def test_an_invalid_mesh_is_refused_with_its_name(tmp_path, content, name, key, reason):
    if content is not None:
        (tmp_path / name).write_bytes(content)
    error = refused(tmp_path, f'[object.mesh]\npath = "{name}"')
    assert error.key == f"object.mesh.{key}"
    assert reason in error.reason


@pytest.mark.parametrize(
    ("text", "key", "reason"),
    [
        ("[upp]", "upp", "did you mean up?"),
        (
            "[[environment.plane]]\nnormal = [0, 0, 1]\nofset_m = 0",
            "environment.plane[1].offset_m",
            "is ofset_m meant for",
        ),
        ("up = 3", "up", "table"),
        ("[up]", "up.direction", "missing"),
        ("[up]\ndirection = [0, 0, 2]", "up.direction", "length 1"),
        ("[up]\ndirection = [0, 0, nan]", "up.direction", "numbers"),
        ("[up]\ndirection = [0, 0, 1]\nspread_deg = 0", "up.spread_deg", "between"),
        ("[environment]\nplane = [3]", "environment.plane[1]", "table"),
        ("[environment]\ncomplete = true", "environment.complete", "nothing"),
        ("[environment]\ncomplete = 1", "environment.complete", "true or false"),
        ("[[environment.plane]]\nnormal = [0, 0, 1]", "environment.plane[1].offset_m", "either"),
        ("[[environment.point]]\npoint_m = [0, 0, 1e9]", "environment.point[1].point_m", "beyond"),
        ("[[environment.point]]\npoint_m = [0, 0, 1]\nname = 7", "environment.point[1].name", "string"),
        ("[object.box]\nsize_m = [1, 1, 0]", "object.box.size_m", "between"),
        ("[object.mesh]\nunit_m = 1", "object.mesh.path", "missing"),
        ("[[object.point]]\nname = 'a'\npoint_m = [0, 0, 1]\n" * 2, "object.name", "twice"),
        ("[[object.point]]\npoint_m = [0, 0, 1]\n" * 201, "object", "too many"),
    ],
)
def test_impossible_values_are_refused_with_key_and_reason(tmp_path, text, key, reason):
    error = refused(tmp_path, text)
    assert key in error.key
    assert reason in error.reason


@pytest.mark.parametrize("name", ["no_such.toml", "", ".", "a\0b", "x" * 5000])
def test_files_that_cannot_be_read_are_refused(name):
    with pytest.raises(KnowledgeError, match=r"^what is known: "):
        read_map(name)


def outcome(read, *arguments):
    """The result of reading: none, or the one allowed error."""
    try:
        read(*arguments)
    except KnowledgeError as error:
        return error


VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=8,
)


@settings(max_examples=20, deadline=None)
@example("object", "plane", "normal", None, {"\n": None})
@given(
    frame=st.sampled_from(["object", "environment"]),
    kind=st.sampled_from(["plane", "line", "point", "box", "mesh", "complete"]),
    key=st.sampled_from(
        ["normal", "offset_m", "direction", "point_m", "size_m", "path", "name", "quat_xyzw"]
    ),
    value=VALUES,
    whole=VALUES,
)
def test_any_table_is_a_map_or_an_error(frame, kind, key, value, whole):
    for table in ({frame: {kind: {key: value}}}, {frame: {kind: whole}}, {frame: whole}, {"up": whole}):
        assert "\n" not in str(outcome(map_from, table, Path("nowhere")))


# --- faces of known bodies that lie on others cannot be touched ---
TABLE = {"name": "table", "normal": [0.0, 0.0, 1.0], "offset_m": 0.71}
BLOCK = {"name": "block", "size_m": [0.2, 0.2, 0.08], "position_m": [0.35, 0.05, 0.75]}
UPPER = {"name": "upper", "size_m": [0.1, 0.1, 0.1], "position_m": [0.35, 0.05, 0.84]}


def names(**environment) -> set[str]:
    """Of all elements that can be touched."""
    known = map_from({"environment": environment}).listed_environment
    return {one.name for one in known if not one.is_covered}


def all_of(*boxes) -> set[str]:
    return names(box=list(boxes))


def at(box: dict, *place_m: float) -> dict:
    return box | {"position_m": list(place_m)}


@pytest.mark.parametrize(
    ("environment", "without_underside"),
    [
        *(({"plane": [TABLE], "box": [at(BLOCK, 0.35, 0.05, z)]}, "block") for z in (0.75, 0.752, 0.748)),
        # through the table, 10 mm above it, and flush with it
        *(({"plane": [TABLE], "box": [at(BLOCK, 0.35, 0.05, z)]}, None) for z in (0.65, 0.7599, 0.67)),
        ({"box": [BLOCK, UPPER]}, "upper"),
        ({"box": [BLOCK, at(UPPER, 0.45, 0.05, 0.84)]}, None),  # it overhangs
        ({"box": [BLOCK, at(UPPER, 0.35, 0.55, 0.84)]}, None),  # it is beside
    ],
)
def test_a_face_that_lies_on_another_is_left_out(environment: dict, without_underside: str | None) -> None:
    """With its edges and vertices, unless it is not within the other."""
    every = set().union(*(all_of(box) for box in environment["box"]))
    every |= {table["name"] for table in environment.get("plane", ())}
    hidden = {n for n in every if n.split()[0] == without_underside and "-z" in n.split()}
    assert names(**environment) == every - hidden


def test_a_mesh_with_rounded_numbers_loses_all_of_its_underside(tmp_path: Path) -> None:
    turn = Rotation.from_rotvec([0.3, -0.5, 0.8])
    corners_m = 0.05 * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    mesh = trimesh.convex.convex_hull(turn.apply(corners_m).round(5))
    mesh.export(tmp_path / "block.stl")
    table = {"name": "table", "normal": turn.apply([0, 0, 1]).tolist(), "offset_m": -0.05}
    known = map_from({"environment": {"plane": [table], "mesh": [{"path": "block.stl"}]}}, tmp_path)
    assert sum(one.is_covered for one in known.listed_environment) == 1 + 4 + 4


def test_the_hull_of_a_hollow_body_neither_covers_nor_is_covered(tmp_path: Path) -> None:
    tray = trimesh.util.concatenate(
        [
            trimesh.creation.box((0.4, 0.4, 0.02)),
            trimesh.creation.box((0.02, 0.4, 0.1)).apply_translation((0.19, 0, 0.04)),
        ]
    )
    tray.export(tmp_path / "tray.stl")
    table = {"name": "table", "normal": [0.0, 0.0, 1.0], "offset_m": -0.01}
    known = map_from({"environment": {"plane": [table], "mesh": [{"path": "tray.stl"}]}}, tmp_path)
    assert not any(one.is_covered for one in known.listed_environment)
    known = map_from({"object": {"box": [BLOCK, UPPER]}})  # an object keeps all its elements
    assert len(known.listed_object) == 2 * (6 + 12 + 8)
    assert not any(one.is_covered for one in known.listed_object)


@pytest.mark.long
def test_a_block_beside_the_object_does_not_take_the_contacts_of_the_table() -> None:
    size_m = np.array([0.1, 0.06, 0.04])
    known = {
        "environment": {
            "plane": [TABLE | {"offset_m": 0.0}],
            "box": [BLOCK | {"position_m": [0.35, 0.05, 0.04]}],
        },
        "object": {"box": {"size_m": size_m.tolist()}},
    }
    poses = slid_and_tilted(np.random.default_rng(1), size_m)
    trajectory = Trajectory.from_arrays(poses.stamp_ns, poses.position_m, poses.quat_xyzw, unit="ns")
    found = segment(trajectory, known=known)
    assert [one.contact.value for one in found.segments] == ["f-f", "e-f"]
    assert all(one.probability > 0.9 for one in found.segments)
    assert {one.geometry.environment.name for one in found.segments if one.geometry} == {"table"}
    assert not found.warnings
