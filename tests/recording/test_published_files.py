"""Files as people publish them: headers as in public repositories, with the poses of the tests."""

import json
import re
import shlex
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import savemat

from contact_tracker import Trajectory
from contact_tracker.cli.main import build_parser
from contact_tracker.errors import NoTruth, UnreadableRecording, UsageError
from contact_tracker.motion.poses import Poses
from contact_tracker.recording import list_sources, open_log
from contact_tracker.recording.annotations import read_labels
from contact_tracker.recording.table_proposals import FIRST_ROWS
from contact_tracker.recording.table_times import unit_of
from pose_tables import (
    DEGREES,
    MATRICES,
    NAMES,
    P_MM,
    POSE,
    REAL_FIRST,
    SINCE_NS,
    TURN,
    WHOLE,
    P,
    Q,
    T,
    assert_read,
    commands,
    proposed,
    rows,
    write,
)

COUNT = len(T)
NS = list(map(str, SINCE_NS.tolist()))
US = [repr(ns / 1e3) for ns in SINCE_NS.tolist()]
TWO_BODIES = Path(__file__).with_name("two_bodies.c3d")
ZEROS = np.zeros((COUNT, 6))
KUKA = TURN.as_euler("ZYX", degrees=True)
NINE = "R11,R12,R13,R21,R22,R23,R31,R32,R33"


def named(prefix: str, names: str) -> str:
    return ",".join(prefix + name for name in names.split(","))


def test_frames_of_a_transform_in_the_names(tmp_path: Path) -> None:
    """As in data sets of Project Aria: translation and quaternion of the object in the world, by object."""
    head = "object_uid,timestamp[ns],t_wo_x[m],t_wo_y[m],t_wo_z[m],q_wo_w,q_wo_x,q_wo_y,q_wo_z"
    cup = rows(["2233"] * COUNT, NS, P, REAL_FIRST)
    tray = rows(["3778"] * COUNT, NS, P + 1.0, REAL_FIRST)
    assert_read(write(tmp_path / "one.csv", [head], cup))
    both = write(tmp_path / "a.csv", [head], [row for pair in zip(cup, tray, strict=True) for row in pair])
    assert sorted(source.child_frame_id for source in list_sources(str(both))) == ["2233", "3778"]
    assert_read(both, frame="2233")


def test_frames_after_the_names_of_the_parts(tmp_path: Path) -> None:
    """As trajectories of Project Aria, which have poses in several frames, and other vectors."""
    parts = "tx,ty,tz,qx,qy,qz,qw"
    of_world, of_earth = (
        ",".join(f"{part}_{frame}_device" for part in parts.split(",")) for frame in ("world", "ecef")
    )
    velocity = "device_linear_velocity_x_device,angular_velocity_x_device,gravity_x_world,quality_score"
    head = f"graph_uid,tracking_timestamp_us,utc_timestamp_ns,{of_world},{velocity}"
    lines = rows(["f27"] * COUNT, US, ["-1"] * COUNT, POSE, ZEROS[:, :4])
    path = write(tmp_path / "closed_loop.csv", [head], lines)
    assert proposed(path) == ["--columns", "time=tracking_timestamp_us"]
    assert_read(path, *proposed(path))
    path = write(
        tmp_path / "geo.csv",
        [f"{head},{of_earth}"],
        [a + b for a, b in zip(lines, rows(POSE + 1.0), strict=True)],
    )
    assert_read(path, "--columns", "time=tracking_timestamp_us", frame="world_device")


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("", "x_std,y_std,z_std,qx_std,qy_std,qz_std,qw_std"),
        ("", "tx_error,ty_error,tz_error,qx_error,qy_error,qz_error,qw_error"),
        ("t_goal_x,t_goal_y,t_goal_z", ""),
        ("tool.t_lin_x,tool.t_lin_y,tool.t_lin_z", ""),
    ],
)
def test_other_vectors_beside_a_pose_are_no_body(tmp_path: Path, before: str, after: str) -> None:
    """Deviations, errors, goals and velocities."""
    head = ",".join(filter(None, ["time", before, "x,y,z,qx,qy,qz,qw", after]))
    others = [names and np.ones((COUNT, len(names.split(",")))) for names in (before, after)]
    parts = [T, others[0], POSE, others[1]]
    path = write(tmp_path / "a.csv", [head], rows(*(part for part in parts if not isinstance(part, str))))
    assert len(list_sources(str(path))) == 1
    assert_read(path)


def test_two_transforms_with_frames_in_the_names_are_two_bodies(tmp_path: Path) -> None:
    names = [f"t_{body}_{axis}" for body in ("cam", "obj") for axis in "xyz"]
    names += [f"q_{body}_{part}" for body in ("cam", "obj") for part in ("x", "y", "z", "w")]
    path = write(tmp_path / "a.csv", [",".join(["time", *names])], rows(T, P + 1.0, P, Q, Q))
    assert sorted(source.child_frame_id for source in list_sources(str(path))) == ["cam", "obj"]
    assert_read(path, frame="obj")


def test_matrices_of_surgical_robots(tmp_path: Path) -> None:
    """Positions and matrices of several arms, without a time, as published tables of JIGSAWS name them."""
    arms = "MASTER_LEFT_", "SLAVE_LEFT_"
    head = ",".join(
        named(
            arm,
            f"POS_X,POS_Y,POS_Z,{named('ROT_', NINE)},LIN_VEL_X,LIN_VEL_Y,LIN_VEL_Z,"
            "ROT_VEL_X,ROT_VEL_Y,ROT_VEL_Z",
        )
        for arm in arms
    )
    path = write(tmp_path / "a.csv", [head], rows(P + 1.0, MATRICES, ZEROS, P, MATRICES, ZEROS))
    assert proposed(path) == ["--time-unit", "100Hz", "--matrix", "rows"]
    assert_read(path, "--time-unit", "200Hz", "--matrix", "rows", frame="slave_left")


@pytest.mark.parametrize("kinds", [("RIst", "RSol"), ("RSol", "RIst")])
def test_actual_and_commanded_poses_of_kuka(tmp_path: Path, kinds: tuple[str, str]) -> None:
    """As RSI names them, beside corrections that are constant; the order of columns decides nothing."""
    head = ",".join(["Time", *(f"{part}_{kind}" for kind in kinds for part in "XYZABC")])
    head += "," + ",".join(f"C1{i}" for i in range(1, 11))
    idle = np.tile([0, 0, 0, 0, 0, 0, 0, 0, 1.0, 0], (COUNT, 1))
    places = [P_MM if kind == "RIst" else P_MM + 5.0 for kind in kinds]
    path = write(tmp_path / "a.csv", [head], rows(T, places[0], KUKA, places[1], KUKA, idle))
    assert "if its columns are those of KUKA, read them by" in refusal(path)
    assert_read(path, *proposed(path))


def refusal(path: Path) -> str:
    with pytest.raises(UnreadableRecording) as raised:
        open_log(str(path), table=build_parser().parse_args(["segment", str(path)]).table)
    return str(raised.value)


def test_joints_are_not_proposed_as_poses(tmp_path: Path) -> None:
    """Of JointState as rostopic echo -p writes it; names are text, and the others are of joints."""
    kinds = ("name", "position", "velocity", "effort")
    head = "%time,field.header.seq," + ",".join(f"field.{kind}{i}" for kind in kinds for i in range(6))
    names = [[f"joint_{i}" for i in range(6)]] * COUNT
    lines = [
        a + b + c
        for a, b, c in zip(
            rows(NS, np.arange(COUNT)), names, rows(ZEROS + POSE[:, :6], ZEROS, ZEROS), strict=True
        )
    ]
    text = refusal(write(tmp_path / "joints.csv", [head], lines))
    assert "no columns of a pose among" in text
    assert "read them by" not in text


def test_poses_beside_joints_are_those_of_kuka(tmp_path: Path) -> None:
    """A few hand poses in JSON: no time is guessed of three rows, and joints are no pose."""
    entries = [
        {"joints": dict(zip([f"A{i}" for i in range(7)], np.arange(7.0) + i, strict=True)), "pose": pose}
        for i, pose in enumerate(
            dict(zip("xyzABC", [*p, *a], strict=True))
            for p, a in zip(P_MM[:3].tolist(), np.sort(KUKA[:3], axis=0).tolist(), strict=True)
        )
    ]
    path = tmp_path / "poses.json"
    path.write_text(json.dumps(entries))
    words = proposed(path)
    assert words == [
        "--unit",
        "mm",
        "--time-unit",
        "100Hz",
        "--euler",
        "ZYX:deg",
        "--columns",
        "rz=pose.A,ry=pose.B,rx=pose.C",
    ]
    table = build_parser().parse_args(["segment", str(path), *words]).table
    np.testing.assert_allclose(Poses.collect(open_log(str(path), table=table)).position_m, P[:3], atol=1e-12)


def test_names_of_devices_and_dates_before_unnamed_values(tmp_path: Path) -> None:
    """As scripts of Lighthouse write them: device, time, position, and the matrix by rows."""
    since = [f"2024-02-16 17:26:{30 + ns / 1e9:.9f}" for ns in SINCE_NS.tolist()]
    tracker, other = (
        rows([name] * COUNT, since, place, MATRICES)
        for name, place in (("tracker_1", P), ("tracker_2", P + 1.0))
    )
    path = write(tmp_path / "a.csv", [], [row for pair in zip(tracker, other, strict=True) for row in pair])
    words = proposed(path)
    assert words == ["--matrix", "rows", "--columns", "position=c[2:5],matrix=c[5:14],time=c1"]
    assert_read(path, *words, frame="tracker_1")


def test_a_name_before_unnamed_angles(tmp_path: Path) -> None:
    path = write(
        tmp_path / "a.csv", [], rows([f"v{i}" for i in range(COUNT)], P, TURN.as_euler("xyz", degrees=True))
    )
    words = [word.replace("100Hz", "200Hz") for word in proposed(path)]
    assert "its 7 columns have no names: if its rotations are c4, c5, c6, three angles: read" in refusal(path)
    assert words == [
        "--time-unit",
        "200Hz",
        "--euler",
        "xyz:deg",
        "--columns",
        "position=c[1:4],rotation=c[4:7]",
    ]
    assert_read(path, *words)


def test_a_name_says_that_the_real_part_is_first(tmp_path: Path) -> None:
    path = tmp_path / "hands.jsonl"
    lines = [
        json.dumps({"timestamp_ns": ns, "wrist": {"q_wxyz": q, "t_xyz": p}})
        for ns, q, p in zip(SINCE_NS.tolist(), REAL_FIRST.tolist(), P.tolist(), strict=True)
    ]
    path.write_text("\n".join(lines) + "\n")
    assert len(commands(path)) == 1
    assert_read(path, *proposed(path))


def test_the_proposal_for_results_of_bop_has_one_comma(tmp_path: Path) -> None:
    cells = [[" ".join(map(repr, row)) for row in v.reshape(COUNT, -1).tolist()] for v in (MATRICES, P_MM)]
    lines = rows(["59"] * COUNT, [str(i) for i in range(COUNT)], ["18"] * COUNT, *cells, ["0.1"] * COUNT)
    path = write(tmp_path / "a.csv", ["scene_id,im_id,obj_id,R,t,time"], lines)
    assert "if its columns are those of BOP, at 30 frames a second, read them by" in refusal(path)


def test_objects_that_are_found_twice_in_some_images_are_bodies(tmp_path: Path) -> None:
    """As in results of BOP, which have several estimates; each image has most objects once."""
    columns = "scene_id,im_id,obj_id,x [mm],y [mm],z [mm],qx,qy,qz,qw"
    lines, rng = list[list[str]](), np.random.default_rng(1)
    for i, (place, quat) in enumerate(zip(rows(P_MM), rows(Q), strict=True)):
        for body in ["5", "7", "18", *(["18"] if i % 5 == 1 else [])]:
            elsewhere = list(map(str, rng.uniform(-9e3, 9e3, 3).tolist()))
            lines.append(["59", str(i), body, *(place if body == "5" else elsewhere), *quat])
    path = write(tmp_path / "a.csv", [columns], lines)
    assert_read(path, "--time-unit", "200Hz", "--columns", "time=im_id", frame="5")


ABOVE = "NO_OF_FRAMES\t120\nNO_OF_CAMERAS\t10\n{}\nFREQUENCY\t200\nDESCRIPTION\t--\nTIME_STAMP\t2024-05-14\n"
NAMES_6D = "X\tY\tZ\tRoll\tPitch\tYaw\tResidual\t" + "\t".join(f"Rot[{i}]" for i in range(9))


@pytest.mark.parametrize("is_prefixed", [False, True])
def test_bodies_of_qualisys(tmp_path: Path, is_prefixed: bool) -> None:
    """Several bodies have columns of the same names; newer versions write the body before each name."""
    heads = [
        "\t".join(f"{body} {name}" for name in NAMES_6D.split("\t")) if is_prefixed else NAMES_6D
        for body in ("Wand", "Big Cup")
    ]
    above = ABOVE.format("NO_OF_BODIES\t2") + "DATA_INCLUDED\t6D\nBODY_NAMES\tWand\tBig Cup"
    body = MATRICES.transpose(0, 2, 1)
    lines = rows(np.arange(COUNT), T, P_MM + 9.0, ZEROS[:, :4], body, P_MM, ZEROS[:, :4], body)
    path = write(tmp_path / "take_6d.tsv", [above, "\t".join(["Frame", "Time", *heads])], lines, "\t")
    assert len(list_sources(str(path))) == 2
    for stated in ([], ["--matrix", "columns"], ["--columns", "time=Time"]):
        assert_read(path, *stated, frame="big_cup")
    table = build_parser().parse_args(["segment", str(path), "--euler", "xyz:deg"]).table
    angles = Poses.collect(open_log(str(path), frame="big_cup", table=table))
    np.testing.assert_allclose(angles.position_m, P, atol=1e-9)  # in millimetres all the same


def test_stated_angles_of_qualisys_are_beside_millimetres(tmp_path: Path) -> None:
    """A check may propose other columns of angles; the unit of the format stays."""
    above = ABOVE.format("NO_OF_BODIES\t1") + "DATA_INCLUDED\t6D\nBODY_NAMES\tWand"
    angles = TURN.as_euler("ZXY", degrees=True)[:, [1, 2, 0]]
    columns = np.arange(COUNT), T, P_MM, angles, ZEROS[:, :1], MATRICES
    path = write(tmp_path / "a.tsv", [above, f"Frame\tTime\t{NAMES_6D}"], rows(*columns), "\t")
    assert_read(path, "--euler", "ZXY:deg", "--columns", "rx=Roll,ry=Pitch,rz=Yaw")


def test_markers_of_qualisys_are_refused_as_such(tmp_path: Path) -> None:
    above = (
        ABOVE.format("NO_OF_MARKERS\t2")
        + "DATA_INCLUDED\t3D\nMARKER_NAMES\tra\tlk\nTRAJECTORY_TYPES\tMeasured\tMeasured"
    )
    head = "\t".join(["Frame", "Time", *(f"{name} {axis}" for name in ("ra", "lk") for axis in "XYZ")])
    path = write(tmp_path / "a.tsv", [above, head], rows(np.arange(COUNT), T, P_MM, P_MM), "\t")
    assert re.search(r"it has markers \(ra, lk.*\), not bodies: export 6D data", refusal(path))


def test_positions_alone_are_no_matrices(tmp_path: Path) -> None:
    path = write(tmp_path / "a.txt", [], rows(P), " ")
    assert "its 3 columns have no names" in refusal(path)


def test_a_mark_in_a_name_separates_nothing(tmp_path: Path) -> None:
    """As where angles have several names."""
    head = "time,Roll | Phi | X (deg),Pitch | Theta | Y (deg),Yaw | Psi | Z (deg),px,py,pz"
    path = write(tmp_path / "a.csv", [head], rows(T, TURN.as_euler("xyz", degrees=True), P))
    names = [part.strip() for part in head.split(",")[1:4]]
    columns = ",".join(f"{role}={name}" for role, name in zip(("rx", "ry", "rz"), names, strict=True))
    assert_read(path, "--euler", "xyz:deg", "--columns", columns)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("readme.txt", "Author: somebody\n\nThis data set has 330 trajectories of a cup.\nIt is public.\n"),
        ("app.log", "06/08/2021 08:47:36 AM INFO:Starting application\n06/08/2021 09:02:23 AM INFO:done\n"),
        (
            "posts.csv",
            "MsgID,Timestamp,Author,Body\n'i4f','2022-04-12 05:57:29','me','It is 1 of 2, I say'\n",
        ),
    ],
)
def test_text_is_called_text(tmp_path: Path, name: str, text: str) -> None:
    (tmp_path / name).write_text(text * 3)
    assert "it is text without rows of numbers, not a table of poses" in refusal(tmp_path / name)


def test_models_of_torch_are_pickles(tmp_path: Path) -> None:
    old, new = tmp_path / "0.pt", tmp_path / "1.pt"
    old.write_bytes(b"\x80\x02\x8a\nl\xfc\x9cF\xf9 j\xa8P\x19.")
    with zipfile.ZipFile(new, "w") as archive:
        archive.writestr("archive/data.pkl", b"\x80\x02}q\x00.")
    for path in (old, new):
        assert "it is a pickle, which runs code" in refusal(path)


def test_orientations_alone_are_no_positions(tmp_path: Path) -> None:
    """As inertial sensors write them; with a position the example says how it is read."""
    path = write(tmp_path / "imu.csv", ["Time (s),W,X,Y,Z"], rows(T, REAL_FIRST))
    assert "its W, X, Y, Z look like a quaternion without a position" in refusal(path)
    path = write(tmp_path / "a.csv", ["Time (s),W,X,Y,Z,east,north,up"], rows(T, REAL_FIRST, P))
    columns = re.search(r"--columns (\S+)", refusal(path))
    assert columns is not None
    assert_read(path, "--columns", columns[1].replace("x=a,y=b,z=c", "x=east,y=north,z=up"))


def test_logs_of_px4(tmp_path: Path) -> None:
    """The log itself, and vehicle_odometry of it, now and of older versions; w is first."""
    (tmp_path / "log.ulg").write_bytes(b"ULog\x01\x12\x35\x01" + bytes(99))
    assert "it is ULog of PX4: ulog2csv log.ulg" in refusal(tmp_path / "log.ulg")
    for place in ("position[0],position[1],position[2]", "x,y,z"):
        head = f"timestamp,timestamp_sample,{place},q[0],q[1],q[2],q[3],velocity[0],velocity[1],velocity[2]"
        path = write(tmp_path / "odometry.csv", [head], rows(US, US, P, REAL_FIRST, ZEROS[:, :3]))
        assert len(commands(path)) == 1
        assert_read(path, *proposed(path))


def test_labels_in_xml_have_a_remedy(tmp_path: Path) -> None:
    path = tmp_path / "take.eaf"
    path.write_text(
        '<?xml version="1.0" encoding="UTF-8"?>\n<ANNOTATION_DOCUMENT AUTHOR="">\n</ANNOTATION_DOCUMENT>\n'
    )
    assert "it is XML or HTML, not a table of poses" in refusal(path)
    with pytest.raises(NoTruth, match="it is XML: export it as tab-delimited text"):
        read_labels(str(path), 0, 1)


def test_objects_of_matlab_are_named(tmp_path: Path) -> None:
    """A table is stored as an object, whose values are bytes without a name."""
    path = tmp_path / "table.mat"
    savemat(path, {"x": np.zeros(9, np.uint8)})
    content = bytearray(path.read_bytes())
    at = content.index(b"\x06\0\0\0\x08\0\0\0") + 8
    content[at] = 17  # the class of objects, which have names instead of a shape
    content[at + 8 : at + 16] = b"\1\0\4\0MCOS"
    path.write_bytes(content)
    assert "it has no array of numbers with a row for each pose; tables, timetables" in refusal(path)


def test_coordinates_of_maps_have_a_remedy(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write(
        tmp_path / "odom.csv",
        ["Time,pose.x,pose.y,pose.z,qx,qy,qz,qw"],
        rows(T, P + np.array([5e5, 3.5e6, 7e2]), Q),
    )
    log = open_log(str(path))
    Poses.collect(log)
    assert "Subtract a constant from coordinates of a map (UTM)" in "\n".join(log.warnings)


def test_matrices_that_are_scaled_are_named(tmp_path: Path) -> None:
    path = tmp_path / "transforms.npy"
    whole = np.tile(np.eye(4), (COUNT, 1, 1))
    whole[:, :3, :3], whole[:, :3, 3] = 1e-3 * MATRICES, P
    np.save(path, whole)
    words = shlex.split(f"segment {path} --matrix rows --columns matrix=c --time-unit 30Hz")
    log = open_log(str(path), table=build_parser().parse_args(words).table)
    Poses.collect(log)
    assert "matrices are no rotations" in "\n".join(log.warnings)


def test_slow_dates_that_may_be_a_time_since_the_start_are_said() -> None:
    """951412773297707 ns since the start of a computer would be a date in microseconds, every 8 s."""
    unit, doubt = unit_of(951412773297707.0 + 8e6 * np.arange(20))
    assert unit == "us"
    assert doubt is not None
    assert "if they are nanoseconds since another time, give --time-unit ns" in doubt
    assert unit_of(1.7e15 + 8e3 * np.arange(20)) == ("us", None)
    assert unit_of(1.7e15 + 2e6 * np.arange(20)) == ("us", None)  # 11 days since a start would be less
    assert unit_of(1.5e9 + 1.4 * np.arange(20)) == ("s", None)  # of maps, a pose a second


def test_markers_in_the_numbers_of_another_machine_are_called_markers(tmp_path: Path) -> None:
    """As C3D of Motive, with the fractions of DEC, whose bodies would not be read."""
    content = bytearray(TWO_BODIES.read_bytes())
    content[512 * (content[0] - 1) + 3] = 85
    path = tmp_path / "a.c3d"
    path.write_bytes(content)
    assert "its numbers are not those of a PC" in refusal(path)
    path.write_bytes(content.replace(b"ROTATION", b"ROTATIOX"))
    assert "it is C3D with markers (tip), not bodies" in refusal(path)


TIME = np.round(1e3 * T)


def beside(form: str, *bodies: str) -> str:
    return ",".join(form.replace("{}", "{0}").format(body) for body in bodies)


GIVEN_KUKA = np.hstack([P_MM + 5.0, KUKA])
OTHER_REAL_FIRST = np.hstack([P_MM + 5.0, REAL_FIRST])
DATES = [f"2024-05-14 10:22:{31 + ns / 1e9:.9f}" for ns in SINCE_NS.tolist()]
ONE_DATE = ["2024-05-14 10:22:31"] * COUNT


@pytest.mark.parametrize(
    ("head", "columns"),
    [
        (f"time,{beside('X_{},Y_{},Z_{},A_{},B_{},C_{}', 'RSol', 'RIst')}", [T, GIVEN_KUKA, P_MM, KUKA]),
        (f"time,{beside('{0}_X,{0}_Y,{0}_Z,{0}_A,{0}_B,{0}_C', 'cmd', 'act')}", [T, GIVEN_KUKA, P_MM, KUKA]),
        (f"time,{beside('{0}X,{0}Y,{0}Z,{0}A,{0}B,{0}C', 'RSol.', 'RIst.')}", [T, GIVEN_KUKA, P_MM, KUKA]),
        (f"seqno,tm,{beside('{0}x,{0}y,{0}z,{0}u0,{0}u1,{0}u2,{0}u3', 'planned.', 'feedback.')}",
         [np.arange(COUNT), TIME, OTHER_REAL_FIRST, P_MM, REAL_FIRST]),
        (f"t,{beside('{0}[0],{0}[1],{0}[2],{0}[3],{0}[4],{0}[5]', 'target_TCP_pose', 'actual_TCP_pose')}",
         [T, P + 1.0, ZEROS[:, :3], P, TURN.as_rotvec()]),
        (f"t,{beside('{0}[0],{0}[1],{0}[2],{0}[3],{0}[4],{0}[5]', 'CMD', 'plane')}",
         [T, P + 1.0, ZEROS[:, :3], P, TURN.as_rotvec()]),
        ("frame,capture_time,x,y,z,roll,pitch,yaw", [np.arange(COUNT), T, P, DEGREES]),
        ("frame,when,x,y,z,qx,qy,qz,qw", [np.arange(COUNT), DATES, POSE]),
        ("frame,created,x,y,z,qx,qy,qz,qw", [np.arange(COUNT), ONE_DATE, POSE]),
        (",x,y,z,qx,qy,qz,qw", [DATES, POSE]),
        ("Frame#,X(in),Y(in),Z(in),Az,El,Roll", [np.arange(COUNT), P / 0.0254, KUKA]),
        ("time,x,y,z,q1,q2,q3,q4", [T, P, REAL_FIRST]),
        ("t,tx,ty,tz,rx,ry,rz,rw", [T, POSE]),
        (f"sim_time,{named('/World/Cube:translate:', 'x,y,z')},{named('/World/Cube:orient:', 'w,x,y,z')}",
         [T, P, REAL_FIRST]),
        ("frame,translateX [cm],translateY [cm],translateZ [cm],rotateX,rotateY,rotateZ",
         [np.arange(COUNT), 1e2 * P, DEGREES]),
    ],
)  # fmt: skip
def test_what_is_proposed_for_names_of_programs_is_right(
    tmp_path: Path, head: str, columns: list[Any]
) -> None:
    """Measured poses, not those commanded; a time that rises, not numbers of frames; units of the names."""
    path = write(tmp_path / "a.csv", [head], rows(*columns))
    assert_read(path, *(word.replace("100Hz", "200Hz") for word in proposed(path)))


@pytest.mark.parametrize(
    ("head", "columns"),
    [
        ("time," + named("xpos_", "x,y,z") + "," + named("xquat_", "w,x,y,z"), [T, P, REAL_FIRST]),
        (f"step,time,{named('base_pos_', 'x,y,z')},{named('base_orn_', 'x,y,z,w')}",
         [np.arange(COUNT), T, POSE]),
        *((f"time,x{mm},y{mm},z{mm},qx,qy,qz,qw", [T, P_MM, Q])
          for mm in ("/mm", " / mm", " in mm", ": mm", " {mm}", " <mm>", " mm", "mm", "_millimeters")),
        ("sec,msec,x,y,z,qx,qy,qz,qw", [["0"] * COUNT, 1e3 * T, POSE]),
        ("sec,msec,x,y,z,qx,qy,qz,qw", [T, 1e3 * T, POSE]),
        ("wait time ms,time ms,x,y,z,qx,qy,qz,qw", [ZEROS[:, 0], 1e3 * T, POSE]),
        ("sec,frame_msec,nsec,x,y,z,qx,qy,qz,qw", [["0"] * COUNT, np.ones(COUNT), NS, POSE]),
        ("time,x,y,z,qx,qy,qz,qw", [[f"20240514_1022{31 + t:09.6f}" for t in T], POSE]),
    ],
)  # fmt: skip
def test_names_and_times_of_programs_are_read(tmp_path: Path, head: str, columns: list[Any]) -> None:
    assert_read(write(tmp_path / "a.csv", [head], rows(*columns)))


def test_stated_columns_go_with_the_position_of_their_body(tmp_path: Path) -> None:
    head = "t," + ",".join(named(body, "x,y,z,q0,q1,q2,q3") for body in ("ref.", "act."))
    path = write(tmp_path / "a.csv", [head], rows(T, P + 1.0, REAL_FIRST, P, REAL_FIRST))
    assert_read(path, "--columns", "qw=act.q0,qx=act.q1,qy=act.q2,qz=act.q3")


def test_a_position_beside_w_may_have_angles(tmp_path: Path) -> None:
    path = write(tmp_path / "a.csv", ["t,x,y,z,w,h"], rows(T, P, ZEROS[:, :2]))
    assert "or, with angles beside the position x, y, z, as in --columns rx=a,ry=b,rz=c" in refusal(path)


@pytest.mark.parametrize("head", ["Frame\t", ""])
@pytest.mark.parametrize("options", [[], ["--matrix", "columns"], ["--time-unit", "200Hz"]])
def test_qualisys_without_times_has_its_rate(tmp_path: Path, head: str, options: list[str]) -> None:
    above = ABOVE.format("NO_OF_BODIES\t1") + "DATA_INCLUDED\t6D\nBODY_NAMES\tWand"
    columns = [np.arange(COUNT)] * bool(head) + [P_MM, ZEROS[:, :4], MATRICES.transpose(0, 2, 1)]
    assert_read(write(tmp_path / "a.tsv", [above, head + NAMES_6D], rows(*columns), "\t"), *options)


@pytest.mark.parametrize(
    "content",
    [
        {"time": T.tolist(), "position": P.T.tolist(), "quaternion": Q.T.tolist()},
        {f"{t:.9f}": {"position": p.tolist(), "quaternion": q.tolist()}
         for t, p, q in zip(T, P, Q, strict=True)},
        [{"time": t, "position": p.tolist(), "rotation": m.tolist()}
         for t, p, m in zip(T, P, MATRICES, strict=True)],
    ],
)  # fmt: skip
def test_json_row_by_row_by_times_and_with_matrices(tmp_path: Path, content: Any) -> None:
    path = tmp_path / "a.json"
    path.write_text(json.dumps(content))
    assert_read(path, *proposed(path))


def test_a_name_that_occurs_again_is_no_time(tmp_path: Path) -> None:
    """As the parts of a quaternion, which may rise, below names of groups."""
    path = write(tmp_path / "a.csv", ["pos,pos,pos,rot,rot,rot,rot", "x,y,z,x,y,z,w"], rows(POSE))
    assert_read(path, *(word.replace("100Hz", "200Hz") for word in proposed(path)))


def test_matrices_as_numpy_prints_them(tmp_path: Path) -> None:
    cells = [str(matrix).replace("\n", "") for matrix in np.dstack([MATRICES, P])]
    path = write(tmp_path / "a.csv", ["time,T"], rows(T, [f'"{cell}"' for cell in cells]))
    assert proposed(path) == ["--matrix", "rows", "--columns", "matrix=T"]


def test_lost_poses_with_angles_are_counted(tmp_path: Path) -> None:
    """As marked by one large number in all columns."""
    lines = rows(T, P, TURN.as_euler("xyz", degrees=True))
    lines[5][1:] = ["9999"] * 6
    path = write(tmp_path / "a.csv", ["time,x,y,z,roll,pitch,yaw"], lines)
    log = open_log(
        str(path), table=build_parser().parse_args(["segment", str(path), "--euler", "xyz:deg"]).table
    )
    assert Poses.collect(log).position_m.max() < 1.0
    assert dict(log.counts) == {"nonfinite": 1}


@pytest.mark.parametrize(
    ("column", "bodies", "is_grouped"),
    [
        ("hand", ["left", "right"], False),
        ("hand", ["left", "right"], True),
        ("what", ["cup", "lid"], False),
        ("marker_id", ["7", "8"], True),
    ],
)
def test_rows_of_several_bodies_are_sources(
    tmp_path: Path, column: str, bodies: list[str], is_grouped: bool
) -> None:
    """Row by row, or one body after the other."""
    both = [rows(T, [body] * COUNT, P + i, Q) for i, body in enumerate(bodies)]
    lines = [*both[0], *both[1]] if is_grouped else [row for pair in zip(*both, strict=True) for row in pair]
    path = write(tmp_path / "a.csv", [f"time,{column},x,y,z,qx,qy,qz,qw"], lines)
    assert sorted(source.child_frame_id for source in list_sources(str(path))) == bodies
    assert_read(path, frame=bodies[0])


@pytest.mark.parametrize(
    ("column", "texts"),
    [
        ("object", ["none", "cup"]),
        ("hand", ["open", "closed"]),
        ("phase_id", ["0", "1"]),
        ("target", ["none", "slot"]),
    ],
)
def test_text_that_changes_while_time_goes_on_names_no_other_body(
    tmp_path: Path, column: str, texts: list[str]
) -> None:
    """As the object in a hand, or the step of a task."""
    first = FIRST_ROWS + 10
    cells = np.repeat(texts, [first, COUNT - first]).tolist()
    assert_read(write(tmp_path / "a.csv", [f"time,{column},x,y,z,qx,qy,qz,qw"], rows(T, cells, POSE)))
    table = dict(zip(NAMES.split(","), POSE.T, strict=True)) | {"time": T, column: cells}
    assert len(Trajectory.from_dataframe(table)) == COUNT
    restarting = table | {"time": np.r_[T[:first], T[: COUNT - first]]}
    with pytest.raises(UsageError, match="several bodies"):
        Trajectory.from_dataframe(restarting)


def test_the_names_of_parent_frames_and_steps_are_no_bodies(tmp_path: Path) -> None:
    steps = ["grasp"] * 60 + ["place"] * 60
    head = "time,header.frame_id,step,x,y,z,qx,qy,qz,qw"
    path = write(tmp_path / "a.csv", [head], rows(T, ["world"] * COUNT, steps, POSE))
    assert [source.child_frame_id for source in list_sources(str(path))] == [""]


@pytest.mark.parametrize(
    ("column", "text", "name"),
    [
        ("phase_id", "0", ""),
        ("operator", "me", ""),
        ("label", "f-f", ""),
        ("object_id", "7", "7"),
        ("object", "cup", "cup"),
    ],
)
def test_a_column_that_does_not_change_names_the_source_only_if_it_is_of_bodies(
    tmp_path: Path, column: str, text: str, name: str
) -> None:
    path = write(tmp_path / "a.csv", [f"time,{column},x,y,z,qx,qy,qz,qw"], rows(T, [text] * COUNT, POSE))
    assert [source.child_frame_id for source in list_sources(str(path))] == [name]


@pytest.mark.parametrize("is_document", [False, True])
def test_objects_in_a_list_are_known_by_their_names(tmp_path: Path, is_document: bool) -> None:
    """Their places change, and each may be missing."""
    entries = []
    for i, (t, p, q) in enumerate(zip(T.tolist(), P.tolist(), Q.tolist(), strict=True)):
        place, turn = dict(zip("xyz", p, strict=True)), dict(zip("xyzw", q, strict=True))
        cup = {"name": "cup", "position": place, "orientation": turn}
        lid = cup | {"name": "lid", "position": dict(zip("xyz", [1.0, i, 1.0], strict=True))}
        entries.append({"t": t, "objects": [cup, lid] if i % 3 else [lid, cup] if i % 2 else [cup]})
    path = tmp_path / "a.jsonl"
    path.write_text(json.dumps(entries) if is_document else "\n".join(map(json.dumps, entries)) + "\n")
    assert sorted(source.child_frame_id for source in list_sources(str(path))) == ["cup", "lid"]
    assert_read(path, frame="cup")


QUOTED = [", ".join(map(repr, row)) for row in np.hstack([P, TURN.as_rotvec()]).tolist()]
LINES = {
    "a date before pairs": [
        f"{date} INFO "
        + " ".join(f"{name}={value}" for name, value in zip(NAMES.split(","), row, strict=True))
        for date, row in zip(DATES, POSE.tolist(), strict=True)
    ],
    "lists": [json.dumps(row) for row in np.c_[T, POSE].tolist()],
    "lists in lists": [json.dumps([t, p, q]) for t, p, q in zip(T, P.tolist(), Q.tolist(), strict=True)],
    "poses of UR": ["time,tcp", *(f"{t},p[{pose}]" for t, pose in zip(T.tolist(), QUOTED, strict=True))],
    "a split DataFrame": [
        json.dumps({"columns": NAMES.split(","), "index": T.tolist(), "data": POSE.tolist()})
    ],
}


def test_contacts_in_a_list_beside_a_pose_are_no_bodies(tmp_path: Path) -> None:
    contacts = [{"name": name, "point": [1, 2, 3], "normal": [0, 0, 1]} for name in ("left", "right")]
    poses = [dict(zip(["t", *NAMES.split(",")], row, strict=True)) for row in np.c_[T, POSE].tolist()]
    path = tmp_path / "a.jsonl"
    path.write_text("\n".join(json.dumps(pose | {"contacts": contacts}) for pose in poses) + "\n")
    assert_read(path)


@pytest.mark.parametrize("lines", LINES.values(), ids=LINES)
def test_what_is_proposed_for_lines_of_programs_is_right(tmp_path: Path, lines: list[str]) -> None:
    path = tmp_path / "a.log.csv"
    path.write_text("\n".join([*lines, ""]))
    assert_read(path, *proposed(path))


def test_matrices_below_numbers_have_a_remedy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As trajectories of Open3D."""
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "a.log"
    blocks = ("\n".join(" ".join(map(repr, row)) for row in pose.tolist()) for pose in WHOLE)
    path.write_text("".join(f"{i} {i} {i + 1}\n{block}\n" for i, block in enumerate(blocks)))
    call = re.search(r"(numpy\.save\(.*\)) makes a file that is read", refusal(path))
    assert call is not None
    exec(call[1], {"numpy": np})
    assert_read(tmp_path / "poses.npy", "--matrix", "rows", "--time-unit", "200Hz", "--columns", "matrix=c")


@pytest.mark.parametrize(("column", "missing"), [("force", "nan"), ("note", ""), ("name", "")])
def test_cells_without_a_value_are_no_name_of_a_body(tmp_path: Path, column: str, missing: str) -> None:
    """Later values were bodies of their own after a stamp that goes back."""
    cells = [missing] * (FIRST_ROWS + 10) + [str(0.1 * i) for i in range(COUNT - FIRST_ROWS - 10)]
    time_s = T.copy()
    time_s[-5] = time_s[-9]
    path = write(tmp_path / "a.csv", [f"time,{column},x,y,z,qx,qy,qz,qw"], rows(time_s, cells, POSE))
    assert [source.child_frame_id for source in list_sources(str(path))] == [""]


def test_many_objects_beside_many_shared_values_are_not_copied(tmp_path: Path) -> None:
    shared = {f"a{i}": i for i in range(4000)}
    objects = [{"name": f"b{i}", "p": [0, 0, 0, 0, 0, 0, 1]} for i in range(4000)]
    path = tmp_path / "a.jsonl"
    path.write_text(json.dumps({"t": 0.0, "objects": objects, **shared}) + "\n")
    with pytest.raises(UnreadableRecording):
        list_sources(str(path))
