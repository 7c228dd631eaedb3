"""Poses in arrays by name: files of MATLAB, HDF5, Feather and NumPy, with time on any axis; damaged ones."""

import shlex
import struct
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow
import pytest
from pyarrow import feather
from scipy.io import savemat

from contact_tracker.cli.main import run
from contact_tracker.config.table_reading import reading_of
from contact_tracker.errors import ChoiceError, UnreadableRecording
from contact_tracker.motion.poses import Poses
from contact_tracker.recording import open_log
from pose_tables import MATRICES, NAMES, POSE, REAL_FIRST, WHOLE, P, Q, T, assert_read, proposed

Arrays = dict[str, Any]
ALL_NAMES = ["t", *NAMES.split(",")]
BY_TIME_LAST = np.moveaxis(WHOLE, 0, -1)


def write_hdf5(path: Path, arrays: Arrays, **how: Any) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w", **how) as file:
        for name, values in arrays.items():
            if isinstance(values, dict):
                for own, inner in values.items():
                    packed = {"compression": "gzip"} if np.size(inner) > 1 else {}
                    file.create_dataset(f"{name}/{own}", data=inner, **packed)
            else:
                file[name] = values


def write_matlab_7_3(path: Path, arrays: Arrays) -> None:
    """HDF5 behind 512 bytes of text, with axes in reverse, and vectors as matrices."""
    turned = {
        name: {field: np.atleast_2d(inner).T for field, inner in values.items()}
        if isinstance(values, dict)
        else np.atleast_2d(values).T
        for name, values in arrays.items()
    }
    write_hdf5(path, turned, userblock_size=512)
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + struct.pack("<HH", 0x200, 0x4D49))


WRITERS: dict[str, Callable[[Path, Arrays], object]] = {
    "v7.mat": lambda path, arrays: savemat(path, arrays, do_compression=True),
    "v6.mat": savemat,
    "v4.mat": lambda path, arrays: savemat(path, arrays, format="4"),
    "v7.3.mat": write_matlab_7_3,
    "a.h5": write_hdf5,
    "a.npz": lambda path, arrays: np.savez_compressed(path, **arrays),
}
FLAT: dict[str, tuple[Arrays, str]] = {
    "rows": ({"t": T, "p": P, "q": Q, "rate": 200.0}, "--columns position=p,quaternion=q"),
    "time last": ({"t": T, "p": P.T, "wxyz": REAL_FIRST.T}, "--columns position=p,wxyz=wxyz"),
    "vectors": (dict(zip(ALL_NAMES, np.c_[T, POSE].T, strict=True)), ""),
    "one matrix": (
        {"data": np.c_[T, POSE]},
        "--columns time=data[0],position=data[1:4],quaternion=data[4:8]",
    ),
}
NESTED: dict[str, tuple[Arrays, str]] = {
    "a struct": (
        {"body": {"time": T, "pose": BY_TIME_LAST, "id": 3}, "K": np.eye(3)},
        "--matrix rows --columns time=body.time,matrix=body.pose",
    ),
    "Qualisys": (
        {
            "take": {
                "FrameRate": 200.0,
                "Positions": np.stack([1e3 * P.T + 50.0, 1e3 * P.T]),
                "Rotations": np.stack([MATRICES.transpose(2, 1, 0).reshape(9, -1)] * 2),
            }
        },
        "--unit mm --time-unit 200Hz --matrix columns --columns "
        "position=take.Positions[3:6],matrix=take.Rotations[9:18]",
    ),
}


@pytest.mark.parametrize("name", WRITERS)
@pytest.mark.parametrize("shape", FLAT)
def test_arrays_are_read_by_their_names(tmp_path: Path, name: str, shape: str) -> None:
    arrays, options = FLAT[shape]
    WRITERS[name](tmp_path / name, arrays)
    assert_read(tmp_path / name, *shlex.split(options))


@pytest.mark.parametrize("name", ["v7.mat", "v6.mat", "v7.3.mat", "a.h5"])
def test_what_is_in_structs_has_their_names(tmp_path: Path, name: str) -> None:
    for arrays, options in NESTED.values():
        if name == "a.h5":
            options = options.replace("body.", "body/").replace("take.", "take/")
        WRITERS[name](tmp_path / name, arrays)
        assert_read(tmp_path / name, *shlex.split(options))


@pytest.mark.parametrize("name", [name for name in WRITERS if name != "v4.mat"])  # has no axes but two
@pytest.mark.parametrize("matrices", [WHOLE, BY_TIME_LAST], ids=["first", "last"])
def test_a_refusal_proposes_what_reads_the_arrays(tmp_path: Path, name: str, matrices: np.ndarray) -> None:
    WRITERS[name](tmp_path / name, {"t": T, "T": matrices})
    assert_read(tmp_path / name, *proposed(tmp_path / name))


def test_arrays_of_other_lengths_are_named_and_can_be_chosen(tmp_path: Path) -> None:
    """Also wide ones, as of all bodies of a simulation."""
    bodies = np.zeros((len(T), 30, 7))
    bodies[:, 20] = POSE
    arrays = {"time": T[:-1], "clock": T, "bodies": bodies, "images": np.zeros((len(T), 90, 90), np.uint8)}
    for name in ("v7.mat", "a.npz"):
        WRITERS[name](
            tmp_path / name, {"t_markers": np.arange(900.0), "markers": np.ones((900, 60)), **arrays}
        )
        with pytest.raises(UnreadableRecording) as raised:
            open_log(str(tmp_path / name))
        wide = "bodies (120 x 30 x 7), images (120 x 90 x 90), which have more than 64 values a row"
        assert f"; not read: {wide}" in str(raised.value)
        assert "; not read: time (" in str(raised.value)
        columns = "time=clock,position=bodies[140:143],quaternion=bodies[143:147]"
        assert_read(tmp_path / name, "--columns", columns)


@pytest.mark.parametrize("name", WRITERS)
def test_named_arrays_are_read_behind_many_others(tmp_path: Path, name: str) -> None:
    many = {f"v{i}": np.arange(120.0) for i in range(250)} | {"z_s": T, "zp": P}
    WRITERS[name](tmp_path / name, many | dict(zip(("q0", "q1", "q2", "q3"), Q.T, strict=True)))
    assert_read(tmp_path / name, "--columns", "time=z,position=zp,quaternion=q")
    with pytest.raises(ChoiceError, match=r"no column 'no'; .*; 5\d arrays after the first 200 are not"):
        open_log(str(tmp_path / name), table=reading_of(columns={"time": "no"}))


def test_arrays_that_are_not_read_are_counted(tmp_path: Path) -> None:
    pose = dict(zip(("x", "y", "z", "qx", "qy", "qz", "qw"), POSE.T, strict=True))
    np.savez(path := tmp_path / "a.npz", t=T, **pose, **{f"v{i}": T for i in range(250)})
    (log := open_log(str(path)), Poses.collect(log))
    assert log.remarks[-1].startswith("58 arrays after the first 200 are not read: name them by --columns")


@pytest.mark.parametrize("compression", ["lz4", "zstd", "uncompressed"])
def test_feather_is_read_like_parquet(tmp_path: Path, compression: str) -> None:
    path = str(tmp_path / "a.feather")
    table = {"time": pyarrow.array((T * 1e9).astype(np.int64), pyarrow.timestamp("ns"))}
    table |= {"pose": pyarrow.array([{"p": p, "q": q} for p, q in zip(P.tolist(), Q.tolist(), strict=True)])}
    feather.write_feather(pyarrow.table(table), path, compression=compression, chunksize=50)
    assert_read(Path(path), "--columns", "position=pose.p,quaternion=pose.q")


@pytest.mark.parametrize(("name", "start"), [("a.h5", b""), ("a.mat", b"MATLAB 7.3 MAT-file".ljust(512))])
def test_without_h5py_hdf5_is_refused_with_what_reads_it(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    name: str,
    start: bytes,
) -> None:
    (tmp_path / name).write_bytes(start + b"\x89HDF\r\n\x1a\n" + bytes(100))
    monkeypatch.setitem(sys.modules, "h5py", None)
    assert run(["info", str(tmp_path / name)]) == 1
    assert "it is HDF5: pip install h5py, with which it is read" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("ending", "kind"), [("npy", "f8"), ("npz", "f8"), ("h5", "f8"), ("npy", "M8[ns]"), ("npz", "M8[ns]")]
)
def test_fields_of_a_structured_array_are_columns(tmp_path: Path, ending: str, kind: str) -> None:
    """Also dates, which only NumPy stores."""
    pose = [(axis, "f8") for axis in "xyz"]
    table = np.zeros(len(T), [("time", kind), ("pose", pose), ("wxyz", "f8", 4)])
    table["time"] = np.rint(1e9 * T).astype("M8[ns]") if kind != "f8" else T
    table["pose"] = np.rec.fromarrays(P.T, dtype=table.dtype["pose"])
    table["wxyz"] = REAL_FIRST
    path = tmp_path / f"a.{ending}"
    if ending == "h5":
        write_hdf5(path, {"log": table})
    elif ending == "npz":
        np.savez(path, log=table)
    else:
        np.save(path, table)
    assert_read(path, "--columns", f"wxyz={'' if ending == 'npy' else 'log.'}wxyz")


def test_arrays_without_names_may_begin_with_the_time(tmp_path: Path) -> None:
    np.savez(path := tmp_path / "a.npz", T, P, Q)
    assert proposed(path) == ["--columns", "quaternion=arr_2,position=arr_1,time=arr_0"]
    assert_read(path, *proposed(path))


def test_names_of_pandas_with_several_levels(tmp_path: Path) -> None:
    levels = [*(("pos", axis) for axis in "xyz"), *(("quat", axis) for axis in "xyzw"), ("time", "")]
    table = pyarrow.table(dict(zip(map(str, levels), [*POSE.T, T], strict=True)))
    feather.write_feather(table, path := tmp_path / "a.feather")
    assert_read(path)


def test_texts_in_structured_arrays_name_bodies(tmp_path: Path) -> None:
    """As of a DataFrame, ``to_records``: rows of two bodies, whose names are text or bytes."""
    for kind in ("U3", "S3"):
        fields = [("time", "f8"), ("body", kind), *((name, "f8") for name in NAMES.split(","))]
        both = [
            (t, name, *row)
            for t, pose in zip(T, POSE, strict=True)
            for name, row in (("cup", pose), ("lid", pose + 1))
        ]
        np.save(tmp_path / "a.npy", np.array(both, fields))
        assert_read(tmp_path / "a.npy", frame="cup")
