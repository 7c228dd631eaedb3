"""Exports that people have, which need a command, or a few lines, that the refusal has."""

import glob
import json
import os
import re
import shlex
import warnings
from collections.abc import Callable
from decimal import Decimal
from pathlib import Path

import numpy as np
import pandas
import pyarrow
import pytest
from pyarrow import feather, parquet

from contact_tracker.cli.main import run
from contact_tracker.errors import AmbiguousSource, UnreadableRecording
from contact_tracker.motion.poses import Poses
from contact_tracker.recording import open_log
from pose_tables import (
    MATRICES,
    NAMES,
    P_MM,
    POSE,
    SINCE_NS,
    TURN,
    WHOLE,
    P,
    Q,
    T,
    assert_read,
    proposed,
    rows,
    write,
)

NUMBERS = [str(i) for i in range(len(T))]


def by_frame(values: list[object]) -> str:
    return json.dumps(dict(zip(NUMBERS, values, strict=True)))


def in_cell(values: np.ndarray) -> list[str]:
    """Numbers between blanks, as in the results of BOP."""
    return [" ".join(map(repr, row)) for row in values.reshape(len(values), -1).tolist()]


def days_since(epoch: int) -> list[str]:
    """Times in days since another year, from 2024 on."""
    return [str(epoch + 19_800 + Decimal(int(n)) / (86_400 * 10**9)) for n in SINCE_NS]


def in_fortran(values: np.ndarray) -> list[list[str]]:
    return [[f"{value:.16E}".replace("E", "D") for value in row] for row in values.tolist()]


@pytest.mark.parametrize(
    ("marks", "offset_m"), [(",.-", 2.0), (".,-", 2.0), ("\u202f.-", -2.0), ("'.\u2212", -2.0)]
)
def test_marks_of_thousands_and_other_signs_are_read(tmp_path: Path, marks: str, offset_m: float) -> None:
    """Of positions 2 m away, in millimetres: of thousands, of decimals and of typesetting."""
    swap = str.maketrans(",.-", marks)
    places = [[f"{v:,.9f}".translate(swap) for v in row] for row in (P_MM + 1e3 * offset_m).tolist()]
    lines = [a + b + c for a, b, c in zip(rows(T), places, rows(Q), strict=True)]
    path = write(tmp_path / "a.csv", ["t;x [mm];y [mm];z [mm];qx;qy;qz;qw"], lines, ";")
    poses = Poses.collect(open_log(str(path)))
    np.testing.assert_allclose(poses.position_m, P + offset_m, rtol=0, atol=1e-9)


NDI = "Tools,Frame,Face,State,Rz,Ry,Rx,Tx,Ty,Tz,Error"
SCENE = [
    {"cam_R_m2c": m.ravel().tolist(), "cam_t_m2c": p.tolist(), "obj_id": 5}
    for m, p in zip(MATRICES, P_MM, strict=True)
]
OF_NDI = rows(
    ["1"] * len(T), NUMBERS, [""] * len(T), ["OK"] * len(T), TURN.as_euler("ZYX", degrees=True), P_MM, T
)
LISTS = [
    {"t": t, "R": matrix, "position": p}
    for t, matrix, p in zip(T.tolist(), MATRICES.tolist(), P.tolist(), strict=True)
]
OF_BOP = rows(*(["1"] * len(T), NUMBERS, ["5"] * len(T), in_cell(MATRICES), in_cell(P_MM), ["-1"] * len(T)))


def parquet_of(**columns: object) -> Callable[[Path], object]:
    return lambda path: parquet.write_table(pyarrow.table({"timestamp": T, **columns}), path)


OF_SEVEN = pyarrow.array(POSE.tolist(), pyarrow.list_(pyarrow.float64(), 7))
EXPORTS: dict[str, Callable[[Path], object]] = {
    "lists of seven.parquet": parquet_of(**{"observation.state": OF_SEVEN}),
    "two lists.parquet": parquet_of(
        position=pyarrow.array(P.tolist()), orientation=pyarrow.array(Q.tolist())
    ),
    "lists of any length.parquet": parquet_of(a=pyarrow.array(POSE.tolist())),
    "by columns.npy": lambda path: np.save(path, np.asfortranarray(np.c_[T, POSE])),
    "named.npz": lambda path: np.savez_compressed(path, t=T, p=P, q=Q, about="a test", other=np.zeros(3)),
    "matrices.npz": lambda path: np.savez(path, t=T, poses=WHOLE),
    "a.feather": lambda path: feather.write_feather(
        pyarrow.table({"t": T, "T": list(WHOLE.reshape(-1, 16))}), str(path)
    ),
    "bop.json": lambda path: path.write_text(by_frame([[one] for one in SCENE])),
    "matrices.json": lambda path: path.write_text(by_frame(WHOLE.tolist())),
    "by rows.json": lambda path: path.write_text(
        json.dumps({"time": [*T], "p": P.T.tolist(), "q": Q.T.tolist()})
    ),
    "by files.json": lambda path: path.write_text(
        json.dumps({f"frame_{i:04}.png": {"T": matrix} for i, matrix in enumerate(WHOLE.tolist())})
    ),
    "in a part.json": lambda path: path.write_text(
        json.dumps({"about": {"rate": 200}, "poses": {"t": [*T], "p": P.tolist(), "q": Q.tolist()}})
    ),
    "metadata.json": lambda path: path.write_text(  # as of Record3D
        json.dumps(
            {"fps": 200, "initPose": [0.0] * 7, "poses": np.c_[Q, P].tolist(), "frameTimestamps": [*T]}
        )
    ),
    "joints and poses.npz": lambda path: np.savez(
        path, time=T, joint_positions=np.tile(np.arange(7.0), (len(T), 1)), grip=P + 1, cup_pos=P, cup_quat=Q
    ),
    "by times.json": lambda path: path.write_text(
        json.dumps({f"{t:.9f}": {"p": [*p], "q": [*q]} for t, p, q in zip(T, P, Q, strict=True)})
    ),
    "apriltag.json": lambda path: path.write_text(json.dumps(LISTS)),
    "bop.csv": lambda path: write(path, ["scene_id,im_id,obj_id,R,t,time"], OF_BOP),
    "ndi.csv": lambda path: write(path, [NDI], OF_NDI),
    "excel.csv": lambda path: write(path, [f"time,{NAMES}"], rows(days_since(25_569), POSE)),
    "fortran.csv": lambda path: write(path, [f"c0,{NAMES}"], in_fortran(np.c_[T, POSE])),
    "matlab.csv": lambda path: write(path, [f"time,{NAMES}"], rows(days_since(719_529), POSE)),
}


@pytest.mark.parametrize("name", EXPORTS)
def test_the_proposed_command_reads_an_export(tmp_path: Path, name: str) -> None:
    EXPORTS[name](tmp_path / name)
    assert_read(tmp_path / name, *(re.sub("100Hz|30Hz", "200Hz", word) for word in proposed(tmp_path / name)))


def test_stamps_in_another_unit_than_their_name_give_a_warning(tmp_path: Path) -> None:
    path = write(
        tmp_path / "a.csv", [f"time_s,{NAMES}"], rows([str(round(1e9 * (4.3 + t))) for t in T], POSE)
    )
    log = open_log(str(path))
    assert len(Poses.collect(log)) < len(T)
    assert "they look like nanoseconds: give --time-unit ns" in " ".join(log.warnings)
    assert "more than 146 years from 1970" in str(log.damage)
    assert_read(path, "--time-unit", "ns")


@pytest.mark.parametrize("kind", ["bop.json", "bop.csv"])
def test_entries_of_several_bodies_are_a_source_for_each(tmp_path: Path, kind: str) -> None:
    """Also where cells have several values."""
    path, options = tmp_path / kind, ["--matrix", "rows", "--unit", "mm", "--time-unit", "200Hz"]
    if kind == "bop.json":
        path.write_text(by_frame([[entry, {**entry, "obj_id": 7}] for entry in SCENE]))
        options += ["--columns", "position=cam_t_m2c,matrix=cam_R_m2c"]
    else:
        twice = [[*row[:2], body, *row[3:]] for row in OF_BOP for body in "57"]
        write(path, ["scene_id,im_id,obj_id,R,t,time"], twice)
        options += ["--columns", "time=im_id,position=t,matrix=R"]
    assert_read(path, *options, frame="5")


def test_more_bodies_than_half_of_the_first_rows_are_a_source_for_each(tmp_path: Path) -> None:
    lines = [[T[i], f"cup {k}", *P[i] + k, *Q[i]] for i in range(3) for k in range(40)]
    path = write(tmp_path / "a.csv", [f"t,name,{NAMES}"], [[str(value) for value in line] for line in lines])
    assert len(Poses.collect(open_log(str(path), frame="cup 39"))) == 3


@pytest.mark.parametrize("last", [2, 16, 50])
def test_numbers_of_rows_that_begin_anew_are_no_bodies(tmp_path: Path, last: int) -> None:
    path = write(tmp_path / "a.csv", [f"t,packet_id,{NAMES}"], rows(T, np.arange(120) % last, POSE))
    assert_read(path)


DTRACK = "fr {}\nts {:.9f}\n6dcal 2\n6d 2 [1 1.0][9 9 9 9 9 9][1 0 0 0 1 0 0 0 1] [0 1.000][{}][{}]\n"


TABLE = pyarrow.table({"t": T, **dict(zip(NAMES.split(","), POSE.T, strict=True))})


def write_dtrack(path: Path) -> None:
    bodies, turns = in_cell(np.c_[P_MM, P_MM]), in_cell(MATRICES.transpose(0, 2, 1))
    path.write_text("".join(map(DTRACK.format, NUMBERS, T, bodies, turns)))


def write_files_of_matrices(path: Path) -> None:
    path.mkdir()
    for number, matrix in enumerate(WHOLE):
        np.savetxt(path / f"{number}.txt", matrix)


def write_files_of_entries(path: Path) -> None:
    path.mkdir()
    for number, one in enumerate(LISTS):
        (path / f"{number}.json").write_text(json.dumps(one))


def write_echo(path: Path) -> None:
    pose = "{{position: {{x: {}, y: {}, z: {}}}, orientation: {{x: {}, y: {}, z: {}, w: {}}}}}"
    head = "header:\n  stamp: {{sec: 1700000000, nanosec: {}}}\n  frame_id: map\npose: {}\n---\n"
    lines = zip(SINCE_NS.tolist(), POSE.tolist(), strict=True)
    path.write_text("".join(head.format(ns, pose.format(*row)) for ns, row in lines))


def write_stream(path: Path) -> None:
    with pyarrow.OSFile(str(path), "wb") as file, pyarrow.ipc.new_stream(file, TABLE.schema) as stream:
        stream.write_table(TABLE)


CONVERTED: dict[str, tuple[Callable[[Path], object], str]] = {
    "folder": (write_files_of_matrices, "poses.npy"),
    "entries": (write_files_of_entries, "poses.json"),
    "echo.txt": (write_echo, "poses.json"),
    "four lines": (lambda path: np.savetxt(path, WHOLE.reshape(-1, 4)), "poses.npy"),
    "three lines": (lambda path: np.savetxt(path, WHOLE[:, :3].reshape(-1, 4)), "poses.npy"),
    "dtrack.txt": (write_dtrack, "body.txt"),
    "v1.feather": (lambda path: feather.write_feather(TABLE, str(path), version=1), "a.feather"),
    "stream.arrow": (write_stream, "a.feather"),
}


@pytest.mark.filterwarnings("ignore:Feather V1")
@pytest.mark.parametrize("name", CONVERTED)
def test_the_line_of_python_makes_a_file_that_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    """By the command in the same message, that for the new file, or as it is."""
    monkeypatch.chdir(tmp_path)
    write_one, file = CONVERTED[name]
    write_one(Path(name))
    with pytest.raises(UnreadableRecording) as raised:
        open_log(name)
    code, command = re.search(
        r"((?:numpy|pyarrow|json)\.\w.*) makes a file(?:.*read by (.*))?", str(raised.value)
    ).groups()
    modules = {"np": np, "numpy": np, "pyarrow": pyarrow, "re": re, "glob": glob, "json": json}
    exec(code, modules | ({"yaml": pytest.importorskip("yaml")} if "yaml." in code else {}))
    is_open = file == "poses.npy" or name == "entries"
    options = shlex.split(command or "")[3:] or (proposed(Path(file)) if is_open else [])
    assert_read(Path(file), *(re.sub("100?Hz", "200Hz", word) for word in options))


def test_a_table_in_a_pipe_is_refused(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    reader, writer = os.pipe()
    os.write(writer, b"t,x,y,z,qx,qy,qz,qw\n")
    os.close(writer)
    with os.fdopen(reader) as stdin:
        monkeypatch.setattr("sys.stdin", stdin)
        assert run(["info", "-"]) == 1
    assert "save it to a file: tables are not read from a pipe" in capsys.readouterr().err


def test_frames_after_a_time_of_day_are_no_fraction(tmp_path: Path) -> None:
    """As in SMPTE's timecode."""
    times = [f"10:00:{i // 25:02d}:{i % 25:02d}" for i in range(len(T))]
    with pytest.raises(UnreadableRecording, match="no time that is a number or a date \\('10:00:00:00'"):
        open_log(str(write(tmp_path / "a.csv", [f"time,{NAMES}"], rows(times, POSE))))


@pytest.mark.parametrize("lost", ["null", "NaN"])
def test_poses_of_json_may_be_lost_at_first(tmp_path: Path, lost: str) -> None:
    entries = [dict(zip(["t", *NAMES.split(",")], row, strict=True)) for row in np.c_[T, POSE].tolist()]
    texts = [json.dumps({**entry, "x": None} if i < 70 else entry) for i, entry in enumerate(entries)]
    (tmp_path / "a.json").write_text(f"[{','.join(texts)}]".replace("null", lost))
    assert len(Poses.collect(open_log(str(tmp_path / "a.json")))) == len(T) - 70


@pytest.mark.parametrize("orient", ["columns", "split", "records", "index"])
def test_json_of_pandas_is_read(tmp_path: Path, orient: str) -> None:
    """Also with rows in another order, and with rows that are lost; damaged columns are refused."""
    frame, path = TABLE.to_pandas(), tmp_path / "a.json"
    content = json.loads(frame.to_json(orient=orient, double_precision=15))
    path.write_text(json.dumps(content))
    assert_read(path)
    if orient == "split":
        content["data"] += [None, "lost"]
    elif orient == "columns":
        content["x"] = dict(reversed(content["x"].items()))
    path.write_text(json.dumps(content))
    assert_read(path)
    if orient == "columns":
        content["x"]["1000"] = content["x"].pop("7")
        path.write_text(json.dumps(content))
        with pytest.raises(UnreadableRecording, match="without entries in a list"):
            open_log(str(path))


def test_numbers_of_any_size_are_no_poses(tmp_path: Path) -> None:
    path = write(tmp_path / "a.csv", [], [["1e308"] * 8] * 80)
    with warnings.catch_warnings(action="error"), pytest.raises(UnreadableRecording, match="have no names"):
        open_log(str(path))


def test_a_name_that_begins_with_an_abbreviation_is_of_a_body(tmp_path: Path) -> None:
    head = [f"HMD{kind}{axis}" for kind, axes in (("Position", "XYZ"), ("Rotation", "XYZW")) for axis in axes]
    names = ",".join([*head, *(name.replace("HMD", "LeftHand") for name in head)])
    path = write(tmp_path / "a.csv", [f"Time,{names}"], rows(T, POSE, POSE))
    assert_read(path, frame="hmd")
    with pytest.raises(AmbiguousSource):
        open_log(str(path))


@pytest.mark.parametrize("body", ["name", "tag_id"])
def test_a_dataframe_in_parquet_is_read(tmp_path: Path, body: str) -> None:
    """With dates as its index, which has no name, and rows of two bodies."""
    frame = pandas.DataFrame(POSE, pandas.to_datetime(SINCE_NS + 10**18), NAMES.split(","))
    bodies = ("cup", "tray") if body == "name" else (3, 4)
    frames = pandas.concat([frame.assign(**{body: value}) for value in bodies])
    frames.sort_index(kind="stable").to_parquet(path := tmp_path / "a.parquet")
    assert_read(path, *proposed(path), frame=str(bodies[0]))
