"""``segment`` of several recordings, and of all objects in one."""

from pathlib import Path

import pytest

from command_line import Done, run
from contact_tracker.recording import write_recording
from mcap_logs import poses_topic, smooth_poses, tf_topic, write_log


def segment(folder: Path, *arguments: str) -> Done:
    return run("segment", *arguments, cwd=folder)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two recordings of one object each, and one of four: on two topics, and two frames of /tf."""
    path = tmp_path_factory.mktemp("several")
    for number in (1, 2):
        write_recording(str(path / f"take{number}.mcap"), smooth_poses(150, 100.0, number), None, {})
    topics = [poses_topic(smooth_poses(100, 100.0), name=name) for name in ("/a/pose", "/b/pose")]
    poses = smooth_poses(100, 100.0)
    frames = tf_topic(poses, "world", "cup", beside=[(poses, "world", "lid")])
    write_log(path / "four.mcap", [*topics, frames])
    return path


def outputs(folder: Path, suffix: str = ".csv") -> dict[str, str]:
    found = {path.name: path.read_text() for path in sorted(folder.glob(f"*{suffix}"))}
    for name in found:
        (folder / name).unlink()
    return found


def test_each_recording_has_the_same_output_as_alone(folder: Path) -> None:
    done = segment(folder, "take1.mcap", "take2.mcap", "-o", "{}.csv")
    assert done.returncode == 0, done.stderr
    together = outputs(folder)
    assert list(together) == ["take1.csv", "take2.csv"]
    assert segment(folder, "take2.mcap", "-o", "alone.csv").returncode == 0
    assert outputs(folder) == {"alone.csv": together["take2.csv"]}
    shown, alone = segment(folder, "take1.mcap", "take2.mcap").stdout, segment(folder, "take2.mcap").stdout
    assert shown.startswith("take1.mcap\n")
    assert shown.endswith(f"take2.mcap\n{alone}")


def test_an_unreadable_recording_does_not_affect_the_others(folder: Path) -> None:
    done = segment(folder, "nothing.mcap", "four.mcap", "take1.mcap", "-o", "{}.csv")
    assert done.returncode == 1
    assert "nothing.mcap: no such file" in done.stderr
    assert "four.mcap holds several pose sources" in done.stderr
    assert list(outputs(folder)) == ["take1.csv"]


def test_all_objects_of_a_recording(folder: Path) -> None:
    done = segment(folder, "four.mcap", "--all", "-o", "{}.csv")
    assert done.returncode == 0, done.stderr
    assert list(outputs(folder)) == ["four-a_pose.csv", "four-b_pose.csv", "four-cup.csv", "four-lid.csv"]
    done = segment(folder, "four.mcap", "--all", "--topic", "/tf")
    assert [line for line in done.stdout.splitlines() if line.startswith("four")] == [
        f"four.mcap /tf world->{child} (tf2_msgs/msg/TFMessage)" for child in ("cup", "lid")
    ]


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["take1.mcap", "take2.mcap", "-o", "out.csv"], "write {} where the name of each goes, as in {}.csv"),
        (["take1.mcap", "./take1.mcap", "-o", "{}.csv"], "would be written to take1.csv"),
        (["take1.mcap", "-"], "standard input is read alone"),
        (["-", "--all"], "--all reads a recording twice"),
        (["take1.mcap", "take2.mcap", "-o", "{}.mcap"], "it is the input take1.mcap"),
    ],
)
def test_impossible_combinations_are_wrong_usage(folder: Path, arguments: list[str], reason: str) -> None:
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    done = segment(folder, *arguments)
    assert done.returncode == 2
    assert reason in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before
