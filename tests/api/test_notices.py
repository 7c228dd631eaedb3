"""What the command line warns of arrives in Python: as warnings, in results, and in the log."""

import contextlib
import html
import io
import logging
import re
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

import contact_tracker as ct
from contact_tracker.cli import main
from contact_tracker.motion.poses import Poses
from contact_tracker.recording import WRENCH_TYPE
from contact_tracker.trajectory.arguments import python_words
from mcap_logs import Topic, poses_topic, smooth_poses, wrench_stamped, write_log

MANY = 200


def in_millimetres(folder: Path) -> tuple[Path, dict[str, str]]:
    """A recording in another unit, whose end is missing."""
    poses = smooth_poses(MANY)
    in_mm = Poses(poses.stamp_ns, 1e3 * poses.position_m, poses.quat_xyzw)
    path = write_log(folder / "millimetres.mcap", [poses_topic(in_mm)])
    path.write_bytes(path.read_bytes()[:-2000])
    return path, {}


def with_a_wrench(folder: Path) -> tuple[Path, dict[str, str]]:
    """A recording too short for its wrenches to be of use; one of these is no number."""
    poses = smooth_poses(MANY // 2)
    wrenches = [
        (int(stamp), wrench_stamped(int(stamp), [0.0, 0.0, np.nan if number == 7 else 3.0, 0.0, 0.0, 0.0]))
        for number, stamp in enumerate(poses.stamp_ns)
    ]
    topics = [poses_topic(poses), Topic("/wrench", WRENCH_TYPE, wrenches)]
    return write_log(folder / "wrench.mcap", topics), {"wrench": "/wrench"}


def with_coarse_times(folder: Path) -> tuple[Path, dict[str, str]]:
    """A table whose times have too few digits and no unit."""
    poses = smooth_poses(MANY)
    times_ms = (poses.stamp_ns - poses.stamp_ns[0]) // 20_000_000 * 20
    rows = np.column_stack([times_ms, poses.position_m, poses.quat_xyzw])
    path = folder / "coarse.csv"
    np.savetxt(path, rows, "%.9g", ",", header="t,x,y,z,qx,qy,qz,qw", comments="")
    return path, {}


def with_time_set_back(folder: Path) -> tuple[Path, dict[str, str]]:
    """A folder that says it is one recording, of which the second part begins as early as the first."""
    path = folder / "parts"
    path.mkdir()
    for name in ("one.mcap", "two.mcap"):
        write_log(path / name, [poses_topic(smooth_poses(MANY // 2))])
    (path / "metadata.yaml").touch()
    return path, {}


FAULTY: list[Callable[[Path], tuple[Path, dict[str, str]]]] = [
    in_millimetres,
    with_a_wrench,
    with_coarse_times,
    with_time_set_back,
]


def on_the_command_line(command: str, path: Path, options: dict[str, str]) -> set[str]:
    """The warnings of a command, without the recording's name."""
    arguments = [part for name, value in options.items() for part in (f"--{name}", value)]
    with contextlib.redirect_stderr(io.StringIO()) as shown, contextlib.redirect_stdout(io.StringIO()):
        main._run([command, str(path), *arguments])
    lines = re.findall(r"^contact-tracker: warning: (.*)$", shown.getvalue(), re.MULTILINE)
    return {line.removeprefix(f"{path}: ") for line in lines}


@contextlib.contextmanager
def recorded_warnings() -> Iterator[list[warnings.WarningMessage]]:
    """Warnings as Python shows them by default."""
    with warnings.catch_warnings(record=True) as shown:
        warnings.simplefilter("default")
        yield shown


@pytest.mark.parametrize("faulty", FAULTY, ids=lambda make: make.__name__)
def test_python_warns_of_what_the_command_warns_of(faulty, tmp_path) -> None:
    path, options = faulty(tmp_path)
    expected = {python_words(text) for text in on_the_command_line("segment", path, options)}
    assert expected
    with recorded_warnings() as shown:
        result = ct.segment(path, **options)
    texts = [str(one.message) for one in shown]
    assert set(texts) == set(result.warnings) == expected
    assert len(texts) == len(expected)
    assert {one.category for one in shown} == {ct.ContactTrackerWarning}
    assert {one.filename for one in shown} == {__file__}
    banner = str(result).splitlines()[: len(expected)]
    assert {line.removeprefix("warning: ") for line in banner} == expected
    assert all(html.escape(text) in result._repr_html_() for text in expected)


@pytest.mark.parametrize(
    ("on_the_command_line", "in_python"),
    [
        ("--up does not fit the motion", "up does not fit the motion"),
        (
            "--states is checked; leave out --plane if it is wrong",
            "states is checked; leave out plane if it is wrong",
        ),
        ("read them by --unit mm --rate 100", "read them by unit='mm' rate='100'"),
    ],
)
def test_a_verb_after_an_option_is_no_value(on_the_command_line: str, in_python: str) -> None:
    assert python_words(on_the_command_line) == in_python


def plain(text: str) -> str:
    """Without the numbers, which change while a stream goes on."""
    return re.sub(r"[\d.e+-]+", "", text)


def test_a_tracker_warns_of_what_live_warns_of_and_once(tmp_path) -> None:
    """Of a unit and of times with few digits, although the state is saved and loaded in between."""
    smooth = smooth_poses(2 * MANY)
    coarse_ns = smooth.stamp_ns // 20_000_000 * 20_000_000
    poses = Poses(coarse_ns, 1e3 * smooth.position_m, smooth.quat_xyzw)
    expected = on_the_command_line("live", write_log(tmp_path / "log.mcap", [poses_topic(poses)]), {})
    assert len(expected) == 2
    tracker = ct.Tracker()
    with recorded_warnings() as shown:
        for number, pose in enumerate(poses):
            tracker.update(*pose)
            if number == len(poses) - MANY // 2:
                assert len(shown) == 2
                tracker.save(tmp_path / "state")
                tracker = ct.Tracker.load(tmp_path / "state")
        tracker.finish()
    assert {plain(text) for text in tracker.warnings} == {plain(python_words(text)) for text in expected}
    assert len(shown) == 2
    assert {one.filename for one in shown} == {__file__}


def test_the_same_fault_of_another_recording_is_told_again(tmp_path) -> None:
    path, _ = with_coarse_times(tmp_path)
    with recorded_warnings() as shown:
        for _ in range(3):
            ct.read(path)
    assert len(shown) == 3 * len({str(one.message) for one in shown})


def test_counts_are_logged_and_the_program_decides_whether_they_are_shown(caplog) -> None:
    poses = smooth_poses(200)
    places = poses.position_m.copy()
    places[::50] = np.nan
    with caplog.at_level(logging.INFO, "contact_tracker"):
        ct.Trajectory.from_arrays(poses.stamp_ns, places, poses.quat_xyzw, unit="ns")
    assert caplog.messages == ["poses: noted: nonfinite 4"]
    assert logging.getLogger("contact_tracker").level == logging.NOTSET
