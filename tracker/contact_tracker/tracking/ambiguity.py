"""Which contacts the motion so far cannot tell from the one believed (docs/theory.md, T23, T24).

Judged over about the same span of time and without what is usual in transitions: a label may be preferred for
being usual, and yet the motion has not shown it.
"""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.hypotheses.bank import Bank
from contact_tracker.hypotheses.evidence import AS_WELL
from contact_tracker.hypotheses.pruning import best_of
from contact_tracker.hypotheses.schedule import FAR_NATS
from contact_tracker.motion.used_directions import DIRECTIONS, used_directions
from contact_tracker.motion.window import Window
from contact_tracker.states import CONTACTS, STATES, Contact

Array = NDArray[np.float64]
Index = NDArray[np.int64]

DECISIVE: Final = float(np.log(20.0))
"""Evidence (nats) that tells two contacts apart: twenty to one."""
SAME_SPAN: Final = 0.25
"""Onsets that differ by this share of the contact's age are about the same span: of old ones few are kept."""
SAME_SPAN_TICKS: Final = 3
RESTRICTED: Final = 0.12
"""Share of the contacts in which an object is moved in fewer directions than it could be."""
MOST_NATS: Final = 50.0
"""Beyond doubt."""
VARIED_S: Final = 0.7
"""Time in which other motion has shown all its directions."""
FIRST_CHOICE: Final = 2.0
"""Weight of the label among states that motion cannot tell apart."""
OPEN_AT_MOST: Final = 0.9
"""Probability of a label that does not name all constraints that are kept."""
ALMOST: Final = 1.0 - 1e-9
LEAST_MOTION_TICKS: Final = 10.0
"""With less motion in the window a contact that is older than the window is judged by its evidence alone, and
free motion is not said to have one degree of freedom."""


class CompetingEvidence(NamedTuple):
    """How well each state explains one span.

    ``evidence`` (7,) in nats against any one of them, and ``rms`` (7,), the whitened residual that is left.
    """

    evidence: Array
    rms: Array


class Freedom(NamedTuple):
    """Of the motion: whether it makes no use of the freedom that its label leaves, and whether it has but one
    degree of freedom."""

    underused: bool
    one_direction: bool


def indistinguishable(label: Contact, rivals: CompetingEvidence, freedom: Freedom) -> tuple[Contact, ...]:
    """The other states that the motion does not distinguish from ``label`` (T23).

    Those are the states whose evidence is at most ``DECISIVE`` below the label's. If the label's freedom is
    underused, not moving in one more direction is no evidence: then also every state that fits the motion,
    and every state that these contain. Motion of one degree of freedom is that of a hinge, a slide or a screw
    as well, whatever fits it: then all.
    """
    if freedom.one_direction:
        return tuple(state for state in STATES if state is not label)
    close = rivals.evidence > rivals.evidence[label.column] - DECISIVE
    if freedom.underused:
        fits = close | (rivals.rms < AS_WELL * max(1.0, rivals.rms[label.column]))
        fitting = [state for state, fit in zip(STATES, fits, strict=True) if fit]
        close = np.array([any(other.contains(state) for other in fitting) for state in STATES])
    return tuple(state for state, near in zip(STATES, close, strict=True) if near and state is not label)


def freedom_of(label: Contact, window: Window, older: bool) -> Freedom:
    """What use the motion makes of the freedom that ``label`` leaves.

    ``window`` are the ticks since the onset, as far as they are at hand; ``older`` if there were others.
    Free motion, too, goes one way at first.
    """
    is_short = float(window.motion_ratio.sum()) < LEAST_MOTION_TICKS
    if older and is_short:
        return Freedom(False, False)
    used = used_directions(window)
    one = used == 1 and not (label is Contact.FREE and is_short)
    return Freedom(used < DIRECTIONS - label.codimension, one)


def tempered(probability: Array, sureness: float) -> Array:
    """Posterior (..., 7), up to a constant, to the power of ``sureness``: the order of the states stays, one
    and all (T31)."""
    power = probability**sureness
    return np.asarray(power / power.sum(axis=-1, keepdims=True))


def p_deliberate(underused: bool, window: Window, tick_s: float) -> float:
    """Probability that the object is moved in so few directions on purpose (T30).

    So it is in a share ``RESTRICTED`` of the contacts. That becomes likely when more and more motion shows no
    other directions.
    """
    moved_s = tick_s * float(window.motion_ratio.sum())
    return RESTRICTED / (RESTRICTED + (1.0 - RESTRICTED) * np.exp(-moved_s / VARIED_S)) if underused else 0.0


def at_most(probability: Array, label: Contact, most: float = OPEN_AT_MOST) -> Array:
    """Posterior (7,) in which the label has ``most`` at most; the rest is as likely any other contact.

    So of motion that keeps more constraints than the contacts that are named (docs/theory.md, section 18).
    """
    beyond = float(probability[label.column]) - most
    if beyond <= 0.0:
        return probability
    share = np.full(len(STATES), 1.0)
    share[[label.column, Contact.FREE.column]] = 0.0
    change = beyond * share / share.sum()
    change[label.column] = -beyond
    return np.asarray(probability + change)


def p_curved(log_evidence: float) -> float:
    """Probability that what is called free keeps to a curved surface, whose evidence is so large (nats)."""
    odds = RESTRICTED / (1.0 - RESTRICTED) * np.exp(min(log_evidence, MOST_NATS))
    return float(odds / (1.0 + odds))


def redistribute(
    probability: Array,
    label: Contact,
    others: tuple[Contact, ...],
    deliberate: float,
    possible: tuple[Contact, ...] = CONTACTS,
) -> Array:
    """Posterior (7,) in which what motion does not tell apart, the label and ``others``, shares probability.

    The most probable contact among them gives to all the others, in proportion to the probability that the
    restriction of the motion is ``deliberate`` (T30). That contact is the label itself, except on a Viterbi
    path or with a lag. Free motion gives only where every ``possible`` contact is consistent with it. The
    most probable state stays the most probable one, and the sum stays 1.
    """
    is_free = label is Contact.FREE
    if not others or (is_free and not set(possible) <= set(others)):
        return probability
    alike = [state.column for state in (label, *others)]
    contacts = [label.column] if is_free else [c for c in alike if c != Contact.FREE.column]
    giver = max(contacts, key=lambda c: (probability[c], c == alike[0]))
    share = np.zeros(len(STATES))
    share[alike] = 1.0
    share[giver] = FIRST_CHOICE
    share /= share.sum()
    change = probability[giver] * (share - (np.arange(len(STATES)) == giver))
    # as far as the giver, and the most probable state, stay ahead of those that are behind them
    most = min(_until_overtaken(probability, change, ahead) for ahead in (giver, int(probability.argmax())))
    return np.asarray(probability + min(deliberate, ALMOST * most) * change)


def decide_by_wrenches(
    label: Contact, others: tuple[Contact, ...], evidence: Array
) -> tuple[Contact, tuple[Contact, ...], Array | None]:
    """What measured wrenches make of a ``label`` and the ``others``, which motion does not tell from it
    (T41).

    Parameters
    ----------
    evidence : (7,) log evidence of each state by the wrenches.

    Returns
    -------
    The most probable of them; those that are not ``DECISIVE`` behind it; and the share (7,) of each in the
    probability of all, None without others. The label is ``FIRST_CHOICE`` times as likely before.
    """
    if not others:
        return label, others, None
    alike = np.array([state.column for state in (label, *others)])
    weight = evidence[alike] + np.where(alike == label.column, np.log(FIRST_CHOICE), 0.0)
    weight -= weight.max()
    share = np.zeros(len(STATES))
    share[alike] = np.exp(weight) / np.exp(weight).sum()
    best = STATES[int(alike[weight.argmax()])]
    open_ones = {int(column) for column in alike[weight > -DECISIVE]}
    rest = tuple(state for state in STATES if state.column in open_ones and state is not best)
    return best, rest, share


def shared(probability: Array, share: Array) -> Array:
    """Posterior (7,) in which the states with a ``share`` (7,) have it of the probability of all of them."""
    alike = share > 0.0
    return np.where(alike, probability[alike].sum() * share, probability)


def _until_overtaken(probability: Array, change: Array, ahead: int) -> float:
    """The share of the ``change`` (7,), at most 1, with which nothing passes the state ``ahead``."""
    lead, loss = probability[ahead] - probability, change - change[ahead]
    behind = (loss > 0.0) & (lead >= 0.0)
    return float(np.min(lead / np.where(behind, loss, np.inf), where=behind, initial=1.0))


def competing_evidence(banks: Sequence[Bank], label: Contact, onset: int, now: int) -> CompetingEvidence:
    """How well each state explains the ticks since about ``onset``, against the label.

    Of each contact the most probable hypothesis of about that onset counts, against the label's evidence from
    just that onset on. -inf where none is left.
    """
    slack = int(max(SAME_SPAN_TICKS, SAME_SPAN * (now - onset)))
    span = np.array([onset - slack, onset + slack + 1])
    evidence, rms = np.full(len(STATES), -np.inf), np.full(len(STATES), np.inf)
    since = np.full(len(STATES), onset)
    for column, bank in enumerate(banks):
        first, end = bank.onset.searchsorted(span)  # they are in order
        if first < end:
            best = first + bank.log_weight[first:end].argmax()
            evidence[column], rms[column] = bank.log_likelihood[best], bank.rms[best]
            since[column] = bank.onset[best]
    evidence[-1], rms[-1] = 0.0, 1.0
    if label is not Contact.FREE:
        evidence -= _evidence(banks[label.column], since)
    evidence[label.column] = 0.0
    return CompetingEvidence(evidence, rms)


def _evidence(bank: Bank, since: Index) -> Array:
    """A contact's evidence against free motion ``since`` some ticks, between its hypotheses: the best of each
    onset, and none that is far behind."""
    near = np.flatnonzero(bank.log_weight >= bank.best - FAR_NATS)
    near = near[best_of(bank.onset[near], bank.log_weight[near])]
    return np.interp(since, bank.onset[near], bank.log_likelihood[near])
