"""A plan, the sequence of expected contacts, and a filter that estimates at which step of it a stream is.

The filter (docs/theory.md, T49) is a hidden Markov model of the steps. A tick changes the odds of two
contacts by the ratio of the tracker's belief to its prediction from the tick before, so that evidence counts
once. A further state is that the plan has been left; then the tracker's belief holds unchanged.
"""

from dataclasses import dataclass
from itertools import compress
from math import ceil
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from contact_tracker.config.keys import Keys
from contact_tracker.errors import KnowledgeError, UsageError
from contact_tracker.geometry.elements import Array
from contact_tracker.map.file import read_table
from contact_tracker.outputs.outcome import Outcome
from contact_tracker.outputs.text import SURE_PROBABILITY
from contact_tracker.sequences.steps import LEAST_PROBABILITY, steps_of
from contact_tracker.states import STATES, Contact, states_from
from contact_tracker.tracking.belief import Belief
from contact_tracker.trajectory.arguments import path_from
from contact_tracker.version import __version__

ANY: Final = "any"
MOST_STEPS: Final = 1000
"""Largest number of steps of a plan: they take 1 to 22 ms per tick."""
_LONGEST_S: Final = 1e6
DURATION_SD: Final = 0.25
"""Relative standard deviation of durations, as measured for 41 steps of nine pairs of takes."""
_LEAST_DURATION_SD: Final = 0.05
STAGE_S: Final = 0.1
"""Least duration of a stage: that of a usual tick. Shorter stages add nothing, and take up to 55 ms per
tick."""
PARTS_PER_STAGE: Final = 4
"""Least number of integrated parts per stage: deviations of durations are then at least 0.87 of the planned
ones."""
_MOST_PARTS: Final = 1000
"""Largest number of integrated parts per tick: it is exceeded by gaps over 25 s, after which any step may
hold."""
_USUAL_S: Final = 5.0
"""Duration of steps if none has one: the mean of 47 steps in nine takes (tests/benchmarks/takes.py)."""


@dataclass(frozen=True)
class PlannedStep:
    """A step in which one of ``contacts`` holds, for about ``duration_s`` if given; it may be left out if it
    ``is_optional``."""

    contacts: tuple[Contact, ...]
    duration_s: float | None = None
    is_optional: bool = False

    @property
    def name(self) -> str:
        """``f-f``, ``e-f|v-f`` or ``any``."""
        return ANY if len(self.contacts) == len(STATES) else "|".join(self.contacts)


@dataclass(frozen=True)
class Plan:
    """Steps in order; ``duration_sd`` is the relative standard deviation of durations."""

    steps: tuple[PlannedStep, ...]
    duration_sd: float = DURATION_SD

    @classmethod
    def read(cls, path: str) -> "Plan":
        """The plan in a TOML file (docs/assembly.md); raises UsageError."""
        try:
            content = read_table(path_from(path))
            keys = Keys(content)
            duration_sd = keys.number("duration_sd", DURATION_SD, _LEAST_DURATION_SD, 1.0)
            rows = keys.tables("step")
            keys.finish()
            if not 0 < len(rows) <= MOST_STEPS:
                raise keys.wrong("step", f"a plan has 1 to {MOST_STEPS} steps, not {len(rows)}")
            return cls(tuple(map(_planned, rows)), duration_sd)
        except KnowledgeError as error:
            text = f"{error.key}: {error.reason}" if error.key else error.reason
            raise UsageError(f"plan {path}: {text}") from error

    @classmethod
    def of(cls, outcome: Outcome) -> "Plan":
        """The plan of a recording. A step that is not sure has all its possible contacts and no duration; an
        open step is optional. Raises UsageError if there are too many steps."""
        steps = list[PlannedStep]()
        for step in steps_of(outcome):
            fits = [step.probability[state.column] > 1.0 - SURE_PROBABILITY for state in STATES]
            may_be = {step.contact, *step.segment.inseparable, *compress(STATES, fits)}
            contacts = tuple(state for state in STATES if state in may_be)
            duration_s = step.end_s - step.start_s
            planned_s = round(duration_s, 2) if len(contacts) == 1 else None
            is_optional = step.is_open
            if steps and steps[-1].contacts == contacts:
                previous = steps.pop()
                whole_s = (previous.duration_s or 0.0) + duration_s
                planned_s = None if planned_s is None or previous.duration_s is None else round(whole_s, 2)
                is_optional = is_optional and previous.is_optional
            steps.append(PlannedStep(contacts, planned_s, is_optional))
        if len(steps) > MOST_STEPS:
            raise UsageError(f"a plan has at most {MOST_STEPS} steps, not {len(steps)}: cut the recording")
        return cls(tuple(steps))

    @property
    def toml(self) -> str:
        """The text of the plan's file."""
        lines = [f"# Written by contact-tracker {__version__}: the contacts to come, for live --expect."]
        lines.append(f"duration_sd = {self.duration_sd:g}  # of durations, as a share of them")
        for number, step in enumerate(self.steps, start=1):
            lines += ["", f"[[step]]  # {number}", f'contact = "{step.name}"']
            lines += [] if step.duration_s is None else [f"duration_s = {step.duration_s:.2f}"]
            lines += ["optional = true"] if step.is_optional else []
        return "\n".join(lines) + "\n"


def write_plan(outcome: Outcome, path: Path, _: str) -> None:
    """Write the plan of a recording."""
    path.write_text(Plan.of(outcome).toml, encoding="utf-8")


def _planned(keys: Keys) -> PlannedStep:
    name = keys.text("contact", None)
    try:
        contacts = STATES if name == ANY else states_from(name.replace("|", ","))
    except ValueError as error:
        raise keys.wrong("contact", str(error)) from error
    duration_s = keys.number("duration_s", 0.0, 0.0, _LONGEST_S) or None
    step = PlannedStep(contacts, duration_s, keys.flag("optional", False))
    keys.finish()
    return step


class Progress(NamedTuple):
    """The progress of a stream in a plan.

    Parameters
    ----------
    step : number of the most probable step, from 1.
    probability : posterior of this step.
    p_left : probability that the plan has been left, even if it was resumed later.
    following : number of the next step that is not optional; None at the end.
    leaves : whether leaving the plan has become sure with this tick; true once.
    """

    step: int
    probability: float
    p_left: float
    following: int | None
    leaves: bool

    def to_json(self) -> dict[str, Any]:
        """The entry ``plan`` of a line of ``live --json``."""
        return self._asdict()


class PlanFollower:
    """Follows a plan: ``update`` with each belief of a tracker returns the progress of the stream.

    A step with duration d and standard deviation s d is a chain of 1 / s^2 stages, which gives its duration
    this deviation (Erlang's distribution), or of fewer, so that stages are no shorter than ticks. A step
    without duration is a single stage.
    """

    def __init__(self, plan: Plan) -> None:
        if not isinstance(plan, Plan):
            raise UsageError(f"plan is a Plan, as of Plan.read, not {type(plan).__name__}")
        self.plan = plan
        count = ceil(plan.duration_sd**-2)
        lengths = [int(min(max((step.duration_s or 0.0) / STAGE_S, 1.0), count)) for step in plan.steps]
        self._last_stage = np.cumsum(lengths) - 1
        self._first_stage = self._last_stage + 1 - lengths
        self._number = np.repeat(np.arange(len(lengths)), lengths)
        planned = [step.duration_s for step in plan.steps if step.duration_s is not None]
        self._mean_s = float(np.mean(planned)) if planned else _USUAL_S
        stage_s = np.array([step.duration_s or self._mean_s for step in plan.steps]) / lengths
        self._stage_s = stage_s[self._number]
        self._columns = np.array([[state in step.contacts for state in STATES] for step in plan.steps], float)
        self._weight = np.zeros((2, len(self._number)))
        """Weights of the stages (2, stages): before the plan was left, and after."""
        self._outside = 1.0 / (len(lengths) + 1)
        self._entries = np.array([self._entry_shares(number) for number in range(len(lengths) + 1)])
        self._weight[0, self._first_stage] = self._entries[0] * (1.0 - self._outside)
        self._belief: tuple[int, Array] | None = None
        self.has_left, self._reported = False, -1
        self.news = ""
        """News of the last belief in words: a step that has become sure, or that the plan was left."""

    def update(self, belief: Belief) -> Progress:
        """Update with the next belief."""
        if not isinstance(belief, Belief):
            raise UsageError(f"a belief is what Tracker.update returns, not {type(belief).__name__}")
        p = np.maximum(belief.probability, LEAST_PROBABILITY)
        p = p / p.sum()
        predicted = np.full(len(STATES), 1.0 / len(STATES))
        if self._belief is not None:
            tick_s = max((belief.stamp_ns - self._belief[0]) * 1e-9, 0.0)
            changed = -np.expm1(-tick_s / self._mean_s)
            previous = self._belief[1]
            predicted = (1.0 - changed) * previous + changed * (1.0 - previous) / (len(STATES) - 1)
            self._advance(tick_s, changed / (len(self._last_stage) + 1))  # Laplace: no step was left so far
        self._belief = belief.stamp_ns, p
        self._weight *= (self._columns @ p / (self._columns @ predicted))[self._number]
        total = self._weight.sum() + self._outside
        self._weight, self._outside = self._weight / total, self._outside / total
        shares = np.bincount(self._number, self._weight.sum(axis=0))
        step, p_left = int(np.argmax(shares)), 1.0 - float(self._weight[0].sum())
        leaves = not self.has_left and p_left >= SURE_PROBABILITY
        self.has_left = self.has_left or leaves
        rest = range(step + 1, len(shares))
        following = next((k + 1 for k in rest if not self.plan.steps[k].is_optional), None)
        is_sure = shares[step] >= SURE_PROBABILITY and step != self._reported
        self.news = ""
        if leaves or is_sure:
            self._reported = step
            comes = "the last step" if step + 1 == len(shares) else "after which none has to come"
            comes = comes if following is None else f"next is {self._step_text(following)}"
            departure = f"left (p {p_left:.2f}), in or before " if leaves else ""
            self.news = f"{departure}step {self._step_text(step + 1)} of {len(shares)}, {comes}"
        return Progress(step + 1, float(shares[step]), p_left, following, leaves)

    def _advance(self, tick_s: float, leaves: float) -> None:
        """Predict the weights after ``tick_s``; a share ``leaves`` of them leaves the plan.

        Time is integrated in parts that are short compared to stages, with one transition each at most. Mean
        durations are exact.
        """
        parts = int(min(max(ceil(PARTS_PER_STAGE * tick_s / self._stage_s.min()), 1), _MOST_PARTS))
        share = np.minimum(tick_s / parts / self._stage_s, 1.0)
        entries = self._entries[1:]
        for _ in range(parts):
            goes_on = share * self._weight
            weight = self._weight - goes_on
            weight[:, 1:] += np.where(np.diff(self._number) == 0, goes_on[:, :-1], 0.0)
            ending = goes_on[:, self._last_stage]
            weight[:, self._first_stage] += ending @ entries
            weight[:, self._last_stage] += ending * (1.0 - entries.sum(axis=1))  # at the end of the plan
            self._weight = weight
        self._weight *= 1.0 - leaves
        self._weight[1, self._first_stage] += self._outside * leaves / len(self._first_stage)
        self._outside = 1.0 - float(self._weight.sum())

    def _entry_shares(self, number: int) -> Array:
        """Probabilities (K,) of the step that begins in place of ``number``: optional ones are left out with
        0.5."""
        are_optional = np.array([step.is_optional for step in self.plan.steps[number:]], bool)
        reached = np.cumprod(np.append(1.0, np.where(are_optional, 0.5, 0.0)))[: len(are_optional)]
        return np.concatenate([np.zeros(number), reached * np.where(are_optional, 0.5, 1.0)])

    def _step_text(self, number: int) -> str:
        return f"{number} ({self.plan.steps[number - 1].name})"
