"""Births of hypotheses: which elements a new contact may assume, and their rows before any data.

Elements are those that are known, those of the map, or new ones.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.contacts import ContactModel
from contact_tracker.contacts.family import directions
from contact_tracker.geometry.elements import (
    ContactGeometry,
    Element,
    Pair,
    Plane,
    canonical,
)
from contact_tracker.hypotheses.bank import Bank, blank
from contact_tracker.hypotheses.schedule import burn_in_ticks
from contact_tracker.map.association import MapView
from contact_tracker.map.elements import Key, kinds_of
from contact_tracker.map.map import Map, NamedElement, Up
from contact_tracker.map.pairs import (
    Frame,
    NamedPair,
    PairPrior,
    known_entries,
    learned_pairs,
    named_pairs,
    pair_priors,
)
from contact_tracker.map.world_map import GrowingMap
from contact_tracker.motion.lifted_pose import R
from contact_tracker.motion.window import Window

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class BirthProposals:
    """n hypotheses of one contact that may begin, still without an onset."""

    rows: Bank
    """(n) hypotheses without data."""
    is_given: Bools
    """(n, S) which entries of x their prior fixes, see ``known_entries``."""
    are_both_known: Bools
    """(n,) whether their prior has both elements, so that a pose shows whether these touch."""

    @property
    def count(self) -> int:
        return len(self.rows)

    @property
    def log_share(self) -> Array:
        """Log share (n,) of the contact's birth weight."""
        return self.rows.log_likelihood

    def sharing(self, log_share: Array) -> "BirthProposals":
        """A copy with other log shares (n,)."""
        return replace(self, rows=self.rows.replace_columns(log_prior=log_share, log_likelihood=log_share))

    def pick(self, rows: NDArray[np.generic]) -> "BirthProposals":
        return BirthProposals(
            self.rows.pick(np.arange(self.count)[rows]), self.is_given[rows], self.are_both_known[rows]
        )


def make_proposals(
    model: ContactModel,
    pairs: Sequence[Pair],
    log_share: Sequence[float],
    known_pair_index: Sequence[int],
    are_both_known: Sequence[bool],
    elements_known: Sequence[bool] | None = None,
    cross: Array | None = None,
) -> BirthProposals:
    """One proposal for each of the ``pairs`` of elements, whose covariances are ``cross`` (``pair_priors``).

    Proposals whose directions the prior leaves open may search, and are protected from pruning during
    burn-in. The other parameters are columns of ``Bank``; by default elements are known as far as both are.
    """
    both = np.array(are_both_known, bool)
    known = both if elements_known is None else np.array(elements_known, bool)
    prior = pair_priors(model, pairs, cross)
    return with_prior(model, prior, np.array(log_share), np.array(known_pair_index), both, known)


def with_prior(
    model: ContactModel,
    prior: PairPrior,
    log_share: Array,
    known_pair_index: NDArray[np.int64],
    are_both_known: Bools,
    elements_known: Bools,
) -> BirthProposals:
    """One proposal for each of n priors on x.

    Elements that are known by others than this motion (``elements_known``) cannot follow it.
    """
    none, given = blank(model, 0), known_entries(model, prior.mean, prior.information)
    needs_search = np.asarray(
        ~given[:, directions(model.family.FORM)].all(axis=1)
    )  # the rest is a linear problem
    is_informed = prior.information.any(axis=(1, 2))
    rows = blank(model, len(given)).replace_columns(
        prior_index=np.where(is_informed, 1 + np.arange(len(given)), 0),
        known_pair_index=known_pair_index,
        elements_known=np.array(elements_known, np.int64),
        needs_search=needs_search,
        protected_until=np.where(needs_search, burn_in_ticks(model.needed), 0.0),
        prior_mean=prior.mean,
        prior_information=prior.information,
        line_anchor=prior.line_points_m,
        log_prior=log_share,
        log_likelihood=log_share,
        onset=0,
    )
    return BirthProposals(replace(rows, onsets=none.onsets), given, are_both_known)


@lru_cache(maxsize=16)
def uninformed_proposal(model: ContactModel) -> BirthProposals:
    """A proposal of elements that nothing is known of."""
    return make_proposals(model, [(None, None)], [0.0], [0], [False])


class Birth(NamedTuple):
    """Hypotheses of one contact that begin in a tick.

    Entries of x without prior start from the best hypothesis so far (a face opposite to a known one is
    parallel to it); in an empty bank they start from fixed directions in the body's frame.
    """

    proposals: BirthProposals
    """With the prior of each."""
    onset: int
    """Index of the tick."""
    onset_ns: int
    """Time at which the tick began."""
    number: int
    """Number of the first hypothesis; the others follow."""
    log_birth_weight: float
    """Log weight of the contact's birth."""
    lag_history: Array
    """(L, 7) probabilities of the states before."""
    turn: Array
    """(3, 3) orientation of the body."""


def add(bank: Bank, model: ContactModel, birth: Birth) -> Bank:
    """The bank with the birth's hypotheses added."""
    begins, old = birth.proposals, len(bank)
    if not begins.count:
        return bank
    given = begins.is_given
    words = np.concatenate([bank.words, begins.rows.words])
    onsets = replace(bank.onsets, words=np.pad(bank.onsets.words, ((0, 1), (0, 0))))
    onsets.rows["onset"][-1], onsets.rows["onset_ns"][-1] = birth.onset, birth.onset_ns
    past = joined(bank.lag_history, birth.lag_history, begins.count, np.arange(len(words)))
    both = Bank(words, bank.layout, onsets, past)
    new = Bank(words[old:], bank.layout, onsets, past[old:])
    if old:
        best = bank.best_row
        x, new.rows["row_weight"][:] = bank.x[best], bank.row_weight[best]
    else:
        x = model.turned(new.rows["x"], birth.turn)
    new.rows["x"][:] = model.faced(np.where(given, begins.rows.prior_mean, x), given, birth.turn)
    new.rows["onset"][:] = birth.onset
    new.rows["number"][:] = birth.number + np.arange(begins.count)
    new.rows["log_birth_weight"][:] = birth.log_birth_weight
    return both


def joined(past: Array, of_new: Array, many: int, rows: Index) -> Array:
    """Lag histories (R, L, 7) of ``rows`` of: the old hypotheses, ``past`` (H, L, 7), then ``many`` new ones
    with the common history ``of_new`` (L, 7)."""
    if not past.shape[1]:
        return np.empty((len(rows), *past.shape[1:]))
    return np.concatenate([past, of_new[None].repeat(many, axis=0)])[rows]


class CachedProposals(NamedTuple):
    """``proposals`` of each contact with what they were computed from: the map without the sightings
    ``left_out``, the pair that touches already, the one of the last contact, and the frame."""

    map: GrowingMap
    left_out: tuple[int, ...]
    current: tuple[Key, Key] | None
    latest: tuple[Key, Key] | None
    frame: Frame | None
    proposals: tuple[BirthProposals, ...]

    def inputs(self, model: ContactModel) -> tuple[object, ...]:
        """Those on which the proposals of one contact depend: the pair that touches, if it is of its kinds,
        and the place of the body, if edges or vertices of the surroundings may be given by it."""
        kinds = None if self.current is None else tuple(self.map.elements[key].kind for key in self.current)
        current = self.current if kinds == kinds_of(model) else None
        frame = None if self.frame is None else self.frame[: 2 if kinds_of(model)[1] == "f" else 3]
        return self.map, self.left_out, current, self.latest, frame


class TickInput(NamedTuple):
    """The prediction for a tick before its evidence, with the hypotheses that begin in it, numbered one
    contact after the other."""

    proposals: tuple[BirthProposals, ...]
    """Per contact."""
    cached_proposals: CachedProposals
    """The same before they are weighed, for reuse at the next tick."""
    onset: int
    """Index of the tick."""
    onset_ns: int
    """Time at which it began."""
    number: int
    """Number of the first hypothesis of the first contact."""
    lag_history: Array
    """(7, L, 7) per state: probabilities of the states before."""
    window: Window
    """The latest ticks, this one included."""
    before: Window
    """The window before this tick."""
    hazard_exposure: float
    """Exposure to change, in ticks of motion."""
    log_transition: Array
    """(7, 7) log probabilities of a change before the tick, from row to column."""
    log_survival: Array
    """(7,) log probabilities of staying in each state through it."""
    log_birth_weight: Array
    """(7,) log birth weights."""

    @property
    def turn(self) -> Array:
        """(3, 3) orientation of the body."""
        return np.asarray(self.window.zeta[-1, R].reshape(3, 3))

    def birth(self, column: int) -> Birth:
        """The births of one contact."""
        number = self.number + sum(begins.count for begins in self.proposals[:column])
        own = float(self.log_birth_weight[column]), self.lag_history[column]
        return Birth(self.proposals[column], self.onset, self.onset_ns, number, *own, self.turn)


def propose_births(
    model: ContactModel, known_map: Map, view: MapView | None, incident_share: float, frame: Frame
) -> BirthProposals:
    """Proposals of a contact for the next tick. Their shares add up to one, unless there are none.

    Where the ``known_map`` leaves both elements open, they may be of the map. The elements of the map were
    estimated from the motion at other times, so all that is known of them is in the prior, and free motion is
    as predictable as for a new contact. ``incident_share`` is the prior probability that they are those of
    the last contact, or incident with these, where the contact needs elements of other kinds.
    """
    known = named_pairs(known_map, model)
    if not known:
        return uninformed_proposal(model).pick(np.zeros(0, np.int64))
    pairs, near_m = [one.pair(frame) for one in known], np.array(frame.near_m)
    log_share, number = [one.log_share for one in known], list(range(len(known)))
    is_certain = [one.is_certain for one in known]
    first = next((i for i, one in enumerate(known) if one.object is None and one.environment is None), None)
    if view is None or first is None:
        return make_proposals(model, pairs, log_share, number, is_certain)
    whole, beside = log_share[first], view.incident_pair(model, near_m)
    if beside is not None and incident_share:
        pairs.append(beside)
        is_certain.append(False)
        log_share.append(whole + np.log(incident_share))
        whole += np.log1p(-incident_share)
    log_p_new, learned = learned_pairs(view, model, near_m)
    log_share[first] = whole + log_p_new
    independent = np.zeros((len(pairs), *learned.cross.shape[1:]))
    pairs += learned.pairs
    return make_proposals(
        model,
        pairs,
        log_share + (whole + learned.log_share).tolist(),
        number + [first] * (len(pairs) - len(known)),
        is_certain + learned.are_both_known.tolist(),
        is_certain + [False] * len(learned.pairs),
        np.concatenate([independent, learned.cross]),
    )


def propose_measured(model: ContactModel, known_map: Map, measured: Pair, frame: Frame) -> BirthProposals:
    """Proposals of a contact with elements that were ``measured`` otherwise than by motion (object in the
    body frame, surroundings in the world frame), where the map does not give them.

    Of a measured normal of the surroundings and the direction up, the more certain one counts.
    """
    ours, theirs = (None if one is None else NamedElement("measured", one) for one in measured)
    if known_map.up is not None and theirs is not None and not _is_surer_than_up(theirs, known_map.up):
        theirs = None
    known = named_pairs(known_map, model)
    return make_proposals(
        model,
        [_with(one, ours, theirs).pair(frame) for one in known],
        [one.log_share for one in known],
        range(len(known)),
        [one.is_certain for one in known],
    )


def _is_surer_than_up(measured: NamedElement, up: Up) -> bool:
    """Whether a measured face has a smaller deviation than faces that point up; other elements have none."""
    element = measured.element
    if not isinstance(element, Plane) or element.covariance is None:
        return True
    return bool(np.trace(element.covariance[:3, :3]) < 2.0 * up.spread_rad**2)


def _with(known: NamedPair, object: NamedElement | None, environment: NamedElement | None) -> NamedPair:
    """``known`` with these elements where it leaves them open."""
    theirs = known.environment or environment
    return NamedPair(known.object or object, theirs, known.log_share, None if theirs else known.up)


def named(geometry: ContactGeometry, known: NamedPair) -> ContactGeometry:
    """The geometry of a hypothesis that assumes ``known``, with the names in the map."""
    faces = isinstance(geometry.object, Plane) and isinstance(geometry.environment, Plane)
    return ContactGeometry(
        _named(geometry.object, known.object, faces), _named(geometry.environment, known.environment, faces)
    )


def _named(element: Element, known: NamedElement | None, faces: bool) -> Element:
    """The element with its name. If both are ``faces``, motion does not show the offset: take the known
    one."""
    if known is None:
        return canonical(element)
    if faces and isinstance(element, Plane) and isinstance(known.element, Plane):
        assert element.covariance is not None
        assert known.element.covariance is not None
        covariance = np.zeros((4, 4))
        covariance[:3, :3] = element.covariance[:3, :3]
        covariance[3, 3] = known.element.covariance[3, 3]
        side = 1.0 if element.normal @ known.element.normal > 0 else -1.0
        normal, offset_m = side * element.normal, known.element.offset_m
        return Plane(normal, offset_m, covariance, element.unobserved, known.name)
    return replace(element, name=known.name)
