"""Comparison of two takes of one task: which steps are missing, new, longer, shorter or elsewhere."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from itertools import takewhile
from math import floor, hypot, log10, sqrt
from typing import Any, Final, Literal

import numpy as np
from scipy.special import ndtr  # scipy.stats takes half a second to import

from contact_tracker.arrays import Array, Bools
from contact_tracker.errors import UsageError
from contact_tracker.map.elements import SAME
from contact_tracker.outputs.outcome import Outcome
from contact_tracker.outputs.text import SURE_PROBABILITY
from contact_tracker.sequences.pair_hmm import align
from contact_tracker.sequences.steps import UNKNOWN, Distance, Step, distances, place_evidence, steps_of
from contact_tracker.states import STATES, Contact

TOLERANCE: Final = 0.25
"""Tolerated difference of a step's durations, relative to the longer one: 34 of 38 steps in nine pairs of
takes of three everyday tasks (docs/assembly.md) are within it, three more with the deviations of their
boundaries."""
MOST_STEPS: Final = 300
"""Largest number of segments of a recording that are aligned: 300 by 300 take four seconds."""


class Verdict(StrEnum):
    """The verdict on a step."""

    SAME = "same"
    MISSING = "missing"
    NEW = "new"
    LONGER = "longer"
    SHORTER = "shorter"
    ELSEWHERE = "elsewhere"
    OPEN = "open"


@dataclass(frozen=True, eq=False)
class ComparedStep:
    """A step of two takes.

    Parameters
    ----------
    first, second : its segments in each take; none where it is missing or new.
    verdict : the verdict; ``open`` if the takes do not decide it.
    probability : that the segments of both takes belong to one step, or that the step is missing or new.
    moved : ``object``, ``surroundings`` or ``both``, the sides that touch with another element (``either``:
        one of them); empty if no side is known to.
    object, surroundings : distances of the touching elements of the two takes.
    longer_s, longer_sd_s : duration in the second take minus that in the first; NaN if only one has the step.
    """

    first: tuple[Step, ...]
    second: tuple[Step, ...]
    verdict: Verdict
    probability: float
    moved: str = ""
    object: Distance = UNKNOWN
    surroundings: Distance = UNKNOWN
    longer_s: float = np.nan
    longer_sd_s: float = np.nan

    def to_json(self) -> dict[str, Any]:
        """Names (``COLUMNS``) and values of the row; None if unknown or not applicable."""
        cells: dict[str, Any] = {"verdict": self.verdict.value, "probability": self.probability}
        for take, steps in (("a", self.first), ("b", self.second)):
            start_s, end_s = (steps[0].start_s, steps[-1].end_s) if steps else (None, None)
            cells[f"contact_{take}"] = _label(steps) or None
            cells |= {f"start_{take}_s": start_s, f"end_{take}_s": end_s}
        cells |= {"longer_s": self.longer_s, "longer_sd_s": self.longer_sd_s, "moved": self.moved or None}
        for side, distance in (("object", self.object), ("surroundings", self.surroundings)):
            for name, (value, sd, unit) in zip(("shift", "turn"), distance.figures, strict=True):
                cells |= {f"{side}_{name}_{unit}": value, f"{side}_{name}_sd_{unit}": sd}
        unknown = {name for name, cell in cells.items() if isinstance(cell, float) and not np.isfinite(cell)}
        return cells | dict.fromkeys(unknown)


@dataclass(frozen=True, eq=False)
class Comparison:
    """Two takes, step by step. ``notes`` are warnings about parts that were not compared."""

    takes: tuple[Outcome, Outcome]
    steps: tuple[ComparedStep, ...]
    notes: tuple[str, ...] = ()

    @property
    def differences(self) -> tuple[ComparedStep, ...]:
        """The steps that are known to differ."""
        return tuple(step for step in self.steps if step.verdict not in (Verdict.SAME, Verdict.OPEN))

    def to_json(self) -> dict[str, Any]:
        """``steps`` with the names of ``columns``, and ``notes``."""
        return {"steps": [step.to_json() for step in self.steps], "notes": [*self.notes]}

    @property
    def columns(self) -> dict[str, list[Any]]:
        """Values by name, a row per step."""
        rows = [step.to_json() for step in self.steps]
        return {name: [row[name] for row in rows] for name in COLUMNS}

    def __str__(self) -> str:
        return "\n".join((*(f"warning: {note}" for note in self.notes), *self.lines()))

    def lines(self) -> Iterator[str]:
        """A table of at most 80 columns, without the notes."""
        yield f"{'A: s':>15}  {'':<5}{'B: s':>15}  {'':<5}  {'what':<9}    p  by"
        for step in self.steps:
            sides = "  ".join(f"{_span(steps):>15} {_label(steps):<5}" for steps in (step.first, step.second))
            yield f"{sides}  {_what(step):<9} {step.probability:4.2f}  {_difference(step)}".rstrip()
        count = {kind: sum(step.verdict is kind for step in self.steps) for kind in Verdict}
        counts = ", ".join(f"{number} {kind}" for kind, number in count.items() if number)
        if not self.steps:
            counts = "neither take has a step"
        elif count[Verdict.OPEN] == len(self.steps):
            counts += ": whether steps differ is not known"
        elif not self.differences:
            counts += ": no step is known to differ"
        yield counts


def compare_outcomes(first: Outcome, second: Outcome, tolerance: float = TOLERANCE) -> Comparison:
    """Align two segmented takes by contacts and places (docs/theory.md, T48).

    ``tolerance`` is the share by which the durations of a step may differ. Raises UsageError if there are too
    many segments.
    """
    takes = steps_of(first), steps_of(second)
    if max(map(len, takes)) > MOST_STEPS:
        raise UsageError(
            f"takes of more than {MOST_STEPS} segments are not compared: cut them with --start and --duration"
        )
    likelihoods = [np.log(len(STATES)) + np.array([step.log_probability for step in take]) for take in takes]
    first_map, second_map = first.learned_world, second.learned_world
    evidence = np.full((len(takes[0]), len(takes[1]), 2, 2), np.nan)
    pairs, notes = np.zeros((*evidence.shape[:2], len(STATES))), list[str]()
    if first_map is not None and second_map is not None:
        evidence = place_evidence(*takes, first_map, second_map)
    else:
        notes.append("places are not compared where elements or wrenches are given")
    is_known = np.isfinite(evidence[..., 0, 0])
    for i, j in np.argwhere(is_known):  # the four cases have equal priors
        pairs[i, j, takes[0][i].contact.column] = np.logaddexp.reduce(evidence[i, j].ravel()) - np.log(4.0)
    are_open = [np.array([step.is_open for step in steps]) for steps in takes]
    are_alike = are_open[0][:, None] == are_open[1]
    p_any = [np.array([step.p_any for step in steps]) for steps in takes]
    alone = np.log(p_any[0]), np.log(p_any[1])
    alignment = align(likelihoods[0], likelihoods[1], pairs, are_alike, alone)

    def rank(pair: tuple[int, int]) -> tuple[float, float]:
        return float(alignment.together[pair]), float(np.ptp(evidence[pair]))

    matched = [  # the most probable pair of segments of each step, of equal ones that with most evidence
        max(((i, j) for i in rows for j in columns if is_known[i, j]), key=rank, default=None)
        for rows, columns in alignment.steps
    ]
    chosen = np.array([evidence[pair] for pair in matched if pair is not None]).reshape(-1, 2, 2)
    both_touch = all(any(step.contact is not Contact.FREE for step in take) for take in takes)
    if not len(chosen) and both_touch and first_map is not None and second_map is not None:
        notes.append(
            "the takes have no touched element in common, or too little motion to tell: of another object or "
            "place? Places are not compared"
        )
    is_compared = np.array([_log_odds_of_same(chosen), _log_odds_of_same(chosen.swapaxes(1, 2))]) >= 0.0
    for name, is_same in zip(("object", "surroundings"), is_compared, strict=True):
        if not is_same:
            notes.append(
                f"no touched element of the {name} is where it was: do they differ, or have frames "
                "moved? Places are not compared"
            )
    steps = []
    for (in_first, in_second), pair in zip(alignment.steps, matched, strict=True):
        parts = tuple(takes[0][i] for i in in_first), tuple(takes[1][j] for j in in_second)
        moved, apart = "", (UNKNOWN, UNKNOWN)
        longer_s = sd_s = tolerated_s = np.nan
        if in_first and in_second:
            p = float(alignment.together[np.ix_(in_first, in_second)].max())
            (before_s, before_sd_s), (after_s, after_sd_s) = map(_duration_s, parts, takes)
            longer_s, sd_s = after_s - before_s, hypot(before_sd_s, after_sd_s)
            tolerated_s = tolerance * max(before_s, after_s)
        else:
            p = float(alignment.missing[in_first[0]] if in_first else alignment.new[in_second[0]])
        if pair is not None and first_map is not None and second_map is not None:
            first_step, second_step = takes[0][pair[0]], takes[1][pair[1]]
            # the object's origin in the middle of the step, in the body and in the world frame
            middle_ns = (second_step.segment.start_ns + second_step.segment.end_ns) // 2
            row = int(np.abs(second.trajectory.stamp_ns - middle_ns).argmin())
            near_m = np.zeros(3), second.trajectory.position_m[row]
            apart = distances(first_step, second_step, first_map, second_map, near_m)
            moved = _moved_sides(evidence[pair], apart, is_compared)
        if p < SURE_PROBABILITY or not all(any(map(_is_sure, part)) for part in parts if part):
            verdict = Verdict.OPEN
        elif not (in_first and in_second):
            verdict = Verdict.MISSING if in_first else Verdict.NEW
        elif moved:
            verdict = Verdict.ELSEWHERE
        elif ndtr((abs(longer_s) - tolerated_s) / max(sd_s, 1e-9)) >= SURE_PROBABILITY:
            verdict = Verdict.LONGER if longer_s > 0.0 else Verdict.SHORTER
        else:
            verdict = Verdict.SAME
        steps.append(ComparedStep(*parts, verdict, p, moved, *apart, longer_s, sd_s))
    return Comparison((first, second), tuple(steps), tuple(notes))


def _log_odds_of_same(evidence: Array) -> float:
    """Log odds of a side (the second axis of ``evidence`` (N, 2, 2)) being the same in both takes, so that
    each step touches with the same element or another one, against all elements being other ones."""
    log_any = np.logaddexp.reduce(evidence.reshape(-1, 4), axis=1) - np.log(4.0)
    log_different = np.logaddexp.reduce(evidence[:, 1], axis=1) - np.log(2.0)
    return float((log_any - log_different).sum())


def _moved_sides(evidence: Array, apart: tuple[Distance, Distance], is_compared: Bools) -> str:
    """The sides that touch with another element, surely and at more than the deviations of the reported
    distances; empty if places are not compared."""
    p = np.exp(evidence - np.logaddexp.reduce(evidence.ravel()))
    is_apart = any(value > SAME * sd for distance in apart for value, sd, _ in distance.figures)
    if not is_compared.all() or p[0, 0] > 1.0 - SURE_PROBABILITY or not is_apart:
        return ""
    sides = np.array([p[1].sum(), p[:, 1].sum()]) >= SURE_PROBABILITY
    return "both" if sides.all() else "object" if sides[0] else "surroundings" if sides[1] else "either"


def _is_sure(step: Step) -> bool:
    return not step.is_open and step.segment.probability >= SURE_PROBABILITY


def _duration_s(steps: Sequence[Step], take: Sequence[Step]) -> tuple[float, float]:
    """Duration of a step and its standard deviation (s): an unknown part of the open segments in and beside
    the step, and of segments of its contact behind these, belongs to it."""
    contact = _main_segment(steps).contact

    def may_go_on(step: Step) -> bool:
        return step.contact is contact or contact in step.segment.inseparable

    first, last = take.index(steps[0]), take.index(steps[-1])
    beside = [*takewhile(may_go_on, take[last + 1 :]), *takewhile(may_go_on, take[:first][::-1])]
    is_known = any(not step.is_open for step in steps)
    doubtful = [*beside, *(step for step in steps if step.is_open and is_known)]
    variance = steps[0].boundary_sd_s[0] ** 2 + steps[-1].boundary_sd_s[1] ** 2
    variance += sum(step.end_s - step.start_s for step in doubtful) ** 2 / 12.0
    return steps[-1].end_s - steps[0].start_s, sqrt(variance)


def _main_segment(steps: Sequence[Step]) -> Step:
    """The segment that names a step: the longest sure one, or the longest."""
    return max(steps, key=lambda step: (not step.is_open, step.end_s - step.start_s))


def _label(steps: Sequence[Step]) -> str:
    """The contact of a step, with ``?`` if it is open."""
    if not steps:
        return ""
    main = _main_segment(steps)
    return f"{main.contact.value}{'?' if main.is_open else ''}"


def _span(steps: Sequence[Step]) -> str:
    if not steps:
        return "-"
    digits = 2 if steps[-1].end_s < 1000.0 else 1
    return f"{steps[0].start_s:.{digits}f}-{steps[-1].end_s:.{digits}f}"


def _what(step: ComparedStep) -> str:
    """The verdict; the more probable one with ``?`` if it is open whether a step is in both takes."""
    if step.verdict is not Verdict.OPEN or (step.first and step.second) or step.probability <= 0.5:
        return step.verdict.value
    return f"{Verdict.MISSING if step.first else Verdict.NEW}?"


def _difference(step: ComparedStep) -> str:
    """The difference of a step: of its duration, or the most significant distance or angle."""
    if step.verdict is not Verdict.ELSEWHERE:
        return "" if np.isnan(step.longer_s) else f"{step.longer_s:+.2f}+/-{step.longer_sd_s:.2g} s"
    figures = [
        (value / sd, f"{value:.{max(1 - floor(log10(sd)), 0)}f}+/-{sd:.2g} {unit}")  # as exact as the sd
        for value, sd, unit in (*step.object.figures, *step.surroundings.figures)
        if sd > 0.0
    ]
    return max(figures, default=(0.0, ""))[1]


COLUMNS: Final[dict[str, Literal["number", "text"]]] = {
    name: "text" if name == "verdict" or name.startswith(("contact", "moved")) else "number"
    for name in ComparedStep((), (), Verdict.OPEN, 0.0).to_json()
}
"""Columns of the rows in CSV, JSON and DataFrames, with their kinds."""
