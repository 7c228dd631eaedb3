"""Names of files, topics and frames: control characters are escaped, and a message is one line."""

import os
import re
import subprocess
import sys
import warnings
from pathlib import Path

import pytest

from command_line import ENVIRONMENT, run, shown_on_a_terminal
from contact_tracker.cli import terminal
from contact_tracker.ground_truth import Truth
from contact_tracker.processes import Workers
from contact_tracker.recording import write_recording
from mcap_logs import Topic, poses_topic, smooth_poses, write_log

RED, ERASED, BELL = "\x1b[31m", "\x9b2J", "\x07"
ODD = f"{RED}a\n{ERASED}{BELL}\r\u2028b"
ODD_BYTES = os.fsdecode(b"\xff\x9b")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Recordings with odd names in odd places."""
    place = tmp_path_factory.mktemp("odd")
    poses = smooth_poses(200)
    truth = Truth.from_changes([int(poses.stamp_ns[0])], ["free"], int(poses.stamp_ns[-1]))
    for name in (ODD, ODD_BYTES):
        write_recording(str(place / f"{name}.mcap"), poses, truth, {ODD: ODD})
    whole = (place / f"{ODD}.mcap").read_bytes()
    (place / f"{ODD}cut.mcap").write_bytes(whole[: len(whole) - 400])
    (place / f"{ODD}text.mcap").write_text("no recording at all")
    (place / f"{ODD}text.toml").write_text(f"no = table at all {RED}")
    (place / f"{ODD}known.toml").write_text('[object.mesh]\npath = "gone\\u001b.stl"\n')
    other = Topic(f"/other{ODD}", f"odd/msg/{ODD}", [(int(poses.stamp_ns[0]), b"")])
    for name, topics in {"one": ["/a"], "two": ["/a", "/b"]}.items():
        sources = [poses_topic(poses, f"{topic}{ODD}", frame=ODD) for topic in topics]
        write_log(place / f"{name}.mcap", [*sources, other])
    return place


def assert_printable(text: str) -> None:
    for line in text.split("\n"):
        assert line.isprintable(), line


LOG, CUT, TEXT = f"{ODD}.mcap", f"{ODD}cut.mcap", f"{ODD}text.mcap"


@pytest.mark.parametrize(
    ("code", "arguments"),
    [
        (0, ["segment", LOG, "-o", f"{ODD}.jsonl"]),
        (1, ["segment", f"{ODD_BYTES}gone.mcap"]),
        (0, ["view", LOG, "--save", f"{ODD}.rrd"]),
        (0, ["info", "two.mcap", "--json"]),
        (0, ["simulate", "vision_30hz", "-o", f"{ODD}made.mcap"]),
        (1, ["evaluate", TEXT, CUT]),
        (0, ["calibrate", LOG, "--only", "transitions", "-o", f"{ODD}.toml"]),
        (2, ["live", "two.mcap"]),
        (2, ["live", "one.mcap", "--topic", ODD]),
        (2, ["live", LOG, "--model", f"{ODD}text.toml"]),
        (2, ["live", LOG, "--known", f"{ODD}known.toml"]),
        (2, ["live", LOG, "--noise", ODD]),
    ],
    ids=lambda value: " ".join(value).encode("unicode_escape", "surrogatepass").decode()[:80]
    if isinstance(value, list)
    else "",
)  # fmt: skip
def test_names_of_any_kind_are_printed_in_lines(code: int, arguments: list[str], folder: Path) -> None:
    done = run(*arguments, cwd=folder)
    assert done.returncode == code, done.stderr
    for text in (done.stdout, done.stderr):
        assert_printable(text)
    lines = done.stderr.splitlines()
    assert all(line.startswith("contact-tracker: ") for line in lines), lines


@pytest.mark.parametrize(
    ("command", "progress"), [("live", r" s  \S+ for \d\.\d s   "), ("evaluate", r"/200 .* poses/s")]
)
def test_names_of_any_kind_are_shown_in_progress(command: str, progress: str, folder: Path) -> None:
    shown = shown_on_a_terminal(command, LOG, cwd=folder)
    assert "\r" in shown
    assert re.search(progress, shown)
    for odd in (RED, ERASED, BELL, "\u2028"):
        assert odd not in shown


def test_warnings_and_logs_of_libraries_are_one_line() -> None:
    program = """
import logging, warnings
from contact_tracker.cli.terminal import take_over_warnings
take_over_warnings()
warnings.warn('a\\x1b\\n  b')
logging.getLogger('lib').warning('c\\x1b\\nd')
"""
    done = subprocess.run([sys.executable, "-c", program], env=ENVIRONMENT, capture_output=True, text=True)
    assert done.stderr == (
        "contact-tracker: warning: UserWarning: a\\x1b b\ncontact-tracker: warning: lib: c\\x1b d\n"
    )


def test_warnings_in_worker_processes_are_one_line(capfd: pytest.CaptureFixture[str]) -> None:
    with Workers(2, terminal.take_over_warnings) as pool:
        list(pool.map(warnings.warn, ["a\x1b", "b\x1b"]))
    lines = sorted(capfd.readouterr().err.splitlines())
    assert lines == [f"contact-tracker: warning: UserWarning: {name}\\x1b" for name in "ab"]


def test_a_very_narrow_terminal_keeps_times_label_and_probability(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "20")
    monkeypatch.setenv("NO_COLOR", "1")
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    figures = "    0.00     15.90  f-f      0.99  "
    terminal.show(f"{figures}face normal (0.35 0.92 0.19) on face normal (0.56 0.56 0.61); or v-f, e-e")
    assert capsys.readouterr().out == f"{figures[:33]}...; or v-f, e-e\n"
