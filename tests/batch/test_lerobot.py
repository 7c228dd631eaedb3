"""LeRobot data sets: their poses, and copies with the contacts of their frames."""

import hashlib
import json
from unittest.mock import patch

import numpy as np
import pandas
import pyarrow
import pytest
from pyarrow.parquet import read_table, write_table

from command_line import run
from contact_tracker.batch.lerobot import NAMES, LeRobot
from contact_tracker.errors import UnreadableRecording, UsageError
from contact_tracker.segmenting import segmented
from contact_tracker.states import STATES
from lerobot_data import FPS, POSE, write_data_set
from short_recordings import FACE_TO_EDGE, MODEL, recorded

ANGLES = ["x", "y", "z", "roll", "pitch", "yaw", "gripper"]
BY_HAND = ["--columns", "position=observation.state[0:3],quaternion=observation.state[3:7]"]
BY_NUMBER = {"position": "observation.state[0:3]", "quaternion": "observation.state[3:7]"}


@pytest.fixture(scope="module")
def simulated():
    return recorded(FACE_TO_EDGE)


@pytest.fixture(scope="module")
def outcome(simulated, tmp_path_factory):
    """The segmentation of its poses at 50 Hz."""
    folder = write_data_set(tmp_path_factory.mktemp("one") / "data", [simulated], "v3.0")
    return segmented(LeRobot.open(folder).trajectory(0), MODEL)


@pytest.fixture
def source(simulated, tmp_path):
    """A data set of its one episode."""
    return write_data_set(tmp_path / "data", [simulated], "v3.0")


@pytest.fixture
def at_once(outcome):
    """Segments any episode as this one."""
    with patch("contact_tracker.batch.lerobot.segmented", return_value=outcome) as segmented_with:
        yield segmented_with


def content(folder):
    return {
        path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in folder.rglob("*")
        if path.is_file()
    }


@pytest.mark.parametrize("version", ["v2.1", "v3.0"])
@pytest.mark.parametrize(
    ("names", "euler", "reading"),
    [
        (POSE, None, {}),
        ({"motors": POSE}, None, {}),
        ({name: k for k, name in enumerate(POSE)}, None, {}),
        (None, None, {"columns": BY_NUMBER}),
        (POSE, None, {"columns": BY_NUMBER}),
        (ANGLES, "xyz", {"euler": "xyz:rad"}),
    ],
)
def test_poses_of_an_episode(simulated, tmp_path, version, names, euler, reading) -> None:
    folder = write_data_set(tmp_path / "data", [simulated] * 2, version, names, euler)
    data = LeRobot.open(folder, **reading)
    assert [number for number, _ in data.episodes()] == [0, 1]
    trajectory = data.trajectory(1)
    poses = simulated.poses[:: 200 // FPS]
    np.testing.assert_allclose(trajectory.position_m, poses.position_m, atol=1e-6)
    turned = np.abs((trajectory.quat_xyzw * poses.quat_xyzw).sum(axis=1))
    np.testing.assert_allclose(turned, 1.0, atol=1e-6)
    np.testing.assert_allclose(np.diff(trajectory.stamp_ns), 1e9 / FPS, rtol=1e-3)


def write_new(table, path) -> None:
    assert not path.exists(), "frames are copied only to be written again"
    write_table(table, path)


@pytest.mark.parametrize(("version", "name"), [("v2.1", "../data"), ("v3.0", ".")])
def test_a_copy_has_contacts_of_its_frames(simulated, at_once, tmp_path, monkeypatch, version, name) -> None:
    """The source is as before, and what else there is copied, but no frames."""
    source = write_data_set(tmp_path / "data", [simulated], version)
    before = content(source)
    copy = tmp_path / "copy"
    monkeypatch.chdir(source)
    with patch("contact_tracker.batch.lerobot.write_table", write_new):
        assert LeRobot.open(name).annotate(copy, MODEL) == 0
    assert content(source) == before
    assert (copy / "videos" / "camera.mp4").read_bytes() == b"frames"
    (file,) = (copy / "data").rglob("*.parquet")
    frames, given = read_table(file), read_table(source / file.relative_to(copy))
    assert frames.select(given.column_names).equals(given)
    described = json.loads(frames.schema.metadata[b"huggingface"])["info"]["features"]
    assert list(described) == frames.column_names
    subtask = frames["subtask_index"].to_numpy()
    time_s = frames["timestamp"].to_numpy()
    true_ns = simulated.truth.intervals[1].start_ns - simulated.poses.stamp_ns[0]
    (change,) = np.flatnonzero(np.diff(subtask))
    assert [NAMES[subtask[change]], NAMES[subtask[change + 1]]] == ["f-f", "e-f"]
    assert abs(time_s[change + 1] - true_ns * 1e-9) < 0.4
    probability = np.array(frames["contact_probability"].to_pylist())
    np.testing.assert_allclose(probability.sum(axis=1), 1.0, atol=1e-5)
    features = json.loads((copy / "meta" / "info.json").read_text())["features"]
    assert features["contact_probability"] == {"dtype": "float32", "shape": [7], "names": list(STATES)}
    assert features.keys() - {"subtask_index", "contact_probability"} < features.keys()
    if version == "v3.0":
        table = pandas.read_parquet(copy / "meta" / "subtasks.parquet")
        assert table.iloc[1].name == "e-f"  # as LeRobot looks it up
        assert list(table.subtask_index) == [*range(len(NAMES))]
    else:
        rows = [json.loads(line) for line in (copy / "meta" / "subtasks.jsonl").read_text().splitlines()]
        assert rows[1] == {"subtask_index": 1, "subtask": "e-f"}
    again = LeRobot.open(copy)  # a copy of a copy has the columns once
    assert again.trajectory(0).stamp_ns.tolist() == LeRobot.open(source).trajectory(0).stamp_ns.tolist()


@pytest.mark.parametrize("version", ["v2.0", "v2.1", "v3.0"])
def test_statistics_of_replaced_columns_are_removed(simulated, at_once, tmp_path, version) -> None:
    source, meta = write_data_set(tmp_path / "data", [simulated] * 2, version), tmp_path / "data" / "meta"
    features = {"action": {"mean": [8.0], "count": [5]}, "subtask_index": {"mean": [8.0], "count": [5]}}
    if version == "v2.1":
        lines = (json.dumps({"episode_index": k, "stats": features}) for k in range(2))
        (meta / "episodes_stats.jsonl").write_text("\n".join(lines) + "\n", encoding="utf-8")
    else:
        (meta / "stats.json").write_text(json.dumps(features), encoding="utf-8")
    episodes = meta / "episodes" / "chunk-000" / "file-000.parquet"
    if version == "v3.0":
        episodes.parent.mkdir(parents=True)
        columns = {f"stats/{name}/{key}": [v] * 2 for name, one in features.items() for key, v in one.items()}
        write_table(pyarrow.table({"episode_index": [1, 0], **columns}), episodes)
    LeRobot.open(source).annotate(tmp_path / "copy", MODEL)
    copied = tmp_path / "copy" / "meta"
    if version == "v2.1":
        found = [json.loads(line) for line in (copied / "episodes_stats.jsonl").read_text().splitlines()]
        assert found == [{"episode_index": k, "stats": {"action": features["action"]}} for k in range(2)]
    else:
        assert json.loads((copied / "stats.json").read_text()) == {"action": features["action"]}
    if version == "v3.0":
        table = read_table(copied / episodes.relative_to(meta))
        assert table.column_names == ["episode_index", "stats/action/mean", "stats/action/count"]


@pytest.mark.parametrize("text", ["[", "[]", "[" * 100_000, "{}" + " " * 20_000_000], ids=len)
def test_statistics_that_cannot_be_read_are_one_line(source, at_once, tmp_path, text) -> None:
    (source / "meta" / "stats.json").write_text(text, encoding="utf-8")
    with pytest.raises(UnreadableRecording, match=r"meta/stats\.json: statistics cannot be read"):
        LeRobot.open(source).annotate(tmp_path / "copy", MODEL)
    assert not (tmp_path / "copy").exists()


def test_a_data_set_without_frames_or_with_an_episode_twice_is_refused(source, tmp_path) -> None:
    (file,) = source.rglob("file-000.parquet")
    again = file.with_name("file-001.parquet")
    write_table(read_table(file), again)
    with pytest.raises(UnreadableRecording, match="episode 0 is in two files"):
        LeRobot.open(source).annotate(tmp_path / "copy", MODEL)
    again.unlink()
    write_table(read_table(file)[:0], file)
    (source / "meta" / "stats.json").write_text("{}", encoding="utf-8")
    with pytest.raises(UnreadableRecording, match="there are no frames"):
        LeRobot.open(source).annotate(tmp_path / "copy", MODEL)


@pytest.mark.long
def test_the_command_with_an_episode_that_cannot_be_used(simulated, tmp_path) -> None:
    """Of several episodes in a file, one has no orientation: it is unknown, and the others are labelled."""
    source = write_data_set(tmp_path / "data", [simulated, simulated], "v3.0")
    (file,) = source.rglob("file-000.parquet")
    frames = read_table(file).to_pylist()
    for frame in frames:
        if frame["episode_index"] == 1:
            frame["observation.state"] = [0.0] * 8
    write_table(pyarrow.Table.from_pylist(frames), file)
    done = run("batch", "data", "-o", "copy", cwd=tmp_path)
    assert done.returncode == 3, done.stderr
    assert "episode 1: no pose that can be used" in done.stderr
    table = read_table(tmp_path / "copy" / "data" / "chunk-000" / "file-000.parquet")
    episode, subtask = (table[name].to_numpy() for name in ("episode_index", "subtask_index"))
    assert {NAMES[k] for k in subtask[episode == 1]} == {"unknown"}
    assert {NAMES[k] for k in subtask[episode == 0]} == {"f-f", "e-f"}


def test_forces_of_a_feature_are_the_wrench(source, at_once, tmp_path) -> None:
    """Of all entries or of some; what is said of them is reported for the episode."""
    data, lines, evidence = LeRobot.open(source), [], object()
    wrenches = data.wrenches(0, "observation.state[1:5],observation.state[5:7]")
    frames = read_table(source / "data" / "chunk-000" / "file-000.parquet")
    state = np.array(frames["observation.state"].to_pylist())
    np.testing.assert_array_equal(np.hstack([wrenches.force_n, wrenches.moment_nm]), state[:, 1:7])
    assert wrenches.stamp_ns.tolist() == data.trajectory(0).stamp_ns.tolist()
    options = {"report": lines.append, "wrench": "observation.state[1:7]"}
    with patch("contact_tracker.batch.lerobot.evidence_as_given") as given:
        given.return_value = evidence, "", ("a doubt",)
        data.annotate(tmp_path / "copy", MODEL, **options)
    assert at_once.call_args.args[-1] is evidence
    np.testing.assert_array_equal(given.call_args.args[0].force_n, wrenches.force_n)
    assert [line.endswith("episode 0: a doubt") for line in lines] == [True]


def test_missing_forces_end_nothing_but_their_episode(source, tmp_path) -> None:
    lines, file = [], source / "data" / "chunk-000" / "file-000.parquet"
    frames = read_table(file).to_pylist()
    frames[5]["observation.state"] = None
    write_table(pyarrow.Table.from_pylist(frames), file)
    data = LeRobot.open(source)
    assert data.annotate(tmp_path / "copy", MODEL, report=lines.append, wrench="observation.state[1:7]") == 1
    assert [line.endswith("observation.state has missing values") for line in lines] == [True]


def test_what_cannot_be_read_is_one_line(simulated, tmp_path) -> None:
    folder = write_data_set(tmp_path / "data", [simulated], "v2.1", [f"joint_{k}" for k in range(8)])
    with pytest.raises(UsageError, match=r"--columns position=observation\.state\[0:3\]"):
        LeRobot.open(folder).trajectory(0)
    with pytest.raises(UsageError, match="a column is"):
        LeRobot.open(folder, columns={"place": "x"})
    with pytest.raises(UsageError, match="no episode 5"):
        LeRobot.open(folder).trajectory(5)
    for time in ({"time_unit": "ms"}, {"columns": {"time": "timestamp", **BY_NUMBER}}):
        with pytest.raises(UsageError, match="timestamp, in seconds"):
            LeRobot.open(folder, **time)
    (tmp_path / "copy").mkdir()
    for arguments, words in (
        (["data", "-o", "data/copy"], "new folder"),
        (["data", "-o", "copy"], "new folder"),
        (["data", "x.mcap", "-o", "new"], "alone"),
        (["data", "-o", "new", "--ticks"], "--ticks"),
        (["data", "-o", "new", "--wrench", "observation.state", *BY_HAND], "has 8 numbers"),
        (["data", "-o", "new", "--wrench", "/wrench"], "not in /wrench"),
        (["data", "-o", "new", "--time-unit", "ms"], "in seconds"),
    ):
        done = run("batch", *arguments, "--processes", "1", cwd=tmp_path)
        assert (done.returncode, words in done.stderr) == (2, True), done.stderr
    (folder / "elsewhere").symlink_to(tmp_path)
    done = run("batch", "data", "-o", "new", "--processes", "1", cwd=tmp_path)
    assert (done.returncode, "elsewhere is a link to a folder" in done.stderr) == (2, True), done.stderr
    (folder / "elsewhere").unlink()
    (folder / "data" / "chunk-000" / "episode_000000.parquet").write_bytes(b"PAR1")
    with pytest.raises(UnreadableRecording, match="cannot be read"):
        LeRobot.open(folder).trajectory(0)
    for text, words in (
        ("{}", "not of None"),
        ("[", "cannot be read"),
        ("[" * 100_000, "cannot be read"),
        ('{"codebase_version": "v1.6"}', "v1"),
    ):
        (folder / "meta" / "info.json").write_text(text)
        with pytest.raises(UnreadableRecording, match=words):
            LeRobot.open(folder)
