"""Output of commands, with control characters escaped.

Data go to stdout, messages to stderr; progress and status only to a terminal.
"""

import logging
import os
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from enum import IntEnum
from typing import Any, Final

from contact_tracker.errors import ContactTrackerWarning, printable

_YELLOW: Final = "33"
_RED: Final = "31"


def show(text: str) -> None:
    """Print lines of data."""
    for line in text.split("\n"):
        print(printable(line))


class Verbosity(IntEnum):
    """Amount of messages on stderr."""

    QUIET = 0
    """Warnings and errors."""
    USUAL = 1
    VERBOSE = 2


_verbosity = Verbosity.USUAL


def set_verbosity(verbosity: Verbosity) -> None:
    """Set the verbosity of all messages."""
    global _verbosity
    _verbosity = verbosity


def say(message: str) -> None:
    """Print a message on stderr, in one line."""
    if _verbosity >= Verbosity.USUAL:
        _write(message)


def detail(message: str) -> None:
    """Print a message that is shown only with higher verbosity."""
    if _verbosity >= Verbosity.VERBOSE:
        _write(message)


def warn(message: str) -> None:
    _write(message, f"{_coloured('warning:', _YELLOW)} ")


def fail(message: str) -> None:
    _write(message, f"{_coloured('error:', _RED)} ")


def _write(message: str, kind: str = "") -> None:
    print(f"contact-tracker: {kind}{printable(message)}", file=sys.stderr, flush=True)


def _coloured(text: str, colour: str) -> str:
    """Coloured text on terminals that support it, unless NO_COLOR is set (https://no-color.org)."""
    if os.environ.get("NO_COLOR") or os.environ.get("TERM") == "dumb" or not sys.stderr.isatty():
        return text
    return f"\x1b[1;{colour}m{text}\x1b[0m"


def take_over_warnings() -> None:
    """Print warnings and log messages of Python and libraries like our own warnings."""
    warnings.showwarning = _show_warning  # type: ignore[assignment]
    logging.lastResort = _LogLine(logging.WARNING)


def _show_warning(message: Warning | str, category: type[Warning], *_: Any) -> None:
    """Print a warning in one line, without its place in the code."""
    text = " ".join(str(message).split())
    warn(text if issubclass(category, ContactTrackerWarning) else f"{category.__name__}: {text}")


class _LogLine(logging.Handler):
    def emit(self, record: logging.LogRecord) -> None:
        warn(f"{record.name}: {' '.join(record.getMessage().split())}")


@contextmanager
def progress(label: str, unit: str, total: int | None = None) -> Iterator[Callable[[int], None]]:
    """A counter on a terminal's stderr, a bar if ``total`` is known; gives the function that sets the number
    of units done."""
    with _bar(desc=printable(label), unit=f" {unit}", total=total) as bar:

        def set_done(done: int) -> None:
            bar.update(done - bar.n)

        yield set_done


class StatusLine:
    """One line on a terminal's stderr that is rewritten in place, under the lines written to stdout."""

    def __init__(self) -> None:
        self._bar = _bar(bar_format="{desc}", dynamic_ncols=True)

    def __enter__(self) -> "StatusLine":
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.close()

    def show(self, text: Callable[[], str]) -> None:
        """Rewrite the status, at most ten times a second; ``text`` is called only then."""
        if not self._bar.disable and self._bar.update():
            self._bar.set_description_str(printable(text()))

    def print(self, line: str) -> None:
        """Write a line of data to stdout at once, above the status."""
        with self._bar.external_write_mode(sys.stdout):
            print(printable(line), flush=True)


def _bar(**options: Any) -> Any:
    from tqdm import tqdm

    disable = True if _verbosity < Verbosity.USUAL else None  # None: if there is no terminal
    return tqdm(file=sys.stderr, disable=disable, leave=False, mininterval=0.1, miniters=1, **options)
