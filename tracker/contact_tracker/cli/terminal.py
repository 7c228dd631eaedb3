"""What goes to stderr: messages always, progress and status only where somebody watches."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from contact_tracker.errors import printable


def say(message: str) -> None:
    """A message beside the data, in one line."""
    print(f"contact-tracker: {printable(message)}", file=sys.stderr, flush=True)


def warn(message: str) -> None:
    say(f"warning: {message}")


def fail(message: str) -> None:
    say(f"error: {message}")


@contextmanager
def progress(label: str, unit: str, total: int | None = None) -> Iterator[Callable[[int], None]]:
    """A counter on a terminal's stderr, a bar where the ``total`` is known; gives the function that sets how
    many units are done."""
    with _bar(desc=label, unit=f" {unit}", total=total) as bar:

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
            self._bar.set_description_str(text())

    def print(self, line: str) -> None:
        """Write a line of data to stdout at once, above the status."""
        with self._bar.external_write_mode(sys.stdout):
            print(line, flush=True)


def _bar(**options: Any) -> Any:
    from tqdm import tqdm

    return tqdm(file=sys.stderr, disable=None, leave=False, mininterval=0.1, miniters=1, **options)
