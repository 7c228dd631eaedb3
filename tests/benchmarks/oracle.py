"""Oracles: labels by the tracker's evidence with the true boundaries, and with the true geometry.

Each true phase is labelled as a whole, from the ticks within it and with the noise that the tracker
estimates:

- *fitted*: every contact is fitted to the phase, the true one from the true elements as well; the label is by
  the tracker's hidden Markov model with changes at the true boundaries only.
- *given*: the same, but the true contact has its true elements, without complexity.
- *rule*: the most constrained contact that fits, without evidence.
"""

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from contact_tracker import hmm
from contact_tracker.config.parameters import Model
from contact_tracker.contacts import CONTACT_MODELS, ContactModel
from contact_tracker.geometry.elements import ContactGeometry, shifted
from contact_tracker.ground_truth import Truth, TruthInterval
from contact_tracker.hypotheses import evidence
from contact_tracker.hypotheses.bank import Bank
from contact_tracker.hypotheses.bank_update import fit_window
from contact_tracker.hypotheses.births import BirthProposals, uninformed_proposal
from contact_tracker.hypotheses.evidence import EvidenceParameters
from contact_tracker.map.element_prior import pair_priors
from contact_tracker.map.map import Accuracy, known_to
from contact_tracker.motion.lifted_pose import T
from contact_tracker.motion.window import Window
from contact_tracker.states import STATES, Contact
from contact_tracker.tracking.state import scales_of
from contact_tracker.tracking.transition_model import hazard_exposure, log_initial, tick_transitions
from tracking import Tracked

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

ORACLES: Final = ("fitted", "given", "rule")
FEWEST: Final = 2
"""Least number of whole ticks in a phase."""
ROUNDS: Final = 4
"""Rounds of a few steps from the true elements to the nearest minimum."""
RARE: Final = 1e-3
AS_WELL: Final = 1.2
"""A contact fits unless its residuals are less probable than ``RARE`` and exceed the noise by this factor."""
FREE: Final = Contact.FREE.column


@dataclass(frozen=True)
class Phase:
    """A contact of the same two elements from ``start_ns`` to ``end_ns`` (included)."""

    start_ns: int
    end_ns: int
    contact: Contact
    geometry: ContactGeometry | None


@dataclass(frozen=True, eq=False)
class OracleResults:
    """Results of the oracles for P phases.

    ``label`` (P,) columns by oracle; ``evidence`` (P, 7) of fitted contacts against free motion, and
    ``given`` (P, 7) with the true elements; ``ticks`` (P,) in each phase.
    """

    label: dict[str, Ints]
    evidence: Array
    given: Array
    ticks: Ints


def phases(truth: Truth) -> list[Phase]:
    """The true phases in order; successive intervals with the same elements are one phase."""
    found: list[Phase] = []
    known = [i for i in truth.intervals if i.contact is not None]
    for before, interval in pairwise([None, *known]):
        assert interval is not None
        assert interval.contact is not None
        if before is not None and _is_same(before, interval):
            found[-1] = replace(found[-1], end_ns=interval.end_ns)
        else:
            found.append(Phase(interval.start_ns, interval.end_ns, interval.contact, interval.geometry))
    return found


def _is_same(before: TruthInterval, after: TruthInterval) -> bool:
    if before.geometry is None or after.geometry is None:
        return before.contact is after.contact
    return before.contact is after.contact and before.geometry.to_json() == after.geometry.to_json()


def evaluate(true: list[Phase], tracked: Tracked, origin_m: Array, model: Model) -> OracleResults:
    """Evaluate the oracles; ``origin_m`` (3,) is the origin of the tracker's coordinates in the world."""
    scales, windows = scales_of(model), [within(phase.start_ns, phase.end_ns, tracked) for phase in true]
    fitted, at_truth = np.zeros((2, len(true), len(STATES)))
    rule = np.full(len(true), FREE)
    for row, (phase, window) in enumerate(zip(true, windows, strict=True)):
        if len(window) < FEWEST:
            continue
        x = _true_x(phase, window, origin_m)
        fitted[row], rule[row] = _fit_all(phase.contact, x, window, scales)
        at_truth[row] = fitted[row]
        if x is not None:  # without the first tick, as for fitted contacts
            at_truth[row, phase.contact.column] = evidence_of_truth(phase, window, origin_m, model, first=1)
    label = {"fitted": _chain(fitted, windows, model), "given": _chain(at_truth, windows, model)}
    return OracleResults(
        label | {"rule": rule}, fitted, at_truth, np.array([len(w) for w in windows], np.int64)
    )


def evidence_within(start_ns: int, end_ns: int, tracked: Tracked, model: Model) -> Array:
    """Evidence (7,) of the states in a span of time only; zero with too few ticks."""
    window = within(start_ns, end_ns, tracked)
    if len(window) < FEWEST:
        return np.zeros(len(STATES))
    return _fit_all(Contact.FREE, None, window, scales_of(model))[0]


def evidence_of_truth(phase: Phase, window: Window, origin_m: Array, model: Model, first: int = 0) -> float:
    """Evidence of the true elements without complexity, in the ticks of the window from row ``first`` on.

    Zero if they are unknown, and for free motion.
    """
    x = _true_x(phase, window, origin_m) if len(window) else None
    if x is None:
        return 0.0
    scales = scales_of(model)
    ratio = evidence.log_ratio(CONTACT_MODELS[phase.contact.column], x[None], window, scales)
    return scales.likelihood_exponent * float(ratio.log_ratio[0, first:].sum())


def log_prior(label: Ints, window: Window, model: Model) -> float:
    """Log prior probability of the labels (W,) of ticks, given only the activity."""
    log_probability, contacts = float(log_initial(model)[label[0]]), np.arange(FREE)
    for before, now, activity in zip(label[:-1], label[1:], window.motion_ratio[1:], strict=True):
        exposed = hazard_exposure(float(activity))
        step, stay = tick_transitions(model, exposed)
        step[contacts, contacts] = np.logaddexp(step[contacts, contacts], stay[contacts])
        log_probability += float(step[before, now])
    return log_probability


def within(start_ns: int, end_ns: int, tracked: Tracked) -> Window:
    """The ticks with frames in this span."""
    inside = (tracked.start_ns >= start_ns) & (tracked.stamp_ns <= end_ns) & (tracked.frames > 0)
    ticks = tracked.window
    return Window(
        ticks.index[inside], ticks.zeta[inside], ticks.variance[inside], ticks.innovation_excess[inside]
    )


def _true_x(phase: Phase, window: Window, origin_m: Array) -> Array | None:
    """The true elements as the parameters (S,) of the true contact; None if they are unknown."""
    if phase.geometry is None or phase.contact is Contact.FREE:
        return None
    contact = CONTACT_MODELS[phase.contact.column]
    anchors = contact.anchors(window.zeta[:, T].mean(axis=0))
    ours, theirs = phase.geometry.object, shifted(phase.geometry.environment, -origin_m)
    (x,) = pair_priors(contact, [(known_to(ours, Accuracy()), known_to(theirs, Accuracy()))]).mean
    return contact.family.normalise(x, anchors)


def _fit_all(true: Contact, x: Array | None, window: Window, scales: EvidenceParameters) -> tuple[Array, int]:
    """Evidence (7,) of the states, and the column of the most constrained one that fits."""
    log_evidence, excess = np.zeros(len(STATES)), np.full(len(STATES), np.inf)
    excess[FREE] = 0.0
    for contact in CONTACT_MODELS:
        column, family = contact.contact.column, contact.family
        fits = [fit_window(contact, window, scales)]
        if contact.contact is true and x is not None:
            fits.append(_from_truth(contact, x, window, scales))
        best = max(fits, key=lambda fit: float(fit.log_likelihood[0]))
        log_evidence[column] = best.log_likelihood[0]
        freedom = max(family.ROWS * len(window) - family.PARAMETERS, 1)
        square = family.ROWS * len(window) * best.rms[0] ** 2
        tolerated = max(chi2.ppf(1.0 - RARE, freedom), AS_WELL**2 * freedom)
        excess[column] = square / tolerated
    codimension = np.array([state.codimension for state in STATES])
    rank = np.where(excess <= 1.0, codimension - 0.5 * excess, -1.0)
    return log_evidence, int(np.argmax(rank))


def _from_truth(contact: ContactModel, x: Array, window: Window, scales: EvidenceParameters) -> Bank:
    """The fit at the minimum nearest to x."""
    new = uninformed_proposal(contact)
    for _ in range(ROUNDS):
        rows = new.rows.replace_columns(needs_search=0, prior_mean=x)
        begin = BirthProposals(rows, np.ones_like(new.is_given), new.are_both_known)
        fitted = fit_window(contact, window, scales, begin)
        x = fitted.x[0]
    return fitted


def _chain(log_evidence: Array, windows: list[Window], model: Model) -> Ints:
    """The most probable label (P,) of each phase in the chain of all, given their evidence (P, 7)."""
    stay, change = np.zeros(log_evidence.shape), np.zeros((*log_evidence.shape, len(STATES)))
    for row, window in enumerate(windows):
        activity = window.motion_ratio
        stay[row] = sum(
            (tick_transitions(model, hazard_exposure(a)).log_survival for a in activity[1:].tolist()),
            np.zeros(len(STATES)),
        )
        change[row] = tick_transitions(
            model, hazard_exposure(float(activity[0]) if len(window) else 0.0)
        ).log_transition
    count, states = log_evidence.shape
    number = np.arange(count * states).reshape(count, states)
    trellis = hmm.Trellis(
        np.tile(np.arange(states), count),
        np.repeat(np.arange(count), states),
        list(number),
        list(log_evidence + stay),
    )
    posterior, _ = hmm.smooth(trellis, log_initial(model), change)
    return np.asarray(posterior.argmax(axis=1), np.int64)
