"""Start of the viewer: locally, reachable from this machine only, and without analytics."""

import os
import shlex
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import rerun_cli

from contact_tracker.cli import view
from contact_tracker.cli.main import run
from contact_tracker.errors import ViewerError
from contact_tracker.viewer import SILENT, sinks
from contact_tracker.viewer.sinks import to_viewer
from contact_tracker.viewer.views import LiveViewer

LINUX = pytest.mark.skipif(sys.platform != "linux", reason="elsewhere files and addresses are others")


def test_a_port_in_use_by_another_program_is_reported() -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        with pytest.raises(ViewerError, match="not by a rerun viewer"):
            LiveViewer(sink=to_viewer(port))


@pytest.fixture
def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as free:
        return int(free.getsockname()[1])


@pytest.fixture
def at_home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty home folder, and no settings of rerun in the environment."""
    for name in ("CI", "FORCE_RERUN_ANALYTICS", "XDG_CONFIG_HOME", "XDG_DATA_HOME"):
        monkeypatch.delenv(name, raising=False)
    home = tmp_path / "home"
    home.mkdir()
    monkeypatch.setenv("HOME", str(home))
    return home


def stand_in(folder: Path, monkeypatch: pytest.MonkeyPatch, script: str) -> None:
    """Run ``script`` instead of the viewer."""
    path = folder / "viewer"
    path.write_text(f"#!/bin/sh\n{script}\n")
    path.chmod(0o755)
    monkeypatch.setenv("RERUN_CLI_PATH", str(path))


@pytest.fixture(autouse=True)
def screen(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DISPLAY", ":0")


def test_without_a_screen_other_ways_are_named_at_once(
    monkeypatch: pytest.MonkeyPatch, free_port: int, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.delenv("DISPLAY")
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.raises(ViewerError, match=r"no screen.*: --web .*view --save"):
        LiveViewer(sink=to_viewer(free_port))
    monkeypatch.setattr(sinks, "answers", lambda port: None)
    monkeypatch.setattr(view, "_view", None)  # nothing is read
    assert run(["view", __file__]) == 1
    assert "no screen" in capsys.readouterr().err


@pytest.fixture
def windowless(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, at_home: Path) -> Iterator[None]:
    """The real viewer without a window."""
    program, note = Path(rerun_cli.__path__[0]) / "rerun", tmp_path / "pid"
    words = shlex.join([str(program), "--serve-grpc"])
    stand_in(tmp_path, monkeypatch, f'echo $$ > {shlex.quote(str(note))}; exec {words} "$@"')
    yield
    os.kill(int(note.read_text()), signal.SIGKILL)


def test_a_viewer_that_cannot_start_is_reported(monkeypatch: pytest.MonkeyPatch, free_port: int) -> None:
    monkeypatch.setenv("RERUN_CLI_PATH", str(Path(sys.executable).with_name("no such viewer")))
    with pytest.raises(ViewerError, match="did not start"):
        LiveViewer(sink=to_viewer(free_port))


@pytest.mark.parametrize("waits", [False, True], ids=["in time", "interrupted"])
def test_a_viewer_that_does_not_answer_is_ended(
    waits: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, free_port: int
) -> None:
    note = tmp_path / "pid"
    stand_in(tmp_path, monkeypatch, f"echo $$ > {shlex.quote(str(note))}; sleep 60")

    def listens_to_nothing(_: int) -> bool | None:
        if waits and note.exists() and note.read_text():
            raise KeyboardInterrupt
        return None

    monkeypatch.setattr(sinks, "answers", listens_to_nothing)
    monkeypatch.setattr(sinks, "_START_S", 60.0 if waits else 3.0)
    with pytest.raises(KeyboardInterrupt if waits else ViewerError):
        sinks.start(free_port, ())
    with pytest.raises(ProcessLookupError):
        os.kill(int(note.read_text()), 0)


@pytest.mark.parametrize(
    ("asked", "kept"),
    [
        ({}, {"CI": "true"}),
        ({"FORCE_RERUN_ANALYTICS": "1", "RUST_LOG": SILENT}, {"CI": "true", "FORCE_RERUN_ANALYTICS": "1"}),
        ({"CI": "1", "RUST_LOG": "debug"}, {"CI": "1", "RUST_LOG": "debug"}),
    ],
    ids=["nothing", "analytics", "their log"],
)
def test_a_viewer_is_started_locally_with_what_the_user_has_chosen(
    asked: dict[str, str],
    kept: dict[str, str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    at_home: Path,
    free_port: int,
) -> None:
    monkeypatch.delenv("RUST_LOG", raising=False)
    for name, value in asked.items():
        monkeypatch.setenv(name, value)
    note = shlex.quote(str(tmp_path / "note"))
    stand_in(tmp_path, monkeypatch, f'echo "$*" > {note}; env >> {note}')
    with pytest.raises(ViewerError):
        LiveViewer(sink=to_viewer(free_port))
    arguments, *environment = (tmp_path / "note").read_text().splitlines()
    assert f"--bind 127.0.0.1 --port {free_port}" in arguments
    names = ("CI=", "FORCE_RERUN_ANALYTICS=", "RUST_LOG=")
    assert dict(one.split("=", 1) for one in environment if one.startswith(names)) == kept


@LINUX
def test_a_viewer_has_no_analytics_and_is_reachable_from_this_machine_only(
    windowless: None, at_home: Path, free_port: int
) -> None:
    """It answers on the loopback address only."""
    LiveViewer(sink=to_viewer(free_port)).close()
    assert list(at_home.rglob("*analytics*")) == []
    socket.create_connection(("127.0.0.1", free_port), timeout=5).close()
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.2", free_port), timeout=5)


@pytest.mark.parametrize("level", [SILENT, "debug"])
def test_rerun_does_not_print_its_log(level: str) -> None:
    """Else rerun prints lines with colours; this is the quickest way to one."""
    program = "import rerun as rr; rr.RecordingStream('test').memory_recording()"
    command = [sys.executable, "-c", program]
    done = subprocess.run(
        command, env=os.environ | {"RUST_LOG": level}, capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0
    assert (done.stderr == "") == (level == SILENT)
