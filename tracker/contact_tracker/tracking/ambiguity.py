"""Contacts that the motion so far does not distinguish from the label (docs/theory.md, T23, T24).

Evidence is compared over about the same span of time and without transition probabilities: a label may be
preferred by these although the motion has not shown it. Free motion is tested for contact with a curved
surface, which is none of the six contacts (T42).
"""

from collections.abc import Container, Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import compress
from math import inf
from operator import attrgetter
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.arrays import Array, Ints
from contact_tracker.explanations.curved_contact import FaceNormals, curved_evidence
from contact_tracker.geometry.elements import ContactGeometry, Line, Plane
from contact_tracker.geometry.lifted_pose import R
from contact_tracker.hypotheses import compiled
from contact_tracker.hypotheses.bank import Bank
from contact_tracker.hypotheses.evidence import DECISIVE, SAME_FIT_RATIO, EvidenceParameters
from contact_tracker.hypotheses.global_search import best_of
from contact_tracker.hypotheses.schedule import NEAR_NATS
from contact_tracker.map.elements import is_same_element
from contact_tracker.map.map import Map
from contact_tracker.motion.free_motion import NOW_TICKS
from contact_tracker.motion.tick_averaging import NOISY_M
from contact_tracker.motion.window import (
    DIRECTIONS,
    Window,
    moves_in,
    turns_about_one_axis,
    used_directions,
)
from contact_tracker.states import CONTACTS, STATES, Contact

SAME_SPAN: Final = 0.25
"""Share of the contact's age by which onsets of the same span may differ, since few old ones are kept."""
SAME_SPAN_TICKS: Final = 3
CURVED: Final = 0.12
"""Prior probability that free motion is on a curved surface."""
MOST_NATS: Final = 50.0
"""Largest evidence (nats) in an exponential, against overflow."""
FIRST_CHOICE: Final = 2.0
"""Prior weight of the label among states that motion does not distinguish."""
OPEN_AT_MOST: Final = 0.9
"""Largest probability of a label that leaves constraints unexplained, or beside which another state is not
excluded."""
NOT_EXCLUDED: Final = 1.0 / OPEN_AT_MOST - 1.0
"""Least probability, relative to the label, of a state that the motion does not distinguish from it."""
SHORT_OF_TIE: Final = 1.0 - 1e-9
"""Share of the change up to a tie of two states that is made, so that their order does not change."""
LEAST_SHARE: Final = 1e-300
"""Share of a state that wrenches rule out: above zero, so that it still counts as indistinguishable."""
CONTAINS: Final = np.array([[state.contains(part) for part in STATES] for state in STATES])
"""(7, 7) whether the state of the row contains that of the column."""
FLUSH_S: Final = 1.0
"""Time in which a face that is not flush with the other element's face turns..."""
FLUSH_RAD: Final = float(np.radians(0.3))
"""... by more than this standard deviation, beyond that of the noise: faces in contact rock by as much. Both
constants change probabilities, but no label (docs/sensitivity.md)."""
BASE_AXIS: Final = Line(np.array([0.0, 0.0, 1.0]), np.zeros(3), np.zeros((6, 6)))
"""Axis about which the base of an arm turns, in the frame of its poses."""
LEAST_MOTION_TICKS: Final = 10.0
"""With less motion in the window, a contact that is older than the window is compared by evidence alone, and
free motion is not tested for one degree of freedom."""


_WORDS: Final = attrgetter("words")


class CompetingEvidence(NamedTuple):
    """How well each state explains one span.

    ``evidence`` (7,) in nats relative to any one of them, and ``rms`` (7,), the whitened residual.
    """

    evidence: Array
    rms: Array

    def fit_like(self, label: Contact) -> NDArray[np.bool_]:
        """Which states (7,) fit the motion as well as the label."""
        return np.asarray(self.rms < SAME_FIT_RATIO * max(1.0, self.rms[label.column]))


class Freedom(NamedTuple):
    """Whether the motion does not use all freedom that its label leaves, whether it has only one degree of
    freedom at a time, and for how many ticks the object has moved; ``is_unknown`` of a contact whose motion
    is older than the window. ``is_programmed``: a machine may be programmed to move so without a contact: it
    keeps one constraint in the air, and carries parts without tilting them."""

    underused: bool
    one_direction: bool
    moved_ticks: float = 0.0
    is_unknown: bool = False
    is_programmed: bool = False


def indistinguishable(label: Contact, rivals: CompetingEvidence, freedom: Freedom) -> tuple[Contact, ...]:
    """The other states that the motion does not distinguish from ``label`` (T23).

    These are the states whose evidence is at most ``DECISIVE`` below the label's. If the label's freedom is
    underused, the lack of motion in one more direction is no evidence: then also all states that fit the
    motion, and all states that these contain. Motion of one degree of freedom may be that of a hinge, a
    slider or a screw: then all states. Where a machine may be programmed to move so: also free motion.
    """
    close = rivals.evidence > rivals.evidence[label.column] - DECISIVE
    if freedom.one_direction:
        close[:] = True
    elif freedom.underused:
        close = CONTAINS[close | rivals.fit_like(label)].any(axis=0)
    close[Contact.FREE.column] |= freedom.is_programmed
    close[label.column] = False
    return tuple(compress(STATES, close.tolist()))


def alike_in_formation(
    label: Contact, rivals: CompetingEvidence, others: Container[Contact]
) -> tuple[Contact, ...]:
    """The other contacts that are indistinguishable from a label beside which further contacts are found.

    These fit as well, and have at least as many constraints, or a further contact may be one of them
    (``others``). The label may have more evidence only because its elements are less complex: a vertex that
    slides along two planes also keeps an edge on the line in which these meet, and an edge that is dragged in
    a vertical plane keeps a face in it.
    """
    fits = rivals.fit_like(label)
    return tuple(
        kind
        for kind in CONTACTS
        if fits[kind.column]
        and (kind.codimension >= label.codimension or kind in others)
        and kind is not label
    )


def motion_since(window: Window, onset: int) -> tuple[int, float]:
    """How many directions the motion since tick ``onset`` uses, and for how many ticks the object moved."""
    if not compiled.in_use():
        since = window.since(onset)
        return used_directions(since), float(since.motion_ratio.sum())
    from contact_tracker.hypotheses.compiled import calls

    return calls.motion_since(calls.ticks_of(window), onset)


LEAST_NOISE_M: Final = 3e-5
"""Noise of a tick of poses without any, by the least floor of the models."""


def are_exact(window: Window) -> bool:
    """Whether the poses of the ticks are exact, as those of a machine, which moves points on lines and in
    planes, and turns objects about one axis. Those of low-passed motion capture are not: the evidence shows
    more noise of their ticks."""
    assert window.frames is not None
    used = window.frames > 0.0
    variance = (window.variance[used, 0] - LEAST_NOISE_M**2) * window.frames[used]
    return bool(used.any() and np.median(variance) <= NOISY_M**2)


def has_least_noise(window: Window) -> bool:
    """Whether the noise of ticks is the least of the models rather than that of the poses."""
    assert window.frames is not None
    variance = window.variance[window.frames > 0.0, 0]
    return bool(variance.size and np.median(variance) < 2.0 * LEAST_NOISE_M**2)


def freedom_of(label: Contact, window: Window, onset: int) -> Freedom:
    """How far the motion since the onset uses the freedom that ``label`` leaves. Free motion also begins in
    one direction."""
    used, moved_ticks = motion_since(window, onset)
    is_short = moved_ticks < LEAST_MOTION_TICKS
    is_programmed = (label is Contact.FF or label.codimension == 1) and are_exact(window)
    if is_short and onset < window.index[0]:
        return Freedom(False, False, moved_ticks, is_unknown=True, is_programmed=is_programmed)
    in_one_direction = used == 1 and not (label is Contact.FREE and is_short)
    is_underused = used < DIRECTIONS - label.codimension
    return Freedom(is_underused, in_one_direction, moved_ticks, is_programmed=is_programmed)


def freedom_by_moves(freedom: Freedom, window: Window, tick_s: float) -> Freedom:
    """The freedom of f-f, in one direction also if each of its moves, two or more between rests, turns the
    object about one axis, as in tilting it on one edge and then on another one: these may be different
    hinges, which no single contact has to explain. Other contacts leave as much freedom as four hinges."""
    if freedom.underused or freedom.is_unknown:
        return freedom
    moves = moves_in(window, tick_s)
    is_hinged = len(moves) > 1 and all(map(turns_about_one_axis, moves))
    return freedom._replace(one_direction=freedom.one_direction or is_hinged)


def agrees_by_chance(label: Contact, window: Window, onset: int, most_ticks: float = inf) -> bool:
    """Whether a contact between new elements may agree with free motion by chance (T24): these can be chosen
    such that they agree with any smooth motion in fewer directions than the contact leaves. Not if the object
    has moved for ``most_ticks`` or more."""
    freedom = freedom_of(label, window, onset)
    return freedom.underused and freedom.moved_ticks < most_ticks


def may_be_free(label: Contact, geometry: ContactGeometry, window: Window) -> bool:
    """Whether free motion may keep the constraints of ``label``: its only one if the motion leaves directions
    open, and those of an edge on the axis of an arm's base, in whose planes the arm may move its tool. The
    axis is the z axis of the world, or, of the exact poses of a machine, parallel to it."""
    edge = geometry.environment
    if isinstance(edge, Line) and edge.covariance is not None and not (edge.name or edge.unobserved):
        base = replace(BASE_AXIS, point_m=edge.point_m) if are_exact(window) else BASE_AXIS
        if is_same_element(edge, base):
            return True
    return label.codimension == 1 and geometry.has_open_directions


def tempered(probability: Array, exponent: float) -> Array:
    """Normalised power of a posterior (..., 7); the order of the states is unchanged (T31)."""
    power = probability**exponent
    return np.asarray(power / power.sum(axis=-1, keepdims=True))


def at_most(
    probability: Array,
    label: Contact,
    possible: tuple[Contact, ...] = CONTACTS,
) -> Array:
    """Posterior (7,) in which the label has at most ``OPEN_AT_MOST``; the rest is distributed equally among
    the other ``possible`` contacts, if there are any.

    For motion that keeps more constraints than the reported contacts (docs/theory.md, section 18).
    """
    excess = float(probability[label.column]) - OPEN_AT_MOST
    columns = [contact.column for contact in possible if contact is not label]
    if excess <= 0.0 or not columns:
        return probability
    adjusted = probability.copy()
    adjusted[columns] += excess / len(columns)
    adjusted[label.column] = OPEN_AT_MOST
    return adjusted


def p_curved(log_evidence: float) -> float:
    """Probability that free motion is on a curved surface, given its evidence (nats)."""
    odds = CURVED / (1.0 - CURVED) * np.exp(min(log_evidence, MOST_NATS))
    return float(odds / (1.0 + odds))


def likelier_states(probability: Array, label: Contact) -> list[Contact]:
    """The states that are more probable than the label, by a mean posterior (7,): of filters or of ticks, not
    all of which have this label. They are open beside it."""
    return [state for state in STATES if probability[state.column] > probability[label.column]]


def shared_with(probability: Array, label: Contact, rivals: Sequence[Contact]) -> Array:
    """Posterior (7,) in which the label and the ``rivals`` divide their total probability: equal shares, but
    ``FIRST_CHOICE`` of them for the label."""
    if not rivals:
        return probability
    shared, alike = probability.copy(), [state.column for state in (label, *rivals)]
    shared[alike] = probability[alike].sum() / (FIRST_CHOICE + len(rivals))
    shared[label.column] *= FIRST_CHOICE
    return shared


def with_rivals(probability: Array, label: Contact, rivals: tuple[Contact, ...]) -> Array:
    """Posterior (7,) in which the label is not certain beside the indistinguishable ``rivals``: it has at
    most its share of their total probability if each rival has ``NOT_EXCLUDED`` times the label's (T30).

    In the posterior of the hypotheses the label is also ahead by its history and its prior, which the motion
    has not shown. The excess of the label goes to the rivals below their share. Only the reported posterior
    is changed, not the one that the map and the further contacts use.
    """
    if not rivals:
        return probability
    values, alike = probability.tolist(), sorted(state.column for state in (label, *rivals))
    label_p, total = values[label.column], sum(values[column] for column in alike)
    largest = total / (1.0 + NOT_EXCLUDED * len(rivals))
    # it stays ahead of the states that are behind it
    behind = max((p for column, p in enumerate(values) if column not in alike and p <= label_p), default=0.0)
    excess = SHORT_OF_TIE * (label_p - max(largest, behind))
    missing = [max(NOT_EXCLUDED * largest - values[rival.column], 0.0) for rival in rivals]
    if excess <= 0.0 or not any(missing):
        return probability
    adjusted = probability.copy()
    for rival, shortfall in zip(rivals, missing, strict=True):
        adjusted[rival.column] += excess * shortfall / sum(missing)
    adjusted[label.column] = label_p - excess
    return adjusted


def decide_by_wrenches(
    label: Contact, rivals: tuple[Contact, ...], evidence: Array
) -> tuple[Contact, tuple[Contact, ...], Array | None]:
    """Decide by measured wrenches between a ``label`` and the ``rivals`` that motion does not distinguish
    from it (T41).

    Parameters
    ----------
    evidence : (7,) log evidence of each state by the wrenches.

    Returns
    -------
    The most probable of them; those within ``DECISIVE`` of it; and the share (7,) of each in the probability
    of all, None without rivals. The prior of the label is ``FIRST_CHOICE`` times a rival's.
    """
    if not rivals:
        return label, rivals, None
    alike = np.array([state.column for state in (label, *rivals)])
    weight = evidence[alike] + np.where(alike == label.column, np.log(FIRST_CHOICE), 0.0)
    weight -= weight.max()
    share = np.zeros(len(STATES))
    share[alike] = np.maximum(np.exp(weight) / np.exp(weight).sum(), LEAST_SHARE)
    best = STATES[int(alike[weight.argmax()])]
    open_columns = {int(column) for column in alike[weight > -DECISIVE]}
    undecided = tuple(state for state in STATES if state.column in open_columns and state is not best)
    return best, undecided, share


def reported(
    probability: Array,
    label: Contact,
    rivals: tuple[Contact, ...],
    known_map: Map,
    is_open: bool = False,
    share: Array | None = None,
) -> Array:
    """The posterior (7,) to report, from that of the hypotheses: shared with the indistinguishable ``rivals``
    (by wrenches, where they have decided a ``share``), and limited where constraints are left unnamed."""
    if share is not None:
        alike = share > 0.0  # states that wrenches decide between divide their total probability
        probability = np.where(alike, probability[alike].sum() * share, probability)
    probability = with_rivals(probability, label, rivals)
    return at_most(probability, label, possible=known_map.possible) if is_open else probability


def most_beside(rivals: int) -> float:
    """Largest probability of a kind of contact, given the number of ``rivals`` that are not excluded."""
    return 1.0 / (1.0 + NOT_EXCLUDED * rivals)


@lru_cache(maxsize=64)
def others_at_rest(
    label: Contact, known_map: Map, by_motion: tuple[Contact, ...] = ()
) -> tuple[Contact, ...]:
    """The states that a rest does not distinguish from the label: all possible ones, except those that the
    label contains and that the motion beside the rest distinguishes (not in ``by_motion``), since the object
    rests on the elements that this motion has shown.

    Empty if a single pose shows whether known elements touch.
    """
    if known_map.shows_touch:
        return ()
    possible = (state for state in STATES if state is not label and known_map.allows(state))
    return tuple(state for state in possible if state in by_motion or not label.contains(state))


def may_be_flush(
    label: Contact, geometry: ContactGeometry, window: Window, tick_s: float
) -> NDArray[np.bool_]:
    """In which ticks (W,) of a segment f-f is as possible as the ``label``: the face does not turn relative
    to the other element for ``FLUSH_S``, or as long as the segment lasts.

    A segment as a whole may show a turn that parts of it do not show.
    """
    flush = np.zeros(len(window), bool)
    environment, body = geometry.environment, geometry.object
    assert window.frames is not None
    rows = np.flatnonzero(window.frames)
    R_world_body = window.zeta[rows][:, R].reshape(-1, 3, 3)
    if label is not Contact.FF and isinstance(environment, Plane):
        normal = environment.normal @ R_world_body  # in the body frame
    elif label is not Contact.FF and isinstance(body, Plane):
        normal = R_world_body @ body.normal  # in the world frame
    else:
        return flush
    count = min(round(FLUSH_S / tick_s) + 1, len(rows))
    if count < NOW_TICKS:
        return flush
    spans = np.arange(len(rows) - count + 1)[:, None] + np.arange(count)
    keeps = _keeps(normal[spans], window.variance[rows][spans, 1])
    for first in np.flatnonzero(keeps):
        flush[rows[first] : rows[first + count - 1] + 1] = True
    return flush


def is_flush_now(normal: Array, in_world: bool, window: Window, onset: int, tick_s: float) -> bool:
    """Whether f-f is as possible in the newest tick as a contact since tick ``onset`` that has a face with
    this ``normal`` (3,), of the world or of the body: it has not turned for ``FLUSH_S``."""
    ticks = round(FLUSH_S / tick_s) + 1
    if window.index.size < ticks or window.index[-ticks] < onset:
        return False
    R_world_body = window.zeta[-ticks:, R].reshape(-1, 3, 3)
    normals = normal @ R_world_body if in_world else R_world_body @ normal
    return bool(_keeps(normals[None], window.variance[None, -ticks:, 1])[0])


def _keeps(normals: Array, variance: Array) -> NDArray[np.bool_]:
    """Whether normals (S, n, 3) keep their direction in each span, with noise ``variance`` (S, n), rad^2."""
    turn = normals - normals.mean(axis=1, keepdims=True)
    largest_rad2 = np.linalg.eigvalsh(turn.swapaxes(1, 2) @ turn / normals.shape[1])[:, -1]
    return np.asarray(largest_rad2 < FLUSH_RAD**2 + variance.mean(axis=1))


def competing_evidence(banks: Sequence[Bank], label: Contact, onset: int, tick: int) -> CompetingEvidence:
    """How well each state explains the ticks since about ``onset``, against the label.

    The evidence of a contact is that of its most probable hypothesis with about that onset, minus the label's
    evidence from the same onset; -inf without a hypothesis.
    """
    if not compiled.in_use():
        return competing_evidence_reference(banks, label, onset, tick)
    from contact_tracker.hypotheses.compiled import calls

    words, slack = [*map(_WORDS, banks)], same_span(tick - onset)
    return CompetingEvidence(*calls.competing_evidence(calls.models(1.0), words, label.column, onset, slack))


def competing_evidence_reference(
    banks: Sequence[Bank], label: Contact, onset: int, tick: int
) -> CompetingEvidence:
    """``competing_evidence`` in numpy: the reference of the compiled kernel."""
    evidence, rms = np.full(len(STATES), -np.inf), np.full(len(STATES), np.inf)
    since = np.full(len(STATES), onset)
    for column, row in enumerate(best_since(banks, onset, tick)):
        if row is not None:
            best = banks[column].rows[row]
            evidence[column], rms[column], since[column] = best["log_likelihood"], best["rms"], best["onset"]
    evidence[-1], rms[-1] = 0.0, 1.0
    if label is not Contact.FREE:
        evidence -= _evidence(banks[label.column], since)
    evidence[label.column] = 0.0
    return CompetingEvidence(evidence, rms)


def best_since(banks: Sequence[Bank], onset: int, tick: int) -> list[int | None]:
    """The rows of the most probable hypotheses of the contacts that have begun at about ``onset``; None
    without one."""
    slack, best_rows = same_span(tick - onset), list[int | None]()
    for bank in banks:
        rows = bank.rows
        begin, end = rows["onset"].searchsorted([onset - slack, onset + slack + 1])  # they are in order
        near = rows[begin:end]
        best = (near["log_birth_weight"] + near["log_likelihood"]).argmax() if begin < end else None
        best_rows.append(None if best is None else int(begin + best))
    return best_rows


def same_span(age_ticks: int) -> int:
    """By how many ticks onsets of this age may differ to count as the same."""
    return int(max(SAME_SPAN_TICKS, SAME_SPAN * age_ticks))


def _evidence(bank: Bank, since: Ints) -> Array:
    """A contact's evidence against free motion ``since`` some ticks, interpolated between its hypotheses: the
    best of each onset, without those far behind."""
    weight = bank.log_weight
    near = (weight >= weight.max() - NEAR_NATS).nonzero()[0]
    near = near[best_of(bank.rows["onset"][near], weight[near])]
    return np.asarray(np.interp(since, bank.rows["onset"][near], bank.rows["log_likelihood"][near]))


SPAN_TICKS: Final = 60
"""Number of ticks that are tested together."""
LEAST_TICKS: Final = 40
"""Least number of ticks; in fewer, smooth motion of a hand may fit by chance: a curved surface, or a contact
of one constraint. Offline, with 300 for the latter, one of four recordings of singular motion is right for
0.44 of the time instead of 0.65 (`contact-tracker evaluate`); those of handling stay the same."""
LEAST_ACTIVITY: Final = 10.0
"""Least motion in them for a test."""
RETEST_GROWTH: Final = 1.5
"""Free motion is tested again when its duration has grown by this factor."""


class CurvedMotion(NamedTuple):
    """The last test of the free motion that began in tick ``since``, at its ``age`` in ticks, with the
    ``probability`` of a curved surface."""

    since: int
    age: int
    probability: float


NO_CURVED_MOTION: Final = CurvedMotion(-1, 0, 0.0)


def update_curved_motion(
    before: CurvedMotion,
    window: Window,
    since: int,
    scales: EvidenceParameters,
    known_map: Map,
    touched: Sequence[FaceNormals] = (),
) -> CurvedMotion:
    """The estimate after another tick of free motion since tick ``since``; ``window`` are the last ticks."""
    current = before if before.since == since else CurvedMotion(since, 0, 0.0)
    age = int(window.index[-1]) + 1 - since
    if age < max(LEAST_TICKS, RETEST_GROWTH * current.age):
        return current
    first = max(int(window.index.searchsorted(since)), len(window) - SPAN_TICKS)
    span = window.cut(first, None)
    if not _is_testable(span, known_map):
        return CurvedMotion(since, age, 0.0)
    return CurvedMotion(since, age, p_curved(curved_evidence(span, scales, touched)))


def curved_probabilities(
    window: Window, scales: EvidenceParameters, known_map: Map, touched: Sequence[FaceNormals] = ()
) -> Array:
    """Probability (n,) of curved contact in each tick of a segment of free motion, by parts of it."""
    probability = np.zeros(len(window))
    for rows in np.array_split(np.arange(len(window)), max(len(window) // SPAN_TICKS, 1)):
        part = window.cut(int(rows[0]), int(rows[-1]) + 1)
        if _is_testable(part, known_map):
            probability[rows] = p_curved(curved_evidence(part, scales, touched))
    return probability


def is_mostly_curved(probability: Array) -> bool:
    """Whether most of a segment, by the probability in each tick (n,), is on a curved surface."""
    return bool(np.mean(probability > 0.5) > 0.5)


def _is_testable(window: Window, known_map: Map) -> bool:
    """Whether curved contact is tested: motion suffices, and the object is not completely known."""
    enough = len(window) >= LEAST_TICKS and float(window.motion_ratio.sum()) >= LEAST_ACTIVITY
    return enough and not known_map.object_complete
