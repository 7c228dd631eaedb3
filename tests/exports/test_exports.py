"""Every output of ``segment -o``, read back by another library and compared with the result."""

import csv
import html
import json
import re
import shutil
import subprocess
import warnings
from base64 import b64decode
from collections import Counter
from dataclasses import replace
from datetime import datetime, timedelta
from itertools import combinations
from pathlib import Path
from random import Random
from typing import Any

import matplotlib
import numpy as np
import pytest
from matplotlib import pyplot
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from mpl_toolkits.mplot3d.proj3d import proj_transform
from pyarrow import parquet
from pyarrow.json import read_json
from scipy.spatial.transform import Rotation

import contact_tracker
from contact_tracker import Trajectory, saved_state
from contact_tracker.errors import StateError, UsageError
from contact_tracker.exports.columns import COLUMNS, decided
from contact_tracker.exports.figure import _draw_parts, _view_of, _write_in_bar, draw_on
from contact_tracker.exports.formats import ROWS, rows_of, write_outcome
from contact_tracker.geometry.elements import ContactGeometry, Line, Plane, Point, Unobserved, flat
from contact_tracker.motion.poses import Poses
from contact_tracker.outputs.outcome import Outcome
from contact_tracker.paper import window_curves
from contact_tracker.recording import write_recording
from contact_tracker.saved_result import RESULT
from contact_tracker.saved_state import save
from contact_tracker.states import CONTACTS, STATES, Contact
from contact_tracker.tracking.belief import FurtherContact, Segment
from contact_tracker.tracking.segmentation import Segmentation
from forged_states import forge
from mcap_logs import Topic, poses_topic, write_log
from short_recordings import EDGE_TO_EDGES, FACE_TO_EDGE, recorded

matplotlib.use("Agg")
ROOT = Path(__file__).resolve().parents[2]
LOG_OFFSET_NS = 12_000_000
TABLE = {"name": "table", "normal": [0.718, -0.598, -0.356], "offset_m": 0.398}


@pytest.fixture(scope="module")
def poses() -> Poses:
    """Poses with faces, edges, and both as elements."""
    first, second = recorded(FACE_TO_EDGE).poses, recorded(EDGE_TO_EDGES).poses
    later = second.stamp_ns - second.stamp_ns[0] + first.stamp_ns[-1] + 5_000_000
    return Poses.join([first, Poses(later, second.position_m, second.quat_xyzw)])


@pytest.fixture(scope="module")
def log(tmp_path_factory, poses) -> Path:
    """Logged later than stamped, beside a topic of something else."""
    chatter = [(int(t) + LOG_OFFSET_NS, {"data": "hello"}) for t in poses.stamp_ns[:3]]
    topics = [poses_topic(poses, offset_ns=LOG_OFFSET_NS), Topic("/chatter", "std_msgs/msg/String", chatter)]
    return write_log(tmp_path_factory.mktemp("exports") / "cube.mcap", topics)


@pytest.fixture(scope="module")
def result(log) -> contact_tracker.Result:
    return contact_tracker.segment(log)


@pytest.fixture(scope="module")
def folder(tmp_path_factory, result) -> Path:
    """All outputs, as ``out.SUFFIX``."""
    folder = tmp_path_factory.mktemp("outputs")
    for suffix in ("csv", "jsonl", "parquet", "mcap", "html", "srt", "tex"):
        result.save(folder / f"out.{suffix}")
    for suffix in ("csv", "jsonl", "parquet"):
        for rows in ROWS:
            result.save(folder / f"{rows}.{suffix}", rows=rows)
    return folder


def assert_rows_are_those_of(rows: list[dict[str, Any]], result: contact_tracker.Result) -> None:
    """Rows of flat columns by tick."""
    assert len(rows) == len(result.beliefs)
    for row, belief in zip(rows, result.beliefs, strict=True):
        assert (row["stamp_ns"], row["onset_ns"]) == (belief.stamp_ns, belief.onset_ns)
        assert row["contact"] == belief.contact.value
        shares = [row[f"p_{state.value.replace('-', '')}"] for state in STATES]
        np.testing.assert_array_equal(shares, belief.probability)
        assert row["probability"] == belief.probability[belief.contact.column]
        assert row["inseparable"].split() == list(belief.inseparable)
        for side in ("object", "environment"):
            element = getattr(belief.geometry, side, None)
            values = dict.fromkeys(flat(None)) if element is None else flat(element)
            for name in ("axis", "point_m", "axis_sd", "point_sd_m"):
                stem, unit = name.removesuffix("_m"), "_m" if name.endswith("_m") else ""
                is_there = element is not None and not (isinstance(element, Point) and "axis" in name)
                expected = values[name] if is_there else [None] * 3
                assert [row[f"{side}_{stem}_{axis}{unit}"] for axis in "xyz"] == expected
            for name in ("type", "name", "unobserved"):
                assert row[f"{side}_{name}"] == (values[name] or None)


def test_parquet_reads_back(folder, result) -> None:
    table = parquet.read_table(folder / "out.parquet")
    assert table.column_names == list(COLUMNS["ticks"])
    assert_rows_are_those_of(table.to_pylist(), result)
    assert {"face", "edge"} <= {*table["environment_type"].to_pylist(), *table["object_type"].to_pylist()}
    kinds = {"integer": "int64", "number": "double", "text": "string"}
    schema = parquet.read_schema(folder / "out.parquet")
    assert [str(field.type) for field in schema] == [kinds[kind] for kind in COLUMNS["ticks"].values()]


def test_rows_are_those_that_are_asked_for_in_each_table(folder, result, tmp_path) -> None:
    """The suffix decides only where nothing is asked for."""
    for rows, entries in (("ticks", result.beliefs), ("segments", result.segments)):
        frame = parquet.read_table(folder / f"{rows}.parquet")
        lines = [json.loads(line) for line in (folder / f"{rows}.jsonl").read_text().splitlines()]
        with open(folder / f"{rows}.csv", newline="") as file:
            table = [*csv.DictReader(file)]
        assert len(frame) == len(lines) == len(table) == len(entries)
        assert [row["contact"] for row in table] == [line["contact"] for line in lines]
        for name in frame.column_names:
            if name not in ("contacts", "joint"):
                for cell, value in zip((row[name] for row in table), frame[name].to_pylist(), strict=True):
                    assert cell == ("" if value is None else str(value))
        stamp = "stamp" if rows == "ticks" else "start"
        seconds = [round((int(row[f"{stamp}_ns"]) - result.origin_ns) * 1e-9, 9) for row in table]
        assert [float(row[f"{stamp}_s"]) for row in table] == seconds
    for suffix, usual in (("csv", "segments"), ("jsonl", "ticks"), ("parquet", "ticks")):
        assert (folder / f"out.{suffix}").read_bytes() == (folder / f"{usual}.{suffix}").read_bytes()
    assert rows_of(Path("out.rrd")) is None
    with pytest.raises(UsageError, match="rows of ticks are for"):
        rows_of(Path("a.rrd"), "ticks")
    for suffix, wrong in (("srt", "ticks"), ("png", "segments"), ("csv", "poses"), ("rrd", "ticks")):
        with pytest.raises(UsageError, match="rows"):
            result.save(tmp_path / f"out.{suffix}", rows=wrong)  # type: ignore[arg-type]


@pytest.mark.parametrize("rows", ["ticks", "segments"])
def test_data_frames_of_both_libraries_are_equal_with_one_schema(result, poses, rows) -> None:
    pandas_table, arrow_table = result.to_pandas(rows), result.to_arrow(rows)
    assert list(pandas_table.columns) == arrow_table.column_names
    assert list(pandas_table["decided"]) == list(pandas_table["contact"])
    assert decided(replace(result.segments[0], inseparable=("v-f",))) == "open"
    assert list(pandas_table.columns) == list(COLUMNS[rows])
    assert arrow_table["contact"].to_pylist() == list(pandas_table["contact"])
    name = "environment_axis_x"
    np.testing.assert_array_equal(pandas_table[name], arrow_table[name].to_numpy())
    free = contact_tracker.segment(Trajectory(poses[:30]))
    assert free.to_arrow(rows).schema == arrow_table.schema
    assert list(free.to_pandas(rows).dtypes) == list(pandas_table.dtypes)


def test_rows_of_json_have_the_same_keys_and_types_for_all_contacts(folder, result) -> None:
    rows = [json.loads(line) for line in (folder / "out.jsonl").read_text().splitlines()]
    assert [row["contact"] for row in rows] == [b.contact.value for b in result.beliefs]
    table = read_json(folder / "out.jsonl")
    assert len(table) == len(rows)
    for side in ("object", "environment"):
        assert table[side].to_pylist() == [row[side] for row in rows]


def test_both_forms_of_elements_are_equivalent() -> None:
    rng = np.random.default_rng(3)
    root = rng.normal(size=(6, 6)) * 1e-2
    covariance = root @ root.T
    normal = np.array([0.6, 0.0, 0.8])
    plane = Plane(normal, 0.5, covariance[:4, :4], (Unobserved("shifts_along", normal),), "table")
    values = flat(plane)
    assert (values["type"], values["name"], values["axis"]) == ("face", "table", [0.6, 0.0, 0.8])
    assert values["point_m"] == pytest.approx([0.3, 0.0, 0.4])
    assert json.loads(values["unobserved"]) == [{"shifts_along": [0.6, 0.0, 0.8]}]
    samples = rng.multivariate_normal([*normal, 0.5], covariance[:4, :4] * 1e-6, 20000)
    spread = (samples[:, 3:] * samples[:, :3]).std(axis=0) * 1e3
    np.testing.assert_allclose(values["point_sd_m"], spread, rtol=0.03)
    line, point = flat(Line(normal, normal, covariance)), flat(Point(normal))
    assert (line["type"], point["type"], flat(None)["type"]) == ("edge", "vertex", "none")
    assert point["point_sd_m"] == [None] * 3
    assert [values.keys(), line.keys(), point.keys()] == [flat(None).keys()] * 3


def test_mcap_has_the_recording_and_what_foxglove_draws(folder, log, result) -> None:
    before = [(c.topic, m.log_time, m.data) for _, c, m in make_reader(log.open("rb")).iter_messages()]
    out = make_reader((folder / "out.mcap").open("rb"), decoder_factories=[DecoderFactory()])
    found = list(out.iter_messages())
    ours = ("/contact/belief", "/contact/frames", "/contact/map", "/contact/scene", "/contact/task_frame")
    assert [(c.topic, m.log_time, m.data) for _, c, m in found if c.topic not in ours] == before
    times = [m.log_time for _, _, m in found]
    assert times == sorted(times)
    schemas = {c.topic: (s.name, s.encoding, c.message_encoding) for s, c, _ in found}
    assert schemas["/contact/frames"] == ("foxglove.FrameTransforms", "protobuf", "protobuf")
    assert schemas["/contact/scene"] == ("foxglove.SceneUpdate", "protobuf", "protobuf")
    beliefs = [(m.log_time, json.loads(m.data)) for _, c, m in found if c.topic == "/contact/belief"]
    assert [b for _, b in beliefs] == [json.loads(json.dumps(b.to_json())) for b in result.beliefs]
    assert all(log_time == b["stamp_ns"] + LOG_OFFSET_NS for log_time, b in beliefs)
    frames, poses = transforms(out, "/contact/frames"), result.trajectory.poses
    assert len(frames) == pytest.approx((poses.stamp_ns[-1] - poses.stamp_ns[0]) * 1e-7, rel=0.02)
    for names, stamp_ns, place_m, turn in frames[::50]:
        (row,) = np.flatnonzero(poses.stamp_ns == stamp_ns)
        assert names == ("world", "object")
        np.testing.assert_array_equal([*place_m, *turn], [*poses.position_m[row], *poses.quat_xyzw[row]])
    of_task = transforms(out, "/contact/task_frame")
    assert len(of_task) > 100
    for names, stamp_ns, place_m, _ in of_task[::200]:
        assert names == ("world", "object/task")
        expected = result.task_frames((stamp_ns - result.origin_ns) * 1e-9)[0].T_world_task[:3, 3]
        np.testing.assert_allclose(place_m, expected, atol=1e-4)
    scenes = [(m.log_time, d) for _, _, m, d in out.iter_decoded_messages(topics=["/contact/scene"])]
    assert [t - LOG_OFFSET_NS for t, _ in scenes] == [s.start_ns for s in result.segments]
    for (_, scene), segment in zip(scenes, result.segments, strict=True):
        assert_scene(scene, segment)
    ((_, _, message, known),) = out.iter_decoded_messages(topics=["/contact/map"])
    assert message.log_time == result.trajectory.stamp_ns[0] + LOG_OFFSET_NS
    shown = [(entity.frame_id, entity.texts[0].text) for entity in known.entities]
    assert shown == [(("object", "world")[part.side], part.name) for part in result.parts]
    assert {"object", "world"} == {frame for frame, _ in shown}


def transforms(reader: Any, topic: str) -> list[tuple[tuple[str, str], int, list[float], list[float]]]:
    """Names of frames, stamp, translation and rotation (xyzw) of each message of a topic."""
    found = []
    for *_, message in reader.iter_decoded_messages(topics=[topic]):
        (one,) = message.transforms
        stamp_ns = one.timestamp.seconds * 10**9 + one.timestamp.nanos
        vectors = [
            [getattr(v, axis) for axis in "xyzw"[:n]] for v, n in ((one.translation, 3), (one.rotation, 4))
        ]
        found.append(((one.parent_frame_id, one.child_frame_id), stamp_ns, *vectors))
    return found


def assert_scene(scene: Any, segment: contact_tracker.Segment) -> None:
    """Earlier entities are deleted; triangles lie on the object's element and on that of the surroundings."""
    assert [deletion.type for deletion in scene.deletions] == [1]  # all
    entities = {entity.id: entity for entity in scene.entities}
    if segment.geometry is None:
        assert not entities
        return
    assert {name: entity.frame_id for name, entity in entities.items()} == {
        "object element": "object",
        "environment element": "world",
    }
    for name, element in (("object", segment.geometry.object), ("environment", segment.geometry.environment)):
        entity = entities[f"{name} element"]
        points = np.array([(p.x, p.y, p.z) for p in entity.triangles[0].points])
        assert max(entity.triangles[0].indices) < len(points)
        values = flat(element)
        axis, foot = np.array(values["axis"]), points - values["point_m"]
        if values["type"] == "face":
            rim_m = 1e-2 * np.ptp(foot, axis=0).max() if name == "object" else 1e-6  # of a wheel
            np.testing.assert_allclose(foot @ axis, 0.0, atol=rim_m)
        else:
            assert np.linalg.norm(foot - np.outer(foot @ axis, axis), axis=1).max() < 0.02
    assert entities["environment element"].texts[0].text == segment.contact.value


def test_the_report_is_self_contained_and_small(folder, result) -> None:
    written = (folder / "out.html").read_text(encoding="utf-8")
    assert not re.search(r"\s(src|href|srcset)=", written)
    assert len(written) < 500_000
    assert written.count("<tr") == len(result.segments) + 1
    for text in ("Contacts in cube.mcap", f"{len(result.trajectory)} poses"):
        assert text in written
    for segment in result.segments:
        assert f">{segment.probability:.2f}</td>" in written
    ribbon = written[written.index("<svg") : written.index("</svg>")]
    assert {state.value for state in STATES} <= set(re.findall(r">([^<]+)</text>", ribbon))
    views = re.findall(r"draw3d\(document.currentScript.previousElementSibling,(.*?)\)</script>", written)
    shapes = [shape for view in views for shape in json.loads(view)["shapes"]]
    for part in result.parts:  # the object's in its own picture, the others in that of the geometry
        (shape,) = [one for one in shapes if one.get("label") == part.name]
        assert shape["name"] == (part.name if part.side == 0 else f"surroundings: {part.name}")
        corners = np.frombuffer(b64decode(shape["vertices"]), "<f4").reshape(-1, 3)
        np.testing.assert_array_equal(corners, part.mesh.vertices)
        assert len(b64decode(shape["triangles"])) == 12 * len(part.mesh.triangles)
    names = Counter(shape["name"] for shape in shapes)
    for segment in result.segments:  # both elements of each, and what is known of the object
        start_s = (segment.start_ns - int(result.trajectory.stamp_ns[0])) * 1e-9
        assert names[f"{segment.contact.value} from {start_s:.1f} s"] == (3 if segment.geometry else 0)


PAGE_STUB = """
const drawn = {}, names = [];
const context = new Proxy({}, {
  get: (_, name) => () => ((drawn[name] = (drawn[name] ?? 0) + 1), { width: 9 }),
});
const canvas = { getContext: () => context, clientWidth: 900, clientHeight: 600, addEventListener() {} };
const legend = { appendChild: (entry) => (names.push(entry), entry) };
const picture = { children: [canvas, legend] };
const row = { dataset: { segments: "0" }, classList: { toggle: (_, is) => is && drawn.rows++ } };
drawn.rows = 0;
const document = {
  createElement: () => ({ style: {}, dataset: {} }),
  querySelectorAll: () => [row],
  currentScript: { previousElementSibling: picture },
};
const devicePixelRatio = 1, addEventListener = () => {};
"""


@pytest.mark.skipif(shutil.which("node") is None, reason="no engine that runs the page's scripts")
def test_the_pictures_of_a_report_are_drawn(folder) -> None:
    """Also after clicks on all names, which swap visible and hidden shapes. The contact under the mouse is
    highlighted in the pictures and the table."""
    page = (folder / "out.html").read_text(encoding="utf-8")
    scripts = re.findall("<script>(.*?)</script>", page, re.DOTALL)
    end = "const before = drawn.fill; names.forEach((entry) => entry.onclick());"
    end += "const after = drawn.fill; row.onmouseenter(); const more = [drawn.fill - after, drawn.rows];"
    end += "row.onmouseleave(); canvas.onpointermove({ offsetX: 1, offsetY: 1 });"
    end += "console.log(JSON.stringify([before, after, names.map((entry) => entry.textContent), more]))"
    program = "\n".join([PAGE_STUB, *scripts, end])
    done = subprocess.run(["node", "-"], input=program, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    before, after, names, (drawn, rows) = json.loads(done.stdout)
    assert (drawn > 0, rows) == (True, 1)
    assert 100 < before < after
    assert any(name.startswith("path in") for name in names)


def test_names_are_escaped_in_html(poses, tmp_path) -> None:
    odd = "</script><b>odd"
    geometry = ContactGeometry(Point(np.zeros(3)), Plane(np.array([0.0, 0.0, 1.0]), 0.0, name=odd))
    stamps = poses.stamp_ns[:100]
    segment = Segment(int(stamps[0]), int(stamps[-1]), Contact.VF, 0.9, geometry)
    trajectory = Trajectory(poses[:100], {odd: 1}, odd, notes=(odd,))
    outcome = Outcome(trajectory, Segmentation((segment,)))
    write_outcome(outcome, tmp_path / "odd.html")
    page = (tmp_path / "odd.html").read_text(encoding="utf-8").partition("</head>")[2]
    assert odd not in page
    assert "<b>odd" not in page
    assert html.escape(odd) in page


def test_subtitles_follow_each_other_as_segments_do(folder, result) -> None:
    blocks = (folder / "out.srt").read_text().strip().split("\n\n")
    assert len(blocks) == len(result.segments)
    origin_ns = int(result.trajectory.stamp_ns[0])
    for number, (block, segment) in enumerate(zip(blocks, result.segments, strict=True), 1):
        index, times, text, *_ = block.split("\n")
        assert int(index) == number
        for time, stamp_ns in zip(times.split(" --> "), (segment.start_ns, segment.end_ns), strict=True):
            since = datetime.strptime(time, "%H:%M:%S,%f") - datetime.strptime("0", "%H")
            assert since // timedelta(milliseconds=1) == (stamp_ns - origin_ns) // 10**6
        assert text.startswith(f"{segment.contact.value} ({segment.probability:.2f})")


def test_the_figure_shows_every_segment_and_state(result) -> None:
    *known, posterior, paper = result.plot(curves=True).axes
    for side, axes in enumerate(known):
        names = [part.name for part in result.parts if part.side == side]
        assert [text.get_text() for text in axes.texts] == names
    assert len(posterior.collections) == len(result.segments)
    hatched = [bool(bars.get_hatch()) for bars in posterior.collections]
    assert hatched == [bool(segment.inseparable) for segment in result.segments]
    colours = [bars.get_facecolor()[0] for bars in posterior.collections]
    for text in (label for label in posterior.texts if label.get_text() in list(Contact)):  # not hatched
        assert (colours == np.array(text.get_bbox_patch().get_facecolor())).all(axis=1).any()
    assert [line.get_label() for line in posterior.lines] == [state.value for state in STATES]
    np.testing.assert_array_equal(posterior.lines[0].get_ydata(), result.beliefs.probability[:, 0])
    rows = window_curves.curves(result.trajectory.poses)
    assert [line.get_label() for line in paper.lines] == [contact.value for contact in CONTACTS]
    for line, curve in zip(paper.lines, rows.normalised.T, strict=True):
        np.testing.assert_array_equal(line.get_ydata(), curve)
    _, (own, other) = pyplot.subplots(2)
    assert result.plot(ax=other).axes == [own, other]
    assert (len(own.lines), len(other.lines)) == (0, len(STATES))
    assert len(result.plot().axes) == 3
    figure = pyplot.figure(figsize=(10.0, 4.2), layout="constrained")
    part = next(part for part in result.parts if part.touched_ns)
    _draw_parts(figure, [part._replace(side=0, name=name) for name in ("a\x07", "face 2", "face 3")], 0)
    axes, legend = figure.axes[0], figure.subfigs[0].legends[0]
    boxes = [text.get_window_extent() for text in axes.texts]
    assert not any(a.overlaps(b) for a, b in combinations(boxes, 2))
    assert all(r"a\x07" in one[0].get_text() for one in (axes.texts, legend.get_texts()))
    around = [axis.label.get_window_extent() for axis in (axes.xaxis, axes.yaxis, axes.zaxis)]
    assert not any(one.overlaps(legend.get_window_extent()) for one in around)
    _, axes = pyplot.subplots()
    axes.set(xlim=(0.0, 100.0), ylim=(0.0, 10.0))
    for duration_s in (20.0, 3.0, 0.5):
        _write_in_bar(axes, 10.0, duration_s, (0.0, 1.0), ["\x07"], "none")
    assert [text.get_rotation() for text in axes.texts] == [0.0, 90.0]
    assert axes.texts[0].get_text() == r"\x07"  # a page with control characters is not well-formed
    pyplot.close("all")


def test_doubtful_labels_are_open_and_the_figure_says_why(tmp_path) -> None:
    """Millimetres that are read as metres; elements whose place is not known are drawn about the object."""
    poses = contact_tracker.read(ROOT / "recordings/mug_first_take.mcap").poses[200:460]
    with pytest.warns(contact_tracker.ContactTrackerWarning, match="too fast for metres"):
        result = contact_tracker.segment(Trajectory(replace(poses, position_m=1e3 * poses.position_m)))
    assert {len(one.inseparable) for one in (*result.segments, *result.beliefs)} == {len(STATES) - 1}
    figure = result.plot()
    assert " ".join(figure.get_suptitle().split()) == f"warning: {result.warnings[0]}"
    assert all(bars.get_hatch() for bars in figure.axes[-1].collections)
    (own, surroundings), centre_m = result.parts, 1e3 * np.median(poses.position_m, axis=0)
    assert own.name == "face 1 (place not known)"
    assert max(*np.abs(own.label_m), *np.abs(surroundings.label_m - centre_m)) < 20.0
    pyplot.close(figure)


def test_a_known_upward_is_upward_in_the_figure() -> None:
    axes = pyplot.figure().add_subplot(projection="3d")
    axes.set(box_aspect=(1.0, 1.0, 1.0), xlim=(-1.0, 1.0), ylim=(-1.0, 1.0), zlim=(-1.0, 1.0))
    for up in Rotation.random(10, rng=np.random.default_rng(3)).apply([0.0, 0.0, 1.0]):
        axes.view_init(*_view_of(up))
        (x, y), (from_x, from_y) = (proj_transform(*place, axes.get_proj())[:2] for place in (up, 0.0 * up))
        assert y - from_y > 20.0 * abs(x - from_x)
    pyplot.close("all")


@pytest.mark.parametrize(
    ("given", "parts"),
    [
        ({"up": {"direction": TABLE["normal"]}}, [(0, "edge 1"), (1, "face 1")]),
        ({"environment": {"plane": TABLE}}, [(1, "table"), (0, "edge 2")]),
    ],
)
def test_what_was_touched_is_drawn_with_prior_knowledge_too(poses, given, parts) -> None:
    """Under the name by which it is listed, or as without."""
    found = contact_tracker.segment(Trajectory(poses[1000:1500]), known=given, noise="0.3mm,0.15deg")
    assert [(part.side, part.name) for part in found.parts] == parts
    assert found.map is None


def test_a_users_labels_are_shown_above_those_that_are_found(result, tmp_path) -> None:
    labels = tmp_path / "labels.csv"
    labels.write_text(f"start,end,contact\n0,{result.trajectory.duration_s:.2f},touch\n")
    *_, axes = result.plot(labels=labels, meanings={"touch": "any"}).axes
    assert {"truth", "found", "touch"} <= {text.get_text() for text in axes.texts}


def test_outputs_of_a_trajectory_without_recording_have_its_known_data(poses, tmp_path) -> None:
    few = poses[:400]
    stamps_s = (few.stamp_ns - few.stamp_ns[0]) * 1e-9
    trajectory = Trajectory.from_arrays(stamps_s, few.position_m, few.quat_xyzw)
    result = contact_tracker.segment(trajectory)
    for suffix in ("mcap", "html", "parquet", "srt", "rrd"):
        result.save(tmp_path / f"OUT.{suffix.upper()}")
    assert (tmp_path / "OUT.RRD").read_bytes()[:3] == b"RRF"
    with (tmp_path / "OUT.MCAP").open("rb") as file:
        topics = {channel.topic for channel in make_reader(file).get_summary().channels.values()}
    assert topics == {"/contact/belief", "/contact/frames", "/contact/scene", "/contact/task_frame"}
    early = Trajectory.from_arrays(stamps_s - 1.0, few.position_m, few.quat_xyzw)
    with pytest.raises(contact_tracker.ContactTrackerError, match="between 0 and"):
        contact_tracker.segment(early).to_mcap(tmp_path / "early.mcap")


def test_a_saved_result_is_loaded_whole(folder, result, tmp_path, monkeypatch) -> None:
    result.save(tmp_path / "a.contacts")
    monkeypatch.setattr(saved_state, "__version__", "9.9")  # of another version with the same classes
    loaded = contact_tracker.Result.load(tmp_path / "a.contacts")
    assert str(loaded) == str(result)
    assert len(loaded.segmentation.filtered) == len(result.beliefs)
    for suffix in ("csv", "jsonl", "parquet", "srt", "tex"):
        loaded.save(tmp_path / f"out.{suffix}")
        assert (tmp_path / f"out.{suffix}").read_bytes() == (folder / f"out.{suffix}").read_bytes()
    assert loaded.plot().axes
    save(tmp_path / "b.contacts", result.trajectory, RESULT)
    (tmp_path / "c.contacts").write_bytes((tmp_path / "a.contacts").read_bytes()[:-9])
    for name, message in (
        ("b", "it is no saved result: name another"),
        ("c", "it is damaged"),
        ("d", "No such file"),
    ):
        with pytest.raises(StateError, match=message):
            contact_tracker.Result.load(tmp_path / f"{name}.contacts")


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_a_forged_result_is_refused_or_can_be_used(result, tmp_path) -> None:
    trajectory = result.trajectory[0:3.0]
    contact_tracker.segment(trajectory).save(tmp_path / "a.contacts")
    refused = 0
    for seed in range(40):
        what = forge(tmp_path / "a.contacts", tmp_path / "b.contacts", Random(seed), RESULT)
        try:
            loaded = contact_tracker.Result.load(tmp_path / "b.contacts")
        except StateError:
            refused += 1
            continue
        assert str(loaded), what
        for suffix in ("csv", "jsonl", "srt", "tex"):
            loaded.save(tmp_path / f"out.{suffix}")
    assert 3 < refused < 40


def test_an_output_can_be_read_and_segmented_again(poses, tmp_path) -> None:
    """The result channels in it are replaced."""
    source, counts = write_log(tmp_path / "in.mcap", [poses_topic(poses[:400])]), []
    for name in ("out.mcap", "again.mcap"):
        contact_tracker.segment(source).to_mcap(source := tmp_path / name)
        messages = make_reader(source.open("rb")).iter_messages()
        counts.append(Counter(channel.topic for _, channel, _ in messages))
    assert counts[0] == counts[1]
    alone = Trajectory.from_arrays(*(column[:400] for column in poses.columns), unit="ns")
    contact_tracker.segment(alone).to_mcap(tmp_path / "alone.mcap")
    with pytest.raises(contact_tracker.ContactTrackerError, match="topic='/contact/frames'"):
        contact_tracker.read(tmp_path / "alone.mcap")
    assert len(contact_tracker.read(tmp_path / "alone.mcap", topic="/contact/frames")) > 100


def test_truth_and_metadata_are_copied(tmp_path) -> None:
    made = recorded(FACE_TO_EDGE)
    write_recording(str(tmp_path / "in.mcap"), made.poses[:400], made.truth, {"scenario": "x"})
    contact_tracker.segment(tmp_path / "in.mcap").to_mcap(tmp_path / "out.mcap")
    for path in (tmp_path / "in.mcap", tmp_path / "out.mcap"):
        with path.open("rb") as file:
            out = make_reader(file)
            assert [a.name for a in out.iter_attachments()] == ["truth.json"]
            assert [m.metadata for m in out.iter_metadata()] == [{"scenario": "x"}]


def test_the_ribbon_has_a_bar_for_each_further_contact() -> None:
    """During the contact, in the lower part of its segment; one that comes again keeps its lane."""
    plane = Plane(np.array([0.0, 0.0, 1.0]), 0.0)
    walls = [ContactGeometry(Point(np.full(3, float(i))), plane) for i in range(6)]
    joins = FurtherContact(Contact.EF, 0.9, 4, 7, walls[0], (), 2)
    stays = FurtherContact(Contact.VF, 0.5, 6, None, walls[0], (), 3)
    free = Segment(10, 30, Contact.FREE, 1.0, None)
    bars = bars_of(Segment(0, 10, Contact.VF, 1.0, walls[0], (), (joins, stays)), free)
    spans_s = [bar.intervalx for bar in bars]
    np.testing.assert_allclose(np.diff(spans_s)[:, 0] * 1e9, [10, 3, 4, 20], atol=1e-3)
    runs = tuple(replace(joins, start_ns=a, end_ns=a + 2, geometry=wall) for a in (1, 5) for wall in walls)
    ribbon, *bars = bars_of(Segment(0, 10, Contact.VF, 1.0, walls[0], (), runs))
    lanes = np.array([bar.intervaly for bar in bars])
    np.testing.assert_allclose(lanes[:6], lanes[6:])
    np.testing.assert_allclose(lanes[1:6, 0], lanes[:5, 1])
    assert lanes.max() <= ribbon.y1 + 1e-9


def bars_of(*segments: Segment) -> list[Any]:
    """The boxes of the segments in a figure and of their further contacts."""
    few = recorded(FACE_TO_EDGE).poses[:9]
    trajectory = Trajectory(Poses(np.arange(9), few.position_m, few.quat_xyzw))
    _, axes = pyplot.subplots()
    draw_on(axes, Outcome(trajectory, Segmentation(segments)))
    return [bars.get_paths()[0].get_extents() for bars in axes.collections]


def test_a_recording_of_one_pose_has_figures(poses, tmp_path) -> None:
    result = contact_tracker.segment(Trajectory(poses[:1]))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        result.save(tmp_path / "a.html")
    assert "<p>1 pose, 0.00 s of motion, 1 segment" in (tmp_path / "a.html").read_text()
