"""Where a recording goes: into a file, or into a viewer on this machine."""

import socket
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Final

import rerun as rr
import rerun.blueprint as rrb

from contact_tracker.errors import ViewerError

HOST: Final = "127.0.0.1"
PORT: Final = 9876
_START_S: Final = 20.0
_POLL_S: Final = 0.1

Sink = Callable[[rr.RecordingStream, rrb.Blueprint], None]


def to_file(path: Path) -> Sink:
    """A sink that writes ``path``, the blueprint in it."""
    return lambda recording, blueprint: recording.save(path, default_blueprint=blueprint)


def to_viewer(port: int = PORT) -> Sink:
    """A sink that shows it in the viewer at ``port``; a viewer is started where nothing listens there."""

    def connect(recording: rr.RecordingStream, blueprint: rrb.Blueprint) -> None:
        if not _listens(port):
            _start(port)
        recording.connect_grpc(f"rerun+http://{HOST}:{port}/proxy", default_blueprint=blueprint)

    return connect


def _listens(port: int) -> bool:
    """Connecting to a viewer that is not there would block for seconds: knock first."""
    try:
        socket.create_connection((HOST, port), timeout=1.0).close()
    except OSError:
        return False
    return True


def _start(port: int) -> None:
    """Start a viewer that outlives this process and is reached from this machine only."""
    command = [sys.executable, "-m", "rerun_cli", "--bind", HOST, "--port", str(port), "--hide-welcome-screen"]
    quiet = subprocess.DEVNULL
    viewer = subprocess.Popen(command, stdin=quiet, stdout=quiet, stderr=quiet, start_new_session=True)
    give_up = time.monotonic() + _START_S
    while not _listens(port):
        if viewer.poll() is not None or time.monotonic() > give_up:
            raise ViewerError("the rerun viewer did not start: is there a screen? view --save writes a file")
        time.sleep(_POLL_S)


def close(recording: rr.RecordingStream, timeout_s: float = 60.0) -> None:
    """See everything delivered, then let go.

    Raises
    ------
    ViewerError : not all of it was taken in time.
    """
    try:
        recording.flush(timeout_sec=timeout_s)
    except Exception as error:  # rerun raises its own and RuntimeError, by version
        raise ViewerError(f"the rerun viewer or file did not take all data: {error}") from error
    finally:
        recording.disconnect()
