"""Commands that messages propose are those of the user, with what names and values of columns allow."""

import json
import re
import shlex
import time
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow
import pytest
from pyarrow import parquet
from scipy.spatial.transform import Rotation

from contact_tracker import ContactTrackerWarning, Trajectory, read
from contact_tracker.cli.main import build_parser, run
from contact_tracker.config.table_reading import AS_NAMED
from contact_tracker.errors import UnreadableRecording, UsageError
from contact_tracker.motion.poses import Poses
from contact_tracker.recording import open_log
from contact_tracker.recording.table_proposals import layout_of_names
from pose_tables import commands


def refusal(path: Path, columns: str, values: str, *words: str) -> str:
    """Of a table with the same row again and again, by a command line."""
    path.write_text(f"t,x,y,z,{columns}\n" + "".join(f"{0.01 * i},1,2,3,{values}\n" for i in range(9)))
    args = build_parser().parse_args(list(words))
    with pytest.raises(UnreadableRecording) as raised:
        open_log(str(path), table=args.table)
    return str(raised.value)


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("segment a.csv -o out.png --states f-f,e-f", "segment a.csv -o out.png --states f-f,e-f"),
        ("segment --unit=mm -o 'a b.png' a.csv", "segment -o 'a b.png' a.csv --unit mm"),
        ("live a.csv --rate 2 --known map.toml --json", "live a.csv --rate 2 --known map.toml --json"),
        ("info a.csv --unit mm -v", "info a.csv -v --unit mm"),
        ("view a.csv b.csv --save x.rrd", "view a.csv b.csv --save x.rrd"),
        ("compare a.csv b.csv --time-unit ms -o x.png", "compare a.csv b.csv -o x.png --time-unit ms"),
    ],
)
def test_a_proposed_command_is_the_users_own(tmp_path: Path, words: str, expected: str) -> None:
    path = tmp_path / "a.csv"
    text = refusal(path, "roll,pitch,yaw", "170,2,3", *shlex.split(words))
    assert f"read them by contact-tracker {expected.format(path=path)} --euler xyz:deg." in text


def test_a_proposed_command_reads_files_whose_names_begin_with_a_dash(tmp_path: Path) -> None:
    text = refusal(tmp_path / "-a.csv", "roll,pitch,yaw", "170,2,3", "segment", "-v", "--", "-a.csv")
    command = "segment -v --euler xyz:deg -- -a.csv"
    assert f"read them by contact-tracker {command}." in text
    args = build_parser().parse_args(shlex.split(command))
    assert (args.table.euler, args.table.given) == ("xyz:deg", ("segment", "-v", "--", "-a.csv"))


@pytest.mark.parametrize(
    ("columns", "values", "ways"),
    [
        ("roll,pitch,yaw", "0.1,0.2,0.3", ["--euler xyz:deg", "--euler xyz:rad"]),
        ("roll,pitch,yaw", "0.1,-170,0.3", ["--euler xyz:deg"]),
        ("roll [rad],pitch [rad],yaw [rad]", "0.1,0.2,0.3", ["--euler xyz:rad"]),
        ("euler_x,euler_y,euler_z", "0.1,100,0.3", ["--euler xyz:deg"]),
        ("rx,ry,rz", "0.1,0.2,0.3", ["--rotation-vector", "--euler xyz:rad", "--euler xyz:deg"]),
        ("rx,ry,rz", "0.1,-170,0.3", ["--euler xyz:deg"]),
        ("rvec_x,rvec_y,rvec_z", "0.1,0.2,0.3", ["--rotation-vector"]),
        ("rvec_x,rvec_y,rvec_z", "0.1,-170,0.3", []),
    ],
)
def test_names_and_values_exclude_readings(
    tmp_path: Path, columns: str, values: str, ways: list[str]
) -> None:
    text = refusal(tmp_path / "a.csv", columns, values, "segment", "a.csv")
    commands = " or ".join(f"contact-tracker segment a.csv {way}" for way in ways)
    assert commands in text
    assert text.count("contact-tracker") == len(ways)
    assert ways or "as in 'rvec_x [deg]'" in text


@pytest.mark.parametrize(
    ("head", "words", "way"),
    [
        ("t,x,y,z,roll,pitch,yaw", "", "--unit mm --euler xyz:deg"),
        ("t,x,y,z,roll,pitch,yaw", "--euler ZYX", "--unit mm --euler ZYX:deg"),
        ("t,x,y,z,rx,ry,rz", "--euler ZYX", "--unit mm --euler ZYX:deg"),
        ("t,x,y,z,roll,pitch,yaw", "--unit cm", "--unit cm --euler xyz:deg"),
        ("frame,x [mm],y [mm],z [mm],roll,pitch,yaw", "", "--time-unit 100Hz --euler xyz:deg"),
        ("frame,x,y,z,roll,pitch,yaw", "", "--unit mm --time-unit 100Hz --euler xyz:deg"),
        (
            "",
            "",
            "--unit mm --time-unit 100Hz --euler xyz:deg --columns 'time=c0,position=c[1:4],rotation=c[4:7]'",
        ),
        ("", "--time-unit s --euler ZYX", "--unit mm --time-unit s --euler ZYX:deg --columns 'time=c0,"),
    ],
)
def test_one_command_says_all_that_is_not_known(tmp_path: Path, head: str, words: str, way: str) -> None:
    """Unit of positions, rate, order and unit of angles; what the user states stays."""
    path = tmp_path / "a.csv"
    path.write_text(csv(head, np.arange(9), 1e3 * PLACE, ZYX))
    with pytest.raises(UnreadableRecording) as raised:
        open_log(str(path), table=build_parser().parse_args(["segment", str(path), *words.split()]).table)
    assert f"read them by contact-tracker segment {path} {way}" in str(raised.value)
    assert ("your unit instead of mm (positions are about " in str(raised.value)) == ("--unit mm" in way)
    assert len(read_by(commands(path, *words.split())[0])) == 9


def read_by(command: str) -> Poses:
    words = shlex.split(command)
    return Poses.collect(open_log(words[1], table=build_parser().parse_args(words).table))


TURN = Rotation.random(9, rng=np.random.default_rng(5))
PLACE = np.random.default_rng(6).uniform(0.1, 0.9, (9, 3))
QUAT = TURN.as_quat()
ZYX = TURN.as_euler("ZYX", degrees=True)
STATE = np.hstack([np.zeros((9, 7)), PLACE, QUAT[:, [3, 0, 1, 2]], np.zeros((9, 6))])
MATRIX = np.dstack([TURN.as_matrix(), PLACE])
COLUMNS = np.swapaxes(np.hstack([MATRIX, np.tile([0.0, 0.0, 0.0, 1.0], (9, 1, 1))]), 1, 2)
SQUARE, NINE = ",".join(f"m{i}" for i in range(9)), COLUMNS[:, :3, :3].reshape(9, 9)


def csv(names: str, *values: Any) -> str:
    rows = [",".join(f"{value:.9g}" for value in row) for row in np.column_stack(values)]
    return "\n".join([*filter(None, [names]), *rows, ""])


@pytest.mark.parametrize(
    ("name", "text", "at"),
    [
        ("square.csv", csv(f"Ticks,x,y,z,{SQUARE}", 10.0 * np.arange(9), PLACE, NINE), 1),
        ("sim.npz", {"root_state": STATE[:, 7:]}, 1),
        ("sim.npz", {"time": 0.1 * np.arange(9), "qpos": STATE}, 1),
        ("poses.json", [{"t": 0.1 * i, "transform": one.tolist()} for i, one in enumerate(COLUMNS)], 0),
        ("state.parquet", np.hstack([PLACE, TURN.as_euler("xyz"), np.zeros((9, 1))]).tolist(), 1),
        ("matrices.parquet", COLUMNS.tolist(), 0),
        ("sim.npz", {"t": 0.1 * np.arange(9), "p": 1e3 * PLACE, "rpy": np.degrees(TURN.as_euler("xyz"))}, 0),
        ("structs.parquet", [{"p": [*a], "q": [*b]} for a, b in zip(PLACE, QUAT, strict=True)], 0),
    ],
)  # fmt: skip
def test_what_is_proposed_reads_the_poses(tmp_path: Path, name: str, text: Any, at: int) -> None:
    """Of systems with a prefix, of lists in which a pose is somewhere, of matrices by columns: the one of the
    commands that is right for the file."""
    path = tmp_path / f"take{{1}} {{b}} {name}"
    if name.endswith("npz"):
        np.savez(path, **text)
    elif name.endswith("parquet"):
        parquet.write_table(pyarrow.table({"timestamp": 0.1 * np.arange(9), "state": text}), path)
    else:
        path.write_text(text if isinstance(text, str) else json.dumps(text))
    poses = read_by(commands(path)[at])
    np.testing.assert_allclose(poses.position_m, PLACE, atol=1e-8)
    np.testing.assert_allclose(np.abs((poses.quat_xyzw * QUAT).sum(axis=1)), 1.0, atol=1e-8)


@pytest.mark.parametrize("lost", [0, 4])
@pytest.mark.parametrize("value", [0.0, np.nan])
@pytest.mark.parametrize(("before", "after"), [(0, 0), (0, 6), (7, 0)])
@pytest.mark.parametrize("ending", ["csv", "npz", "json"])
def test_a_lost_pose_makes_quaternions_nothing_else(
    tmp_path: Path, ending: str, before: int, after: int, value: float, lost: int
) -> None:
    """Nor does a pose at rest before the one that moves."""
    rows = np.hstack([PLACE, QUAT])
    rows[lost] = value
    table = np.hstack([np.tile([0, 0, 0, 0, 0, 0, 1.0], (9, 1))[:, :before], rows, np.zeros((9, after))])
    path = tmp_path / f"a.{ending}"
    if ending == "npz":
        np.savez(path, s=table)
    elif ending == "csv":
        path.write_text(csv(",".join(f"s{i}" for i in range(table.shape[1])), table))
    else:
        lists = [[] if np.isnan(value) and i == lost else row for i, row in enumerate(table.tolist())]
        path.write_text(json.dumps([{"s": row} for row in lists]))
    span = f"s[{before}:{before + 3}],quaternion=s[{before + 3}:{before + 7}]"
    assert f"--columns 'position={span}'" in commands(path)[0]


def test_lost_rows_hide_no_matrix_by_columns(tmp_path: Path) -> None:
    rows = np.where(np.arange(9)[:, None] == 3, np.nan, COLUMNS.reshape(9, 16))
    np.savez(path := tmp_path / "a.npz", T=rows)
    assert "--matrix columns" in commands(path)[0]
    path = tmp_path / "a.csv"
    path.write_text(csv("", 0.1 * np.arange(9), np.where(np.arange(9)[:, None] == 3, 0.0, rows)))
    assert "--matrix columns" in commands(path)[0]


def test_rows_that_are_all_lost_are_quaternions_by_their_number(tmp_path: Path) -> None:
    np.savez(path := tmp_path / "a.npz", s=np.zeros((9, 7)))
    assert "--columns 'position=s[0:3],quaternion=s[3:7]'" in commands(path)[0]


def test_the_call_proposed_for_a_table_in_memory_reads_it() -> None:
    table = dict(
        zip(["t", *(f"s_{i}" for i in range(6))], [0.1 * np.arange(9), *PLACE.T, *ZYX.T], strict=True)
    )
    with pytest.raises(UsageError, match="three angles") as raised:
        Trajectory.from_dataframe(table)
    call = re.search(r"Trajectory\.from_dataframe\(.*?\)(?= or|\.|$)", str(raised.value))
    assert call is not None
    poses = eval(call[0], {"Trajectory": Trajectory, "table": table}).poses
    np.testing.assert_allclose(poses.position_m, PLACE, atol=1e-8)


def test_columns_are_shown_by_their_own_numbers(tmp_path: Path) -> None:
    parquet.write_table(
        pyarrow.table(
            {"t": np.arange(9.0), "q[3]": PLACE[:, 0], "q[4]": PLACE[:, 0], "s": [[0.0] * 20_000] * 9}
        ),
        path := tmp_path / "a.parquet",
    )
    with pytest.raises(UnreadableRecording, match=r"among t, q\[3:5\], s\[0:64\], s\[64:20000\]: missing"):
        open_log(str(path))


@pytest.mark.parametrize("scale", [5, 16384])
def test_scaled_quaternions_are_equal(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], scale: float
) -> None:
    """Which are refused with the reason, whatever their norm."""
    path = tmp_path / "scaled.txt"
    rows = np.round(scale * QUAT)
    path.write_text(csv("", 0.1 * np.arange(9), PLACE, rows).replace(",", " "))
    run(["info", str(path)])
    assert "integers that stand for fractions" in capsys.readouterr().err


def test_angles_without_names_are_no_trajectory_of_quaternions(tmp_path: Path) -> None:
    path = tmp_path / "station.txt"
    path.write_text(csv("", np.ones(9), 1e2 * PLACE, ZYX, np.arange(9)).replace(",", " "))
    with pytest.raises(UnreadableRecording, match="8 columns have no names: say which they are, by number"):
        open_log(str(path))


@pytest.mark.parametrize("mark", ["_", ". ", "- "])
def test_names_of_many_marks_take_no_longer(mark: str) -> None:
    begin_s = time.process_time()
    with pytest.raises(UnreadableRecording):
        layout_of_names([f"{mark * 100}{i}" for i in range(300)], AS_NAMED)
    assert time.process_time() - begin_s < 1.0


def test_unwrapped_angles_that_exceed_a_turn_later_are_read_on(tmp_path: Path) -> None:
    turn = np.linspace(0.0, 7.0, 12000)
    rows = np.column_stack([0.01 * np.arange(12000), np.full((12000, 3), 0.2), turn, np.zeros((12000, 2))])
    np.savetxt(tmp_path / "a.csv", rows, "%.6g", ",", header="time [s],x,y,z,rx,ry,rz", comments="")
    with pytest.warns(ContactTrackerWarning, match="larger than a turn"):
        trajectory = read(tmp_path / "a.csv", euler="xyz:rad")
    assert len(trajectory) == 12000


KINDS = {"quaternion": "qx,qy,qz,qw", "angles": "rx,ry,rz", "matrix": "r11,r12,r13,r21,r22,r23,r31,r32,r33"}


@pytest.mark.parametrize(
    ("kind", "options", "message"),
    [
        ("quaternion", ["--euler", "xyz:deg"], "a quaternion (qx, qy, qz, qw): leave out --euler, which is"),
        ("quaternion", ["--rotation-vector"], "leave out --rotation-vector, which is not needed"),
        ("quaternion", ["--matrix", "rows"], "leave out --matrix, which is not needed"),
        ("angles", ["--matrix", "rows"], "give --euler XYZ:deg or --rotation-vector instead of --matrix"),
        ("matrix", ["--euler", "xyz:deg"], "a matrix (r11, r12, r13, r21"),
        ("matrix", ["--rotation-vector"], "give --matrix rows instead of --rotation-vector"),
    ],
)
def test_a_rotation_of_another_kind_than_stated_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], kind: str, options: list[str], message: str
) -> None:
    path, count = tmp_path / "a.csv", 4 + len(KINDS[kind].split(","))
    lines = [f"t,x,y,z,{KINDS[kind]}", *(",".join([f"{0.1 * i:.1f}"] * count) for i in range(1, 9))]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    assert run(["info", str(path), *options]) == 2
    assert message in capsys.readouterr().err
