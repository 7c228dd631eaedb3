"""The commands on other inputs than MCAP with poses: tables, chains of transforms, other bodies."""

import json
from inspect import signature
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_commands import assert_one_line_error

from batches import run as batch
from command_line import run, shown_on_a_terminal
from contact_tracker.cli.main import run as run_here
from contact_tracker.geometry.elements import ContactGeometry, Plane, Point
from contact_tracker.ground_truth import Truth, TruthInterval
from contact_tracker.motion.poses import Poses
from contact_tracker.recording import open_log
from contact_tracker.states import Contact
from contact_tracker.tracker import Tracker
from mcap_logs import START_NS, Topic, poses_topic, smooth_poses, tf_topic, write_log
from short_recordings import shipped

POSES = smooth_poses(300)


def write_chain(path: Path, *more: Topic) -> Path:
    chain = tf_topic(POSES, "world", "flange", beside=[(smooth_poses(300, seed=4), "flange", "cup")])
    return write_log(path, [chain, poses_topic(POSES, "/tray"), *more])


def test_what_is_assumed_and_what_comes_late_is_warned_of(tmp_path: Path) -> None:
    done = run("live", write_chain(tmp_path / "a.mcap"), "--topic", "/tf", "--frame", "cup")
    assert f"warning: {tmp_path / 'a.mcap'}: poses are in flange, which may move in world" in done.stderr
    assert "--frame 'world->cup'" in done.stderr
    rows = np.column_stack([5 * np.arange(60), POSES.position_m[:60], POSES.quat_xyzw[:60]])
    np.savetxt(tmp_path / "a.csv", rows, "%.9g", ",", header="t,x,y,z,qx,qy,qz,qw", comments="")
    done = run("info", tmp_path / "a.csv")
    assert done.stderr.count("its times have no unit and are taken as milliseconds") == 1
    early, late = smooth_poses(450, 100.0), smooth_poses(50, start_ns=START_NS + 4 * 10**9)
    messages = [*poses_topic(early, frame="a").messages, *poses_topic(late, frame="b").messages]
    path = write_log(tmp_path / "b.mcap", [Topic("/p", "geometry_msgs/msg/PoseStamped", messages)])
    done = run("live", path)
    assert "another source of poses shows up: /p b" in done.stderr
    assert "other_source 50" in done.stderr


def test_in_another_frame_elements_are_not_compared(tmp_path: Path) -> None:
    """The true ones are in the frame of the recording."""
    pair = ContactGeometry(Point(np.zeros(3)), Plane(np.array([0.0, 0.0, 1.0]), 0.0))
    poses = smooth_poses(150)
    span = int(poses.stamp_ns[0]), int(poses.stamp_ns[-1])
    truth = Truth((TruthInterval(*span, Contact.VF, geometry=pair),)).to_json()
    topics = [poses_topic(poses, "/tray"), poses_topic(smooth_poses(150, seed=1), "/cup")]
    path = write_log(tmp_path / "a.mcap", topics, truth)
    done = run("evaluate", path, "--topic", "/cup")
    assert "within 3 sd" in done.stdout
    done = run("evaluate", path, "--topic", "/cup", "--relative-to", "/tray")
    assert done.returncode == 0
    assert "elements are not compared" in done.stderr
    assert "within 3 sd" not in done.stdout


@pytest.mark.parametrize(
    ("words", "source"),
    [
        (["--topic", "/object/pose", "--relative-to", "/tray"], "/object/pose /tray"),
        (["--frame", "world->cup"], "/tf world->cup"),
    ],
)
def test_info_summarises_composed_poses(tmp_path: Path, words: list[str], source: str) -> None:
    path = str(write_chain(tmp_path / "a.mcap", poses_topic(smooth_poses(300, seed=2), "/object/pose")))
    done = run("info", path, *words)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(source + " (")
    (found,) = json.loads(run("info", path, "--json", *words).stdout)["sources"]
    which = dict(zip([word.lstrip("-").replace("-", "_") for word in words[::2]], words[1::2], strict=True))
    log = open_log(path, **which)
    poses = Poses.collect(log)
    assert found["poses"] == found["published"] == len(poses) == 300
    assert found["first_ns"] == poses.stamp_ns[0]
    length_m = np.linalg.norm(np.diff(poses.position_m, axis=0), axis=1).sum()
    assert found["path_m"] == pytest.approx(length_m)
    assert found["counts"] == dict(log.counts)


def test_both_takes_are_read_before_the_work_on_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    log = write_log(tmp_path / "a.mcap", [poses_topic(smooth_poses(150))])
    (tmp_path / "b.csv").write_text("t,x,y,z,qx,qy,qz,qw\n0,0,0,0,0,0,0,0\n")
    monkeypatch.setattr("contact_tracker.cli.source.segmented", None)
    assert run_here(["compare", str(log), str(tmp_path / "b.csv")]) == 1
    assert "b.csv: no pose that can be used" in capsys.readouterr().err


def test_info_composes_nothing_of_standard_input_and_says_so(tmp_path: Path) -> None:
    path = write_chain(tmp_path / "a.mcap")
    for words in (["--frame", "world->cup"], ["--frame", "cup", "--relative-to", "world"]):
        done = run("info", "-", *words, stdin=path.read_bytes())
        assert_one_line_error(done, 2, "reads the recording twice, which standard input does not allow")


@pytest.mark.parametrize("command", ["segment", "live", "view", "info", "batch"])
def test_the_tracker_knows_that_a_frame_moves(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    few = smooth_poses(60)
    path = write_log(tmp_path / "a.mcap", [poses_topic(few, "/table"), poses_topic(few, "/cup")])
    start, told = Tracker.start, list[bool]()

    def noted(*arguments: Any, **options: Any) -> Tracker:
        told.append(signature(start).bind(*arguments, **options).arguments["read_as"].frame_moves)
        return start(*arguments, **options)

    monkeypatch.setattr(Tracker, "start", noted)
    if command == "batch":
        assert batch([path], tmp_path / "dataset", topic="/table", relative_to="/cup").bad == 0
    else:
        output = ["--save", tmp_path / "a.rrd"] if command == "view" else []
        done = run(command, path, "--topic", "/table", "--relative-to", "/cup", *output)
        assert done.returncode == 0, done.stderr
    assert set(told) == {True}


def test_a_warning_comes_while_the_stream_goes_on_with_the_option_that_is_tried(tmp_path: Path) -> None:
    path, poses = tmp_path / "a.csv", shipped("paper_experiment")[3000:5000:2]
    numbers = np.column_stack([1e-9 * poses.stamp_ns, 1e3 * poses.position_m, poses.quat_xyzw])
    np.savetxt(path, numbers, "%.9f", ",", header="time [s],x,y,z,qx,qy,qz,qw", comments="")
    lines = shown_on_a_terminal("live", path, "--json", "-q").splitlines()
    (warned,) = (i for i, line in enumerate(lines) if "if they are in mm, read them by" in line)
    assert lines[warned].endswith(f"read them by contact-tracker live {path} --json -q --unit mm")
    assert warned < len(lines) - 20


def test_info_reports_why_no_pose_is_usable(tmp_path: Path) -> None:
    path = write_log(tmp_path / "a.mcap", [Topic("/a", "std_msgs/msg/String", [(1, {"data": "hello"})])])
    done = run("info", path)
    assert done.returncode == 1
    assert done.stderr == run("segment", path).stderr
    assert "/a" in done.stdout


@pytest.mark.parametrize(
    ("words", "code"),
    [
        (["segment", "loop"], 1),
        (["live", "log.mcap", "--state", "loop"], 2),
        (["batch", "log.mcap", "-o", "loop"], 2),
    ],
)
def test_a_link_to_itself_is_one_line(tmp_path: Path, words: list[str], code: int) -> None:
    write_log(tmp_path / "log.mcap", [poses_topic(smooth_poses(), "/a")])
    (tmp_path / "loop").symlink_to("loop")
    paths = [str(tmp_path / word) if word in ("loop", "log.mcap") else word for word in words]
    assert_one_line_error(run(*paths), code, "loop")


def test_a_pattern_that_the_shell_has_not_replaced(tmp_path: Path) -> None:
    for name in ("a.mcap", "b.mcap"):
        write_log(tmp_path / name, [poses_topic(smooth_poses(60))])
    said = "looks like a pattern: if it is in quotes, leave these out; if not, no file matches it"
    assert_one_line_error(run("segment", "*.mcap", cwd=tmp_path), 1, said)
    said = "*.mcap: no such file or folder; a shell replaces patterns without quotes"
    assert_one_line_error(run("batch", "*.mcap", "-o", "other", cwd=tmp_path), 1, said)


def test_a_truth_without_contacts_is_nothing_to_compare_with(tmp_path: Path) -> None:
    done = run("simulate", "slider", "-o", "slider.mcap", cwd=tmp_path)
    assert "1 interval of truth in" in done.stderr
    done = run("evaluate", "slider.mcap", cwd=tmp_path)
    assert_one_line_error(done, 1, "its truth names no contact")
