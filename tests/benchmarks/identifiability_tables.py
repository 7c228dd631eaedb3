"""The tables of the identifiability benchmark: accuracy beside oracles, and the errors in classes."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import partial
from itertools import groupby
from typing import Final

import numpy as np
from numpy.typing import NDArray

from contact_tracker.hypotheses.evidence import DECISIVE
from contact_tracker.states import Contact
from contact_tracker_lab.evaluation.tables import number, table
from oracle import ORACLES
from tracking import NAME as TRACKER

Array = NDArray[np.float64]

MARGINS: Final = ("fitted", "known", "prior")
ACCURACY: Final = ("set", "s", TRACKER, *ORACLES, f"F1 {TRACKER}", *ORACLES)
PAIRS: Final = ("set", "true", "taken for", "s", "times", "phase s", "Hz", "mm", *MARGINS, "class")
OWN: Final = ("recording", "from s", "to s", "true", "taken for", "s", *MARGINS)
TICK_S: Final = 0.1
SHOWN_S: Final = 0.3
"""Pairs that were confused for less time are not listed."""
LEGEND: Final = f"""\
{TRACKER}        the label, offline; share of the time, and mean F1 over the states
fitted         oracle: the true boundaries, all contacts fitted (the true one from the true elements as well)
given          oracle: the true boundaries, and the true elements of the true contact without complexity
rule           the true boundaries, the most constrained contact that fits, without evidence

near a change  wrong within 0.25 s of a true change and for no more than a tick beyond
oracle wrong   the oracle "fitted" is wrong in this phase as well
less probable  the truth in place of the label would be less probable than the label
near tie       it would be more probable, but less than 20 times
own            the rest, avoidable errors of the {TRACKER}; "at best" is its accuracy without these, and
               "ties won" without near ties as well
known          the same without the complexity of the true elements, as if all had touched before (the
               oracle is then "given"): avoidable errors, and accuracy without them

For each interval with wrong labels, nats of the truth relative to the labels:
fitted         evidence, all contacts fitted to this interval only
known          evidence, with the true elements without complexity; used where it is larger and the
               {TRACKER} has found the contact in the rest of the phase
prior          log prior probability of all labels with the truth in this interval: changes are rare
phase s (length), Hz, mm (noise of a pose) and nats of pairs are medians"""


class Class(StrEnum):
    """Class of an error."""

    NEAR = "near a change"
    ORACLE = "oracle wrong"
    LESS = "less probable"
    TIE = "near tie"
    OWN = "own"


@dataclass(frozen=True)
class Mistake:
    """An interval with wrong labels, within one true phase of ``phase_s``.

    ``start_s`` and ``end_s`` are the times of its first and last frame since the first pose; ``near_s`` of it
    are within 0.25 s of a true change, ``clear_s`` are not; ``taken`` is its most frequent label. Nats of the
    truth relative to the labels: evidence, ``fitted`` to the interval only and with the true elements
    ``known``; ``prior`` probability of all labels. ``beside``: whether some of the rest of the phase has the
    true label.
    """

    recording: str
    rate_hz: float
    sigma_mm: float
    start_s: float
    end_s: float
    phase_s: float
    true: Contact
    taken: Contact
    near_s: float
    clear_s: float
    oracles: Mapping[str, Contact]
    beside: bool
    fitted: float
    known: float
    prior: float

    @property
    def seconds(self) -> float:
        return self.near_s + self.clear_s

    def log_odds(self, known: bool = False) -> float:
        """Log odds (nats) of the truth against the labels; the true elements count without complexity if they
        are ``known``, or if the contact was found in the rest of the phase."""
        evidence = max(self.fitted, self.known) if known or self.beside else self.fitted
        return evidence + self.prior

    def reason(self, known: bool = False) -> Class:
        """The class of the whole mistake."""
        if self.clear_s < TICK_S:
            return Class.NEAR
        if self.oracles["given" if known else "fitted"] is not self.true:
            return Class.ORACLE
        log_odds = self.log_odds(known)
        if log_odds < 0.0:
            return Class.LESS
        return Class.OWN if log_odds >= DECISIVE else Class.TIE


@dataclass(frozen=True, eq=False)
class RecordingErrors:
    """One recording: ``confusion_s`` (7, 7), truth by label, of each method, and the tracker's mistakes."""

    name: str
    confusion_s: Mapping[str, Array]
    mistakes: tuple[Mistake, ...]


def classes(recordings: Iterable[RecordingErrors], known: bool = False) -> dict[Class, float]:
    """Seconds in each class of the tracker's errors."""
    seconds = dict.fromkeys(Class, 0.0)
    for mistake in (m for one in recordings for m in one.mistakes):
        seconds[mistake.reason(known)] += mistake.seconds
    return seconds


def to_text(sets: Mapping[str, Sequence[RecordingErrors]]) -> str:
    """All tables."""
    named = [(name, recordings) for name, recordings in sets.items() if recordings]
    wrong = ("set", "wrong s", *Class, "at best", "ties won", "| known: own", "at best")
    own = [row for _, recordings in named for row in _own_rows(recordings)]
    parts = [
        table(ACCURACY, [_accuracy_row(name, recordings) for name, recordings in named]),
        table(wrong, [_class_row(name, recordings) for name, recordings in named]),
        table(PAIRS, [row for name, recordings in named for row in _pair_rows(name, recordings)], left=3),
        "Avoidable errors:\n" + table(OWN, own) if own else "No avoidable errors.",
        LEGEND,
    ]
    return "\n\n".join(parts)


def _accuracy_row(name: str, recordings: Sequence[RecordingErrors]) -> list[str]:
    methods = (TRACKER, *ORACLES)
    total = {w: sum((one.confusion_s[w] for one in recordings), np.zeros((7, 7))) for w in methods}
    right = [number(float(np.trace(total[w]) / total[w].sum())) for w in methods]
    f1 = [number(_macro_f1(total[w])) for w in methods]
    return [name, number(float(total[TRACKER].sum()), 1), *right, *f1]


def _macro_f1(confusion_s: Array) -> float:
    true_s, found_s = confusion_s.sum(axis=1), confusion_s.sum(axis=0)
    known = true_s > 0
    return float(np.mean(2.0 * np.diag(confusion_s)[known] / (true_s + found_s)[known]))


def _class_row(name: str, recordings: Sequence[RecordingErrors]) -> list[str]:
    seconds, known = classes(recordings), classes(recordings, known=True)
    total_s = sum(float(one.confusion_s[TRACKER].sum()) for one in recordings)
    wrong_s = sum(seconds.values())

    def without(seconds: float) -> str:
        return number(1.0 - (wrong_s - seconds) / total_s)

    best, won = without(seconds[Class.OWN]), without(seconds[Class.OWN] + seconds[Class.TIE])
    own_known = number(known[Class.OWN], 1), without(known[Class.OWN])
    return [name, number(wrong_s, 1), *(number(s, 1) for s in seconds.values()), best, won, *own_known]


def _pair_rows(name: str, recordings: Sequence[RecordingErrors]) -> Iterator[list[str]]:
    """Confused pairs, the longest first."""

    def key(mistake: Mistake) -> tuple[str, str, str]:
        return mistake.true, mistake.taken, mistake.reason()

    mistakes = sorted(
        (m for one in recordings for m in one.mistakes if m.reason() is not Class.NEAR), key=key
    )
    groups = [list(group) for _, group in groupby(mistakes, key)]
    for group in sorted(groups, key=lambda g: -sum(m.seconds for m in g)):
        seconds = sum(m.seconds for m in group)
        if seconds >= SHOWN_S:
            middle = np.median([(m.phase_s, m.rate_hz, m.sigma_mm, *_margins(m)) for m in group], axis=0)
            shown = map(number, middle, (1, 0, 2, 1, 1, 1))
            first, count = group[0], str(len(group))
            yield [name, first.true, first.taken, number(seconds, 1), count, *shown, first.reason()]


def _own_rows(recordings: Sequence[RecordingErrors]) -> Iterator[list[str]]:
    for m in sorted((m for one in recordings for m in one.mistakes), key=lambda m: (m.recording, m.start_s)):
        if m.reason() is Class.OWN:
            figures = map(partial(number, decimals=1), (m.start_s, m.end_s, m.seconds, *_margins(m)))
            from_s, to_s, *others = figures
            yield [m.recording, from_s, to_s, m.true, m.taken, *others]


def _margins(mistake: Mistake) -> tuple[float, ...]:
    return mistake.fitted, mistake.known, mistake.prior
