"""Files of any size and kind are read or refused, in bounded work, in one line."""

import os
import subprocess
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from command_line import ENVIRONMENT, PROGRAM
from contact_tracker.cli.main import run
from contact_tracker.config import shipped
from contact_tracker.config.loading import load_model
from contact_tracker.errors import KnowledgeError, ModelError
from contact_tracker.geometry import polyhedron
from contact_tracker.map.file import map_from, read_map, triangles_of_obj, triangles_of_stl

FACET = b"facet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\n"
CORNERS = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n"
SEVERAL = b"".join(b"solid %d\n" % i + FACET + b"endsolid\n" for i in range(20_000))
fifo = pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs named pipes")


def cut(triangles: int) -> trimesh.Trimesh:
    """A rotated prism with 19 sides, cut into at least ``triangles``, with rounding errors."""
    body = trimesh.creation.cylinder(0.1, 0.2, sections=19)
    body.apply_transform(trimesh.transformations.rotation_matrix(0.7, (1, 2, 3)))
    while len(body.faces) < triangles:
        body = body.subdivide()
    return body


def known(folder: Path, mesh: str) -> str:
    (folder / "known.toml").write_text(f'[object.mesh]\npath = "{mesh}"\n')
    return str(folder / "known.toml")


def refusal(folder: Path, mesh: str) -> str:
    with pytest.raises(KnowledgeError) as error:
        read_map(known(folder, mesh))
    assert error.value.key == "object.mesh.path"
    return error.value.reason


@pytest.mark.parametrize(("suffix", "halvings"), [("obj", 5), ("stl", 6)])
def test_meshes_of_many_triangles_take_little_work(
    tmp_path: Path, suffix: str, halvings: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A round one is refused before any work that grows with the square of its faces."""
    ball = trimesh.creation.icosphere(halvings)
    cut(len(ball.faces)).export(tmp_path / f"cut.{suffix}")
    ball.export(tmp_path / f"ball.{suffix}")
    begin_s = time.process_time()
    found = read_map(known(tmp_path, f"cut.{suffix}"))
    assert len(found.object) == 21 + 57 + 38
    assert found.object_complete
    monkeypatch.setattr(polyhedron, "_edge", lambda *_: pytest.fail("work that grows"))
    monkeypatch.setattr(polyhedron, "_ordered", lambda *_: pytest.fail("work that grows"))
    assert "more than 60 faces" in refusal(tmp_path, f"ball.{suffix}")
    assert time.process_time() - begin_s < 20.0  # a second on an idle machine


@pytest.mark.parametrize(
    ("name", "content", "reason"),
    [
        ("solids.stl", SEVERAL, "no solid"),
        ("many.obj", CORNERS + b"f 1 2 3\n" * 400_001, "more than 400000 triangles"),
        ("one.obj", CORNERS + b"f" + b" 1" * 1_200_001 + b"\n", "more than 400000 triangles"),
        ("points.obj", b"v 0 0 0\n" * 1_200_001 + b"f 1 2 3\n", "more than 400000 triangles"),
        ("many.stl", b"solid" + b" vertex 0 0 0" * 1_200_001, "more than 400000 triangles"),
        ("large.stl", None, "larger than 20 MB"),
        ("far.obj", b"f 1 2 3\nv 1e38 1e38 -1e38\n", "not there"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_large_meshes_are_refused(
    tmp_path: Path, name: str, content: bytes | None, reason: str, capfd: pytest.CaptureFixture[str]
) -> None:
    with open(tmp_path / name, "wb") as file:
        file.truncate(10**12) if content is None else file.write(content)  # no disk has to have that
    assert reason in refusal(tmp_path, name)
    if name == "far.obj":
        (tmp_path / "log.mcap").touch()
        assert run(["segment", str(tmp_path / "log.mcap"), "--known", known(tmp_path, name)]) == 2
        (line,) = capfd.readouterr().err.splitlines()
        assert line.startswith("contact-tracker: error: ")


def test_an_incomplete_hull_is_not_used(monkeypatch: pytest.MonkeyPatch) -> None:
    points = np.asarray(trimesh.creation.cylinder(0.1, 0.2, sections=20).vertices)
    assert len(polyhedron.convex(points, 1e-6, 60).of_kind("f")) == 22
    monkeypatch.setattr(polyhedron, "_ENOUGH_VERTICES", 10)
    with pytest.raises(polyhedron.TooManyFaces):
        polyhedron.convex(points, 1e-6, 60)


def test_faces_of_an_obj_are_read_however_they_are_written() -> None:
    text = b"# a comment\nvn 0 0 1\nvt 0 0\n" + CORNERS + b"g side\nf 1/1/1 2//1 3/1 # f 1 1 1\r\n"
    text += b"\tf -1 -2 \\\n -3\nv 5 5 5 1\nf 1 2 3 5\nf -1 1 2\nl 1 2\ns off\nf 1 2\nf\n"
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [5, 5, 5]], float)
    wanted = points[[[0, 1, 2], [3, 2, 1], [0, 1, 2], [0, 2, 4], [4, 0, 1]]]
    np.testing.assert_array_equal(triangles_of_obj(text), wanted)


def test_readers_agree_with_another_library(tmp_path: Path) -> None:
    body = trimesh.creation.icosphere(2, 0.1)
    for name, read in (("a.stl", triangles_of_stl), ("b.stl", triangles_of_stl), ("c.obj", triangles_of_obj)):
        text = {"file_type": "stl_ascii"} if name == "b.stl" else {}
        body.export(tmp_path / name, **text)
        np.testing.assert_allclose(read((tmp_path / name).read_bytes()), body.triangles, atol=1e-7)


@fifo
def test_other_than_regular_files_are_refused_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """A device and a pipe in a separate process: it must neither block nor fill the memory."""
    monkeypatch.chdir(tmp_path)
    Path("log.mcap").touch()
    Path("folder.toml").mkdir()
    os.truncate(os.open("large.toml", os.O_CREAT | os.O_WRONLY), 10**12)
    Path("device.toml").symlink_to("/dev/zero")
    os.mkfifo("pipe.obj")
    known(tmp_path, "pipe.obj")
    refused = []
    for option, name in (("--model", "folder.toml"), ("--model", "large.toml")):
        assert run(["segment", "log.mcap", option, name]) == 2
        refused.append(capfd.readouterr().err)
    for name in ("device.toml", "known.toml"):
        words = [*PROGRAM, "segment", "log.mcap", "--known", name]
        limited = ["bash", "-c", 'ulimit -v 4000000; exec "$@"', "bash", *words]
        done = subprocess.run(limited, env=ENVIRONMENT, capture_output=True, text=True, timeout=60)
        assert done.returncode == 2, done.stderr
        refused.append(done.stderr)
    reasons = "a folder", "larger than", "not a regular file", "not a regular file"
    for text, reason in zip(refused, reasons, strict=True):
        (line,) = text.splitlines()
        assert line.startswith("contact-tracker: error: ")
        assert reason in line


@pytest.mark.parametrize("read", [load_model, read_map])
def test_toml_files_have_a_limit(tmp_path: Path, read) -> None:
    """In bytes, including comments."""
    content = (shipped() / "default.toml").read_bytes() if read is load_model else b""
    path = tmp_path / "file.toml"
    path.write_bytes(content + b"#" * (1_000_000 - len(content)))
    read(str(path))
    path.write_bytes(content + b"#" * (1_000_001 - len(content)))
    with pytest.raises((ModelError, KnowledgeError), match="larger than 1 MB"):
        read(str(path))


@pytest.mark.skipif(not Path("/proc/self/maps").exists(), reason="needs files without size")
def test_a_file_that_hides_its_size_is_not_read_without_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("contact_tracker.config.keys.MOST_BYTES", 100)
    with pytest.raises(ModelError, match="larger than"):
        load_model("/proc/self/maps")


@pytest.mark.parametrize(
    ("shape", "refused"),
    [
        ("[[object.mesh]]\npath = 'box.obj'", "too many"),
        ("[[environment.box]]\nsize_m = [1, 1, 1]", "208 elements"),
    ],
    ids=["mesh", "box"],
)
def test_many_bodies_are_refused_before_all_are_made(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, shape: str, refused: str
) -> None:
    (tmp_path / "box.obj").write_bytes(CORNERS + b"f 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n")
    made = []

    def counting(*args: Any) -> Any:
        made.append(args)
        return polyhedron.convex(*args)

    monkeypatch.setattr("contact_tracker.map.file.convex", counting)
    (tmp_path / "known.toml").write_text("".join(f'{shape}\nname = "{i}"\n' for i in range(1000)))
    with pytest.raises(KnowledgeError, match=refused):
        read_map(str(tmp_path / "known.toml"))
    assert 5 < len(made) < 20


@pytest.mark.parametrize(
    ("ours", "theirs", "refused"),
    [
        (1, 7, None),
        (2, 3, None),
        (7, 7, "1849 pairs of elements for f-f are too many; 1100 are allowed"),
        (2, 4, "1225 pairs of elements for e-e are too many; 1100 are allowed"),
        (0, 0, "5766 pairs of elements are too many; 3000 are allowed"),
    ],
)
def test_elements_of_both_sides_have_a_limit_of_pairs(ours: int, theirs: int, refused: str | None) -> None:
    """Without one, a file of 600 bytes would make 21 000 hypotheses in every tick."""
    boxes = [{"name": str(i), "size_m": [1, 1, 1]} for i in range(7)]
    table: dict[str, Any] = {"object": {"box": boxes[:ours]}, "environment": {"box": boxes[:theirs]}}
    if not ours:  # all contacts together
        directions = [[np.cos(a), np.sin(a), 0.0] for a in np.linspace(0.0, 3.0, 30)]
        side = {
            "plane": [{"normal": direction, "offset_m": 0.1} for direction in directions],
            "line": [{"direction": direction, "point_m": [0, 0, 0]} for direction in directions],
            "point": [{"point_m": direction} for direction in directions],
        }
        table = {"object": side, "environment": side}
    if refused is None:
        assert map_from(table).object
        return
    with pytest.raises(KnowledgeError, match=refused):
        map_from(table)
