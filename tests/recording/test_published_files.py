"""Files as people publish them: headers as in public repositories, with the poses of the tests."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

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
    columns = "rz=pose.A,ry=pose.B,rx=pose.C"
    assert words == f"--unit mm --time-unit 100Hz --euler ZYX:deg --columns {columns}".split()
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


def test_orientations_alone_are_no_positions(tmp_path: Path) -> None:
    """As inertial sensors write them; with a position the example says how it is read."""
    path = write(tmp_path / "imu.csv", ["Time (s),W,X,Y,Z"], rows(T, REAL_FIRST))
    assert "its W, X, Y, Z look like a quaternion without a position" in refusal(path)
    path = write(tmp_path / "a.csv", ["Time (s),W,X,Y,Z,east,north,up"], rows(T, REAL_FIRST, P))
    columns = re.search(r"--columns (\S+)", refusal(path))
    assert columns is not None
    assert_read(path, "--columns", columns[1].replace("x=a,y=b,z=c", "x=east,y=north,z=up"))


@pytest.mark.parametrize("vector", ["acc_", "linear_acceleration.", "gyr_", "v_", "mag."])
def test_vectors_beside_orientations_are_no_positions(tmp_path: Path, vector: str) -> None:
    for quaternion in ("qw,qx,qy,qz", "q0,q1,q2,q3"):
        path = write(
            tmp_path / "imu.csv", [f"t,{named(vector, 'x,y,z')},{quaternion}"], rows(T, P, REAL_FIRST)
        )
        assert "read them by" not in refusal(path)


def test_labels_in_xml_have_a_remedy(tmp_path: Path) -> None:
    (path := tmp_path / "take.eaf").write_text('<?xml version="1.0"?>\n<ANNOTATION_DOCUMENT AUTHOR="">\n')
    with pytest.raises(NoTruth, match="it is XML: export it as tab-delimited text"):
        read_labels(str(path), 0, 1)


def test_slow_dates_that_may_be_a_time_since_the_start_are_said() -> None:
    """951412773297707 ns since the start of a computer would be a date in microseconds, every 8 s."""
    unit, doubt = unit_of(951412773297707.0 + 8e6 * np.arange(20))
    assert unit == "us"
    assert doubt is not None
    assert "if they are nanoseconds since another time, give --time-unit ns" in doubt
    assert unit_of(1.7e15 + 8e3 * np.arange(20)) == ("us", None)
    assert unit_of(1.7e15 + 2e6 * np.arange(20)) == ("us", None)  # 11 days since a start would be less
    assert unit_of(1.5e9 + 1.4 * np.arange(20)) == ("s", None)  # of maps, a pose a second


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
        (f"time,{beside('X_{},Y_{},Z_{},A_{},B_{},C_{}', 'RIst', 'RSol')},C11,C12,C13",
         [T, P_MM, KUKA, GIVEN_KUKA, ZEROS[:, :3]]),
        *((f"timestamp,timestamp_sample,{place},q[0],q[1],q[2],q[3],velocity[0]",
           [US, US, P, REAL_FIRST, ZEROS[:, 0]])
          for place in ("position[0],position[1],position[2]", "x,y,z")),
        ("pos,pos,pos,rot,rot,rot,rot\nx,y,z,x,y,z,w", [POSE]),
        ("", [[f"v{i}" for i in range(COUNT)], P, DEGREES]),
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
        (f"sim_time,{named('/World/Cube:translate:', 'x,y,z')},{named('/World/Cube:orient:', 'w,x,y,z')}",
         [T, P, REAL_FIRST]),
        ("frame,translateX [cm],translateY [cm],translateZ [cm],rotateX,rotateY,rotateZ",
         [np.arange(COUNT), 1e2 * P, DEGREES]),
    ],
)  # fmt: skip
def test_what_is_proposed_for_names_of_programs_is_right(
    tmp_path: Path, head: str, columns: list[Any]
) -> None:
    """Measured poses, not those commanded; a time that rises, not numbers of frames, nor a name that occurs
    again; units of the names."""
    path = write(tmp_path / "a.csv", [head] * bool(head), rows(*columns))
    assert_read(path, *(word.replace("100Hz", "200Hz") for word in proposed(path)))


@pytest.mark.parametrize(
    ("head", "columns"),
    [
        ("time," + named("xpos_", "x,y,z") + "," + named("xquat_", "w,x,y,z"), [T, P, REAL_FIRST]),
        ("t,tx,ty,tz,rx,ry,rz,rw", [T, POSE]),
        ("time,x,y,z,r_w,r_x,r_y,r_z", [T, P, REAL_FIRST]),
        ("t,tx,ty,tz,ox,oy,oz,ow", [T, POSE]),
        # deviations, errors, goals and velocities are no body
        *((f"time,x,y,z,qx,qy,qz,qw,{others}", [T, POSE, np.ones((COUNT, 7))])
          for others in ("x_std,y_std,z_std,qx_std,qy_std,qz_std,qw_std",
                         "tx_error,ty_error,tz_error,qx_error,qy_error,qz_error,qw_error")),
        *((f"time,{others},x,y,z,qx,qy,qz,qw", [T, np.ones((COUNT, 3)), POSE])
          for others in ("t_goal_x,t_goal_y,t_goal_z", "tool.t_lin_x,tool.t_lin_y,tool.t_lin_z")),
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


SEVERAL_NAMES = "Roll | Phi | X (deg)", "Pitch | Theta | Y (deg)", "Yaw | Psi | Z (deg)"
ARM = f"POS_X,POS_Y,POS_Z,{named('ROT_', NINE)},LIN_VEL_X,LIN_VEL_Y,LIN_VEL_Z"


@pytest.mark.parametrize(
    ("head", "columns", "options", "frame"),
    [
        ("t," + ",".join(named(body, "x,y,z,q0,q1,q2,q3") for body in ("ref.", "act.")),
         [T, P + 1.0, REAL_FIRST, P, REAL_FIRST],
         ["--columns", "qw=act.q0,qx=act.q1,qy=act.q2,qz=act.q3"], None),
        (",".join(["time", *(named(f"t_{body}_", "x,y,z") for body in ("cam", "obj")),
                   *(named(f"q_{body}_", "x,y,z,w") for body in ("cam", "obj"))]),
         [T, P + 1.0, P, Q, Q], [], "obj"),
        (f"{named('MASTER_LEFT_', ARM)},{named('SLAVE_LEFT_', ARM)}",
         [P + 1.0, MATRICES, ZEROS[:, :3], P, MATRICES, ZEROS[:, :3]],
         ["--time-unit", "200Hz", "--matrix", "rows"], "slave_left"),
        (",".join(["time", *SEVERAL_NAMES, "px,py,pz"]), [T, DEGREES, P],
         ["--euler", "xyz:deg", "--columns", "rx={},ry={},rz={}".format(*SEVERAL_NAMES)], None),
    ],
)  # fmt: skip
def test_columns_of_one_of_several_bodies_or_with_several_names(
    tmp_path: Path, head: str, columns: list[Any], options: list[str], frame: str | None
) -> None:
    assert_read(write(tmp_path / "a.csv", [head], rows(*columns)), *options, frame=frame)


@pytest.mark.parametrize(
    ("head", "columns", "options", "text"),
    [
        (f"t,{NAMES}", [T, P + 3.5e6, Q], [], "Subtract a constant from coordinates of a map (UTM)"),
        (f"t,x,y,z,{NINE}", [T, P, 1e-3 * MATRICES], ["--matrix", "rows"], "matrices are no rotations"),
    ],
)  # fmt: skip
def test_why_poses_are_not_used_is_said(
    tmp_path: Path, head: str, columns: list[Any], options: list[str], text: str
) -> None:
    path = write(tmp_path / "a.csv", [head], rows(*columns))
    log = open_log(str(path), table=build_parser().parse_args(["segment", str(path), *options]).table)
    assert not len(Poses.collect(log))
    assert text in "\n".join(log.warnings)


@pytest.mark.parametrize("head", ["Frame\t", ""])
@pytest.mark.parametrize("options", [[], ["--matrix", "columns"], ["--time-unit", "200Hz"]])
def test_qualisys_without_times_has_its_rate(tmp_path: Path, head: str, options: list[str]) -> None:
    above = ABOVE.format("NO_OF_BODIES\t1") + "DATA_INCLUDED\t6D\nBODY_NAMES\tWand"
    columns = [np.arange(COUNT)] * bool(head) + [P_MM, ZEROS[:, :4], MATRICES.transpose(0, 2, 1)]
    assert_read(write(tmp_path / "a.tsv", [above, head + NAMES_6D], rows(*columns), "\t"), *options)


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


@pytest.mark.parametrize(
    ("column", "text", "name"),
    [
        ("phase_id", "0", ""),
        ("operator", "me", ""),
        ("label", "f-f", ""),
        ("header.frame_id", "world", ""),
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
    "a real part that is first by its name": [
        json.dumps({"timestamp_ns": ns, "wrist": {"q_wxyz": q, "t_xyz": p}})
        for ns, q, p in zip(SINCE_NS.tolist(), REAL_FIRST.tolist(), P.tolist(), strict=True)
    ],
    "poses of UR": ["time,tcp", *(f"{t},p[{pose}]" for t, pose in zip(T.tolist(), QUOTED, strict=True))],
    "a split DataFrame": [
        json.dumps({"columns": NAMES.split(","), "index": T.tolist(), "data": POSE.tolist()})
    ],
}


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
