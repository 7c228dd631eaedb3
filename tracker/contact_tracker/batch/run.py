"""All recordings of a batch: those whose result is there are passed over, the others get one."""

from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any

from contact_tracker.batch import rows
from contact_tracker.batch.dataset import Dataset
from contact_tracker.batch.finding import Found
from contact_tracker.batch.processes import Jobs, Killed
from contact_tracker.batch.segmenting import Answer, segment_recording
from contact_tracker.batch.settings import Settings

_GIVEN_UP = "the process that segmented it was ended twice, as happens where memory runs out"


@dataclass
class Outcome:
    """How many recordings have a new row (``segmented``) and are ``unchanged``; of both, how many are ``bad``
    (without a result) and ``damaged`` (with one of what can be read)."""

    segmented: int = 0
    unchanged: int = 0
    bad: int = 0
    damaged: int = 0

    @property
    def total(self) -> int:
        return self.segmented + self.unchanged


def run(
    recordings: Iterable[Found],
    settings: Settings,
    dataset: Dataset,
    workers: Callable[[], AbstractContextManager[Jobs]],
    tell: Callable[[rows.Row], None],
    set_done: Callable[[int], None],
    looks_at_content: bool = False,
) -> Outcome:
    """Bring a dataset up to date.

    Parameters
    ----------
    workers : opened if there is anything to do.
    tell : is told each new row.
    set_done : is told how many recordings are done.
    looks_at_content : take no recording for unchanged because its files look it.

    Raises
    ------
    ContactTrackerError, OSError
        The dataset cannot be written, or nobody is there to work. What was recorded until then is kept.
    """
    outcome = Outcome()

    def count(name: str, is_new: bool) -> None:
        code = dataset.exit_code(name)
        outcome.segmented += is_new
        outcome.unchanged += not is_new
        outcome.damaged += code == rows.DAMAGED
        outcome.bad += code not in (rows.OK, rows.DAMAGED)
        set_done(outcome.total)

    def jobs() -> Iterator[tuple[Any, ...]]:
        for found in recordings:
            known = dataset.known(found.name, settings)
            if known is not None and looks_at_content:
                known = known._replace(signature="")
            if known is not None and found.signature and known.signature == found.signature:
                count(found.name, False)
            else:
                yield found.name, known, settings, str(dataset.folder)

    waiting = jobs()
    first = next(waiting, None)
    if first is None:
        return outcome
    with workers() as call:
        for (name, *_), answer in call(segment_recording, _chain(first, waiting)):
            if isinstance(answer, Killed):
                row = rows.failure(name, settings, rows.KILLED, f"{name}: {_GIVEN_UP}", None)
                answer = Answer(name, "", row)
            dataset.record(answer)
            if answer.row is not None:
                tell(answer.row)
            count(name, answer.row is not None)
    return outcome


def _chain(first: tuple[Any, ...], rest: Iterator[tuple[Any, ...]]) -> Iterator[tuple[Any, ...]]:
    yield first
    yield from rest
