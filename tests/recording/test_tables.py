"""Trajectories in text files and tables, written by other libraries, and exports of motion capture."""

import csv
import json
import pickle
import re
import struct
import time
from collections.abc import Callable
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow
import pytest
import zstandard
from pyarrow import feather, parquet
from scipy.io import savemat

from contact_tracker import Trajectory
from contact_tracker.cli.main import run
from contact_tracker.config.table_reading import reading_of
from contact_tracker.errors import AmbiguousSource, ChoiceError, UnreadableRecording
from contact_tracker.motion.poses import Poses
from contact_tracker.recording import PoseLog, list_sources, open_log, summarise
from mcap_logs import smooth_poses
from motive_export import ABOUT, HEADS, VALUES, write_motive
from pose_tables import rows, write

POSES = smooth_poses(300)
OTHER = smooth_poses(300, seed=5)
HIDDEN = slice(100, 110)
FRAMES_NS = 5_000_000 * np.arange(300)
CUP, TRAY = replace(POSES, stamp_ns=FRAMES_NS), replace(OTHER, stamp_ns=FRAMES_NS)
"""As in exports of motion capture, which begin at zero."""
TWO_BODIES = Path(__file__).with_name("two_bodies.c3d")
NAMES = ("x", "y", "z", "qx", "qy", "qz", "qw")
HEADER = ",".join(("t", *NAMES))


def write_parquet(path: Path, table: dict[str, object], **how: object) -> Path:
    parquet.write_table(pyarrow.table(table), path, **how)
    return path


def columns(poses: Poses) -> np.ndarray:
    """Seconds, position and quaternion."""
    return np.column_stack([poses.stamp_ns / 1e9, poses.position_m, poses.quat_xyzw])


def assert_read(path: Path | str, expected: Poses = POSES, time_ns: float = 0, **which: str) -> PoseLog:
    for collect in (Poses.collect, lambda log: Poses.join(list(log.batches()))):
        log = open_log(str(path), **which)
        result = collect(log)
        np.testing.assert_allclose(result.stamp_ns, expected.stamp_ns, rtol=0, atol=time_ns)
        np.testing.assert_allclose(result.position_m, expected.position_m, rtol=0, atol=1e-9)
        np.testing.assert_allclose(result.quat_xyzw, expected.quat_xyzw, rtol=0, atol=1e-8)
        assert log.damage is None
    return log


def exact_seconds(poses: Poses) -> list[str]:
    return [f"{stamp // 10**9}.{stamp % 10**9:09d}" for stamp in poses.stamp_ns.tolist()]


@pytest.mark.parametrize("head", ["", "timestamp tx ty tz qx qy qz qw", "a trajectory\nof two lines"])
def test_tum(tmp_path: Path, head: str) -> None:
    """As written by numpy, with times to the microsecond, and by any white space to the nanosecond."""
    path = tmp_path / "a.txt"
    np.savetxt(path, columns(POSES), fmt=["%.6f", *["%.12f"] * 7], header=head)
    assert_read(path, time_ns=501)
    assert list_sources(str(path))[0].topic == "a.txt"
    lines = rows(exact_seconds(POSES), columns(POSES)[:, 1:])
    path.write_text("".join(f" {t}\t{'   '.join(row)}\r\n" for t, *row in lines))
    assert_read(path)


def test_several_bodies_in_named_columns(tmp_path: Path) -> None:
    bodies = {"cup": POSES, "big_table": OTHER}
    names = ",".join(["t", *(f"{body}_{axis}" for body in bodies for axis in NAMES)])
    path = write(tmp_path / "a.csv", [names], rows(columns(POSES), columns(OTHER)[:, 1:]))
    with pytest.raises(AmbiguousSource, match=r"->big_table \(table\).*->cup \(table\)"):
        open_log(str(path))
    for body, poses in bodies.items():
        assert_read(path, poses, time_ns=300, frame=body)


@pytest.mark.parametrize("units", ["Millimeters", "Meters"])
@pytest.mark.parametrize("version", HEADS)
def test_motive(tmp_path: Path, units: str, version: str) -> None:
    path = str(write_motive(tmp_path / "take.csv", POSES, OTHER, units=units, version=version, hidden=HIDDEN))
    with pytest.raises(AmbiguousSource, match=r"take.csv ->cup \(Motive\); take.csv ->table \(Motive\)"):
        open_log(path)
    assert assert_read(path, CUP[np.r_[0:100, 110:300]], frame="cup").counts["nonfinite"] == 10
    assert_read(path, TRAY, frame="table")


def motive(kinds: list[str], names: list[str], values: list[str], axes: str, space: str = "Global") -> str:
    about = ABOUT.format(version="1.23", rotation="Quaternion", units="Meters").replace("Global", space)
    rows = [["", "Type", *kinds], ["", "Name", *names], ["", "", *values], ["Frame", "Time (Seconds)", *axes]]
    line = ",".join(["0", "0.0", *("0" if axis != "W" else "1" for axis in axes)])
    return "\n".join([about, "", *map(",".join, rows), line, line.replace("0.0", "0.1", 1)]) + "\n"


@pytest.mark.parametrize("frame", ["cup", None])
def test_bodies_of_an_export_are_relative_to_each_other(tmp_path: Path, frame: str | None) -> None:
    """Their poses are in one frame, which has no name."""
    path = str(write_motive(tmp_path / "take.csv", POSES, OTHER))
    result = Poses.collect(open_log(path, frame=frame, relative_to="table"))
    back = OTHER.rotation.swapaxes(1, 2)
    expected = np.einsum("nij,nj->ni", back, POSES.position_m - OTHER.position_m)
    np.testing.assert_allclose(result.position_m, expected, rtol=0, atol=1e-9)
    np.testing.assert_allclose(result.rotation, back @ POSES.rotation, rtol=0, atol=1e-9)
    with pytest.raises(AmbiguousSource, match="cup is the body itself"):
        open_log(path, frame="cup", relative_to="cup")
    with pytest.raises(ChoiceError, match=r"leads to lid; there is .*->cup .*->table"):
        open_log(path, frame="cup", relative_to="lid")


@pytest.mark.parametrize(("kind", "names"), [("Rigid Body", ["cup", "cup 2"]), ("Bone", ["cup"])])
def test_motive_bodies_of_one_name_are_distinguished(tmp_path: Path, kind: str, names: list[str]) -> None:
    path, count = tmp_path / "take.csv", len(names)
    path.write_text(motive([kind] * 7 * count, ["cup"] * 7 * count, VALUES * count, "XYZWXYZ" * count))
    assert [source.child_frame_id for source in list_sources(str(path))] == names


@pytest.mark.parametrize(
    ("count", "message"), [(1_200, "no rigid body"), (50_000, "leave out those of no body")]
)
def test_exports_of_endless_columns_are_refused_at_once(tmp_path: Path, count: int, message: str) -> None:
    path = tmp_path / "take.csv"
    path.write_text(motive(["Rigid Body"] * count, ["a"] * count, ["Position"] * count, ["X"] * count))
    begin_s = time.process_time()
    with pytest.raises(UnreadableRecording, match=message):
        open_log(str(path))
    assert time.process_time() - begin_s < 2.0


def test_motive_bones_are_read_in_global_coordinates_only(tmp_path: Path) -> None:
    path = tmp_path / "take.csv"
    path.write_text(motive(["Bone"] * 7, ["hand"] * 7, VALUES, "XYZWXYZ", space="Local"))
    with pytest.raises(UnreadableRecording, match=r"no rigid body has both .* in global coordinates"):
        open_log(str(path))


def write_vicon(path: Path, quaternions: bool = True, kind: str = "Segments", about: str = "") -> Path:
    axes = "RX,RY,RZ,RW,TX,TY,TZ" if quaternions else "RX,RY,RZ,TX,TY,TZ"
    units = (",,,," if quaternions else "deg,deg,deg,") + "mm,mm,mm"
    commas = "," * axes.count(",")
    rows = [kind, "200", f",,{about}cup:cup{commas},{about}me:hand{commas}", f"Frame,Sub Frame,{axes},{axes}"]
    rows.append(f",,{units},{units}")
    for i, (a, b) in enumerate(zip(POSES, OTHER, strict=True)):
        cells = [
            repr(value)
            for p in (a, b)
            for value in (*p.quat_xyzw[: 4 if quaternions else 3], *(1e3 * v for v in p.position_m))
        ]
        rows.append(",".join([str(i + 1), "0", *cells]))
    rows += ["", "Trajectories", "200", ",,cup:M1,,", "Frame,Sub Frame,X,Y,Z", ",,mm,mm,mm", "1,0,1,2,3"]
    path.write_text("\r\n".join(rows) + "\r\n")
    return path


@pytest.mark.parametrize(
    ("kind", "about"),
    [("Segments", ""), ("Objects", "Global Angle "), ("Objects", "Global Angle (Quaternion) ")],
)
def test_vicon(tmp_path: Path, kind: str, about: str) -> None:
    path = str(write_vicon(tmp_path / "trial.csv", kind=kind, about=about))
    assert [source.child_frame_id for source in list_sources(path)] == ["cup", "me:hand"]
    for name, poses in (("cup", CUP), ("me:hand", TRAY)):
        assert_read(path, replace(poses, stamp_ns=FRAMES_NS + 5_000_000), frame=name)
    assert [source.poses for source in summarise(path).sources] == [300, 300]


QUATERNION = "qx,qy,qz,qw\n0,1,2,3,0,0,0,1\n"


LACKING: list[tuple[str, str]] = [
    ("1 2 3 4\n", "its 4 columns have no names: say which they are, by number"),
    ("t,x,y,z\n1,2,3,4\n", "among t, x, y, z: missing are qx, qy, qz, qw: say which"),
    ("t,x,y,z,qx,qy,qz\n1,2,3,0,0,0,1\n", "missing is qw: say which .* or rename columns, as in"),
    ("t,x [mm],y [mm],qx,qy,qz,qw\n1,2,3,0,0,0,1\n", r"missing is z: .*x \[mm\],y \[mm\],z \[mm\],qx"),
    (f"{HEADER}\n\n# end\n", "it has a header but no rows"),
    (f"{HEADER}\n0 0 0 0 0 0 0 1\n1,0,0,0,0,0,0,1\n", "row 1 has 1 value, the header has 8: separate"),
    ("x,y,z,qx,qy,qz,qw\n1,2,3,0,0,0,1\n", "read them by .*100Hz, with the rate of your poses"),
    ("Format Version,1.23\n\n,,Rigid Body\nFrame,Time,X\n", "no rigid body with Rotation and Position"),
    ("Format Version|1.23|Take Name|a\n", "its columns are separated by nothing known"),
    ("Objects\nx\n", "its section Objects lacks rate, names, columns or units"),
    (",".join(["t"] * 5001) + "\n", "its rows have 5000 values or more"),
    (f"{HEADER}\n" + "1," * 400_000, "its rows have 5000 values or more"),
    ("Trajectories\n100\n,,a\nFrame,Sub Frame,X\n,,mm\n", "its section is Trajectories: export Objects"),
    ("t,[0],[1],[2]\n1,2,3,4\n", r"no columns of a pose among t, \[0\]"),
    ("0, 1, 2, 3, 0, 0, 0, 1\n", r"time=c0,position=c\[1:4\],quaternion=c\[4:8\]"),
    ("0,5;1,5;2;3;0;0;0;1\n", "no names: if they are meant so, read them by contact"),
    (
        "t,x,y,z,w,h\n0,1,2,3,4,5\n",
        "or, with angles beside the position x, y, z, as in --columns rx=a,ry=b,rz=c",
    ),
    (f"t,Pos X (ft),Pos Y (ft),Pos Z (ft),{QUATERNION}", r"'Pos X \(ft\)' is not known: m, cm, mm"),
    (f"time [days],x,y,z,{QUATERNION}", r"'days' of column 'time \[days\]' is not known: s, ms, us, ns"),
    (f"time_mm,x,y,z,{QUATERNION}", "'mm' of column 'time_mm' is not known: s, ms, us, ns"),
    (f"t,x [mm],y [m],z [mm],{QUATERNION}", r"columns x \[mm\], y \[m\], z \[mm\] differ"),
    (f"t,x [mm],y,z,{QUATERNION}", r"the units of the columns x \[mm\], y, z differ"),
    ("\0" * 99, "it is named as a table, but is not text"),
    *(
        (line * 10_000 + "0 0 0 0 0 0 0 1\n", "its first 64 lines are empty or comments")
        for line in ("\n", "#\n", "# t x y z qx qy qz qw\n", "  \n")
    ),
    (f"{HEADER}\n" + ",".join(["0,005"] * 8) + "\n", r"16 values under 8 names: .* decimal commas"),
]
"""Texts of tables, and what they lack."""


def npy_of(rows: int) -> bytes:
    """The beginning of an array that says that it has so many rows."""
    out = BytesIO()
    np.save(out, np.zeros((1, 8)))
    return out.getvalue().replace(b"(1, 8), }" + b" " * 9, f"({rows}, 8), }}".encode().ljust(18))


def cells_that_are_not_there(path: Path) -> None:
    """A list of so many cells takes scipy 800 MB."""
    savemat(path, {"s": {"c": np.array([["a"], ["b"], ["c"]], object)}, "x": np.zeros(9)})
    content = path.read_bytes()
    path.write_bytes(content.replace(struct.pack("<ii", 3, 1), struct.pack("<ii", 10**8, 1)))


def hdf5_of_zeros(path: Path) -> None:
    with pytest.importorskip("h5py").File(path, "w") as file:
        file.create_dataset("a/t", data=np.zeros(5_000_000), compression="gzip")


def feather_of(further: dict[str, object]) -> Callable[[Path], object]:
    table = pyarrow.table(dict.fromkeys(("t", *NAMES), MANY) | further)
    return lambda path: feather.write_feather(table, str(path), compression="zstd")


def object_of_matlab(path: Path) -> None:
    """A table is stored as an object, whose values are bytes without a name."""
    savemat(path, {"x": np.zeros(9, np.uint8)})
    content = bytearray(path.read_bytes())
    at = content.index(b"\x06\0\0\0\x08\0\0\0") + 8
    content[at] = 17  # the class of objects, which have names instead of a shape
    content[at + 8 : at + 16] = b"\1\0\4\0MCOS"
    path.write_bytes(content)


PROSE = (
    "Author: somebody\n\nThis data set has 330 trajectories of a cup.\nIt is public.\n",
    "06/08/2021 08:47:36 AM INFO:Starting application\n06/08/2021 09:02:23 AM INFO:done\n",
    "MsgID,Timestamp,Author,Body\n'i4f','2022-04-12 05:57:29','me','It is 1 of 2, I say'\n",
)
MANY, WITH_MARKERS = np.zeros(5_000_000), TWO_BODIES.read_bytes().replace(b"ROTATION", b"ROTATIOX")
OF_DEC = bytearray(TWO_BODIES.read_bytes())
"""C3D in the numbers of another machine, whose fractions are not read, as Motive writes it."""
OF_DEC[512 * (OF_DEC[0] - 1) + 3] = 85
TOO_MUCH = "it is too much for its size"
UNREAD: list[tuple[str, str | bytes | Callable[[Path], object], str]] = [
    *(("a.csv", text, message) for text, message in LACKING),
    ("a.npz", lambda path: np.savez_compressed(path, t=MANY), TOO_MUCH),
    ("a.mat", lambda path: savemat(path, {"t": MANY[:4_500_000]}, do_compression=True), TOO_MUCH),
    ("a.feather", feather_of({}), TOO_MUCH),
    ("a.feather", feather_of({"l": pyarrow.FixedSizeListArray.from_arrays(MANY, 1)}), TOO_MUCH),
    ("a.h5", hdf5_of_zeros, TOO_MUCH),
    ("a.mat", cells_that_are_not_there, "no columns of a pose among x"),
    (
        "a.mat",
        lambda path: savemat(path, {"s": "cup", "c": np.array(["a", 1], object)}),
        "it has no array of",
    ),
    (
        "a.mat",
        b"MATLAB 5.0".ljust(126) + b"IM\x0e\0\0\0\xff",
        "it has no array of numbers with a row for each",
    ),
    ("a.mat", bytes(30), "it cannot be read as arrays of MATLAB: Mat file appears to be corrupt"),
    ("a.npy", b"\x93NUMPY\1\0\x10\0{'a': (".ljust(26, b"\0"), "it cannot be read as arrays of NumPy: .*EOF"),
    ("a.npy", npy_of(10**9), "an array is longer than its file"),
    ("a.npz", b"PK\3\4" * 9, "it cannot be read as arrays of NumPy"),
    (
        "a.npy",
        lambda path: np.save(path, np.array([{}], object)),
        r"it has no array of .*from_arrays\(t, p, q\)",
    ),
    ("a.pkl", pickle.dumps({"t": 1}), "a pickle, which runs code"),
    ("a.c3d", WITH_MARKERS, r"with markers \(tip\), not .*ezc3d\.c3d\('a\.c3d'\)"),
    ("a.c3d", bytes(OF_DEC), "its numbers are not those of a PC"),
    ("a.c3d", bytes(OF_DEC).replace(b"ROTATION", b"ROTATIOX"), r"it is C3D with markers \(tip\), not bodies"),
    ("a.mat", object_of_matlab, "it has no array of numbers with a row for each pose; tables, timetables"),
    ("log.ulg", b"ULog\x01\x12\x35\x01" + bytes(99), "it is ULog of PX4: ulog2csv log.ulg"),
    ("0.pt", b"\x80\x02\x8a\nl\xfc\x9cF\xf9 j\xa8P\x19.", "it is a pickle, which runs code"),
    ("1.pt", b"PK\3\4" * 9, "it is a pickle, which runs code"),
    ("a.txt", lambda path: np.savetxt(path, POSES.position_m), "its 3 columns have no names"),
    (
        "a.tsv",
        "NO_OF_FRAMES\t1\nMARKER_NAMES\tra\tlk\n",
        r"it has markers \(ra, lk\), not bodies: export 6D data",
    ),
    *(("a.log", text * 3, "text without rows of numbers, not a table of poses") for text in PROSE),
    ("a.c3d", b"\2P" + bytes(510), "its parameters cannot be read"),
    ("a.txt", "# Image list with two lines\n", "COLMAP's images.txt"),
    ("a.out", "# Bundle file v0.3\n", "a file of Bundler, which"),
    ("a.yaml", "header:\n  stamp:\n", "ros2 topic echo --csv"),
    ("a.csv", HEADER.encode("utf-16-be"), "is not text: save it as UTF-8"),
    ("a.trc", "PathFileType\t4\n", "it is TRC, which has markers"),
    ("a.txt", lambda path: np.savetxt(path, np.eye(4)), r"numpy\.loadtxt"),
    ("a.json", '[{"t":\n', "it begins like JSON, but is none"),
    ("a.json", '{"meta": {"a": 1}, "data": {"t": [1, 2]}}', r"without entries in a list.* as by jq \.data"),
    ("a.json", "{}", r"without entries in a list.* as by jq \.data"),
    ("a.xlsx", b"PK\3\4", "a workbook of Excel: save the sheet as CSV; or .*read_excel"),
    ("a.xls", b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1", "a workbook of Excel"),
    ("a.mp4", bytes(100), "not an MCAP file. What is read: MCAP files, ROS bags"),
    ("a.mcap", "404: not found", "if it is a table, name it .csv"),
    ("a.mcap", "<html><body>404", "it is XML or HTML, not a table"),
    ("a.csv.zst", zstandard.compress(HEADER.encode()), "if it is a table, decompress it: zstd -d"),
    ("a.csv.gz", b"\x1f\x8b\0", "it is compressed: gunzip -c a.csv.gz > a.csv makes"),
]
"""Names of files, their content, and why they are not read."""


@pytest.mark.parametrize(("name", "content", "message"), UNREAD)
def test_why_a_file_is_not_read_is_said(
    tmp_path: Path, name: str, content: str | bytes | Callable[[Path], object], message: str
) -> None:
    path = tmp_path / name
    if callable(content):
        content(path)
    else:
        path.write_bytes(content.encode() if isinstance(content, str) else content)
    for read in (open_log, summarise):
        with pytest.raises(UnreadableRecording, match=message):
            read(str(path))


def test_rotations_that_are_no_quaternions_are_refused(tmp_path: Path) -> None:
    with pytest.raises(
        UnreadableRecording, match=r"rotations are XYZ: export .* segment .* --euler XYZ:deg$"
    ):
        open_log(str(write_motive(tmp_path / "a.csv", POSES, OTHER, rotation="XYZ")))
    with pytest.raises(UnreadableRecording, match="rotations of cup are three angles or a helical vector"):
        open_log(str(write_vicon(tmp_path / "b.csv", quaternions=False)))
    path = write_vicon(tmp_path / "c.csv", quaternions=False, kind="Objects", about="Global Angle (Helical) ")
    with pytest.raises(UnreadableRecording, match=r"of the kind Helical: export quat.* --rotation-vector$"):
        open_log(str(path))


def test_rows_that_are_cut_off_or_garbage_are_counted(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("t,x,y,z,qx,qy,qz,qw\n0,1,2,3,0,0,0,1\n0.1,1,2,3,0,0,0,1\nx,1,2,3,0,0,0,1\n0.3,1,2\n")
    log = open_log(str(path))
    assert len(Poses.collect(log)) == 2
    assert log.damage.startswith(
        "1 row has no time that is a number or a date ('x'): give each a number, or a date"
    )
    assert log.counts["nonfinite"] == 1


ROWS_OF_SEVEN = f"{HEADER}\n" + "".join(f"{i / 10},1,2,3,0,0,0,1\n" for i in range(7))


@pytest.mark.parametrize("separator", [",", ";", "\t", " "])
@pytest.mark.parametrize(
    ("last", "kept", "is_cut"),
    [
        *(
            (f"0.7{rest}", 7, True)
            for rest in ("", ",1,2,3", ",1,2,3,0,0,0", ",1,2,3,0,0,0,", ",1,2,3,0,0,0,-")
        ),
        *((f"0.7,1,2,3,0,0,0,1{end}", 8, False) for end in ("", "\n")),
        *((text, 7, False) for text in ("", "# written by hand")),
    ],
)
def test_a_last_line_without_a_line_break_is_cut_off_if_it_lacks_values(
    tmp_path: Path, separator: str, last: str, kept: int, is_cut: bool
) -> None:
    path = tmp_path / "a.csv"
    rows = ROWS_OF_SEVEN.partition("\n")[2] if separator == " " else ROWS_OF_SEVEN  # TUM
    path.write_text((rows + last).replace(",", separator))
    for collect in (Poses.collect, lambda log: Poses.join(list(log.batches()))):
        log = open_log(str(path))
        assert len(collect(log)) == kept
        assert (log.damage or "").startswith("its last line is cut off inside a row and left out" * is_cut)
        assert "nonfinite" not in log.counts
    assert (log.damage is not None) == (summarise(str(path)).damage is not None) == is_cut


def test_rows_with_another_separator_are_named(tmp_path: Path) -> None:
    (path := tmp_path / "a.csv").write_text(f"{ROWS_OF_SEVEN}0.7;1;2;3;0;0;0;1\n")
    log = open_log(str(path))
    assert len(Poses.collect(log)) == 7
    assert "separate their values by commas, as in the first row" in str(log.damage)


def test_a_whole_last_row_without_a_pose_is_no_damage(tmp_path: Path) -> None:
    (path := tmp_path / "a.csv").write_text(f"{ROWS_OF_SEVEN}0.7,,,,,,,")
    assert open_log(str(path)).damage is None
    assert len(Poses.collect(open_log(str(path)))) == 7


def test_exports_of_motion_capture_that_are_cut_off_are_damaged(tmp_path: Path) -> None:
    motive = write_motive(tmp_path / "a.csv", POSES, OTHER)
    vicon = write_vicon(tmp_path / "b.csv")
    text = vicon.read_text()
    for path, cut, damaged in (
        (motive, motive.read_text(encoding="utf-8-sig").rstrip()[:-30], True),
        (vicon, text[: text.index("\n\nTrajectories")][:-30], True),
        (vicon, text.rstrip()[:-2], False),  # in a section that has no poses
    ):
        path.write_text(cut)
        log = open_log(str(path), frame="cup")
        assert len(Poses.collect(log)) == 300 - damaged
        assert (log.damage is not None) is damaged


@pytest.mark.parametrize(
    ("rows", "dictionary"), [pytest.param(20_000_000, True, marks=pytest.mark.long), (3_000_000, False)]
)
def test_the_decompressed_size_of_parquet_is_limited(tmp_path: Path, rows: int, dictionary: bool) -> None:
    column = pyarrow.array(np.zeros(rows))
    table = pyarrow.table(dict.fromkeys(("t", *NAMES), column))
    path = tmp_path / "a.parquet"
    parquet.write_table(table, path, compression="zstd", use_dictionary=dictionary, row_group_size=rows)
    assert path.stat().st_size < 2**20
    with pytest.raises(UnreadableRecording, match=r"for its size: more records than \d+ bytes explain"):
        open_log(str(path))


@pytest.mark.parametrize(
    ("rows", "length", "encoding", "message"),
    [
        (3, 40_000_000, "PLAIN", r"it is too much for its size: \d+ bytes are to become"),
        (3000, 100_000, "dictionary", "its column t is text: write numbers"),
        (3000, 100_000, "DELTA_BYTE_ARRAY", "its column t is text: write numbers"),
    ],
)
def test_long_texts_are_refused(tmp_path: Path, rows: int, length: int, encoding: str, message: str) -> None:
    """A page of 120 MB; or short pages, of which all texts together have 300 MB."""
    is_dictionary, numbers = encoding == "dictionary", {name: np.zeros(rows) for name in NAMES}
    path = write_parquet(
        tmp_path / "a.parquet",
        {"t": pyarrow.array(["0" * length] * rows), **numbers},
        compression="zstd",
        use_dictionary=is_dictionary,
        column_encoding=None if is_dictionary else {"t": encoding, **dict.fromkeys(numbers, "PLAIN")},
    )
    assert path.stat().st_size < 2**20
    with pytest.raises(UnreadableRecording, match=message):
        open_log(str(path))


def test_parquet_with_invalid_pages_is_refused(tmp_path: Path) -> None:
    path = write_parquet(tmp_path / "a.parquet", dict.fromkeys(("t", *NAMES), np.arange(9.0)))
    content = path.read_bytes()
    path.write_bytes(content[:4] + b"\xff" * 40 + content[44:])
    with pytest.raises(UnreadableRecording, match="where its pages begin cannot be read"):
        open_log(str(path))


@pytest.mark.parametrize("rows_of_group", [1, 7, 59, 60])
def test_all_groups_of_parquet_are_read(tmp_path: Path, rows_of_group: int) -> None:
    poses, path = POSES[:60], tmp_path / "a.parquet"
    table = dict(zip(("t", *NAMES), columns(poses).T, strict=True))
    write_parquet(path, table, row_group_size=rows_of_group, compression="zstd")
    assert_read(path, poses, time_ns=1000)


@pytest.mark.parametrize("value", [b"1", True])
@pytest.mark.parametrize("column", ["t", "qx"])
def test_parquet_columns_of_no_numbers_are_refused(tmp_path: Path, column: str, value: object) -> None:
    names = dict(zip(["t", *NAMES], columns(POSES).T, strict=True))
    write_parquet(tmp_path / "a.parquet", names | {column: [value] * len(POSES)})
    for read in (open_log, summarise):
        with pytest.raises(UnreadableRecording, match=f"its column {column} is of the type"):
            read(str(tmp_path / "a.parquet"))


def write_times(path: Path, times: np.ndarray | list[str], name: str = "t") -> Path:
    """A table of the first poses at these times."""
    return write(path, [",".join([name, *NAMES])], rows(times, columns(POSES)[: len(times), 1:]))


RATE, WHOLE = "poses a second; ", "whole seconds, one after the other: if they are numbers of frames, give"
LIKE_MS = "they look like milliseconds: give --time-unit ms"
TIMES: list[tuple[str, str | None, float, float, int | None, str]] = [
    *(("t", None, first, step, 10**9, "") for first, step in ((0, 0.005), (1.7e9, 0.25), (50_000.0, 0.1))),
    *(("t", None, 0, step, 10**6, "taken as milliseconds") for step in (5, 33)),
    *(("t", None, first, 5000, 10**3, "taken as microseconds") for first in (0, 120_000)),
    *(("t", None, first, 5_000_000, 1, "") for first in (0, 1_000_000_000)),
    ("t", None, 0, 1_000_000, 1, "taken as nanoseconds"),  # or 10 Hz in units of 100 ns
    *(
        (name, unit, 0, 5, unit_ns, f"taken as {unit}, are those of {rate} {RATE}{LIKE_MS}" if rate else "")
        for name in ("t", "time_ms")
        for unit, unit_ns, rate in (
            ("s", 10**9, "0.2"),
            ("ms", 10**6, ""),
            ("us", 10**3, "200000"),
            ("ns", 1, "2e+08"),
        )
    ),
    ("t", "ms", 0, 0.005, None, f"200000 {RATE}they look like seconds: give --time-unit s"),
    ("t", "s", 1.7e9, 5.0, 10**9, ""),
    ("t", "s", 0, 2.0, 10**9, ""),  # as milliseconds 0.6 s in all
    ("time [s]", None, 0, 1.0, 10**9, WHOLE),
    ("time [ms]", None, 0, 0.01, None, f"100000 {RATE}they look like seconds: give --time-unit s"),
    ("time_us", None, 0, 5.0, None, f"200000 {RATE}{LIKE_MS}"),
    ("time [ns]", None, 0, 0.3, None, f"{RATE}give their unit with --time-unit s, ms, us or ns"),
]
"""Names of times, the stated unit, the first time and the steps, their unit (ns), and the remark."""


@pytest.mark.parametrize(("name", "stated", "first", "step", "unit_ns", "text"), TIMES)
def test_units_of_times(
    tmp_path: Path, name: str, stated: str | None, first: float, step: float, unit_ns: int | None, text: str
) -> None:
    """A unit without a name is that which fits the steps, or the times as dates; rates that no tracker has
    are reported."""
    times = first + step * np.arange(300)
    log = open_log(str(write_times(tmp_path / "a.csv", times, name)), table=reading_of(time_unit=stated))
    result = Poses.collect(log)
    if unit_ns is not None:
        np.testing.assert_allclose(result.stamp_ns, times * unit_ns, rtol=0, atol=300)
    assert len(log.remarks) == bool(text)
    assert text in "".join(log.remarks)
    assert not re.search("taken as [a-z]{3}", text) or "--time-unit s, ms, us or ns" in log.remarks[0]
    assert summarise(str(tmp_path / "a.csv"), reading_of(time_unit=stated)).assumptions == log.remarks[:1]


def test_a_unit_cannot_be_given_for_times_with_their_own(tmp_path: Path) -> None:
    dates = write_times(tmp_path / "a.csv", [f"2026-03-01T10:00:0{i}" for i in range(4)])
    for path, which, message in (
        (write_motive(tmp_path / "take.csv", POSES, OTHER), {"frame": "cup"}, "its times have a unit"),
        (write_vicon(tmp_path / "v.csv"), {"frame": "cup"}, "its times have a unit"),
        (dates, {}, "its times are dates"),
    ):
        with pytest.raises(ChoiceError, match=f"{message}: leave out --time-unit"):
            Poses.collect(open_log(str(path), table=reading_of(time_unit="ms"), **which))


def test_dates_count_from_their_time_zone(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    times = [
        "2026-03-01T10:00",
        "2026-03-01 10:00:01,5",
        "2026-03-01T12:00:02+02:00",
        "2026-03-01T04:30:03-0530",
    ]
    rows = "".join(f"{time};0;0;{i};0;0;0;1\n" for i, time in enumerate(times))
    path.write_text(f"time;x;y;z;qx;qy;qz;qw\n{rows}1500-01-01T00:00:00;0;0;0;0;0;0;1\nnever;0;0;0;0;0;0;1\n")
    log = open_log(str(path))
    result = Poses.collect(log)
    assert ((result.stamp_ns - result.stamp_ns[0]) / 1e9).tolist() == [0.0, 1.5, 2.0, 3.0]
    assert np.datetime64(int(result.stamp_ns[0]), "ns") == np.datetime64("2026-03-01T10:00:00", "ns")
    assert log.damage.startswith("2 rows have no time that is a number or a date")


def test_times_of_a_day_go_on_after_midnight(tmp_path: Path) -> None:
    times = ["23:59:58.5", "23:59:59.5", "0:00:00.5", "0:00:01.5"]
    result = Poses.collect(open_log(str(write_times(tmp_path / "a.csv", times))))
    assert (np.diff(result.stamp_ns) / 1e9).tolist() == [1.0, 1.0, 1.0]


def test_days_and_months_that_cannot_be_told_are_refused(tmp_path: Path) -> None:
    times = [f"{day}/03/2026 {time}" for day, time in ((12, "23:59:59"), (13, "00:00:00"), (13, "00:00:01"))]
    with pytest.raises(ChoiceError, match=r"day or the month comes first .* write them as 2026-03-31"):
        Poses.collect(open_log(str(write_times(tmp_path / "a.csv", times))))


@pytest.mark.parametrize(
    "times",
    [
        *(
            pyarrow.array(POSES.stamp_ns).cast(pyarrow.timestamp("ns", zone))
            for zone in (None, "Europe/Berlin")
        ),
        *(POSES.stamp_ns.astype("timedelta64[ns]"), exact_seconds(POSES)),
        *(POSES.stamp_ns // unit_ns for unit_ns in (1, 1000, 1_000_000)),
    ],
)
def test_times_in_parquet(tmp_path: Path, times: object) -> None:
    """Dates, durations, text, and integers whose unit follows from their size."""
    table = {"t": times, **dict(zip(NAMES, columns(POSES)[:, 1:].T, strict=True))}
    path = write_parquet(tmp_path / "a.parquet", table)
    assert assert_read(path, time_ns=1e6).source.type == "Parquet"


@pytest.mark.parametrize("separator", [";", "\t"])
def test_exports_separated_by_other_than_commas(tmp_path: Path, separator: str) -> None:
    """As spreadsheets write them with decimal commas."""
    for name, path in (
        ("take.csv", write_motive(tmp_path / "take.csv", POSES, OTHER, hidden=HIDDEN)),
        ("trial.csv", write_vicon(tmp_path / "trial.csv")),
    ):
        cells = csv.reader(path.read_text(encoding="utf-8-sig").splitlines())
        path.write_text("\n".join(separator.join(row).replace(".", ",") for row in cells) + "\n")
        first_ns, frame = (0, "table") if name == "take.csv" else (5_000_000, "me:hand")
        assert_read(path, replace(OTHER, stamp_ns=FRAMES_NS + first_ns), frame=frame)


@pytest.mark.parametrize(("rate", "is_rounded"), [(360, True), (120, True), (100, False)])
def test_rounded_times_of_motive_follow_the_frames(tmp_path: Path, rate: int, is_rounded: bool) -> None:
    """Motive 2.3 and 3 write times to the millisecond, at 360 Hz 0.003, 0.006, 0.008; else those of the file
    are taken, at 200 Hz."""
    path = write_motive(tmp_path / "take.csv", POSES, OTHER)
    lines = path.read_text(encoding="utf-8-sig").replace("Rate,200.0", f"Rate,{rate}.000000").splitlines()
    if is_rounded:
        rows = [line.split(",", 2) for line in lines[7:]]
        lines[7:] = [f"{i},{int(i) / rate:.3f}000,{rest}" for i, _, rest in rows]
    path.write_text("\n".join(lines) + "\n")
    expected_ns = np.arange(300) / (rate if is_rounded else 200) * 1e9
    assert_read(path, replace(POSES, stamp_ns=expected_ns), time_ns=1, frame="cup")


@pytest.mark.parametrize("separator", [", ", "\t"])
def test_names_in_a_comment_hold_for_values_with_blanks_and_tabs(tmp_path: Path, separator: str) -> None:
    """Integers followed by a comma and a blank are no TUM trajectory."""
    path = tmp_path / "a.csv"
    names = separator.join(("qw", "qx", "qy", "qz", "x [m]", "y [m]", "z [m]", "t [s]"))
    path.write_text(
        f"# {names}\n" + "".join(separator.join("10001234"[:7]) + f"{separator}{i}\n" for i in (5, 6))
    )
    result = Poses.collect(open_log(str(path)))
    np.testing.assert_array_equal(result.quat_xyzw, [[0, 0, 0, 1]] * 2)
    np.testing.assert_array_equal(result.position_m, [[1, 2, 3]] * 2)
    np.testing.assert_array_equal(result.stamp_ns, [5 * 10**9, 6 * 10**9])


def test_unordered_rows_are_reported_with_remedy(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    mixed = np.random.default_rng(0).permutation(columns(POSES))
    path = write(tmp_path / "a.csv", [HEADER], rows(mixed))
    log = open_log(str(path))
    kept = len(Poses.collect(log))
    assert log.remarks == ()
    assert log.loss.endswith(
        "sort them by time; if they are of several bodies, record each on a topic of its own"
    )
    assert run(["info", str(path)]) == 3
    assert log.loss in capsys.readouterr().err
    result = Trajectory.from_arrays(mixed[:, 0], mixed[:, 1:4], mixed[:, 4:])
    assert (len(result), result.damage) == (kept, log.loss)


@pytest.mark.parametrize(
    ("order", "counted"),
    [
        (np.r_[:50, 51, 50, 52:120, 121, 120, 122:200, 201, 200, 202:300], {"backward_stamp": 3}),
        (np.r_[:35, :35], {"clock_reset": 1}),
    ],
)
def test_little_disorder_is_only_counted(tmp_path: Path, order: np.ndarray, counted: dict[str, int]) -> None:
    log = open_log(str(write(tmp_path / "a.csv", [HEADER], rows(columns(POSES)[order]))))
    Poses.collect(log)
    assert counted.items() <= log.counts.items()
    assert log.remarks == ()


def test_lines_with_several_objects_are_parsed_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    parsed, decode = list[str](), json.JSONDecoder.decode

    def decode_counted(decoder: json.JSONDecoder, line: str) -> Any:
        parsed.append(line)
        return decode(decoder, line)

    monkeypatch.setattr(json.JSONDecoder, "decode", decode_counted)
    objects = [{"name": name, "p": [1, 2, 3], "q": [0, 0, 0, 1]} for name in ("cup", "lid")]
    path = tmp_path / "a.jsonl"
    objects.append({"name": "tag", "p": [1, 2, 3], "q": [0, 0, 0]})  # without its last value
    path.write_text("\n".join(json.dumps({"t": t, "objects": objects}) for t in range(1000)))
    table = reading_of("time=t,position=objects.p,quaternion=objects.q")
    log = open_log(str(path), frame="cup", table=table)
    assert len(Poses.collect(log)) == 1000
    assert log.damage is None  # the last line has no end
    assert len(parsed) < 2500  # also to list the sources, and of the first lines
