"""The tables of the identifiability benchmark: accuracy beside oracles, and the errors in classes."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import partial
from itertools import groupby
from typing import Final

import numpy as np
from numpy.typing import NDArray
from oracle import ORACLES
from tracking import NAME as TRACKER

from contact_tracker.evaluation.tables import number, table
from contact_tracker.labels import Contact
from contact_tracker.separability import DECISIVE

Array = NDArray[np.float64]

MARGINS: Final = ("margin", "given", "there", "prior")
ACCURACY: Final = ("set", "s", TRACKER, "fitted", "given", "rule", f"F1 {TRACKER}", "fitted", "given", "rule")
PAIRS: Final = ("set", "true", "taken for", "s", "phases", "phase s", "Hz", "mm", *MARGINS, "class")
OWN: Final = ("recording", "from s", "to s", "true", "taken for", "s", *MARGINS)
TICK_S: Final = 0.1
SHOWN_S: Final = 0.3
"""Pairs that were mistaken for less time are not listed."""
LEGEND: Final = f"""\
{TRACKER}        the label, offline; share of the time, and mean F1 over the states
fitted         oracle: the true boundaries, all contacts fitted (the true one from the true elements as well)
given          oracle: the true boundaries, and the true elements of the true contact at no price
rule           the true boundaries, the most constrained contact that fits, whatever the evidence

near a change  wrong within 0.25 s of a true change and for no more than a tick beyond
oracle wrong   the oracle "fitted" is wrong in this phase as well
not tellable   in its place the truth is less than 20 times as probable as what the {TRACKER} said
own            the rest, what the {TRACKER} could still gain; "at best" is its accuracy without these

margin         evidence for the truth over that for the label, nats, all fitted; given: with the true elements
               at no price; there: fitted to just the time that had the wrong label; prior: log chance of the
               {TRACKER}'s labels with the truth there, over that of its labels (changes are rare).
               What counts is the prior with the larger of margin and there, or with there where it was free.
               phase s (length), Hz, mm (noise of a pose) and margins of pairs are medians"""


class Class(StrEnum):
    """Why a label was wrong."""

    NEAR = "near a change"
    ORACLE = "oracle wrong"
    TIE = "not tellable"
    OWN = "own"


@dataclass(frozen=True)
class Mistake:
    """A label that was wrong in a true phase.

    ``start_s`` to ``end_s`` since the first pose, the first and the last frame that had it; of that
    ``near_s`` within 0.25 s of a true change and ``clear_s`` not. ``margin`` and ``margin_given`` (nats):
    evidence of the truth over that of the label in this phase of ``phase_s`` and ``ticks`` whole ticks,
    fitted and with the true elements; ``margin_there``: fitted to just the time that had the label.
    ``prior`` (nats): the chance of all labels with the truth there, over that of the labels as they are.
    """

    recording: str
    rate_hz: float
    sigma_mm: float
    start_s: float
    end_s: float
    phase_s: float
    ticks: int
    true: Contact
    taken: Contact
    near_s: float
    clear_s: float
    oracles: Mapping[str, Contact]
    margin: float
    margin_given: float
    margin_there: float
    prior: float

    @property
    def seconds(self) -> float:
        return self.near_s + self.clear_s

    @property
    def log_odds(self) -> float:
        """How much more probable (nats) the truth is, in place of the label.

        Free motion is free tick by tick. A contact is known by its whole phase, if it was found beside.
        """
        evidence = self.margin_there
        if self.true is not Contact.FREE:
            evidence = max(evidence, self.margin)
        return evidence + self.prior

    @property
    def reason(self) -> Class:
        """The class of the whole mistake."""
        if self.clear_s < TICK_S:
            return Class.NEAR
        if self.oracles["fitted"] is not self.true:
            return Class.ORACLE
        return Class.OWN if self.log_odds >= DECISIVE else Class.TIE


@dataclass(frozen=True, eq=False)
class Judged:
    """One recording: ``confusion_s`` (7, 7) by who answers, truth by label, and the tracker's mistakes."""

    name: str
    confusion_s: Mapping[str, Array]
    mistakes: tuple[Mistake, ...]


def classes(judged: Iterable[Judged]) -> dict[Class, float]:
    """Seconds in each class of the tracker's errors."""
    seconds = dict.fromkeys(Class, 0.0)
    for mistake in (m for j in judged for m in j.mistakes):
        seconds[mistake.reason] += mistake.seconds
    return seconds


def to_text(sets: Mapping[str, Sequence[Judged]]) -> str:
    """All tables."""
    named = [(name, judged) for name, judged in sets.items() if judged]
    wrong = ("set", "wrong s", *Class, "at best")
    own = [row for _, judged in named for row in _own_rows(judged)]
    parts = [
        table(ACCURACY, [_accuracy_row(name, judged) for name, judged in named]),
        table(wrong, [_class_row(name, judged) for name, judged in named]),
        table(PAIRS, [row for name, judged in named for row in _pair_rows(name, judged)], left=3),
        "Own errors:\n" + table(OWN, own) if own else "No error of its own.",
        LEGEND,
    ]
    return "\n\n".join(parts)


def _accuracy_row(name: str, judged: Sequence[Judged]) -> list[str]:
    who = (TRACKER, *ORACLES)
    total = {w: sum((j.confusion_s[w] for j in judged), np.zeros((7, 7))) for w in who}
    right = [number(float(np.trace(total[w]) / total[w].sum())) for w in who]
    return [name, number(float(total[TRACKER].sum()), 1), *right, *(number(_macro_f1(total[w])) for w in who)]


def _macro_f1(confusion_s: Array) -> float:
    true_s, found_s = confusion_s.sum(axis=1), confusion_s.sum(axis=0)
    known = true_s > 0
    return float(np.mean(2.0 * np.diag(confusion_s)[known] / (true_s + found_s)[known]))


def _class_row(name: str, judged: Sequence[Judged]) -> list[str]:
    seconds = classes(judged)
    total_s = sum(float(j.confusion_s[TRACKER].sum()) for j in judged)
    wrong_s = sum(seconds.values())
    best = 1.0 - (wrong_s - seconds[Class.OWN]) / total_s
    return [name, number(wrong_s, 1), *(number(s, 1) for s in seconds.values()), number(best)]


def _pair_rows(name: str, judged: Sequence[Judged]) -> Iterator[list[str]]:
    """What was taken for what, the longest first."""

    def key(mistake: Mistake) -> tuple[str, str, str]:
        return mistake.true, mistake.taken, mistake.reason

    mistakes = sorted((m for j in judged for m in j.mistakes if m.reason is not Class.NEAR), key=key)
    groups = [list(group) for _, group in groupby(mistakes, key)]
    for group in sorted(groups, key=lambda g: -sum(m.seconds for m in g)):
        seconds = sum(m.seconds for m in group)
        if seconds >= SHOWN_S:
            middle = np.median([(m.phase_s, m.rate_hz, m.sigma_mm, *_margins(m)) for m in group], axis=0)
            shown = map(number, middle, (1, 0, 2, 1, 1, 1, 1))
            first, count = group[0], str(len(group))
            yield [name, first.true, first.taken, number(seconds, 1), count, *shown, first.reason]


def _own_rows(judged: Sequence[Judged]) -> Iterator[list[str]]:
    for m in sorted((m for j in judged for m in j.mistakes), key=lambda m: (m.recording, m.start_s)):
        if m.reason is Class.OWN:
            figures = map(partial(number, decimals=1), (m.start_s, m.end_s, m.seconds, *_margins(m)))
            from_s, to_s, *others = figures
            yield [m.recording, from_s, to_s, m.true, m.taken, *others]


def _margins(mistake: Mistake) -> tuple[float, ...]:
    return mistake.margin, mistake.margin_given, mistake.margin_there, mistake.prior
