"""All that a command prints. Whatever names are in it, they do not steer the terminal.

Data go to stdout, messages to stderr; progress and status only where somebody watches.
"""

import logging
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from contact_tracker.errors import SlowUpdate, printable


def show(text: str) -> None:
    """Lines of data."""
    for line in text.split("\n"):
        print(printable(line))


def say(message: str) -> None:
    """A message beside the data, in one line."""
    print(f"contact-tracker: {printable(message)}", file=sys.stderr, flush=True)


def warn(message: str) -> None:
    say(f"warning: {message}")


def fail(message: str) -> None:
    say(f"error: {message}")


def take_over_warnings() -> None:
    """Have what Python and libraries warn of, and what these log, come out as our own warnings do."""
    warnings.showwarning = _show_warning  # type: ignore[assignment]
    logging.lastResort = _LogLine(logging.WARNING)


def _show_warning(message: Warning | str, category: type[Warning], *_: Any) -> None:
    """In one line, without where in the code it was raised."""
    text = " ".join(str(message).split())
    warn(text if issubclass(category, SlowUpdate) else f"{category.__name__}: {text}")


class _LogLine(logging.Handler):
    def emit(self, record: logging.LogRecord) -> None:
        warn(f"{record.name}: {' '.join(record.getMessage().split())}")


@contextmanager
def progress(label: str, unit: str) -> Iterator[Callable[[int], None]]:
    """A counter on a terminal's stderr; gives the function that sets how many units are done."""
    with _bar(desc=printable(label), unit=f" {unit}") as bar:

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

    return tqdm(file=sys.stderr, disable=None, leave=False, mininterval=0.1, miniters=1, **options)
