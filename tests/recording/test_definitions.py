"""Message definitions from files are never executed, and take little time."""

import builtins
import struct
import time
from collections.abc import Callable, Mapping
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zstandard
from mcap.writer import Writer
from rosbags import typesys
from rosbags.interfaces import Nodetype
from test_message_formats import POSES, RULE, SINGLE, assert_read

from contact_tracker.errors import NoPoses, UnreadableRecording
from contact_tracker.motion.poses import Pose, Poses
from contact_tracker.recording import open_log, summarise
from contact_tracker.recording.definitions import known_definition, parse_definition
from contact_tracker.recording.mcap_file import inflate_zstd
from mcap_logs import ROS2, SCHEMAS, TF, header, pose_stamped, vector
from pose_files import POSE_TYPE, ROS1, ROS1_TEXT, cdr_pose, ros1_pose, write_raw


def write(path: Path, encoding: str, text: str) -> Path:
    """A log of poses with this definition of their type."""
    if encoding == "ros1msg":
        rows = [(pose.stamp_ns, ros1_pose(i, pose)) for i, pose in enumerate(POSES)]
        return write_raw(path, "geometry_msgs/PoseStamped", "ros1", encoding, text.encode(), rows)
    rows = [(pose.stamp_ns, cdr_pose(pose)) for pose in POSES]
    return write_raw(path, POSE_TYPE, "cdr", encoding, text.encode(), rows)


SOUND = {"ros1msg": ROS1_TEXT, "ros2msg": SCHEMAS[POSE_TYPE]}


CODE = "__import__('os').system('touch owned')"
CRAFTED = {
    "sound": "{}",
    "quotes": 'string s "a\\"b"\nstring S="\\"\\"\\""\n{}',
    "code_as_default": f"string s {CODE}\nstring S={CODE}\n{{}}",
    "code_as_name": f"string {CODE}\n{{}}",
    "docstring": 'string S=""")\nimport os\nos.system("touch owned")\n"""\n{}',
    "dunder": "string __class__\nstring __init__\nstring __dict__\n{}",
    "keywords": "string class\nstring import\nstring self\n{}",
    "name_of_a_type": "builtins/eval x\nos/system y\n{}",
    "line_ends": "string a\rimport os\n\x0bimport os\n\u2028import os\n{}",
    "array_of_a_name": f"string[{CODE}] x\n{{}}",
    "huge_array": "float64[999999999999] x\n{}",
    "huge_array_of_types": "geometry_msgs/Pose[999999999] x\n{}",
    "huge_number": f"int32 A={'9' * 20000}\n{{}}",
    "deep_default": f"int32 a {'[' * 20000}\n{{}}",
    "comment": f"# {'(' * 50000}\n{{}}",
}
TREE = "".join(f"{RULE}MSG: a/T{i}\nT{i + 1} x\nT{i + 1} y\n" for i in range(200)) + f"{RULE}MSG: a/T200\n"
CRAFTED |= {
    "doubles_at_each_level": "a/T0 t\n{}" + TREE,
    "part_of_itself": "a/A t\n{}" + f"{RULE}MSG: a/A\na/A a\n",
    "arrays_of_nothing": "a/E[] t\n{}" + f"{RULE}MSG: a/E\n",
    "too_long": "{}" + "# x\n" * 2**16,
}


def poses_of(path: Path) -> tuple[int, int]:
    """How many poses are read, and how many of them by a known definition."""
    try:
        log = open_log(str(path))
    except (NoPoses, UnreadableRecording):
        return 0, 0
    return len(Poses.collect(log)), log.counts.get("known_definition", 0)


@pytest.fixture(scope="module", params=SOUND)
def encoding(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> str:
    """After one was read, which loads the modules."""
    poses_of(write(tmp_path_factory.mktemp("sound") / "a.mcap", request.param, SOUND[request.param]))
    return str(request.param)


@pytest.mark.parametrize("name", CRAFTED)
def test_definitions_are_not_run(
    tmp_path: Path, encoding: str, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Poses are read by the definition or by the known one of the type, or not at all; nothing is compiled or
    run for a file."""
    monkeypatch.chdir(tmp_path)
    path = write(tmp_path / "a.mcap", encoding, CRAFTED[name].format(SOUND[encoding]))
    begin_s = time.process_time()
    with monkeypatch.context() as patch:
        for function in ("exec", "eval", "compile"):
            patch.setattr(builtins, function, None)
        result, known = poses_of(path)
    assert result + summarise(str(path)).undecodable == len(POSES)
    assert known in (0, result)
    assert name != "sound" or (result, known) == (len(POSES), 0)
    assert time.process_time() - begin_s < 5.0
    assert not (tmp_path / "owned").exists()


IDL = "module geometry_msgs { module msg { struct PoseStamped { long x[1 << 30000000000]; }; }; };"


def test_other_types_in_idl_are_refused_with_the_remedy(tmp_path: Path) -> None:
    kind = "visualization_msgs/msg/MarkerArray"
    path = write_raw(tmp_path / "a.mcap", kind, "cdr", "ros2idl", IDL.encode(), [(1, b"")])
    with pytest.raises(NoPoses, match="definitions in IDL are not read: record the types with ros2msg def"):
        open_log(str(path))


@pytest.mark.parametrize(
    "kind", ["geometry_msgs/msg/WrenchStamped", "nav_msgs/msg/Odometry", "visualization_msgs/msg/MarkerArray"]
)
def test_definitions_equal_those_of_rosbags(kind: str) -> None:
    definition = parse_definition(ROS2.generate_msgdef(kind, ros_version=2)[0], kind)
    again = typesys.get_types_from_msg(definition.ros2msg, kind)
    for name in definition.fields:
        name = name.replace("/", "/msg/")
        assert again[name][1] == ROS2.fielddefs[name][1], name
    known = known_definition(kind)
    assert known is None or known.fields == definition.fields


def test_known_types_need_no_definition_in_others() -> None:
    definition = parse_definition("geometry_msgs/PoseStamped pose\n", "lab_msgs/msg/Tracked")
    known = known_definition("geometry_msgs/msg/PoseStamped")
    assert known is not None
    assert {**definition.fields, **known.fields} == definition.fields
    assert not definition.is_complete


# --- ROS 1 as rosbags writes it ----------------------------------------------------------------------------


def of_ros1(kind: str, values: Mapping[str, Any]) -> Any:
    """A message of rosbags with these values; others are zero or empty."""

    def field(node: tuple[Nodetype, Any], value: Any) -> Any:
        match node:
            case Nodetype.NAME, name:
                return of_ros1(name, value or {})
            case Nodetype.BASE, (name, _):
                return value if value is not None else "" if name == "string" else 0
            case _, ((kind, about) as element, length):
                values = [field(element, one) for one in ([None] * length if value is None else value)]
                return np.array(values, about[0]) if kind == Nodetype.BASE else values

    return ROS1.types[kind](*(field(node, values.get(name)) for name, node in ROS1.fielddefs[kind][1]))


def ros1_message(kind: str, values: Mapping[str, Any]) -> bytes:
    return bytes(ROS1.serialize_ros1(of_ros1(kind, values), kind))


def marker(pose: Pose) -> dict[str, Any]:
    """With arrays of types, and text."""
    more = {"points": [vector(pose.position_m)] * 2, "colors": [{"r": 0.1}], "text": "\u00e4", "id": 3}
    return {"header": header(pose.stamp_ns), "pose": pose_stamped(*pose)["pose"], "ns": "box", **more}


OF_ROS1: dict[str, Callable[[Pose], Any]] = {
    **{kind: message for kind, (_, message) in SINGLE.items() if kind != TF},
    "geometry_msgs/msg/PoseArray": lambda p: {
        "header": header(p.stamp_ns),
        "poses": [pose_stamped(*p)["pose"]],
    },
    "visualization_msgs/msg/MarkerArray": lambda p: {"markers": [marker(p)]},
}


@pytest.mark.parametrize("kind", OF_ROS1)
def test_types_of_ros1(tmp_path: Path, kind: str) -> None:
    """Each as rosbags defines and encodes it; a message that is cut off or too long is counted."""
    rows = [(pose.stamp_ns, ros1_message(kind, OF_ROS1[kind](pose))) for pose in POSES]
    text = ROS1.generate_msgdef(kind, ros_version=1)[0].encode()
    name = kind.replace("/msg/", "/")
    assert_read(write_raw(tmp_path / "a.mcap", name, "ros1", "ros1msg", text, rows))
    odd = [*rows, (rows[-1][0], rows[-1][1][:-1]), (rows[-1][0], rows[-1][1] + b"x")]
    log = open_log(str(write_raw(tmp_path / "b.mcap", name, "ros1", "ros1msg", text, odd)))
    assert len(Poses.collect(log)) == len(rows)
    assert log.counts == {"undecodable": 2}


@pytest.mark.parametrize("kind", ["tf/tfMessage", "tf2_msgs/TFMessage"])
def test_transforms_of_ros1(tmp_path: Path, kind: str) -> None:
    stamped = "geometry_msgs/msg/TransformStamped"
    messages = (ros1_message(stamped, OF_ROS1[stamped](pose)) for pose in POSES)
    rows = [(p.stamp_ns, struct.pack("<I", 1) + data) for p, data in zip(POSES, messages, strict=True)]
    text, _ = ROS1.generate_msgdef(stamped, ros_version=1)
    fields, rule, parts = text.partition(RULE)
    content = (
        f"geometry_msgs/TransformStamped[] transforms\n{RULE}MSG: geometry_msgs/TransformStamped\n{fields}"
    )
    path = write_raw(tmp_path / "a.mcap", kind, "ros1", "ros1msg", (content + rule + parts).encode(), rows)
    assert_read(path)
    assert_read(path, frame="world->box")


def nested(extra: str, types: Mapping[str, str]) -> str:
    """The definition of poses with further fields at the end, and their types."""
    fields, _, rest = SCHEMAS[POSE_TYPE].partition("=" * 80)
    parts = "".join(f"{'=' * 80}\nMSG: p/{name}\n{body}\n" for name, body in types.items())
    return f"{fields.rstrip()}\n{extra}\n{'=' * 80}{rest.rstrip()}\n{parts}"


TINY = {"E": "uint8 a"}
TOO_DEEP = {**{f"A{i}": f"p/A{i + 1} a" for i in range(60)}, "A60": "uint8 a"}
ENDLESS = {**{f"A{i}": f"p/A{i + 1} a" for i in range(5000)}, "A5000": "uint8 a"}


def write_many(path: Path, definition: str, after: bytes, count: int) -> Path:
    """A small file of many messages of poses, with further bytes."""
    rows = [(i, cdr_pose(pose) + after) for i, pose in zip(range(count), cycle(POSES), strict=False)]
    return write_raw(path, POSE_TYPE, "cdr", "ros2msg", definition.encode(), rows)


def write_zeros(path: Path) -> Path:
    """Messages of zeros, each compressed by itself."""
    packed = zstandard.ZstdCompressor().compress(bytes(2**22))
    rows = [(i, packed) for i in range(20_000)]
    return write_raw(path, POSE_TYPE, "cdr", "ros2msg", SCHEMAS[POSE_TYPE].encode(), rows)


SLOW: Mapping[str, tuple[Callable[[Path], Path], int, int]] = {
    "elements of one byte": (
        lambda path: write_many(
            path, nested("p/E[] a", TINY), struct.pack("<I", 400_000) + bytes(400_000), 40
        ),
        40,
        2,
    ),
    "compressed": (write_zeros, 20_000, 2000),
}
"""How small files are written, the number of their messages, and the most that may be decoded."""


@pytest.mark.parametrize("name", SLOW)
def test_the_bytes_explain_decoded_messages(
    tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    write, count, most = SLOW[name]
    path = write(tmp_path / "a.mcap")
    assert path.stat().st_size < 1e6
    inflated = list[int]()
    monkeypatch.setattr(
        "contact_tracker.recording.decoding.inflate_zstd",
        lambda data, limit: inflated.append(limit) or inflate_zstd(data, limit),
    )
    summary = summarise(str(path))
    assert sum(source.observed for source in summary.sources) <= most < count
    assert summary.damage is not None
    assert len(inflated) <= most


@pytest.mark.parametrize(("levels", "why"), [(TOO_DEEP, "cannot be used"), (ENDLESS, "is too long")])
def test_too_many_levels_are_not_used(tmp_path: Path, levels: Mapping[str, str], why: str) -> None:
    """The known definition is, which has no further fields."""
    path = write_many(tmp_path / "a.mcap", nested("p/A0 a", levels), bytes(1), 2000)
    summary = summarise(str(path))
    assert [source.observed for source in summary.sources] == [2000]
    assert len(summary.assumptions) == 1
    assert f"its definition in the file {why}" in summary.assumptions[0]


@pytest.mark.parametrize("definition", ["? {}", "float64 a{}"])
def test_many_definitions_take_little_time(
    tmp_path: Path, definition: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    length = 1500
    with (tmp_path / "a.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        for i in range(length):
            schema = writer.register_schema(POSE_TYPE, "ros2msg", definition.format(i).encode())
            channel = writer.register_channel(f"/p{i}", "cdr", schema)
            writer.add_message(channel, i, cdr_pose(next(iter(POSES))), i)
        writer.finish()
    parsed = list[str]()
    monkeypatch.setattr(
        "contact_tracker.recording.decoding.parse_definition",
        lambda text, name: parsed.append(text) or parse_definition(text, name),
    )
    summarise(str(tmp_path / "a.mcap"))
    assert 500 < len(parsed) < 1000


def test_what_takes_too_long_is_left_out_and_the_rest_is_read(tmp_path: Path) -> None:
    rows = [
        (i, cdr_pose(pose) + struct.pack("<I", length) + bytes(length))
        for i, (pose, length) in enumerate(zip(POSES, cycle((3, 1_000_000)), strict=False))
    ]
    text = nested("p/E[] a", TINY).encode()
    write_raw(tmp_path / "a.mcap", POSE_TYPE, "cdr", "ros2msg", text, rows)
    log = open_log(str(tmp_path / "a.mcap"))
    assert len(Poses.collect(log)) == (len(POSES) + 1) // 2
    assert log.counts == {"undecodable": len(POSES) // 2}
    assert "messages that take longer to decode" in log.damage
    assert "write it without compression" in log.damage
