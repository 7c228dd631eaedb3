"""The report of a calibration: its data, the changes, and their effect on held-out recordings."""

from functools import reduce
from operator import add
from typing import Final

import numpy as np

from contact_tracker.config.parameters import Model, Noise, Transitions
from contact_tracker.states import CONTACTS, STATES
from contact_tracker.tracking.transition_model import destinations, initial, leave_per_s
from contact_tracker_lab.calibration.calibrate import Calibration, HeldOut
from contact_tracker_lab.calibration.floors import FEWEST, Floor
from contact_tracker_lab.calibration.learned import How, Learned, value_of
from contact_tracker_lab.evaluation.evaluate import Evaluation
from contact_tracker_lab.evaluation.metrics import Tally
from contact_tracker_lab.evaluation.tables import number, table

FLOOR_NOTE: Final = """\
Floor of each contact alone, beyond the sensor's noise; - with too few residuals."""
ERROR_NOTE: Final = """\
Floor of each contact beyond the common one (m, rad), in quadrature."""
RATE_NOTE: Final = """\
Seen: seconds in motion and changes out of each state; rates per second of motion. Begins: probability that
a recording begins in the state."""
SPLIT_NOTE: Final = """\
Distribution of the next state, in percent, by the state that ends (row); of a contact to itself: to other
elements."""
HELD_OUT_NOTE: Final = """\
Scores of each recording by the initial model and by one learned without its fold. Log-loss in nats; ECE:
expected calibration error."""


def to_text(calibration: Calibration) -> str:
    """Tables, no trailing newline."""
    start, model = calibration.plan.start, calibration.learned.model
    blocks = [_source(calibration), _scalars(calibration, start, model)]
    if calibration.learned.floors:
        blocks += [_floors(calibration.learned.floors), FLOOR_NOTE]
    if calibration.plan.wants(How.CONTACTS):
        blocks += [_errors(model.noise), ERROR_NOTE]
    if calibration.plan.wants(How.COUNTS):
        blocks += [_rates(start.transitions, model.transitions), RATE_NOTE]
        blocks += [_split(model.transitions), SPLIT_NOTE]
    if calibration.held_out:
        blocks += [*_held_out(calibration.held_out), HELD_OUT_NOTE]
    return "\n\n".join(blocks)


def _source(calibration: Calibration) -> str:
    studies = calibration.studies
    labelled = sum(study.labelled for study in studies)
    seconds = sum(study.seconds for study in studies)
    rounds = calibration.learned.rounds
    head = f"{len(studies)} recordings, {seconds:.0f} s; learned from the truth of {labelled}"
    if not rounds:
        return head
    gained = f"{rounds[-1] - rounds[0]:.1f} nats"
    return f"{head}; transitions after {len(rounds)} rounds, log posterior {gained} higher"


def _scalars(calibration: Calibration, start: Model, model: Model) -> str:
    rows = [
        [
            learned.key,
            _short(value_of(start, learned.key)),
            _short(value_of(model, learned.key)),
            _from(calibration, learned),
        ]
        for learned in calibration.plan.wanted
        if learned.how not in (How.COUNTS, How.CONTACTS)
    ]
    prior = model.transitions.prior_changes
    text = f"prior of the transitions: the lattice, as much as {prior:g} changes out of each state"
    return "\n".join([*([table(["parameter", "before", "after", "from"], rows)] if rows else []), text])


def _from(calibration: Calibration, learned: Learned) -> str:
    if learned.how is How.RESIDUALS:
        floor = next(f for f in calibration.learned.floors if f.key == learned.key and f.contacts == "all")
        enough = "" if floor.residuals >= FEWEST else ": too few, kept"
        return f"{floor.residuals} {learned.how}{enough}"
    if learned.how is How.SEARCH:
        found = next(s for s in calibration.learned.searched if s.key == learned.key)
        return f"log-loss {number(found.before)} to {number(found.after)} in {len(found.tried)} runs"
    return str(learned.how)


def _floors(floors: tuple[Floor, ...]) -> str:
    rows = [
        [f.key, f.contacts, "-" if f.value is None else _short(f.value), str(f.residuals)] for f in floors
    ]
    return table(["floor", "contacts", "value", "residuals"], rows, left=2)


def _errors(noise: Noise) -> str:
    rows = [
        [contact.value, _short(noise.contact_position_m[column]), _short(noise.contact_rotation_rad[column])]
        for column, contact in enumerate(CONTACTS)
    ]
    return table(["contact", "contact_position_m", "contact_rotation_rad"], rows)


def _rates(before: Transitions, after: Transitions) -> str:
    columns = zip(
        STATES,
        after.counts.moving_s,
        np.array(after.counts.changes).sum(axis=1),
        leave_per_s(before),
        leave_per_s(after),
        initial(before),
        initial(after),
        strict=True,
    )
    rows = [
        [state.value, number(s, 1), number(n, 1), *(number(v) for v in values)]
        for state, s, n, *values in columns
    ]
    return table(["state", "seen s", "changes", "leave 1/s", "after", "begins", "after"], rows)


def _split(transitions: Transitions) -> str:
    names = [state.value for state in STATES]
    rows = zip(names, 100.0 * destinations(transitions), strict=True)
    return table(["", *names], [[name, *(number(p, 1) if p else "." for p in row)] for name, row in rows])


def _held_out(held_out: tuple[HeldOut, ...]) -> list[str]:
    blocks = []
    both = [(h.before.evaluation, h.after.evaluation) for h in held_out]
    scored = [(b, a) for b, a in both if b is not None and a is not None]
    if scored:
        before, after = (reduce(add, column) for column in zip(*scored, strict=True))
        rows = [*_modes("before", before), *_modes("after", after)]
        header = ["held out", "", "accuracy", "F1", "log-loss", "Brier", "ECE", "sure & wrong"]
        blocks.append(table(header, rows, left=2))
    chains = [h.chain for h in held_out if h.chain is not None]
    if chains:
        b, a = np.sum(chains, axis=0)
        blocks.append(f"log probability of the true states by the transitions: {b:.1f} before, {a:.1f} after")
    b, a, s = np.sum(
        [[h.before.log_evidence, h.after.log_evidence, h.before.seconds] for h in held_out], axis=0
    )
    blocks.append(f"log evidence against free motion: {b / s:.3f} nats/s before, {a / s:.3f} after")
    return blocks


def _modes(when: str, evaluation: Evaluation) -> list[list[str]]:
    modes: tuple[tuple[str, Tally], ...] = (("smoothed", evaluation.offline), ("filtered", evaluation.online))
    return [
        [
            mode,
            when,
            number(t.accuracy()),
            number(t.macro_f1),
            number(t.log_loss),
            number(t.brier),
            number(t.calibration_error),
            number(t.sure_wrong),
        ]
        for mode, t in modes
    ]


def _short(value: float) -> str:
    return f"{value:.3g}"
