"""The recordings in the repository are reproduced by the commands in their README."""

import re
from pathlib import Path

import numpy as np
import pytest

from contact_tracker.cli.main import run
from contact_tracker.ground_truth import Truth
from contact_tracker.motion.poses import Poses
from contact_tracker.recording import open_log, read_metadata, read_truth, write_recording
from long_logs import write_long_log
from mcap_logs import smooth_poses

FOLDER = Path(__file__).resolve().parent.parent / "recordings"
COMMAND = re.compile(r"^contact-tracker (simulate (\w+) +--seed \d+ -o) recordings/(\w+\.mcap)$", re.M)
COMMANDS = {name: words.split() for words, _, name in COMMAND.findall((FOLDER / "README.md").read_text())}
MEGABYTE = 1_000_000


def poses_of(path: Path) -> Poses:
    return Poses.collect(open_log(str(path)))


def truth_of(path: Path) -> Truth:
    truth = read_truth(str(path))
    assert truth
    return truth


def numbers(value: object) -> list[float]:
    """All numbers of nested lists and dictionaries, in order."""
    if isinstance(value, dict):
        value = list(value.values())
    if isinstance(value, list):
        return [number for item in value for number in numbers(item)]
    return [float(value)] if isinstance(value, int | float) else []


def test_readme_names_every_recording() -> None:
    files = {path.name for path in FOLDER.glob("*.mcap")}
    takes = {"mug_first_take.mcap", "mug_second_take.mcap"}  # of a physics engine
    assert set(COMMANDS) == files - takes
    assert len(COMMANDS) == 5
    assert takes <= files


@pytest.mark.long
@pytest.mark.parametrize("name", COMMANDS)
def test_committed_recordings_are_reproduced_by_their_commands(name: str, tmp_path: Path) -> None:
    made = tmp_path / name
    assert run([*COMMANDS[name], str(made)]) == 0
    committed = FOLDER / name
    assert committed.stat().st_size <= MEGABYTE
    ours, theirs = poses_of(made), poses_of(committed)
    assert len(theirs) > 1000
    np.testing.assert_array_equal(ours.stamp_ns, theirs.stamp_ns)
    np.testing.assert_allclose(ours.position_m, theirs.position_m, atol=1e-9, rtol=0)
    np.testing.assert_allclose(ours.quat_xyzw, theirs.quat_xyzw, atol=1e-9, rtol=0)
    mine, yours = truth_of(made).intervals, truth_of(committed).intervals
    assert [(i.start_ns, i.end_ns, i.contact, i.motion, i.singular) for i in mine] == [
        (i.start_ns, i.end_ns, i.contact, i.motion, i.singular) for i in yours
    ]
    for a, b in zip(mine, yours, strict=True):
        assert [(f.start_ns, f.end_ns, f.contact) for f in a.further] == [
            (f.start_ns, f.end_ns, f.contact) for f in b.further
        ]
        assert (a.geometry is None) == (b.geometry is None)
        if a.geometry and b.geometry:
            np.testing.assert_allclose(
                numbers(a.geometry.to_json()), numbers(b.geometry.to_json()), atol=1e-9, rtol=0
            )
    described = read_metadata(str(committed))["recording"]
    assert described["scenario"] == name.removesuffix(".mcap")
    assert set(described) == set(read_metadata(str(made))["recording"])


def test_a_long_log_plays_forward_and_backward_at_the_same_rate(tmp_path: Path) -> None:
    write_recording(str(tmp_path / "short.mcap"), smooth_poses(60, rate_hz=100.0), None, {})
    short = poses_of(tmp_path / "short.mcap")
    opened = open_log(str(write_long_log(tmp_path / "short.mcap", 3.0, tmp_path / "long.mcap")))
    long = Poses.collect(opened)
    assert len(long) == 300
    assert not opened.counts
    assert set(np.diff(long.stamp_ns)) == {10_000_000}
    row = np.abs((np.arange(300) + 59) % 118 - 59)
    np.testing.assert_array_equal(long.position_m, short.position_m[row])
    np.testing.assert_array_equal(long.quat_xyzw, short.quat_xyzw[row])
