"""Output of commands, with control characters escaped.

Data go to stdout, messages to stderr; progress and status are shown only on a terminal.
"""

import os
import re
import shutil
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Final, TextIO

from contact_tracker.errors import ContactTrackerWarning, printable
from contact_tracker.states import STATES, Contact

_YELLOW: Final = "33"
_RED: Final = "31"


_ROW: Final = re.compile(r"\s*[\d.]+\s+(?:[\d.]+\s+)?(?:[-+=] )?[a-z]|\s+(?:start|time) s ")
"""A line of a table of contacts, or its header."""
_DEVIATION: Final = re.compile(r" \+/- [\d.]+ \w+")
_CUT: Final = "..."
_FIGURES: Final = 33
"""Width in characters of the times, label and probability of a row, which are never cut."""
_LABELLED: Final = re.compile(rf"(\s*[\d.]+\s+(?:[\d.]+\s+)?)([+-] )?({'|'.join(STATES)})(?=\s|$)")
"""A line of data with a label after one or two times."""


def show(text: str) -> None:
    """Print lines of data."""
    for line in text.split("\n"):
        print(_with_coloured_label(_fitted(printable(line))))


def _fitted(line: str) -> str:
    """A row cut to the width of the terminal: deviations go first, then the end of the elements, but not the
    other contacts that the motion fits."""
    width = shutil.get_terminal_size().columns
    if _is_wide or len(line) <= width or not sys.stdout.isatty() or not _ROW.match(line):
        return line
    line = _DEVIATION.sub("", line)
    row, semicolon, alternatives = line.partition("; or ")
    room = max(width - len(semicolon + alternatives) - len(_CUT), _FIGURES)
    return line if len(line) <= width else f"{row[:room]}{_CUT}{semicolon}{alternatives}"


def _with_coloured_label(line: str) -> str:
    """A row with its label in colour, on a terminal with colours."""
    if not _has_colours(sys.stdout) or (row := _LABELLED.match(line)) is None:
        return line
    from contact_tracker.outputs.text import ansi_of

    start, end = row.span(3)
    return f"{line[:start]}\x1b[{ansi_of(Contact(row[3]))}m{row[3]}\x1b[0m{line[end:]}"


QUIET, USUAL, VERBOSE = range(3)
"""Amount of messages on stderr; QUIET is warnings and errors only."""
_verbosity = USUAL
_is_wide = False


def set_verbosity(verbosity: int, is_wide: bool = False) -> None:
    """Set the verbosity of all messages, and whether rows may be wider than the terminal."""
    global _verbosity, _is_wide
    _verbosity, _is_wide = verbosity, is_wide


def say(message: str) -> None:
    """Print a message on stderr, in one line."""
    if _verbosity >= USUAL:
        _write(message)


def detail(message: str) -> None:
    """Print a message on stderr if the verbosity is VERBOSE."""
    if _verbosity >= VERBOSE:
        _write(message)


def warn(message: str) -> None:
    """Print a warning on stderr, in one line."""
    _write(message, f"{_coloured('warning:', _YELLOW)} ")


def fail(message: str) -> None:
    """Print an error on stderr, in one line."""
    _write(message, f"{_coloured('error:', _RED)} ")


def _write(message: str, kind: str = "") -> None:
    print(f"contact-tracker: {kind}{printable(message)}", file=sys.stderr, flush=True)


def _coloured(text: str, colour: str) -> str:
    """Coloured text for stderr on terminals that support it, unless NO_COLOR is set (https://no-color.org)."""
    return f"\x1b[1;{colour}m{text}\x1b[0m" if _has_colours(sys.stderr) else text


def _has_colours(stream: TextIO) -> bool:
    return not os.environ.get("NO_COLOR") and os.environ.get("TERM") != "dumb" and stream.isatty()


def take_over_warnings() -> None:
    """Print warnings and log messages of Python and libraries like those of this package."""
    import logging

    def emit(record: logging.LogRecord) -> None:
        warn(f"{record.name}: {' '.join(record.getMessage().split())}")

    warnings.showwarning = _show_warning  # type: ignore[assignment]
    logging.lastResort = logging.Handler(logging.WARNING)
    logging.lastResort.emit = emit  # type: ignore[method-assign]


def _show_warning(message: Warning | str, category: type[Warning], *_: Any) -> None:
    """Print a warning in one line, without its place in the code."""
    text = " ".join(str(message).split())
    warn(text if issubclass(category, ContactTrackerWarning) else f"{category.__name__}: {text}")


@contextmanager
def progress(label: str, unit: str, total: int | None = None) -> Iterator[Callable[[int], None]]:
    """A context with a counter on a terminal's stderr (a bar if ``total`` is known); its value is the
    function that sets the number of units done."""
    with _bar(desc=printable(label), unit=f" {unit}", total=total) as bar:

        def set_done(done: int) -> None:
            bar.update(done - bar.n)

        yield set_done


class StatusLine:
    """A line on a terminal's stderr that is rewritten in place, below the lines on stdout."""

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
            print(_with_coloured_label(_fitted(printable(line))), flush=True)


def _bar(**options: Any) -> Any:
    from tqdm import tqdm

    disable = True if _verbosity < USUAL else None  # None: if there is no terminal
    return tqdm(file=sys.stderr, disable=disable, leave=False, mininterval=0.1, miniters=1, **options)
