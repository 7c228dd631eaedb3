"""A batch run: recordings without an up-to-date result get one."""

from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass
from itertools import chain
from typing import Any, Final, Self

from contact_tracker import errors
from contact_tracker.batch import rows
from contact_tracker.batch.dataset import Dataset
from contact_tracker.batch.finding import Found
from contact_tracker.batch.rows import Settings
from contact_tracker.batch.segmenting import Answer, segment_recording
from contact_tracker.processes import Jobs

_GIVEN_UP: Final = "the process that segmented it was ended, as happens where memory runs out"


@dataclass(eq=False)
class Batch:
    """Updates a ``dataset``, and counts its recordings.

    Parameters
    ----------
    report : called with one line for each recording that cannot be used or is damaged.
    set_done : called with the number of recordings that are done.
    looks_at_content : whether to compare contents even if the signatures are equal.
    done, unchanged : recordings with a new row, and those whose row is kept.
    bad, damaged : of both, those without a result and those with a partial one.
    warned : of the new ones, those with warnings.
    """

    settings: Settings
    dataset: Dataset
    report: Callable[[str], None]
    set_done: Callable[[int], None]
    looks_at_content: bool = False
    done: int = 0
    unchanged: int = 0
    bad: int = 0
    damaged: int = 0
    warned: int = 0

    @property
    def total(self) -> int:
        """Number of recordings."""
        return self.done + self.unchanged

    def run(self, recordings: Iterable[Found], workers: Callable[[], AbstractContextManager[Jobs]]) -> Self:
        """Make or keep the row of each of the ``recordings``; ``workers`` are opened if needed.

        Raises
        ------
        ContactTrackerError, OSError
            The dataset cannot be written, or there are no workers. Answers until then are kept.
        """
        jobs = self._jobs(recordings)
        first = next(jobs, None)
        if first is None:
            return self
        with workers() as call:
            for (name, *_), answer in call(segment_recording, chain([first], jobs)):
                if answer is None:
                    error = f"{name}: {_GIVEN_UP}"
                    answer = Answer(name, "", rows.failure(name, self.settings, errors.KILLED, error, None))
                self._take(answer)
        return self

    def _jobs(self, recordings: Iterable[Found]) -> Iterator[tuple[Any, ...]]:
        """The arguments of ``segment_recording`` for recordings that may have changed."""
        folder = str(self.dataset.folder)
        for found in recordings:
            known = self.dataset.known(found.name, self.settings)
            if known is not None and self.looks_at_content:
                known = known._replace(signature="")
            if found.is_missing:
                self._take(segment_recording(found.name, known, self.settings, folder))
            elif known is not None and found.signature and known.signature == found.signature:
                self._count(found.name, None)
            else:
                yield found.name, known, self.settings, folder, found.within

    def _take(self, answer: Answer) -> None:
        self.dataset.record(answer)
        self._count(answer.name, answer.row)

    def _count(self, name: str, new: rows.Row | None) -> None:
        """Count a recording with a ``new`` row, or an unchanged one, and report what is wrong with it."""
        code = self.dataset.exit_code(name)
        is_damaged = code == errors.DAMAGED
        is_bad = not is_damaged and code != errors.DONE
        self.done += new is not None
        self.unchanged += new is None
        self.damaged += is_damaged
        self.bad += is_bad
        if new is None and (is_bad or is_damaged):
            column = "damage" if is_damaged else "error"
            self.report(f"{rows.shown(name)}: as before: see the column {column} of the summary")
        elif new is not None and (is_bad or is_damaged):
            self.report(new["error"] or f"{new['recording']}: {new['damage']}")
        self.warned += new is not None and bool(new["warnings"])
        self.set_done(self.total)
