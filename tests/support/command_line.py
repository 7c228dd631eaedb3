"""The command line in this process, with the streams, folder and exit code of a process of its own."""

import logging
import os
import pty
import signal
import subprocess
import sys
import tempfile
import termios
import threading
import warnings
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, chdir, contextmanager
from pathlib import Path
from typing import IO, Any
from unittest.mock import patch

from contact_tracker.cli import main, terminal

ROOT = Path(__file__).resolve().parents[2]
PROGRAM = [sys.executable, "-m", "contact_tracker"]
ENVIRONMENT = os.environ | {
    "PYTHONPATH": str(ROOT / "tracker"),
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
}
"""For tests of processes: signals, closed streams, what is loaded."""
UNSEEN_WARNINGS = (DeprecationWarning, PendingDeprecationWarning, ImportWarning, ResourceWarning)
"""Python shows users the others."""


PIPE, DEVNULL = subprocess.PIPE, subprocess.DEVNULL


def started(*arguments: object, **options: Any) -> "subprocess.Popen[Any]":
    """The command line in a process of its own, with ``options`` of ``Popen``; it heeds interrupts, although
    tests that run in the background ignore them."""
    options = {"preexec_fn": lambda: signal.signal(signal.SIGINT, signal.SIG_DFL)} | options
    return subprocess.Popen([*PROGRAM, *map(str, arguments)], env=ENVIRONMENT, **options)


class Done:
    """What a command left: its exit code and the text on its streams."""

    def __init__(self, returncode: int, stdout: bytes, stderr: bytes) -> None:
        self.returncode, self.stdout, self.stderr = returncode, stdout.decode(), stderr.decode()


def run(*arguments: object, stdin: bytes = b"", cwd: Path | None = None) -> Done:
    """Run the command line to its end; ``stdin`` comes through a pipe."""
    with ExitStack() as stack:
        out, err = (stack.enter_context(tempfile.TemporaryFile()) for _ in range(2))
        source = stack.enter_context(_piped(stdin))
        with _streams(source, out.fileno(), err.fileno()):
            code = _run(arguments, cwd)
        out.seek(0)
        err.seek(0)
        return Done(code, out.read(), err.read())


def shown_on_a_terminal(
    *arguments: object, cwd: Path | None = None, environment: Mapping[str, str] | None = None
) -> str:
    """All that a command shows on a terminal of 100 columns."""
    controller, theirs = pty.openpty()
    termios.tcsetwinsize(theirs, (24, 100))
    shown = bytearray()

    def collect() -> None:
        try:
            while data := os.read(controller, 65536):
                shown.extend(data)
        except OSError:  # Linux: the other side is closed
            pass

    reader = threading.Thread(target=collect)
    reader.start()
    variables = {"TERM": "xterm", "NO_COLOR": ""} | dict(environment or {})
    with _piped(b"") as source, patch.dict(os.environ, variables), _streams(source, theirs, theirs):
        _run(arguments, cwd)
    os.close(theirs)
    reader.join()
    os.close(controller)
    return shown.decode()


def _run(arguments: tuple[object, ...], cwd: Path | None) -> int:
    handlers = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGHUP)}
    hook, last_resort = sys.unraisablehook, logging.lastResort
    with warnings.catch_warnings(), patch.dict(os.environ), chdir(cwd or Path.cwd()):
        warnings.simplefilter("default")
        for category in UNSEEN_WARNINGS:
            warnings.simplefilter("ignore", category)
        try:
            return main.run(list(map(str, arguments)))
        finally:
            terminal.set_verbosity(terminal.USUAL)
            sys.unraisablehook, logging.lastResort = hook, last_resort
            for number, handler in handlers.items():
                signal.signal(number, handler)


@contextmanager
def _piped(data: bytes) -> Iterator[int]:
    """The reading end of a pipe with ``data``."""
    reading, writing = os.pipe()

    def write() -> None:
        try:
            with open(writing, "wb") as file:
                file.write(data)
        except BrokenPipeError:  # it was not read to its end
            pass

    thread = threading.Thread(target=write)
    thread.start()
    try:
        yield reading
    finally:
        os.close(reading)
        thread.join()


@contextmanager
def _streams(*descriptors: int) -> Iterator[None]:
    """Standard streams, also those of child processes, that are ``descriptors``."""
    names, modes, kept = ("stdin", "stdout", "stderr"), "rww", list[int]()
    for name in names[1:]:
        getattr(sys, name).flush()
    with ExitStack() as stack:
        for number, descriptor in enumerate(descriptors):
            kept.append(os.dup(number))
            os.dup2(descriptor, number)
        opened: list[IO[str]] = []
        for number, (name, mode) in enumerate(zip(names, modes, strict=True)):
            opened.append(open(number, mode, encoding="utf-8", closefd=False))  # noqa: SIM115
            stack.enter_context(patch.object(sys, name, opened[-1]))
        try:
            yield
        finally:
            for stream in opened:
                stream.close()
            for number, copy in enumerate(kept):
                os.dup2(copy, number)
                os.close(copy)
