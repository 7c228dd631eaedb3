"""Conveniences of the command line: help, completion, colours, verbosity, and outputs by suffix."""

import json
import re
import signal
import subprocess
from pathlib import Path

import pytest
from pyarrow import parquet

from command_line import PIPE, ROOT, run, shown_on_a_terminal, started
from contact_tracker.motion.poses import Poses
from contact_tracker.recording import write_recording
from mcap_logs import smooth_poses


@pytest.fixture(scope="module")
def poses() -> Poses:
    return smooth_poses(400)


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory, poses: Poses) -> Path:
    path = tmp_path_factory.mktemp("cli") / "log.mcap"
    write_recording(str(path), poses, None, {})
    return path


def test_without_arguments_there_is_help_and_it_is_no_success() -> None:
    done = run()
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == run("--help").stdout


def test_a_shell_completes_commands_and_options() -> None:
    done = run("--print-completion", "bash")
    assert done.returncode == 0, done.stderr
    script = done.stdout + (
        "\nCOMP_WORDS=(contact-tracker segment --to); COMP_CWORD=2; COMP_LINE='contact-tracker segment --to'"
        "\n_shtab_contact_tracker; printf '%s\\n' \"${COMPREPLY[@]}\""
        "\nCOMP_WORDS=(contact-tracker se); COMP_CWORD=1"
        "\n_shtab_contact_tracker; printf '%s\\n' \"${COMPREPLY[@]}\""
    )
    shell = subprocess.run(["bash", "-c", script], capture_output=True, text=True)
    assert shell.stdout.split() == ["--topic", "segment"], shell.stderr


def test_colours_are_used_on_terminals_only(log: Path, tmp_path: Path) -> None:
    absent = tmp_path / "absent.mcap"
    assert "\x1b[1;31merror:\x1b[0m" in shown_on_a_terminal("info", absent)
    for environment in ({"NO_COLOR": "1"}, {"TERM": "dumb"}):
        assert "\x1b" not in shown_on_a_terminal("info", absent, environment=environment)
    assert "\x1b" not in run("info", absent).stderr


def test_progress_has_a_total_where_it_is_known_and_rows_are_as_wide_as_the_terminal(log: Path) -> None:
    recording = ROOT / "recordings" / "robot_1khz.mcap"  # a shorter one is done before anything is shown
    for more in ((), ("--wide", "--duration", "4")):
        shown = shown_on_a_terminal("segment", recording, *more)
        assert "poses" in shown
        assert bool(re.search(r"\d+%.*\d+/10500 ", shown)) == (not more)
        assert re.search(r"\d\.\d\d  \x1b\[38;5;\d+m[efv]-[efv]\x1b\[0m  ", shown)  # the label of a segment
        rows = re.findall(r"[^\r\n]+ (?:normal|along) [^\r\n]+", re.sub(r"\x1b\[[\d;]*[A-Za-z]", "", shown))
        assert rows
        assert (max(map(len, rows)) > 100) == bool(more)
    assert "poses" not in shown_on_a_terminal("segment", log, "-q")


def test_quiet_prints_no_messages_and_verbose_prints_the_settings(log: Path) -> None:
    usual, quiet, verbose = (run("segment", log, *more) for more in ((), ("-q",), ("-v",)))
    assert usual.stdout == quiet.stdout == verbose.stdout
    assert len(quiet.stderr) < len(usual.stderr) < len(verbose.stderr)
    assert all(line.startswith("contact-tracker: warning:") for line in quiet.stderr.splitlines())
    assert "/object/pose" in verbose.stderr
    assert "default.toml" in verbose.stderr


@pytest.mark.parametrize(
    ("suffix", "begins"),
    [("MCAP", b"\x89MCAP0"), ("Html", b"<!DOCTYPE html>"), ("PNG", b"\x89PNG"), ("pdf", b"%PDF")],
)
def test_every_suffix_is_an_output_in_any_case(log: Path, tmp_path: Path, suffix: str, begins: bytes) -> None:
    done = run("segment", log, "-o", tmp_path / f"out.{suffix}")
    assert (done.returncode, done.stdout) == (0, ""), done.stderr
    last = done.stderr.splitlines()[-1]
    assert last == f"contact-tracker: wrote {tmp_path / f'out.{suffix}'}"
    assert (tmp_path / f"out.{suffix}").read_bytes().startswith(begins)
    assert [path.name for path in tmp_path.iterdir()] == [f"out.{suffix}"]


def test_a_report_has_what_was_warned_of_before_the_first_pose(log: Path, tmp_path: Path) -> None:
    corners = "0 0 0;1 0 0;0 1 0;0 0 1;.1 .1 .1"  # the last is a dent in the face between the others
    faces = "1 3 2;1 2 4;1 4 3;2 3 5;3 4 5;4 2 5"
    lines = [*(f"v {one}" for one in corners.split(";")), *(f"f {one}" for one in faces.split(";"))]
    (tmp_path / "dent.obj").write_text("\n".join(lines))
    (tmp_path / "known.toml").write_text('[object.mesh]\npath = "dent.obj"')
    done = run("segment", log, "--known", tmp_path / "known.toml", "-o", tmp_path / "out.html")
    assert "is not convex" in done.stderr
    assert "is not convex" in (tmp_path / "out.html").read_text(encoding="utf-8")


def test_live_writes_the_lines_that_it_prints(log: Path, tmp_path: Path) -> None:
    done = run("live", log, "--json", "-o", tmp_path / "out.PARQUET")
    assert done.returncode == 0, done.stderr
    table = parquet.read_table(tmp_path / "out.PARQUET")
    beliefs = [json.loads(line) for line in done.stdout.splitlines()]
    assert table["stamp_ns"].to_pylist() == [belief["stamp_ns"] for belief in beliefs]
    assert table["p_free"].to_pylist() == [belief["probability"]["free"] for belief in beliefs]


def test_live_leaves_its_ticks_and_a_summary_when_it_is_interrupted(log: Path, tmp_path: Path) -> None:
    words = "live", log, "--json", "--rate", "0.5", "-o", tmp_path / "out.jsonl"
    pipes = {"stdout": PIPE, "stderr": PIPE, "text": True}
    with started(*words, **pipes) as running:
        lines = [running.stdout.readline() for _ in range(5)]
        running.send_signal(signal.SIGINT)
        lines += running.stdout.readlines()
        messages = running.stderr.read()
    assert running.returncode == 128 + signal.SIGINT
    assert "poses" in messages
    assert "Traceback" not in messages
    assert (tmp_path / "out.jsonl").read_text().splitlines(keepends=True) == lines
    assert len(list(tmp_path.iterdir())) == 1


def test_the_table_of_outputs_has_all_of_them() -> None:
    import tomllib

    page = (ROOT / "docs" / "conventions.md").read_text(encoding="utf-8").partition("## Outputs")[2]
    rows = re.findall(r"^\| `(\w+) -o FILE(\.\w+)` \|.*\| (?:`(\w+)` )?\|$", page, re.MULTILINE)
    for command in ("segment", "live"):
        suffixes = {suffix for name, suffix, _ in rows if name == command}
        wrong = run(command, "x", "-o", "x.none").stderr
        assert suffixes == set(re.findall(r"(\.\w+)(?=,| or|$)", wrong.partition("must end in ")[2].strip()))
    assert run("segment", "x", "-o", "x.json").stderr.endswith("; did you mean .jsonl?\n")
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    assert {extra for *_, extra in rows if extra} <= extras.keys()
