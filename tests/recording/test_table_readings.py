"""What users say of the columns of a table, what its names say of it, and exports that people have."""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas
import pyarrow
import pytest

import contact_tracker
from contact_tracker import Trajectory, read
from contact_tracker.cli.main import build_parser, run
from contact_tracker.config.table_reading import reading_of
from contact_tracker.errors import (
    ChoiceError,
    UnreadableRecording,
    UsageError,
)
from contact_tracker.motion.poses import Poses
from contact_tracker.recording import open_log
from contact_tracker.recording.table_layouts import TableLayout, quaternions
from pose_tables import (
    ANGLES,
    DEGREES,
    MATRICES,
    NAMES,
    P_MM,
    POSE,
    REAL_FIRST,
    SINCE_NS,
    TURN,
    VECTORS,
    WHOLE,
    P,
    Q,
    T,
    assert_read,
    names,
    numbered,
    proposed,
    rows,
    write,
    xyz,
)

Lines = list[list[str]]
OF_MATRICES = ",".join(f"r{i}{j}" for i in "123" for j in "123")
SECONDS, REST = [str(1_700_000_000 + n // 10**9) for n in SINCE_NS], [str(n % 10**9) for n in SINCE_NS]
ENTRIES = list(zip(T.tolist(), P.tolist(), Q.tolist(), strict=True))


CELLS = list(zip(rows(T), rows(P), rows(Q), strict=True))


def entry(p: list[float], q: list[float]) -> str:
    """A pose in JSON."""
    return json.dumps({"position": dict(zip("xyz", p, strict=True)), "q": dict(zip("xyzw", q, strict=True))})


def stamped(t: float, p: list[float], q: list[float]) -> str:
    return f'{{"time": {t!r}, "pose": {entry(p, q)}}}'


def by(separator: str, lines: Lines) -> Lines:
    """The rows with another separator than commas."""
    return [[separator.join(line)] for line in lines]


def with_decimal_commas(separator: str) -> tuple[str, Lines]:
    head, quote = [] if separator == " " else [["t", *NAMES.split(",")]], '"' * ('"' in separator)
    lines = (separator.join(row).replace(".", ",") for row in [*head, *rows(T, POSE)])
    return "", [[f"{quote}{line}{quote}"] for line in lines]


def named_values(form: str) -> Lines:
    lead, _, form = form.rpartition(" .. ")
    all_names = ["t", *NAMES.split(",")]
    return by(" ", [[lead, *map(form.format, all_names, line)] for line in rows(T, POSE)])


def cells(form: str, separator: str) -> Lines:
    """Positions and quaternions in one cell each, as Unity and lists of Python are written."""
    texts = ([form.format(separator.join(map(repr, values))) for values in (p, q)] for _, p, q in ENTRIES)
    return [[repr(t), *text] for t, text in zip(T.tolist(), texts, strict=True)]


QUALISYS = """NO_OF_FRAMES\t120\nFREQUENCY\t200\nTIME_STAMP\t2024-05-14, 10:22:31.123\t5021.1
DATA_INCLUDED\t6D\nBODY_NAMES\tblock\nFrame\tTime\tX\tY\tZ\tRoll\tPitch\tYaw\tResidual\t"""
QUALISYS_ROWS = rows(np.arange(120), T, P_MM, np.degrees(VECTORS), T, MATRICES.transpose(0, 2, 1))
OPENSIM = "Poses\nversion=1\nnRows=120\ninDegrees=no\nendheader\ntime\t"
QUOTED = [[repr(t), '"' + entry(p, q).replace('"', '""') + '"'] for t, p, q in ENTRIES]
STAMPED = [stamped(*one) for one in ENTRIES]
DATES = (
    *("2026-03-01T10:00:0{}.{}", "2026-03-01 10:00:0{}.{}", "2026-03-01T10:00:0{}.{}Z"),
    *("2026-03-01T10:00:0{}.{}+00:00", "2026-03-01 10:00:0{}.{} +0000"),
    *("2026-03-01 10:00:0{}.{}+00", "2026-03-01 10:00:0{}.{} UTC"),  # of databases
    *("2026-03-01 9:00:0{}.{}", "09:00:0{}.{}", "2026/03/01 09:00:0{}.{}", "20260301T09000{}.{}"),
    *("1.3.2026 09:00:0{}.{}", "03/01/2026 09:00:0{}.{} PM", "03/31/2026, 9:00:0{}.{} am"),
)
"""Forms of seconds and nanoseconds."""
HEADS = (
    *(f"t,{NAMES}", "time [s],px,py,pz,qx,qy,qz,qw", "timestamp,tx,ty,tz,q_x,q_y,q_z,q_w"),
    "#timestamp [s],p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_x [],q_RS_y [],q_RS_z [],q_RS_w []",
    f"Time,{xyz('position.')},{xyz('orientation.')},orientation.w",
    f"header.stamp,{xyz('pose.position.')},{xyz('pose.orientation.')},pose.orientation.w",
    f"__time,{xyz('/o/pose/position/')},{xyz('/o/pose/orientation/')},/o/pose/orientation/w",
    "stamp,pos_x,pos_y,pos_z,quat_x,quat_y,quat_z,quat_w",
    "t,loc_x,loc_y,loc_z,quat_i,quat_j,quat_k,quat_real",
    "TIME,POSx,POSy,POSz,QUATx,QUATy,QUATz,QUATw",
    "Timestamp,PositionX,PositionY,PositionZ,RotationX,RotationY,RotationZ,RotationW",
    f"Project: demo\nSample rate (Hz),200\n\nTime,{NAMES}",
    *(200 * f"{line}\n" + f"t,{NAMES}" for line in ("# a comment", "Channel 3,on")),
    # lengths of something else leave metres
    f"# residual positions: mm\nt,{NAMES}".replace("x,y,z,", "x [m],y [m],z [m],"),
    *(
        f"{above}\nt,{NAMES}"
        for above in ("# mean error 0.3 mm", "# accuracy = 1 mm", "# sigma=1mm", "cutoff=1 cm")
    ),
)
VALUES = ("{}={}", "{}: {}", "{} = {};", "{}:{},", "INFO pose: .. {}={}", "of: {}={}", "- { .. {}: {},")
READ: list[tuple[str, Lines]] = [
    *((head, rows(T, POSE)) for head in HEADS),
    (f"# by me\nt,{NAMES},gap [mm]", rows(T, POSE, T)),
    ("Tracker 1.2\nDone in 3 s", by(" ", rows(T, POSE))),  # text above a trajectory
    (f"# t, {NAMES.replace(',', ', ')}", by(" ", rows(T, POSE))),
    (f"time,timestamp,{NAMES}", rows([f"10:00:0{n // 10**9}" for n in SINCE_NS], T, POSE)),
    ("t,px1,py1,pz1,qx1,qy1,qz1,qw1", rows(T, POSE)),
    (f"t,{NAMES}", [[f"np.float64({value})" for value in row] for row in rows(T, POSE)]),
    ("t,p,q", [[t, "x={} y={} z={}".format(*p), "X={} Y={} Z={} W={}".format(*q)] for [t], p, q in CELLS]),
    ("", [[str(dict(zip(["t", *NAMES.split(",")], row, strict=True)))] for row in np.c_[T, POSE].tolist()]),
    *(  # columns rot_x may be those of a quaternion, but not beside qx
        (f"t,x,y,z,{xyz(f'{angles}_')},qx,qy,qz,qw", rows(T, P, DEGREES, Q))
        for angles in ("orient", "rot", "orientation")
    ),
    (f"secs,nsecs,{NAMES}", rows(SECONDS, REST, POSE)),
    (f"ZeitInSec,ZeitInNanoSec,{NAMES}", rows(SECONDS, REST, POSE)),
    (f"sec,usec,{NAMES}", rows(["1700000000"] * 120, [str(n // 1000) for n in SINCE_NS], POSE)),
    (f"time,{NAMES}", rows([f"1 days 00:00:{t:09.6f}" for t in T.tolist()], POSE)),
    (f"time,{NAMES}\n[iso],,,,,,,", rows([f"2026-03-01 10:00:{t:012.9f}" for t in T.tolist()], POSE)),
    (f"t_ms,{NAMES}", rows([f'"{1e3 * (t + 90):,.6f}"' for t in T.tolist()], POSE)),
    ("t_ns,x [mm],y [mm],z [mm],qw,qx,qy,qz", rows(SINCE_NS, P_MM, REAL_FIRST)),
    (f"Time,{NAMES}\ns,mm,mm,mm,,,,", rows(T, P_MM, Q)),
    ("t,x,y,z,q0,qx,qy,qz", rows(T, P, REAL_FIRST)),
    ("time [min],x [in],y [in],z [in],qx,qy,qz,qw", rows(T / 60, P / 0.0254, Q)),
    (f",cup,cup,cup,cup,cup,cup,cup\n,{NAMES}\ntime,,,,,,,", rows(T, POSE)),  # by pandas
    ("t,position,,,rotation,,,\n,X,Y,Z,X,Y,Z,W", rows(T, POSE)),  # cells that were merged
    (
        f"{NAMES.replace(',', ' ')} t",
        by(" ", [[str(i), *row] for i, row in enumerate(rows(POSE, T))]),
    ),  # by R
    (f"sep=;\nTime;{names(';')}", by(";", rows(T, POSE))),
    (f"time | {names(' | ')}", by(" | ", rows(T, POSE))),
    (QUALISYS + numbered("Rot[{}]", 9).replace(",", "\t"), by("\t", QUALISYS_ROWS)),
    (OPENSIM + names("\t"), by("\t", rows(T, POSE))),
    *(
        (
            f"time;{names(';')}",
            by(";", rows([date.format(n // 10**9, f"{n % 10**9:09d}") for n in SINCE_NS], POSE)),
        )
        for date in DATES
    ),
    *(
        (f"{mark} about\n{mark} t {names(' ')}", by(" ", rows(T, POSE)))
        for mark in ("%", "//", ";", "# by me\n#")
    ),
    *(("", named_values(form)) for form in VALUES),
    *map(with_decimal_commas, (";", "\t", " ", '","')),
    ("time,pose", QUOTED),
    ("", [[f'{{"contacts": [{{"name": "a"}}, {{"name": "b"}}], {one[1:]}'] for one in STAMPED]),
    ("", [[f"[{','.join(STAMPED)}]"]]),
    ('{"fps": 1,\n"frames": [', [[",\n".join(STAMPED) + "]}"]]),
]
"""What is above the rows, and these."""


@pytest.mark.parametrize(("head", "lines"), READ, ids=[f"{head[-60:]} {lines[0]}" for head, lines in READ])
def test_text_that_says_what_its_values_are(tmp_path: Path, head: str, lines: Lines) -> None:
    assert_read(write(tmp_path / "a.csv", [head] if head else [], lines))


@pytest.mark.parametrize(
    ("encoding", "end"), [("utf-16", "\r\n"), ("utf-8-sig", "\n"), ("latin-1", "\n"), ("utf-8", "\r")]
)
def test_text_in_other_encodings_and_with_other_line_ends(tmp_path: Path, encoding: str, end: str) -> None:
    path = write(tmp_path / "a.csv", [f"t,{NAMES},Temperatur [\u00b0C]"], rows(T, POSE))
    path.write_bytes(path.read_text().replace("\n", end).encode(encoding))
    assert_read(path)


def test_json_lines(tmp_path: Path) -> None:
    lines = [*STAMPED]
    write(tmp_path / "a.jsonl", lines, [])
    assert_read(tmp_path / "a.jsonl")
    lines[5] = lines[5][:40]
    write(tmp_path / "a.jsonl", lines, [])
    log = open_log(str(tmp_path / "a.jsonl"))
    assert len(Poses.collect(log)) == 119
    assert str(log.damage).startswith("1 row has no time that is a number or a date ('{")


ABOVE = (
    *("# unit: mm", "# made by me, units=mm", "; Length Units,Millimeters", "Units,mm", "% positions in mm"),
    *("# units: s, mm", "# x, y, z in mm", "# all in mm", "# measured in mm", "# units: deg, mm"),
    *("# distances in mm", "# xyz [mm]", "# pos: mm, rot: quaternion", "# 1 unit = 1 mm", "unit_mm"),
    *("# All positions are given in millimeters.", "Exported on Monday by me with all of the lengths in mm"),
)
PROPOSALS: dict[str, tuple[str, Lines, str]] = {
    "UR": (
        "timestamp," + numbered("actual_TCP_pose_{}", 6),
        rows(T, P, VECTORS),
        "--rotation-vector --columns position=actual_TCP_pose[0:3],rotation=actual_TCP_pose[3:6]",
    ),
    "libfranka": (
        "time," + numbered("O_T_EE[{}]", 16),
        rows(T, WHOLE.transpose(0, 2, 1)),
        "--matrix columns --columns matrix=O_T_EE",
    ),
    "KUKA": (
        "t,X,Y,Z,A,B,C",
        rows(T, P_MM, TURN.as_euler("ZYX", degrees=True)),
        "--unit mm --euler ZYX:deg --columns rz=A,ry=B,rx=C",
    ),
    "ABB": ("t,X,Y,Z,Q1,Q2,Q3,Q4", rows(T, P_MM, REAL_FIRST), "--unit mm --columns qw=Q1,qx=Q2,qy=Q3,qz=Q4"),
    "matrices": (f"t,x,y,z,{OF_MATRICES}", rows(T, P, MATRICES), "--matrix rows"),
    "Windows' clock": (
        f"timestamp,{NAMES}",
        rows([str(133_500_000_000_000_000 + n // 100) for n in SINCE_NS], POSE),
        "--time-unit 100ns",
    ),
    **{
        angles: (f"t,x,y,z,{angles}", rows(T, P, DEGREES), "--euler xyz:deg")
        for angles in (
            *("roll,pitch,yaw", "rx,ry,rz", "rot_x,rot_y,rot_z", "Roll_deg,Pitch_deg,Yaw_deg"),
            "euler_x [deg],euler_y [deg],euler_z [deg]",
        )
    },
    "no names": ("", rows(T, POSE), "--columns time=c0,position=c[1:4],quaternion=c[4:8]"),
    "real part first in Blender": (
        f"frame,{numbered('location[{}]', 3)},{numbered('rot[{}]', 4)}",
        rows([f"{n}" for n in range(120)], POSE),
        "--time-unit 100Hz --columns quaternion=rot,position=location",
    ),
    "FANUC": ("t,X,Y,Z,W,P,R", rows(T, P_MM, DEGREES), "--unit mm --euler xyz:deg --columns rx=W,ry=P,rz=R"),
    "three angles of Blender": (
        f"frame,{xyz('location_')},{xyz('rotation_euler_')}",
        rows([f"{n}" for n in range(120)], P, DEGREES),
        "--time-unit 100Hz --euler xyz:deg",
    ),
    "angles of Unity": (
        f"t,{xyz('transform.position.')},{xyz('transform.eulerAngles.')}",
        rows(T, P, TURN.as_euler("zxy", degrees=True)[:, [1, 2, 0]]),
        "--euler zxy:deg",
    ),
    "a time by its values": (f"X_Value,{NAMES}", rows(T, POSE), "--columns time=X_Value"),
    "an index of times without a name": (f",{NAMES}", rows(T, POSE), "--columns time=c0"),
    "an index of rows without a name": (f",{NAMES}", rows(np.arange(120), POSE), "--time-unit 100Hz"),
    "a time after the pose": (
        *("", rows(POSE, T)),
        "--columns time=c7,position=c[0:3],quaternion=c[3:7]",
    ),
    "days": (
        f"Date,{NAMES}",
        rows([f"{45_000 + n / 86_400e9:.15f}" for n in SINCE_NS.tolist()], POSE),
        "--time-unit days --columns time=Date",
    ),
    "a time before named values": (
        *("", [[f"[info] [{t!r}] [node_1]: p={p!r} q={q!r}"] for t, p, q in ENTRIES]),
        "--columns quaternion=q,position=p,time=c0",
    ),
    "names twice": ("t,x,y,z,x,y,z,w", rows(T, POSE), "--columns qx=x.1,qy=y.1,qz=z.1,qw=w"),
    "another time": (f"unix_time,{NAMES}", rows(T, POSE), "--columns time=unix_time"),
    "matrices by two numbers": (
        "t," + numbered("T_{}_{}", 4, 4),
        rows(T, WHOLE),
        "--matrix rows --columns matrix=T",
    ),
    "vectors of OpenCV": (
        f"t,{numbered('rvec{}', 3)},{numbered('tvec{}', 3)}",
        rows(T, VECTORS, P),
        "--rotation-vector --columns rotation=rvec,position=tvec",
    ),
    "matrices without names": (
        *("", rows(T, WHOLE[:, :3])),
        "--matrix rows --columns time=c0,matrix=c[1:13]",
    ),
    "numbered rows without names": (
        *("", rows(np.arange(120), T, POSE)),
        "--columns time=c1,position=c[2:5],quaternion=c[5:9]",
    ),
    "quaternions before positions": (
        *("", rows(T, Q, P)),
        "--columns time=c0,quaternion=c[1:5],position=c[5:8]",
    ),
    "numbers of frames before quaternions and positions": (
        *("", by(" ", rows(np.arange(120), Q, P))),
        "--time-unit 100Hz --columns time=c0,quaternion=c[1:5],position=c[5:8]",
    ),
    "angles beside quaternions": (
        *("", rows(T, P, np.radians(DEGREES), Q)),
        "--columns time=c0,position=c[1:4],quaternion=c[7:11]",
    ),
    "matrices before positions": (
        *("", rows(T, MATRICES, P)),
        "--matrix rows --columns time=c0,matrix=c[1:10],position=c[10:13]",
    ),
    "numbers of columns": (
        *(",0,1,2,3,4,5,6,7", rows(np.arange(120), T, POSE)),
        "--columns time=c1,position=c[2:5],quaternion=c[5:9]",
    ),
    "other lines between": (
        *(
            "",
            by(
                " ",
                [row for i, one in enumerate(rows(T, POSE, T)) for row in ([["lost"] * (not i), one])][1:],
            ),
        ),
        "--columns time=c0,position=c[1:4],quaternion=c[4:8]",
    ),
    "tuples": (
        *("", [[str(tuple(row))] for row in np.c_[T, POSE].tolist()]),
        "--columns time=c0,position=c[1:4],quaternion=c[4:8]",
    ),
    "matrices in several lines of a cell": (
        "t,T",
        [
            [repr(t), '"' + str(matrix.tolist()).replace("], ", "],\n ") + '"']
            for t, matrix in zip(T.tolist(), WHOLE, strict=True)
        ],
        "--matrix rows --columns matrix=T",
    ),
    "steps of time": (f"dt,{NAMES}", rows(np.r_[0.0, [0.005] * 119], POSE), "--time-unit 100Hz"),
    "a matrix of the camera beside poses": (
        f"t,{numbered('K{}', 9)},{numbered('R{}', 9)},tx,ty,tz",
        rows(T, np.tile([500.0, 0, 320, 0, 500, 240, 0, 0, 1], (120, 1)), MATRICES, P),
        "--matrix rows --columns matrix=R",
    ),
    "joints before poses": (
        f"t,{numbered('joint_{}', 7)},{numbered('tool_{}', 7)}",
        rows(T, np.tile(np.arange(7.0), (120, 1)), POSE),
        "--columns position=tool[0:3],quaternion=tool[3:7]",
    ),
    "angles beside matrices": (
        f"t,x,y,z,rx,ry,rz,{numbered('b{}', 9)}",
        rows(T, P, DEGREES, MATRICES),
        "--matrix rows --columns matrix=b",
    ),
    "angles of any names": (
        "t,x,y,z,A1,A2,A3",
        rows(T, P, DEGREES),
        "--euler xyz:deg --columns rx=A1,ry=A2,rz=A3",
    ),
    "quaternions of any names": (
        *("t,x,y,z,k,l,m,n", rows(T, POSE)),
        "--columns qx=k,qy=l,qz=m,qw=n",
    ),
    "axes of the body": (
        "t,x,y,z,Xx,Xy,Xz,Yx,Yy,Yz,Zx,Zy,Zz",
        rows(T, P, MATRICES),
        "--matrix rows --columns r11=Xx,r12=Xy,r13=Xz,r21=Yx,r22=Yy,r23=Yz,r31=Zx,r32=Zy,r33=Zz",
    ),
    "angles without names": (
        *("", rows(T, P, DEGREES)),
        "--euler xyz:deg --columns time=c0,position=c[1:4],rotation=c[4:7]",
    ),
    **{
        f"cells with several values {form}{separator}": (
            *("t,Position,Rotation", cells(form, separator)),
            "--columns quaternion=Rotation,position=Position",
        )
        for form, separator in (('"({})"', ", "), ("({})", ","), ("[{}]", " "), ('"[{}]"', ", "))
    },
    **{above: (f"{above}\nt,{NAMES}", rows(T, P_MM, Q), "--unit mm") for above in ABOVE},
    "units in a comment below the names": (f"t,{NAMES}\n# s,mm,mm,mm,-,-,-,-", rows(T, P_MM, Q), "--unit mm"),
    "lists with their names": (
        *("", [[f"t={t!r} p={p!r} q={q!r}"] for t, p, q in ENTRIES]),
        "--columns quaternion=q,position=p",
    ),
    "OpenSim's kinematics": (
        "inDegrees=yes\nendheader\ntime,cup_X,cup_Y,cup_Z,cup_Ox,cup_Oy,cup_Oz",
        rows(T, P, TURN.as_euler("XYZ", degrees=True)),
        "--euler XYZ:deg",
    ),
    **{
        f"axis {axis}": (
            f"t,x,y,z,{axis}",
            rows(T, P, VECTORS / ANGLES[:, None], np.degrees(ANGLES) if "deg" in axis else ANGLES),
            f"--rotation-vector {columns}",
        )
        for axis, columns in (
            ("axis_x,axis_y,axis_z,angle", ""),
            ("rx,ry,rz,angle [deg]", ""),
            ("ax,ay,az,angle_rad", "--columns rx=ax,ry=ay,rz=az"),
            ("ux,uy,uz,theta", "--columns rx=ux,ry=uy,rz=uz"),
        )
    },
    "ros2 topic echo": (
        *("", rows(SECONDS, REST, ["world"] * 120, POSE)),
        "--columns time=c0,nanoseconds=c1,position=c[3:6],quaternion=c[6:10]",
    ),
}


@pytest.mark.parametrize("above", ["quaternions are w x y z", "timestamp position orientation", "time [ms]"])
def test_text_that_may_be_of_columns_is_not_passed_over(tmp_path: Path, above: str) -> None:
    path = write(tmp_path / "a.txt", ["Take 5", above], by(" ", rows(T, P, REAL_FIRST)))
    with pytest.raises(UnreadableRecording):
        open_log(str(path))


def test_a_unit_above_a_trajectory_is_stated_by_the_proposed_command(tmp_path: Path) -> None:
    path = write(tmp_path / "a.txt", ["units: mm"], by(" ", rows(T, P_MM, Q)))
    with pytest.raises(UnreadableRecording, match="--unit mm"):
        open_log(str(path))
    assert_read(path, "--unit", "mm")


@pytest.mark.parametrize("word", ["inches", "feet", "decimetres"])
def test_lengths_without_a_command_are_refused(tmp_path: Path, word: str) -> None:
    path = write(tmp_path / "a.csv", [f"# positions in {word}", f"t,{NAMES}"], rows(T, POSE))
    with pytest.raises(UnreadableRecording, match=f"a unit is {word} .*, convert them to metres.* --unit m$"):
        open_log(str(path))
    assert_read(path, "--unit", "m")


@pytest.mark.parametrize(
    "form",
    [
        "t={} s {}={} cm y={} z={} qx={} qy={} qz={} qw={}",
        "t={} {}={} y={} z={} qx={} qy={} qz={} qw={} mm",
        "t={} {}=({},{},{}) mm q=({},{},{},{})",
    ],
)
def test_text_between_values_with_names_is_refused(tmp_path: Path, form: str) -> None:
    lines = [form.format(t, "x", *pose) for (t, *pose) in rows(T, POSE)]
    path = write(tmp_path / "a.txt", lines, [])
    for columns in (None, "time=t,position=x,quaternion=q"):
        with pytest.raises(
            UnreadableRecording, match=r"beside its values with names there is '.*m?'.* x_cm=29"
        ):
            open_log(str(path), table=reading_of(columns))


@pytest.mark.parametrize(
    "above",
    [
        "# fx=500 fy=500 cx=320 cy=240 k1=0 k2=0",
        "# t:0 qw:1 qx:0 qy:0 qz:0 x:0 y:0 z:0 start pose",
        "% T = [1 0 0 0; 0 1 0 0; 0 0 1 0; 0 0 0 1]",
        "// qw:1 qx:0 qy:0 qz:0 x:0 y:0 z:0 start pose",
    ],
)
@pytest.mark.parametrize("lines", [[[f"t,{NAMES}"], *rows(T, POSE)], named_values("{}={}")])
def test_values_in_comments_are_no_rows(tmp_path: Path, above: str, lines: Lines) -> None:
    assert_read(write(tmp_path / "a.csv", [above], lines))


def test_many_words_are_refused_soon(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tried = list[int]()

    def count(names: Sequence[str], *units: object) -> TableLayout:
        tried.append(len(names))
        raise UnreadableRecording("none")

    monkeypatch.setattr("contact_tracker.recording.text_tables.layout_of_names", count)
    path = write(tmp_path / "a.csv", [], [[f"w{i}" for i in range(4000)]] * 64)
    with pytest.raises(UnreadableRecording, match="text without rows of numbers"):
        open_log(str(path))
    assert sum(tried) <= 5 * 4000


@pytest.mark.parametrize("system", PROPOSALS)
def test_the_command_that_is_proposed_reads_the_columns(tmp_path: Path, system: str) -> None:
    head, lines, words = PROPOSALS[system]
    path, options = write(tmp_path / "a.csv", [head] if head else [], lines), words.split()
    assert sorted(proposed(path)) == sorted(options)
    with pytest.raises(UnreadableRecording, match="by contact-tracker info"):
        Poses.collect(open_log(str(path), table=reading_of(given=("info", "a.csv"))))
    assert_read(path, *(option.replace("100Hz", "200Hz") for option in options))


def test_numbers_of_frames_need_a_rate(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write(tmp_path / "a.csv", [f"frame,{NAMES}"], rows(np.arange(100, 220), POSE))
    assert proposed(path) == ["--time-unit", "100Hz"]
    for options in ("--time-unit 200Hz", "--time-unit frames --rate 200", "--rate 200 --time-unit frames"):
        assert_read(path, *options.split())
    for read_by in ({"time_unit": "200Hz"}, {"time_unit": "frames", "rate": 200}, {"rate": 200.0}):
        np.testing.assert_allclose(read(path, **read_by).duration_s, 119 / 200)  # type: ignore[arg-type]
    with pytest.raises(UsageError, match="rate is for time_unit='frames', not 'ms'"):
        read(path, time_unit="ms", rate=200)
    assert_read(write(tmp_path / "b.csv", [NAMES], rows(POSE)), "--time-unit", "200Hz")  # by rows
    for name, times in (("time [s]", T), ("time", T), ("time_ms", np.arange(120) * 5)):
        with pytest.raises(ChoiceError, match=r"not numbers of frames: leave out the rate"):
            Poses.collect(
                open_log(str(write(path, [f"{name},{NAMES}"], rows(times, POSE))), table=reading_of(rate=200))
            )
    path = write(path, [f"frame,{NAMES}"], rows(np.arange(120), POSE))
    assert run(["info", str(path)]) == 1
    assert f"read them by contact-tracker info {path} --time-unit 100Hz" in capsys.readouterr().err


C3D = Path(__file__).parent / "two_bodies.c3d"
"""Written by ezc3d 1.7.2: the first 20 poses as a cup, a table that rests, and a marker."""


def test_bodies_of_c3d(tmp_path: Path) -> None:
    """Of a file that is cut off, the readable part is used."""
    result = read(C3D, child="cup")
    np.testing.assert_array_equal(result.stamp_ns, SINCE_NS[:20])
    np.testing.assert_allclose(result.position_m, P[:20], rtol=0, atol=1e-7)
    np.testing.assert_allclose(np.abs(np.sum(result.quat_xyzw * Q[:20], axis=1)), 1.0, rtol=0, atol=1e-9)
    assert run(["info", str(C3D), "--euler", "xyz:deg"]) == 2
    (path := tmp_path / "a.c3d").write_bytes(C3D.read_bytes()[:-1000])
    log = open_log(str(path), frame="cup")
    assert len(Poses.collect(log)) == 12
    assert "it ends after 12 of 20 frames" in str(log.damage)
    content = bytearray(C3D.read_bytes()[:-1000])
    content[6:10] = bytes([5, 0, 3, 0])  # the last frame is before the first, as where numbers are too large
    path.write_bytes(content)
    assert len(Poses.collect(open_log(str(path), frame="cup"))) == 12


def test_lost_tracking_is_counted(tmp_path: Path) -> None:
    """Blanks, NaN, and matrices of zeros."""
    cells = rows(T, P, MATRICES)
    for i, fill in ((10, ""), (11, "NaN"), (12, "0.0")):
        cells[i][1:] = [fill] * 12
    path = write(tmp_path / "a.csv", [f"t,x,y,z,{OF_MATRICES}"], cells)
    log = open_log(str(path), table=build_parser().parse_args(["info", "a", "--matrix", "rows"]).table)
    assert len(Poses.collect(log)) == 117
    assert log.counts == {"nonfinite": 2, "bad_quaternion": 1}


def test_no_turn_needs_no_axis() -> None:
    values = np.array([[0.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.3], [0.0, 0.0, 1.0, np.pi]])
    np.testing.assert_allclose(
        quaternions("axis_angle", values, "rad"), np.eye(4)[[3, 0, 2]] * [[1], [0], [1]], atol=1e-9
    )


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--unit", "ms"], "unit is m, cm, mm, um, not 'ms'; a time has time_unit='ms'"),
        (
            ["--time-unit", "min"],
            "time_unit is s, ms, us, ns, 100ns, days, or the rate of frame numbers, as 200Hz",
        ),
        (["--time-unit", "frames"], "--time-unit frames needs the rate of the frames: --time-unit 120Hz"),
        (["--rate", "120", "--time-unit", "ms"], "rate is for time_unit='frames', not 'ms'"),
        (["--euler", "XYx"], "euler is three of the letters xyz or XYZ"),
        (["--euler", "xyy:deg"], "euler is three of the letters xyz or XYZ, no two neighbours alike"),
        (["--matrix", "diagonal"], "matrix is rows or columns"),
        (["--columns", "time"], "columns are given as time=t,x=px"),
        (["--columns", "q=a"], "a column is time, nanoseconds, x"),
        (["--columns", "x=posx"], "no column 'posx'; did you mean pos_x?"),
        (["--columns", "matrix=t"], "no columns t[0], t[1], ...; there are t, pos_x"),
    ],
)
def test_what_does_not_fit_is_wrong_usage(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], options: list[str], message: str
) -> None:
    path = write(tmp_path / "a.csv", ["t,pos_x,pos_y,pos_z,qx,qy,qz,qw"], rows(T, POSE))
    assert run(["info", str(path), *options]) == 2
    assert message in capsys.readouterr().err


def test_python_takes_the_same_as_arguments(tmp_path: Path) -> None:
    angles = TURN.as_euler("XYZ", degrees=True)
    lines = rows(SINCE_NS // 100, 1e3 * P, angles)
    path = write(tmp_path / "a.csv", ["t,px,py,pz,rx,ry,rz"], lines)
    arguments = {"unit": "mm", "time_unit": "100ns", "euler": "XYZ:deg"}
    table = dict(
        zip(
            ("t", "px", "py", "pz", "rx", "ry", "rz"),
            np.column_stack([SINCE_NS // 100, 1e3 * P, angles]).T,
            strict=True,
        )
    )
    for result in (
        contact_tracker.read(path, **arguments),
        Trajectory.from_arrays(SINCE_NS // 100, 1e3 * P, angles, **arguments),
        Trajectory.from_dataframe(table, **arguments),
        Trajectory.from_dataframe(pyarrow.table(table), columns={"time": "t"}, **arguments),
        Trajectory.from_dataframe(
            pandas.DataFrame(np.column_stack([T, POSE])),
            columns=dict(zip(["time", *NAMES.split(",")], "01234567", strict=True)),
        ),
        Trajectory.from_dataframe(pandas.DataFrame(table).set_index("t"), **arguments),
        Trajectory.from_dataframe(pandas.DataFrame(POSE, pandas.to_timedelta(SINCE_NS), NAMES.split(","))),
        Trajectory.from_arrays(T, P, TURN),
        Trajectory.from_arrays(T, P, MATRICES),
        Trajectory.from_arrays(T, P, VECTORS, rotation_vector=True),
        Trajectory.from_arrays(T, WHOLE),
    ):
        np.testing.assert_allclose(result.stamp_ns, SINCE_NS, rtol=0, atol=101)
        np.testing.assert_allclose(result.position_m, P, rtol=0, atol=1e-9)
        np.testing.assert_allclose(np.abs(np.sum(result.quat_xyzw * Q, axis=1)), 1.0, rtol=0, atol=1e-9)
    with pytest.raises(UsageError, match=r"from_dataframe\(table, unit='mm', euler='xyz:deg'\)"):
        Trajectory.from_dataframe(table)


def test_columns_without_names_beside_named_ones_have_numbers(tmp_path: Path) -> None:
    """As where one name stands for the four columns of a quaternion, and dates have hours of one digit."""
    seconds = [f"2022-08-15 9:28:{58.177 + t:.6f}" for t in T]
    path = write(tmp_path / "a.csv", ["time,x,y,z,rotation,,,"], rows(seconds, P, Q))
    assert proposed(path) == ["--columns", "qx=rotation,qy=c5,qz=c6,qw=c7"]
    assert_read(path, *proposed(path))


@pytest.mark.parametrize(
    ("arguments", "name"), [({"unit": "cm"}, "x .mm."), ({"euler": "xyz:rad"}, "roll .deg.")]
)
def test_a_unit_against_the_names_is_refused(tmp_path: Path, arguments: dict[str, str], name: str) -> None:
    head = "t [s],x [mm],y [mm],z [mm],roll [deg],pitch [deg],yaw [deg]"
    log = write(tmp_path / "a.csv", [head], rows(T, 1e3 * P, TURN.as_euler("xyz", degrees=True)))
    with pytest.raises(UnreadableRecording, match=f"column '{name}' states the unit"):
        read(log, **{"euler": "xyz", **arguments})
    assert len(read(log, unit="mm", euler="xyz:deg")) == len(T)


@pytest.mark.parametrize("how", [{"euler": "xyz:rad"}, {"rotation_vector": True}])
def test_degrees_that_are_read_as_radians_are_refused(tmp_path, how):
    """Also where the first rows are small, so that these may be radians; not if names state the unit, and not
    for the number of a lost pose."""
    turn_deg = np.linspace(0.0, 60.0, 300)
    rows = np.column_stack([0.01 * np.arange(300), np.full((300, 3), 0.2), turn_deg, np.zeros((300, 2))])
    path = tmp_path / "take.csv"

    def saved(names: str) -> None:
        np.savetxt(path, rows, "%.6f", ",", header=f"time [s],x,y,z,{names}", comments="")

    saved("rx,ry,rz")
    with pytest.raises(UnreadableRecording, match="larger than a turn") as refused:
        read(path, **how)
    assert f"read them by contact_tracker.read({str(path)!r}, euler='xyz:deg');" in str(refused.value)
    assert len(read(path, euler="xyz:deg")) == 300
    table = dict(zip(("time [s]", "x", "y", "z", "rx", "ry", "rz"), rows.T, strict=True))
    with pytest.raises(UsageError, match=r"larger than a turn.*euler='xyz:deg'"):
        Trajectory.from_dataframe(table, **how)
    with pytest.raises(UsageError, match="larger than a turn: if they are degrees"):
        Trajectory.from_arrays(rows[:, 0], rows[:, 1:4], rows[:, 4:], **how)
    saved("rx [rad],ry [rad],rz [rad]")
    assert len(read(path, **how)) == 300
    rows[:, 4] = np.where(np.arange(300) % 50 == 7, 9999.0, 0.01 * turn_deg)
    saved("rx,ry,rz")
    assert len(read(path, **how)) >= 295
    rows[:, 4] = np.where(np.arange(300) == 7, 8.0, 0.01 * turn_deg)  # a single row is an outlier
    saved("rx,ry,rz")
    assert len(read(path, **how)) == 300


def test_angles_that_may_be_radians_are_said(tmp_path: Path, recwarn: pytest.WarningsRecorder) -> None:
    """Not if they are larger than half a turn in radians, or if the names of columns state the unit."""
    rows = np.column_stack([0.01 * np.arange(300), np.full((300, 3), 0.2), np.zeros((300, 3))])
    path = tmp_path / "take.csv"
    for largest, unit, is_said in (
        (3.1, "", True),
        (0.1, "", False),
        (4.0, "", False),
        (3.1, " [deg]", False),
    ):
        rows[:, 4] = np.linspace(0.0, largest, 300)
        names = ("time [s]", "x", "y", "z", *(f"r{axis}{unit}" for axis in "xyz"))
        np.savetxt(path, rows, "%.6f", ",", header=",".join(names), comments="")
        for source in (path, dict(zip(names, rows.T, strict=True))):
            (read if source is path else Trajectory.from_dataframe)(source, euler="xyz:deg")
            texts = [str(warning.message) for warning in recwarn]
            recwarn.clear()
            assert any("angles are within 3.10 deg: if they are radians" in text for text in texts) == is_said
            assert not is_said or any("euler='xyz:rad'" in text for text in texts)
