"""The viewer is started for this machine only, without analytics: in a window, a browser or a notebook, which
load nothing from others."""

import os
import shlex
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from urllib.request import urlopen

import pytest
import rerun_cli

import contact_tracker
from contact_tracker.cli import view
from contact_tracker.cli.main import run
from contact_tracker.errors import ViewerError
from contact_tracker.viewer import SILENT, sinks
from contact_tracker.viewer.sinks import to_viewer, web_viewer
from contact_tracker.viewer.views import LiveViewer
from mcap_logs import smooth_poses

LINUX = pytest.mark.skipif(sys.platform != "linux", reason="elsewhere files and addresses are others")


def test_a_port_in_use_by_another_program_is_reported() -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        with pytest.raises(ViewerError, match="not by a rerun viewer"):
            LiveViewer(sink=to_viewer(port))


@pytest.fixture
def free_ports() -> tuple[int, int]:
    with socket.create_server(("127.0.0.1", 0)) as one, socket.create_server(("127.0.0.1", 0)) as other:
        return int(one.getsockname()[1]), int(other.getsockname()[1])


@pytest.fixture
def free_port(free_ports) -> int:
    return free_ports[0]


@pytest.fixture
def at_home(tmp_path, monkeypatch) -> Path:
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
def screen(monkeypatch) -> None:
    monkeypatch.setenv("DISPLAY", ":0")


def test_without_a_screen_other_ways_are_named_at_once(monkeypatch, free_port, capsys) -> None:
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
def windowless(tmp_path, monkeypatch, at_home) -> Iterator[None]:
    """The real viewer without a window."""
    program, note = Path(rerun_cli.__path__[0]) / "rerun", tmp_path / "pid"
    words = shlex.join([str(program), "--serve-grpc"])
    stand_in(tmp_path, monkeypatch, f'echo $$ > {shlex.quote(str(note))}; exec {words} "$@"')
    yield
    os.kill(int(note.read_text()), signal.SIGKILL)


def test_a_viewer_that_cannot_start_is_reported(monkeypatch, free_port) -> None:
    monkeypatch.setenv("RERUN_CLI_PATH", str(Path(sys.executable).with_name("no such viewer")))
    with pytest.raises(ViewerError, match="did not start"):
        LiveViewer(sink=to_viewer(free_port))


@pytest.mark.parametrize("waits", [False, True], ids=["in time", "interrupted"])
def test_a_viewer_that_does_not_answer_is_ended(waits, tmp_path, monkeypatch, free_port) -> None:
    note = tmp_path / "pid"
    stand_in(tmp_path, monkeypatch, f"echo $$ > {shlex.quote(str(note))}; sleep 60")

    def listens_to_nothing(_: int) -> bool | None:
        if waits and note.exists() and note.read_text():
            raise KeyboardInterrupt
        return None

    monkeypatch.setattr(sinks, "answers", listens_to_nothing)
    monkeypatch.setattr(sinks, "_START_S", 60.0 if waits else 1.0)
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
def test_a_viewer_has_the_environment_of_the_user(
    asked, kept, tmp_path, monkeypatch, at_home, free_port
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
def test_a_viewer_has_no_analytics_and_answers_this_machine_only(windowless, at_home, free_port) -> None:
    with LiveViewer(sink=to_viewer(free_port)):
        pass
    assert list(at_home.rglob("*analytics*")) == []
    socket.create_connection(("127.0.0.1", free_port), timeout=5).close()
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.2", free_port), timeout=5)


@pytest.mark.parametrize("level", [SILENT, "debug"])
def test_rerun_does_not_print_its_log(level) -> None:
    program = "import rerun as rr; rr.RecordingStream('test').memory_recording()"
    command = [sys.executable, "-c", program]
    environment = os.environ | {"RUST_LOG": level}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0
    assert (done.stderr == "") == (level == SILENT)


@LINUX
def test_a_page_is_served_to_this_machine_only_and_ends_with_the_command(free_ports) -> None:
    ports = free_ports
    with web_viewer(*ports) as (url, _, _):
        assert f":{ports[1]}/" in url
        assert str(ports[0]) in url
        with urlopen(url, timeout=10) as page:
            assert b"rerun" in page.read().lower()
        for port in ports:
            with pytest.raises(ConnectionRefusedError):
                socket.create_connection(("127.0.0.2", port), timeout=5)
    for port in ports:
        with pytest.raises(ConnectionRefusedError):
            socket.create_connection(("127.0.0.1", port), timeout=5)


@pytest.mark.parametrize("which", [0, 1])
def test_a_port_in_use_is_reported(which, free_ports) -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        ports = [*free_ports]
        ports[which] = other.getsockname()[1]
        with pytest.raises(ViewerError, match=f"port {ports[which]} is taken"), web_viewer(*ports):
            pytest.fail("it is served")


@pytest.mark.long
def test_a_result_shows_itself_in_a_notebook_without_a_foreign_server() -> None:
    program = (
        "import contact_tracker, sys; sys.path.insert(0, sys.argv[1]);"
        "from mcap_logs import smooth_poses; from contact_tracker import Trajectory;"
        "result = contact_tracker.segment(Trajectory(smooth_poses(30)));"
        "viewer = result.show(width=800, height=500);"
        "import rerun_notebook;"
        "sys.exit(type(viewer).__name__ != 'Viewer' or rerun_notebook.ASSET_IS_URL)"
    )
    support = str(Path(__file__).resolve().parents[1] / "support")
    environment = {k: v for k, v in os.environ.items() if k != "RERUN_NOTEBOOK_ASSET"}
    environment["PYTHONPATH"] = os.pathsep.join(p for p in sys.path if p.endswith("tracker"))
    done = subprocess.run(
        [sys.executable, "-c", program, support], env=environment, capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stderr


def test_a_missing_notebook_extra_is_reported(monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "rerun_notebook", None)
    result = contact_tracker.segment(contact_tracker.Trajectory(smooth_poses(30)))
    with pytest.raises(contact_tracker.ContactTrackerError, match=r"contact-tracker\[notebook\]"):
        result.show()
