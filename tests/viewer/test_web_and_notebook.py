"""The viewer in a browser and in a notebook: for this machine only, and loading nothing from others."""

import os
import socket
import subprocess
import sys
from pathlib import Path
from urllib.request import urlopen

import pytest

import contact_tracker
from contact_tracker.errors import ViewerError
from contact_tracker.viewer.sinks import web_viewer
from mcap_logs import smooth_poses

LINUX = pytest.mark.skipif(sys.platform != "linux", reason="elsewhere addresses and signals are others")


def free_ports() -> tuple[int, int]:
    with socket.create_server(("127.0.0.1", 0)) as one, socket.create_server(("127.0.0.1", 0)) as other:
        return int(one.getsockname()[1]), int(other.getsockname()[1])


@LINUX
def test_a_page_is_served_to_this_machine_only_and_ends_with_the_command() -> None:
    ports = free_ports()
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
def test_a_port_in_use_is_reported(which: int) -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        ports = [*free_ports()]
        ports[which] = other.getsockname()[1]
        with pytest.raises(ViewerError, match=f"port {ports[which]} is taken"), web_viewer(*ports):
            pytest.fail("it is served")


@pytest.mark.long
def test_a_result_shows_itself_in_a_notebook_without_a_foreign_server() -> None:
    program = (
        "import contact_tracker, sys; sys.path.insert(0, sys.argv[1]);"
        "from mcap_logs import smooth_poses; from contact_tracker.api import Trajectory;"
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


def test_a_missing_notebook_extra_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rerun_notebook", None)
    result = contact_tracker.segment(contact_tracker.Trajectory(smooth_poses(30)))
    with pytest.raises(contact_tracker.ContactTrackerError, match=r"contact-tracker\[notebook\]"):
        result.show()
