"""A batch: a row for each recording, and updates of changed recordings only."""

import json
import os
import sys
from contextlib import nullcontext
from pathlib import Path
from unittest.mock import patch

import pyarrow
import pytest
from pyarrow import parquet

import contact_tracker
from batches import BROKEN, MODEL, contents, run, settings, write_broken, write_recordings
from contact_tracker import errors
from contact_tracker.batch import segmenting
from contact_tracker.batch.dataset import FORMAT, Batch, open_dataset
from contact_tracker.batch.finding import find, tables_beside
from contact_tracker.batch.segmenting import segment_recording
from contact_tracker.errors import ContactTrackerWarning, StateError, UnreadableRecording, UsageError
from contact_tracker.exports.columns import COLUMNS
from contact_tracker.recording import WRENCH_TYPE, write_recording
from contact_tracker.states import CONTACTS, STATES, Contact
from contact_tracker.tracking.belief import Segment
from mcap_logs import Topic, header, poses_topic, smooth_poses, vector, write_log
from short_recordings import FACE_TO_EDGE, recorded

TYPES = {"integer": pyarrow.int64(), "number": pyarrow.float64(), "text": pyarrow.string()}


def summary(dataset: Path) -> pyarrow.Table:
    return parquet.read_table(dataset / "summary.parquet")


@pytest.fixture
def recordings(tmp_path) -> list[Path]:
    return write_recordings(tmp_path / "logs")


def test_each_recording_has_a_row_and_those_that_can_be_used_their_segments(tmp_path) -> None:
    good = write_recordings(tmp_path / "logs")
    cut = tmp_path / "logs" / "cut.mcap"
    write_recording(str(cut), smooth_poses(600), None, {})
    cut.write_bytes(cut.read_bytes()[:-700])
    broken = write_broken(tmp_path / "broken")
    again = good[0], tmp_path / "logs" / ".." / "logs" / "0.mcap"  # one with three names is done once
    outcome = run([tmp_path / "logs", *again, *broken], tmp_path / "dataset")
    assert (outcome.done, outcome.unchanged) == (len(good) + 1 + BROKEN, 0)
    assert (outcome.bad, outcome.damaged) == (BROKEN, 1)
    table = summary(tmp_path / "dataset")
    assert {one.name: one.type for one in table.schema} == {
        name: TYPES[kind] for name, kind in segmenting.SUMMARY_COLUMNS.items()
    }
    assert table["recording"].to_pylist() == sorted(map(str, [*good, cut, *broken]))
    codes = dict(zip(table["recording"].to_pylist(), table["exit_code"].to_pylist(), strict=True))
    assert [codes[str(path)] for path in good] == [0] * len(good)
    found = {Path(name).stem: codes[name] for name in map(str, [cut, *broken])}
    unreadable = dict.fromkeys(("empty", "short", "zeros", "text", "link"), 1)
    assert found == {"cut": 3, **unreadable, "ambiguous": 2}
    for row in table.to_pylist():
        is_usable = row["exit_code"] in (0, 3)
        assert (row["error"] is None) == is_usable
        assert is_usable or row["recording"] in row["error"]
        assert (row["damage"] is not None) == (row["exit_code"] == 3)
        assert (row["file"] is not None) == is_usable
    files = {name.removeprefix("segments/") for name in contents(tmp_path / "dataset") if "/" in name}
    assert files == set(table["file"].to_pylist()) - {None}


def test_batch_and_segment_write_the_same(tmp_path) -> None:
    log = tmp_path / "cube.mcap"
    write_recording(str(log), recorded(FACE_TO_EDGE).poses[:500], None, {})
    run([log], tmp_path / "dataset", with_ticks=True)
    result = contact_tracker.segment(log)
    (row,) = summary(tmp_path / "dataset").to_pylist()
    for kind in COLUMNS:
        path = tmp_path / "dataset" / kind / row["file"]
        written = parquet.read_table(path)
        assert path.stat().st_size == row[f"{kind}_bytes"]
        assert set(written["recording"].to_pylist()) == {str(log)}
        assert written.drop_columns("recording").equals(result.to_arrow(kind))
    assert row["poses"] == len(result.trajectory)
    assert row["duration_s"] == pytest.approx(result.trajectory.duration_s)
    assert (row["ticks"], row["segments"]) == (len(result.beliefs), len(result.segments))
    assert json.loads(row["counts"]) == dict(result.counts)
    assert (row["warnings"] or "").splitlines() == list(result.warnings)
    for state in STATES:
        name = state.value.replace("-", "")
        spans = [segment.end_ns - segment.start_ns for segment in result.segments if segment.contact is state]
        assert (row[f"segments_{name}"], row[f"time_{name}_s"]) == (len(spans), sum(spans) / 1e9)
    assert row["segments_ff"] > 0
    assert row["sigma_position_m"] == pytest.approx(result.report.noise[0])


def test_the_second_run_opens_nothing(tmp_path, monkeypatch) -> None:
    good, broken = write_recordings(tmp_path / "logs"), write_broken(tmp_path / "broken")
    first = run([*good, *broken], tmp_path / "dataset")
    before = contents(tmp_path / "dataset")
    read, names = segmenting.read_content, list[str]()
    monkeypatch.setattr(segmenting, "read_content", lambda name: names.append(name) or read(name))
    second = run([*good, *broken], tmp_path / "dataset")
    assert names == [str(tmp_path / "broken" / "link.mcap")]  # a dangling link has to be checked again
    missing = 1
    assert (second.done, second.unchanged) == (missing, first.total - missing)
    assert (second.bad, second.damaged) == (first.bad, first.damaged)
    assert contents(tmp_path / "dataset") == before


def test_only_changed_recordings_are_done_again(tmp_path, recordings, monkeypatch) -> None:
    dataset = tmp_path / "dataset"

    def done(**options: object) -> set[str]:
        new: list[segmenting.Row] = []
        run(recordings, dataset, new, **options)
        return {Path(row["recording"]).stem for row in new}

    assert done() == {"0", "1"}
    assert done() == set()
    before = contents(dataset)
    os.utime(recordings[0], ns=(1, 1))
    assert done() == set()  # it is read, and its content is unchanged
    now = contents(dataset)
    assert now.pop("signatures.parquet") != before.pop("signatures.parquet")
    assert now == before
    write_recording(str(recordings[1]), smooth_poses(80, seed=9), None, {})
    assert done() == {"1"}
    assert summary(dataset)["poses"].to_pylist() == [60, 80]
    file = summary(dataset)["file"][0].as_py()
    (dataset / "segments" / file).unlink()
    assert done() == {"0"}
    assert done(with_ticks=True) == {"0", "1"}
    assert done(with_ticks=True) == set()
    assert done() == set()
    assert done(model=MODEL.with_noise(1e-3, 1e-2)) == {"0", "1"}
    assert not list(dataset.glob("ticks/*/*"))  # those of the other model are removed
    assert done(topic="/object/pose") == {"0", "1"}
    recordings[0].write_bytes(b"")
    assert done(topic="/object/pose") == {"0"}
    assert len(list(dataset.glob("segments/*/*"))) == 1  # its old result is removed
    monkeypatch.setattr(segmenting, "__version__", "9.9")
    assert done(topic="/object/pose") == {"0", "1"}


def test_a_change_without_new_size_or_time_is_detected_by_a_new_time_only(tmp_path, recordings) -> None:
    run(recordings[:1], tmp_path / "dataset")
    state = recordings[0].stat()
    data = bytearray(recordings[0].read_bytes())
    data[len(data) // 2] ^= 1
    with open(recordings[0], "r+b") as file:
        file.write(data)
    os.utime(recordings[0], ns=(state.st_atime_ns, state.st_mtime_ns))
    assert run(recordings[:1], tmp_path / "dataset").unchanged == 1
    recordings[0].touch()
    assert run(recordings[:1], tmp_path / "dataset").done == 1


@pytest.mark.parametrize(
    ("place", "error", "code", "said", "bad_again"),
    [
        ("batch.segmenting.open_log", MemoryError(), 1, "it takes more memory than there is", 0),
        ("recording.text_tables.TextTable._opened", OSError(5, "Input/output error"), 1, "Input/", 0),
        ("batch.segmenting.open_log", ZeroDivisionError("by 0"), errors.UNEXPECTED, "by 0 (mock.py:", 1),
    ],
    ids=["memory", "disk", "internal"],
)
def test_errors_are_rows_and_system_errors_are_tried_again(
    tmp_path, place, error, code, said, bad_again
) -> None:
    """Internal ones in the next version."""
    log = tmp_path / "a.csv"
    log.write_text("t,x,y,z,qx,qy,qz,qw\n" + "".join(f"{0.01 * i:.2f},0,0,0,0,0,0,1\n" for i in range(60)))

    with patch(f"contact_tracker.{place}", side_effect=error):
        assert run([log], tmp_path / "dataset").bad == 1
    (row,) = summary(tmp_path / "dataset").to_pylist()
    assert row["exit_code"] == code
    assert row["error"].startswith(f"{log}: ")
    assert said in row["error"]
    again = run([log], tmp_path / "dataset")
    assert (again.bad, again.unchanged) == (bad_again, bad_again)


def test_a_recording_that_changes_while_it_is_read_has_no_result(tmp_path, recordings) -> None:
    read = segmenting.read_content

    def read_and_change(name: str) -> object:
        os.utime(name, ns=(5, 5))
        return read(name)

    with patch.object(segmenting, "read_content", read_and_change):
        assert run(recordings[:1], tmp_path / "dataset").bad == 1
    (row,) = summary(tmp_path / "dataset").to_pylist()
    assert "it changed while it was read" in row["error"]
    assert not list((tmp_path / "dataset").glob("segments/*/*"))
    assert run(recordings[:1], tmp_path / "dataset").bad == 0


def test_a_recording_that_ends_processes_is_a_row_and_tried_again(tmp_path, recordings) -> None:
    with open_dataset(tmp_path / "dataset") as dataset:
        batch = Batch(settings(), dataset, lambda _: None, lambda _: None)
        killed = lambda _, jobs: ((job, None) for job in jobs)  # noqa: E731
        outcome = batch.run(find(map(str, recordings[:1])), lambda: nullcontext(killed))
    assert outcome.bad == 1
    assert set(summary(tmp_path / "dataset")["exit_code"].to_pylist()) == {errors.KILLED}
    assert run(recordings[:1], tmp_path / "dataset").bad == 0


def test_recorded_rows_survive_a_kill(tmp_path, recordings) -> None:
    """Except an incomplete last line of the journal, and lines of something else."""
    dataset = tmp_path / "dataset"
    run(recordings, dataset)
    whole = contents(dataset)
    for path in (dataset / "summary.parquet", dataset / "signatures.parquet"):
        path.unlink()
    with open_dataset(dataset) as opened:
        for path in recordings:
            opened.record(segment_recording(str(path), None, settings(), str(dataset)))
        journal = (dataset / "journal.jsonl").read_bytes()
    (dataset / "summary.parquet").unlink()
    nested = b'{"recording": "a", "signature": "", "row": ' + b"[" * 100_000 + b"\n"
    row = {key: {"a": 1} for key in segmenting.SUMMARY_COLUMNS}
    odd = json.dumps({"recording": "a", "signature": "", "row": row}).encode() + b"\n"
    (dataset / "journal.jsonl").write_bytes(nested + odd + journal[:-20])
    assert run(recordings, dataset).unchanged == 1
    assert contents(dataset) == whole


def test_a_dataset_is_written_by_one_and_replaces_nothing_else(tmp_path, recordings) -> None:
    run(recordings[:1], tmp_path / "dataset")
    with open_dataset(tmp_path / "dataset"), pytest.raises(UsageError, match="another process is writing it"):
        run(recordings, tmp_path / "dataset")
    (tmp_path / "dataset" / "dataset.json").write_text(json.dumps(FORMAT | {"format_version": 3}))
    for dataset, words in (
        (tmp_path / "logs", "it holds something else"),
        (recordings[0], "it is a file"),
        (tmp_path / "no" / "dataset", "there is no folder"),
        (tmp_path / "dataset", "of another version"),
    ):
        with pytest.raises(UsageError, match=words):
            run(recordings, dataset)


@pytest.mark.parametrize("name", ["segments", "journal.jsonl", "segments/{}/{}"])
def test_nothing_is_written_through_links_in_a_dataset(name, tmp_path, recordings) -> None:
    dataset, own = tmp_path / "dataset", Path(segmenting.file_of(str(recordings[0])))
    run(recordings[1:], dataset)
    link = dataset / name.format(own.parent, own.name)
    is_file = bool(link.suffix)
    link.parent.mkdir(exist_ok=True)
    if link.exists():
        link.rename(tmp_path / link.name)
    target = tmp_path / ("secret" if is_file else "secrets/secret")
    target.parent.mkdir(exist_ok=True)
    target.write_text("secret")
    link.symlink_to(target if is_file else target.parent)
    with pytest.raises(OSError, match="a dataset has none"):
        run(recordings, dataset)
    assert target.read_text() == "secret"
    assert is_file or os.listdir(target.parent) == ["secret"]


def test_a_damaged_summary_is_reported(tmp_path, recordings) -> None:
    run(recordings[:1], tmp_path / "dataset")
    for name in ("summary.parquet", "signatures.parquet"):
        path = tmp_path / "dataset" / name
        whole = path.read_bytes()
        path.write_bytes(whole[:-10])
        with pytest.raises(StateError, match=f"{name}: it is damaged"):
            run(recordings[:1], tmp_path / "dataset")
        path.write_bytes(whole)


def test_a_folder_is_searched_and_one_with_metadata_is_one_recording(tmp_path) -> None:
    write_recordings(tmp_path / "logs" / "deep", 2)
    poses = smooth_poses(120)
    bag = tmp_path / "logs" / "bag"
    bag.mkdir()
    for i in range(2):
        write_recording(str(bag / f"bag_{i}.mcap"), poses[60 * i : 60 * (i + 1)], None, {})
    (bag / "metadata.yaml").write_text("rosbag2_bagfile_information: {}\n")
    (tmp_path / "logs" / "notes.csv").write_text("a,b\n")
    found = [Path(one.name).relative_to(tmp_path / "logs") for one in find([str(tmp_path / "logs")])]
    assert found == [Path("bag"), Path("deep/0.mcap"), Path("deep/1.mcap")]
    run([tmp_path / "logs"], tmp_path / "dataset")
    assert summary(tmp_path / "dataset")["poses"].to_pylist() == [120, 60, 60]
    (tmp_path / "empty").mkdir()
    with pytest.raises(UnreadableRecording, match=r"holds no recording \(\.mcap, "):
        list(find([str(tmp_path / "empty")]))


def test_tables_beside_the_recordings_of_a_folder_are_found(tmp_path) -> None:
    logs = tmp_path / "logs"
    write_recordings(logs / "deep", 2)
    (logs / "bag").mkdir()
    write_recordings(logs / "bag", 1)
    (logs / "bag" / "metadata.yaml").write_text("rosbag2_bagfile_information: {}\n")
    (logs / "notes").mkdir()
    for name in ("readme.txt", "poses.csv", "notes/other.csv", "empty.mcap"):
        (logs / name).touch()
    os.mkfifo(logs / "pipe")
    for name, tables in ((f"{logs}", 2), (f"{logs}/notes", 0), (f"{logs}/bag", 0), (f"{logs}/empty.mcap", 0)):
        assert len(tables_beside(name)) == tables, name
    found = [Path(one.name).relative_to(logs).as_posix() for one in find([str(logs)])]
    assert found == ["bag", "deep/0.mcap", "deep/1.mcap", "empty.mcap"]


@pytest.mark.skipif(sys.platform != "linux", reason="names of files are text elsewhere")
def test_a_name_of_any_bytes_is_text_in_the_summary(tmp_path) -> None:
    (path,) = write_recordings(tmp_path / "logs", 1)
    odd = os.fsdecode(os.fsencode(tmp_path / "logs") + b"/\xff\n.mcap")
    path.rename(odd)
    assert run([tmp_path / "logs"], tmp_path / "dataset").bad == 0
    assert summary(tmp_path / "dataset")["recording"].to_pylist() == [f"{tmp_path}/logs/\\xff\n.mcap"]
    assert run([tmp_path / "logs"], tmp_path / "dataset").unchanged == 1


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs pipes with names")
def test_other_than_regular_files_do_not_block(tmp_path) -> None:
    os.mkfifo(tmp_path / "pipe.mcap")
    assert run([tmp_path / "pipe.mcap"], tmp_path / "dataset").bad == 1
    assert "not a regular file" in summary(tmp_path / "dataset")["error"][0].as_py()


def test_a_full_disk_ends_the_run_and_keeps_earlier_results(tmp_path, recordings, monkeypatch) -> None:
    whole_file = segmenting.whole_file

    def refuse(path: Path) -> object:
        if list((tmp_path / "dataset").glob("segments/*/*.parquet")):
            raise OSError(28, "No space left on device", str(path))
        return whole_file(path)

    monkeypatch.setattr(segmenting, "whole_file", refuse)
    with pytest.raises(OSError, match="No space left"):
        run(recordings, tmp_path / "dataset")
    assert len(summary(tmp_path / "dataset")) == 1


@pytest.mark.long
def test_wrenches_decide_as_they_do_for_one_recording(tmp_path) -> None:
    poses, frame, force = recorded(FACE_TO_EDGE).poses, "world", [0.0, 0.0, -9.81]
    wrench = {"force": vector(force), "torque": vector([0.0, 0.0, 0.0])}
    messages = [(int(t), {"header": header(int(t), frame), "wrench": wrench}) for t in poses.stamp_ns]
    topics = [poses_topic(poses), Topic("/wrench", WRENCH_TYPE, messages)]
    names = write_recordings(tmp_path / "logs", 1)
    log = write_log(tmp_path / "logs" / "a.mcap", topics)
    names.append(log)
    run(names, tmp_path / "dataset", wrench="/wrench")
    without, row = summary(tmp_path / "dataset").sort_by([("exit_code", "descending")]).to_pylist()
    assert (without["exit_code"], row["exit_code"]) == (2, 0)
    assert "no topic /wrench" in without["error"]
    with pytest.warns(ContactTrackerWarning, match="/wrench is not used"):
        result = contact_tracker.segment(log, wrench="/wrench")
    assert list(result.warnings) == (row["warnings"] or "").splitlines()
    written = parquet.read_table(tmp_path / "dataset" / "segments" / row["file"])
    assert written.drop_columns("recording").equals(result.to_arrow("segments"))
    assert run(names, tmp_path / "dataset", wrench="/wrench").unchanged == 2
    assert run(names, tmp_path / "dataset").done == 2


def test_what_the_motion_leaves_open_counts_for_no_contact() -> None:
    """At rest the label is that of a near tie, which noise decides."""
    cells, others = dict(segmenting.NO_SEGMENTS), CONTACTS
    segmenting.count([Segment(0, 3 * 10**9, Contact.FREE, 0.29, None, others)], cells)
    segmenting.count([Segment(3 * 10**9, 5 * 10**9, Contact.FREE, 0.9, None, others[:1])], cells)
    assert (cells["time_free_s"], cells["segments_free"]) == (2.0, 1)
    assert (cells["time_open_s"], cells["segments_open"]) == (3.0, 1)
    assert cells["segments"] == 2
