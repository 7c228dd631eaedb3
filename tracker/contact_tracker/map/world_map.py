"""The map of one recording: elements, which contact touched which, and their joint Gaussian.

The poses are known, so mapping is a linear problem once it is decided which contact touched which elements.
A new element has a price: one that n of N contacts of its kind have touched is touched again with
probability n / (N + a), and a new one with a / (N + a) (a Chinese restaurant process, on each side).
"""

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from contact_tracker.geometry.elements import Array
from contact_tracker.map.elements import MapElement, prior_variance
from contact_tracker.map.sighting import Pair, Sighting

CONCENTRATION: Final = 0.06
"""a: how readily contacts touch elements that no other contact has touched."""
MOST_SIGHTINGS: Final = 120
"""Most contacts in a map; those with the most information."""
MOST_SWEEPS: Final = 3
SOLVER_ROUNDS: Final = 4
LONGEST_TURN_RAD: Final = 0.3
"""Largest turn of an element in one step of the solver."""
CONVERGED: Final = 1e-7

Key = tuple[int, int]
"""Side (0: object, 1: environment) and number of an element."""


@dataclass(frozen=True, eq=False)
class MapView:
    """The map without some of its contacts: ``elements`` that others touched, how often, and the joint
    ``covariance`` of their free coordinates, in which each has its ``slots``."""

    elements: dict[Key, MapElement]
    counts: dict[Key, int]
    slots: dict[Key, slice]
    covariance: Array

    def choices(self, side: int, kind: str) -> list[tuple[Key | None, float]]:
        """Elements of a kind, None for a new one, with their log probabilities."""
        known = [key for key, one in self.elements.items() if key[0] == side and one.kind == kind]
        total = sum(self.counts[key] for key in known) + CONCENTRATION
        return [
            (None, math.log(CONCENTRATION / total)),
            *((key, math.log(self.counts[key] / total)) for key in known),
        ]

    def joint(self, pair: tuple[Key | None, Key | None], kinds: tuple[str, str], reach_m: float) -> Array:
        """Covariance (P, P) of the free coordinates of a pair; a new element has the prior's."""
        parts = [
            prior_variance(kind, reach_m) if key is None else np.zeros(len(self.covariance[self.slots[key]]))
            for key, kind in zip(pair, kinds, strict=True)
        ]
        out = np.diag(np.concatenate(parts))
        bounds = slice(0, len(parts[0])), slice(len(parts[0]), None)
        for one, rows in zip(pair, bounds, strict=True):
            for other, columns in zip(pair, bounds, strict=True):
                if one is not None and other is not None:
                    out[rows, columns] = self.covariance[self.slots[one], self.slots[other]]
        return out


def log_prior_of_new(contacts: Iterable[str]) -> float:
    """Log prior probability that contacts, such as ``v-f``, all touched elements of their own."""
    counts = Counter((side, contact[2 * side]) for contact in contacts for side in (0, 1))
    return sum(
        math.log(CONCENTRATION / (touched + CONCENTRATION))
        for count in counts.values()
        for touched in range(count)
    )


class Map:
    """Learned from the ``sightings`` of one recording; ``pairs`` are the keys that each of them touched."""

    def __init__(self, sightings: Sequence[Sighting], reach_m: float) -> None:
        by_information = sorted(sightings, key=lambda one: -_gain(one.information, reach_m))
        self.sightings = sorted(by_information[:MOST_SIGHTINGS], key=lambda one: one.first)
        self._reach_m = reach_m
        self._elements: dict[Key, MapElement] = {}
        self.pairs: dict[int, tuple[Key, Key]] = {}  # by the first tick of the sighting
        self._views: dict[frozenset[int], MapView] = {}
        for sighting in by_information[:MOST_SIGHTINGS]:
            self._associate(sighting)
        for _ in range(MOST_SWEEPS):
            before = set(self.pairs.values())
            for sighting in self.sightings:
                self._forget(sighting)
                self._associate(sighting)
            if set(self.pairs.values()) == before:
                break
        self._solve(SOLVER_ROUNDS)

    def without(self, left_out: Iterable[int] = ()) -> MapView:
        """The map without the sightings that begin with these ticks."""
        some = frozenset(left_out)
        if some not in self._views:
            self._views[some] = self._view(some)
        return self._views[some]

    @property
    def complexity(self) -> float:
        """Complexity (nats) of the elements that several contacts touched, half of log det of prior over
        posterior covariance: what it costs to learn them once. Zero if no element was touched twice.

        The evidence of a pass in which each contact uses what the others have learned never counts that.
        """
        view = self.without()
        shared = [key for key, count in view.counts.items() if count > 1]
        if not shared:
            return 0.0
        rows = np.concatenate([np.arange(view.slots[key].start, view.slots[key].stop) for key in shared])
        prior = np.concatenate([prior_variance(view.elements[key].kind, self._reach_m) for key in shared])
        volume = np.linalg.slogdet(view.covariance[np.ix_(rows, rows)])[1]
        return float(0.5 * (np.log(prior).sum() - volume))

    def _view(self, left_out: frozenset[int]) -> MapView:
        used = {first: pair for first, pair in self.pairs.items() if first not in left_out}
        counts = Counter(key for pair in used.values() for key in pair)
        slots, end = dict[Key, slice](), 0
        for key in sorted(counts):
            slots[key] = slice(end, end + self._elements[key].size)
            end = slots[key].stop
        covariance = np.asarray(np.linalg.inv(self._normal_equations(slots, used)[0]))
        return MapView({key: self._elements[key] for key in slots}, counts, slots, covariance)

    def _normal_equations(
        self, slots: dict[Key, slice], used: dict[int, tuple[Key, Key]]
    ) -> tuple[Array, Array]:
        """Information (P, P) of all free coordinates, and the gradient (P,) of the squared residuals."""
        variances = [prior_variance(self._elements[key].kind, self._reach_m) for key in slots]
        information = np.diag(1.0 / np.concatenate([np.zeros(0), *variances]))
        gradient = np.zeros(len(information))
        for sighting in self.sightings:
            if sighting.first not in used:
                continue
            ours, theirs = used[sighting.first]
            residual, derivative = sighting.linearised((self._elements[ours], self._elements[theirs]))
            rows = np.r_[slots[ours], slots[theirs]]
            weighted = derivative.T @ sighting.information
            information[np.ix_(rows, rows)] += weighted @ derivative
            gradient[rows] += weighted @ residual
        return information, gradient

    def _solve(self, rounds: int) -> None:
        """Move the elements to where all sightings agree best (Gauss-Newton)."""
        self._views.clear()
        view = self.without()
        for _ in range(rounds):
            information, gradient = self._normal_equations(view.slots, self.pairs)
            change = np.asarray(-np.linalg.solve(information, gradient))
            for key, rows in view.slots.items():
                one = self._elements[key]
                turn = float(np.linalg.norm(change[rows][:2])) if one.kind != "v" else 0.0
                self._elements[key] = one.moved(
                    change[rows] * min(1.0, LONGEST_TURN_RAD / max(turn, CONVERGED))
                )
            if np.abs(change).max(initial=0.0) < CONVERGED:
                break
        self._views.clear()

    def _forget(self, sighting: Sighting) -> None:
        for key in self.pairs.pop(sighting.first):
            if all(key not in pair for pair in self.pairs.values()):
                del self._elements[key]
        self._views.clear()

    def _associate(self, sighting: Sighting) -> None:
        """Let a sighting touch the pair of elements, known or new, that is most probable for it."""
        view, kinds = self.without(), sighting.kinds
        best = max(
            (
                self._candidate(sighting, view, (ours, theirs), our_log_p + their_log_p)
                for ours, our_log_p in view.choices(0, kinds[0])
                for theirs, their_log_p in view.choices(1, kinds[1])
            ),
            key=lambda candidate: candidate.log_weight,
        )
        keys = [
            (side, 1 + max((number for _, number in self._elements), default=0)) if key is None else key
            for side, key in enumerate(best.keys)
        ]
        is_known = best.keys != (None, None)
        self._elements.update(zip(keys, best.pair, strict=True))
        self.pairs[sighting.first] = keys[0], keys[1]
        if is_known:
            self._solve(1)
        self._views.clear()

    def _candidate(
        self, sighting: Sighting, view: MapView, keys: tuple[Key | None, Key | None], log_choice: float
    ) -> "_Candidate":
        """The log evidence of a sighting if it touched these elements, and their log probability."""
        own, is_new = sighting.own_pair, (keys[0] is None, keys[1] is None)
        ours, theirs = (
            mine if key is None else view.elements[key] for key, mine in zip(keys, own, strict=True)
        )
        pair = sighting.completed((ours, theirs), is_new)
        residual, derivative = sighting.linearised(pair)
        whitened, by_pair = sighting.root.T @ residual, sighting.root.T @ derivative
        ratio = np.eye(len(residual)) + by_pair @ view.joint(keys, sighting.kinds, self._reach_m) @ by_pair.T
        misfit = whitened @ np.linalg.solve(ratio, whitened)
        evidence = -0.5 * (float(np.linalg.slogdet(ratio)[1]) + float(misfit))
        return _Candidate(evidence + log_choice, keys, pair)


class _Candidate(NamedTuple):
    log_weight: float
    keys: tuple[Key | None, Key | None]
    pair: Pair


def _gain(information: Array, reach_m: float) -> float:
    """Information (nats) of a sighting relative to about what is known before."""
    return float(np.linalg.slogdet(np.eye(len(information)) + reach_m**2 * information)[1])
