"""The map of one world: elements, which contact touched which, and their joint Gaussian.

The poses are known, so mapping is a linear problem once it is decided which contact touched which elements.
A new element has a price, see ``prices``.
"""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Final

import numpy as np

from contact_tracker.geometry.elements import Array, Element, Origins
from contact_tracker.map.association import (
    MapView,
    Sighting,
    log_marginal,
    log_probabilities_of_new,
    weigh_pairs,
)
from contact_tracker.map.elements import (
    NOTHING_LEARNED,
    PARALLEL,
    TURNS,
    Key,
    LearnedElements,
    MapElement,
    slots_of,
)

MOST_SIGHTINGS: Final = 60
"""Most contacts in a map, those with the most information: if nothing is shared, 60 take some seconds."""
MOST_LEARNED: Final = 40
"""Most elements that are kept for another recording."""
MOST_ROUNDS: Final = 4
"""Most sweeps of the association, and steps of the solver; both end sooner if nothing changes."""
CONVERGED: Final = 1e-7
"""Largest change of a coordinate (rad, m) in the last step of the solver."""
DROPPED_NATS: Final = 7.5
"""Evidence against the prior's elements of a side by which they are dropped: a contact that they do not
explain costs the price of a new element, 5 nats with ten contacts known and 2.5 with two, and one that they
explain gains tens. The least sum on 16 recordings of everyday handling is -4.5 with a map of their scene, and
with another one -2.4 to -6.9 for the object and 1 to -18 for the surroundings."""
FEW_CONTACTS: Final = 3
"""Contacts of which one touches what is known of each side, on all but one of these 16 recordings."""
MARGIN_S: Final = 1.0
"""Time before a contact in which the next pass may begin the same contact."""


Touch = tuple[int, int, tuple[Key, Key]]
"""Start and end stamps of a contact, and the keys of the object's and of the environment's element."""


@dataclass(frozen=True, eq=False)
class GrowingMap:
    """Learned from the ``sightings`` of one recording; ``pairs`` are the keys that each of them touched, by
    its first tick.

    Parameters
    ----------
    reach_m : standard deviation of the places of elements that nothing is known of.
    contacts : how many contacts there were in the whole recording; None while the map grows.
    prior : what was known before.
    origins : of its coordinates; None before they are known, with the prior in those of the world and body.
    prior_log_odds : by first tick of each sighting, how much more probable it is with the prior than without
        its elements of the object, and without those of the environment.
    prior_is_dropped : whether these are not used any more, as they explain nothing.
    recognised : contacts that it has decided, and which of its elements they touched.
    """

    reach_m: float
    sightings: tuple[Sighting, ...] = ()
    pairs: Mapping[int, tuple[Key, Key]] = field(default_factory=dict)
    elements: Mapping[Key, MapElement] = field(default_factory=dict)
    contacts: int | None = None
    prior: LearnedElements = NOTHING_LEARNED
    origins: Origins | None = None
    prior_log_odds: Mapping[int, tuple[float, float]] = field(default_factory=dict)
    prior_is_dropped: tuple[bool, bool] = (False, False)
    recognised: tuple[Touch, ...] = ()

    @classmethod
    def learn(
        cls,
        sightings: Sequence[Sighting],
        reach_m: float,
        contacts: int = 0,
        prior: LearnedElements = NOTHING_LEARNED,
        share: float = 0.0,
    ) -> "GrowingMap":
        """The map of all sightings of a recording: associate greedily, then reconsider each. With probability
        ``share``, a contact keeps an element of the one from which, or to which, it changes."""
        by_information = sorted(sightings, key=lambda s: -s.gain(reach_m))[:MOST_SIGHTINGS]
        mapper = _Mapper(cls(reach_m, contacts=contacts).with_prior(prior), share)

        def fits_parallel_faces(sighting: Sighting) -> tuple[bool, bool]:
            return sighting.has_one_height, not any(map(sighting.is_beside, by_information))

        for sighting in sorted(by_information, key=fits_parallel_faces):  # f-f last, at first beside others
            mapper.insert(sighting)
        for _ in range(MOST_ROUNDS):
            partition = mapper.partition()
            for sighting in sorted(by_information, key=lambda s: s.first):
                mapper.forget(sighting.first)
                mapper.insert(sighting)
            if mapper.partition() == partition:
                break
        mapper.solve(MOST_ROUNDS)
        return mapper.map

    def with_prior(self, prior: LearnedElements) -> "GrowingMap":
        """An empty map with what is known before."""
        return replace(self, prior=prior, elements=dict(prior.elements))

    def at_origins(self, origins: Origins) -> "GrowingMap":
        """The map in coordinates with these origins, if it has none yet."""
        if self.origins is not None:
            return self
        return replace(self, origins=origins).with_prior(self.prior.shifted(origins.reversed))

    @property
    def learned(self) -> LearnedElements:
        """What is known now of the elements that were touched most, without those that the user lists, in the
        coordinates of the world and the body, for another recording."""
        counts = self.whole.counts
        unlisted = counts.keys() - {*self.prior.listed}
        often = sorted(unlisted, key=lambda key: (-counts[key], key))[:MOST_LEARNED]
        learned = replace(self._learned(self.whole.slots, self.pairs), counts=counts)
        return self._in_users_frames(learned.of(often, self.reach_m))

    @property
    def known(self) -> dict[Key, Element]:
        """All elements with their covariances, in the coordinates of the world and the body."""
        return self._in_users_frames(self._learned(self.whole.slots, self.pairs)).known

    @property
    def prior_error_m(self) -> float:
        """How far contacts move an element from where the prior has it, beyond its standard deviation; the
        largest of all."""
        variance, slots, excess = self.prior.covariance().diagonal(), self.prior.slots, [0.0]
        for key, before in self.prior.elements.items():
            rows = slice(slots[key].start + TURNS[before.kind], slots[key].stop)
            moved_m = before.change_to(self.elements[key])[TURNS[before.kind] :]
            excess.append(float(moved_m @ moved_m - variance[rows].sum()))
        return float(np.sqrt(max(excess)))

    def _in_users_frames(self, learned: LearnedElements) -> LearnedElements:
        return learned if self.origins is None else learned.shifted(self.origins)

    def insert(self, sighting: Sighting) -> "GrowingMap":
        """The map with one more sighting, which replaces an earlier one with the same first tick.

        If the prior's elements of a side make the sightings far less probable, they are of another object or
        place, and are dropped. Once those of all its sides are as probable as that is improbable, they are
        not tested.
        """
        sides = sorted({side for side, _ in self.prior.elements})
        totals = np.sum([(0.0, 0.0), *self.prior_log_odds.values()], axis=0)[sides]
        if (totals > DROPPED_NATS).all():
            return self._insert(sighting)
        bare = {side: self._without_prior(side) for side in sides}

        def log_evidence(world: GrowingMap) -> float:
            return log_marginal(sighting, world.without((sighting.first,)), self.reach_m)

        odds, with_prior = [0.0, 0.0], log_evidence(self)
        for side in sides:
            odds[side] = with_prior - log_evidence(bare[side])
        kept = {first: odds for first, odds in self.prior_log_odds.items() if first in self.pairs}
        prior_log_odds = {**kept, sighting.first: (odds[0], odds[1])}
        totals = np.sum([*prior_log_odds.values()], axis=0)[sides]
        if totals.min() < -DROPPED_NATS:
            return bare[sides[int(totals.argmin())]].insert(sighting)
        return replace(self, prior_log_odds=prior_log_odds)._insert(sighting)

    def _without_prior(self, side: int) -> "GrowingMap":
        """The map without the prior's elements of a side."""
        prior = self.prior.of([key for key in self.prior.elements if key[0] != side], self.reach_m)
        kept = {*prior.elements, *(key for pair in self.pairs.values() for key in pair)}
        body_is_dropped, world_is_dropped = self.prior_is_dropped
        return replace(
            self,
            prior=prior,
            elements={key: element for key, element in self.elements.items() if key in kept},
            prior_is_dropped=(body_is_dropped or side == 0, world_is_dropped or side == 1),
        )

    def _insert(self, sighting: Sighting) -> "GrowingMap":
        mapper = _Mapper(self)
        if sighting.first in self.pairs:
            mapper.forget(sighting.first)
        elif len(self.sightings) == MOST_SIGHTINGS:
            mapper.forget(min(self.sightings, key=lambda s: s.gain(self.reach_m)).first)
        mapper.insert(sighting)
        return mapper.map

    def before_onsets(self) -> "GrowingMap":
        """The map for a stream whose ticks are numbered anew."""
        number = {sighting.first: i - len(self.sightings) for i, sighting in enumerate(self.sightings)}
        return replace(
            self,
            sightings=tuple(
                replace(sighting, first=number[sighting.first], end=number[sighting.first])
                for sighting in self.sightings
            ),
            pairs={number[first]: pair for first, pair in self.pairs.items()},
            prior_log_odds={
                number[first]: odds for first, odds in self.prior_log_odds.items() if first in number
            },
        )

    @cached_property
    def without_prior(self) -> "GrowingMap":
        """The map by the sightings of this recording alone."""
        return replace(self, prior=NOTHING_LEARNED) if self.prior else self

    @cached_property
    def untested_sides(self) -> set[int]:
        """The sides of which no contact has touched the prior's elements of another recording yet: of another
        object or in another scene, its price of new elements hides contacts in free motion."""
        touched = {key for pair in self.pairs.values() for key in pair}
        return {side for side, _ in self.prior.touched} - {side for side, _ in touched & self.prior.touched}

    @property
    def unused_sides(self) -> tuple[int, ...]:
        """The sides of which the prior's elements are dropped, or touched by none of ``FEW_CONTACTS``."""
        untouched = self.untested_sides if len(self.pairs) >= FEW_CONTACTS else set()
        return tuple(side for side in (0, 1) if self.prior_is_dropped[side] or side in untouched)

    @property
    def touches(self) -> tuple[Touch, ...]:
        """When which elements touched."""
        return tuple(sorted([*map(self.touch, self.sightings), *self.recognised]))

    def touch(self, sighting: Sighting) -> Touch:
        """The elements that touched in a sighting of the map."""
        return sighting.onset_ns, sighting.stamp_ns, self.pairs[sighting.first]

    def with_recognised(self, decided: Iterable[Sighting]) -> "GrowingMap":
        """The map with contacts that it has decided, each with the most probable pair of its elements."""
        recognised = list[Touch]()
        for sighting in decided:
            (body, world), log_weight = weigh_pairs(sighting, self.whole, self.reach_m)
            known = log_weight[1:, 1:]  # the first choices are new elements
            if known.size:
                row, column = divmod(int(known.argmax()), known.shape[1])
                keys = body[1 + row][0], world[1 + column][0]
                if keys[0] is not None and keys[1] is not None:
                    recognised.append((sighting.onset_ns, sighting.stamp_ns, (keys[0], keys[1])))
        return replace(self, recognised=tuple(recognised))

    @cached_property
    def touched_faces(self) -> tuple[tuple[Array, Array], ...]:
        """The normals (3,) of the faces that touched one another, of the object and of the environment."""
        pairs = (
            (self.elements[body], self.elements[world]) for body, world in sorted({*self.pairs.values()})
        )
        return tuple(
            (body.direction, world.direction) for body, world in pairs if body.kind == world.kind == "f"
        )

    @cached_property
    def due_ns(self) -> dict[int, int]:
        """Time from which each contact in the map is due again, by its onset."""
        return {sighting.onset_ns: sighting.due_ns for sighting in self.sightings}

    def shown_after(self, tick: int, tick_s: float) -> tuple[int, ...]:
        """The sightings, by their first ticks, that may be of a contact which begins in this tick.

        A contact does not use what it has itself shown: an element that no other contact touched is new to
        it. So a wrong estimate does not confirm itself. What ended before is of other data.
        """
        first = tick + round(MARGIN_S / tick_s)
        return tuple(s.first for s in self.sightings if s.first < first and s.end > tick)

    def latest_before(self, tick: int) -> tuple[Key, Key] | None:
        """The pair that touched in the last contact that had ended before this tick."""
        ended = [s.first for s in self.sightings if s.end <= tick]
        return self.pairs[max(ended)] if ended else None

    @cached_property
    def whole(self) -> MapView:
        """The map with all sightings."""
        return self.without(())

    def without(self, left_out: Iterable[int]) -> MapView:
        """The map without the sightings that begin with these ticks."""
        excluded = frozenset(left_out)
        used = {first: pair for first, pair in self.pairs.items() if first not in excluded}
        counts = dict[Key, float](self.prior.counts)
        for key in (key for pair in used.values() for key in pair):
            counts[key] = counts.get(key, 0.0) + 1.0
        slots = slots_of(self.elements, sorted(counts))
        covariance = self._learned(slots, used).covariance(self.reach_m)
        # the few sure contacts of a prior would not show how seldom elements are new
        contacts = 0 if self.prior.touched and self.contacts is None else self.contacts
        return MapView(
            {key: self.elements[key] for key in slots},
            counts,
            slots,
            covariance,
            log_probabilities_of_new(counts, contacts),
            self.pairs[max(used)] if used else None,
        )

    def _learned(self, slots: Mapping[Key, slice], used: Mapping[int, tuple[Key, Key]]) -> LearnedElements:
        """The elements with ``slots`` by what the prior and the ``used`` sightings show, uncounted."""
        elements = {key: self.elements[key] for key in slots}
        information = self.normal_equations(slots, used)[0]
        return LearnedElements(elements, {}, information, self.prior.extents, self.prior.outward)

    def normal_equations(
        self, slots: Mapping[Key, slice], used: Mapping[int, tuple[Key, Key]]
    ) -> tuple[Array, Array]:
        """Information (P, P) of all free coordinates from the prior and the ``used`` sightings, and the
        gradient (P,) of the squared residuals."""
        size = sum(self.elements[key].size for key in slots)
        information, gradient = np.zeros((size, size)), np.zeros(size)
        if self.prior:
            prior_elements = self.prior.elements
            rows = np.concatenate([np.arange(slots[key].start, slots[key].stop) for key in prior_elements])
            moved = np.concatenate(
                [element.change_to(self.elements[key]) for key, element in prior_elements.items()]
            )
            information[np.ix_(rows, rows)] += self.prior.information
            gradient[rows] += self.prior.information @ moved
        for sighting in self.sightings:
            if sighting.first not in used:
                continue
            body_key, world_key = used[sighting.first]
            residual, derivative = sighting.linearised((self.elements[body_key], self.elements[world_key]))
            rows = np.r_[slots[body_key], slots[world_key]]
            weighted = derivative.T @ sighting.information
            information[np.ix_(rows, rows)] += weighted @ derivative
            gradient[rows] += weighted @ residual
        return information, gradient

    @property
    def is_shared(self) -> bool:
        """Whether contacts share an element: with each other, or with the prior."""
        touched = Counter(key for pair in self.pairs.values() for key in pair)
        return any(count > 1 or key in self.prior.elements for key, count in touched.items())

    @property
    def complexity(self) -> float:
        """Complexity (nats) of the elements that several contacts touched, half of log det of prior over
        posterior covariance: what it costs to learn them once. Zero if no element was touched twice.

        The evidence of a pass in which each contact uses what the others have learned never counts that.
        """
        view = self.whole
        counts = view.counts.items()
        shared = {k: view.elements[k] for k, n in counts if n > 1.0 and k not in self.prior.elements}
        rows = np.array([row for key in shared for row in np.r_[view.slots[key]]], int)
        volume = np.linalg.slogdet(view.covariance[np.ix_(rows, rows)])[1]
        return float(0.5 * (np.log(LearnedElements(shared).weak(self.reach_m)).sum() - volume))


class _Mapper:
    """Changes to a map: which elements its sightings touched, and where these are."""

    def __init__(self, start: GrowingMap, share: float = 0.0) -> None:
        self._start, self._share = start, share
        self._sightings = {sighting.first: sighting for sighting in start.sightings}
        self._pairs, self._elements = dict(start.pairs), {**start.prior.elements, **start.elements}

    @property
    def map(self) -> GrowingMap:
        start, sightings = self._start, sorted(self._sightings.values(), key=lambda sighting: sighting.first)
        return replace(
            start, sightings=tuple(sightings), pairs=dict(self._pairs), elements=dict(self._elements)
        )

    def partition(self) -> set[frozenset[tuple[int, int]]]:
        """Which sightings (by first tick) share an element of a side, however it is numbered."""
        sharing = dict[Key, list[tuple[int, int]]]()
        for first, pair in self._pairs.items():
            for key in pair:
                sharing.setdefault(key, []).append((key[0], first))
        return {frozenset(group) for group in sharing.values()}

    def forget(self, first: int) -> None:
        """Remove a sighting, and the elements that it alone touched."""
        del self._sightings[first]
        for key in self._pairs.pop(first):
            if key not in self._start.prior.elements and all(
                key not in pair for pair in self._pairs.values()
            ):
                del self._elements[key]

    def insert(self, sighting: Sighting) -> None:
        """Let a sighting touch the pair of elements, known or new, that is most probable for it."""
        view = self.map.whole
        choices, log_weight = weigh_pairs(sighting, view, self._start.reach_m)
        covered = [key is not None and self._is_covered(sighting, key) for key, _ in choices[1]]
        log_weight[0, covered] = -np.inf  # the first choice is a new element
        log_weight += np.add.outer(*(self._kept(sighting, side) for side in choices))
        best = np.unravel_index(log_weight.argmax(), log_weight.shape)
        keys = [side[int(row)][0] for side, row in zip(choices, best, strict=True)]
        pair = [
            estimated if key is None else view.elements[key]
            for key, estimated in zip(keys, sighting.own_pair, strict=True)
        ]
        is_new = keys[0] is None, keys[1] is None
        number = 1 + max((number for _, number in self._elements), default=0)
        named = [(side, number) if key is None else key for side, key in enumerate(keys)]
        self._elements.update(zip(named, sighting.completed((pair[0], pair[1]), is_new), strict=True))
        self._sightings[sighting.first] = sighting
        self._pairs[sighting.first] = named[0], named[1]
        if not all(is_new):
            self.solve(1)

    def _kept(self, sighting: Sighting, choices: Sequence[tuple[Key | None, float]]) -> Array:
        """Change of the log probabilities (K,) of one side's choices, as a contact that changes may keep its
        element."""
        beside = {
            key
            for first, pair in self._pairs.items()
            if self._sightings[first].is_beside(sighting)
            for key in pair
        }
        is_kept = np.array([key in beside for key, _ in choices])
        if not is_kept.any():
            return np.zeros(len(choices))
        log_p = np.array([log_p for _, log_p in choices])
        kept = np.where(is_kept, self._share / is_kept.sum() / np.exp(log_p), 0.0)
        return np.asarray(np.log(kept + 1.0 - self._share))

    def _is_covered(self, sighting: Sighting, face: Key) -> bool:
        """Whether a face of the object that has touched this ``face`` of the environment is parallel to it in
        a ``sighting`` of f-f, on the same side: a new face of the object would be behind that one, or in
        front of it. So an object on a shelf touches a new face of the environment, not another one of its
        own."""
        if not sighting.has_one_height:
            return False
        normal = self._elements[face].direction
        for first, (body, touched) in self._pairs.items():
            earlier = self._sightings[first]
            if touched == face and earlier.has_one_height:
                outward = self._elements[body].direction
                cosines = [normal @ shown.estimate.rotation @ outward for shown in (sighting, earlier)]
                if cosines[0] * cosines[1] > PARALLEL:
                    return True
        return False

    def solve(self, rounds: int) -> None:
        """Move the elements to where all sightings agree best (Gauss-Newton)."""
        slots = slots_of(self._elements, sorted(self._elements))
        for _ in range(rounds):
            information, gradient = self.map.normal_equations(slots, self._pairs)
            weak = LearnedElements({key: self._elements[key] for key in slots}).weak(self._start.reach_m)
            change = np.asarray(-np.linalg.solve(information + np.diag(1.0 / weak), gradient))
            for key, rows in slots.items():
                self._elements[key] = self._elements[key].moved(change[rows])
            if np.abs(change).max(initial=0.0) < CONVERGED:
                break
