"""Destinations of a rerun recording: a file, or a viewer in a window or a browser on this machine."""

import os
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final
from urllib.parse import quote

import rerun as rr
import rerun.blueprint as rrb
import rerun_cli

from contact_tracker.errors import ViewerError
from contact_tracker.viewer import SILENT

HOST: Final = "127.0.0.1"
PORT: Final = 9876
_ADDRESS: Final = f"rerun+http://{HOST}:{{port}}/proxy"
"""Address at which a viewer accepts recordings."""
WEB_PORT: Final = 9090
_WITHOUT_SCREEN: Final = "--web shows it in a browser, and view --save FILE.rrd writes a file"
_START_S: Final = 20.0
_POLL_S: Final = 0.1
_NOT_STARTED: Final = f"the rerun viewer did not start: is there a screen? {_WITHOUT_SCREEN}"
_ANSWER_S: Final = 2.0
# RFC 9113, 3.4: a client begins with this text and a SETTINGS frame, a server answers with one.
_SETTINGS: Final = b"\x04"
_PREFACE: Final = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + b"\0\0\0" + _SETTINGS + bytes(5)

Sink = Callable[[rr.RecordingStream, rrb.Blueprint | None], None]
"""Receives everything drawn afterwards; the blueprint may follow."""


def to_file(path: Path) -> Sink:
    """A sink that writes ``path`` incrementally, with the blueprint."""

    def write(recording: rr.RecordingStream, blueprint: rrb.Blueprint | None) -> None:
        path.touch()  # rerun's own error would not be an OSError
        recording.save(path, default_blueprint=blueprint)

    return write


def to_viewer(port: int = PORT) -> Sink:
    """A sink that sends to the viewer at ``port``; a viewer is started if nothing listens at the port.

    Raises ViewerError at once if no viewer listens and no window can be opened.
    """
    has_screen = sys.platform != "linux" or any(map(os.environ.get, ("DISPLAY", "WAYLAND_DISPLAY")))
    if not has_screen and answers(port) is None:
        raise ViewerError(f"there is no screen for the rerun viewer: {_WITHOUT_SCREEN}")

    def connect(recording: rr.RecordingStream, blueprint: rrb.Blueprint | None) -> None:
        speaks = answers(port)
        if speaks is None:
            start(port, ("--hide-welcome-screen",))
        elif not speaks:
            raise ViewerError(f"port {port} is taken, and not by a rerun viewer")
        recording.connect_grpc(_ADDRESS.format(port=port), default_blueprint=blueprint)

    return connect


def answers(port: int) -> bool | None:
    """Whether ``port`` answers HTTP/2, as viewers do; None if nothing listens.

    rerun connects to anything and fails only later.
    """
    try:
        connection = socket.create_connection((HOST, port), timeout=_ANSWER_S)
    except OSError:
        return None
    with connection, suppress(OSError):
        connection.sendall(_PREFACE)
        return connection.recv(9)[3:4] == _SETTINGS
    return False


def start(port: int, options: Sequence[str], web_port: int | None = None) -> "subprocess.Popen[bytes]":
    """Start a viewer for this machine only, which outlives this process.

    The program comes with rerun, whose own functions to start it let other machines connect. It is ended if
    it does not start or the wait for it is interrupted.

    rerun enables usage analytics by default and stores this in its settings on the first run, so the settings
    do not show the user's choice. ``CI`` disables analytics; ``FORCE_RERUN_ANALYTICS`` takes precedence.

    Raises
    ------
    ViewerError : no recordings are accepted at ``port``, or no page is served at ``web_port``, in time.
    """
    folder, override = Path(rerun_cli.__path__[0]), os.environ.get("RERUN_CLI_PATH")
    path = os.pathsep.join(map(str, (folder, folder / "Rerun.app/Contents/MacOS")))
    program = shutil.which(override) if override else shutil.which("rerun", path=path)
    if program is None:
        raise ViewerError(_NOT_STARTED)
    environment = {"CI": "true", **os.environ}
    if environment.get("RUST_LOG") == SILENT:
        del environment["RUST_LOG"]  # it was set for this process; the viewer shows its log in its window
    viewer = subprocess.Popen(
        (program, "--bind", HOST, "--port", str(port), *options),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env=environment,
        start_new_session=True,
    )
    try:
        give_up = time.monotonic() + _START_S
        while not answers(port) or (web_port is not None and answers(web_port) is None):
            if viewer.poll() is not None or time.monotonic() > give_up:
                raise ViewerError(_NOT_STARTED)
            time.sleep(_POLL_S)
    except BaseException:
        end(viewer)
        raise
    return viewer


def end(viewer: "subprocess.Popen[bytes]") -> None:
    """End a viewer that this process started."""
    viewer.terminate()
    viewer.wait()


def close(recording: rr.RecordingStream, timeout_s: float = 60.0) -> None:
    """Deliver all data, then disconnect; raises ViewerError if the delivery fails or takes too long."""
    try:
        recording.flush(timeout_sec=timeout_s)
    except Exception as error:  # rerun raises its own errors or RuntimeError, by version
        raise ViewerError(f"the rerun viewer or file did not take all data: {error}") from error
    finally:
        recording.disconnect()


@contextmanager
def web_viewer(port: int = PORT, web_port: int = WEB_PORT) -> Iterator[tuple[str, Sink, Callable[[], None]]]:
    """Serve a viewer's page to this machine only at ``web_port``, and accept recordings at ``port``, until
    the context ends.

    Returns
    -------
    The page's URL, the sink that sends recordings to it, and a function that waits for Ctrl-C or until the
    server ends.

    Raises
    ------
    ViewerError : the server does not start, or a port is in use.
    """
    for taken in (port, web_port):
        if answers(taken) is not None:
            raise ViewerError(f"port {taken} is taken: end what listens there, perhaps another viewer")
    server = start(port, ("--serve-web", "--web-viewer-port", str(web_port)), web_port)

    def wait() -> None:
        with suppress(KeyboardInterrupt):
            server.wait()

    try:
        url = f"http://{HOST}:{web_port}/?url={quote(_ADDRESS.format(port=port), safe='')}"
        yield url, to_viewer(port), wait
    finally:
        end(server)
