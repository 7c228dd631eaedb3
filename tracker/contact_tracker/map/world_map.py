"""The map of one recording: elements, which contact touched which, and their joint Gaussian.

The poses are known, so mapping is a linear problem once it is decided which contact touched which elements.
A new element has a price: one that n of N contacts of its kind have touched is touched again with
probability n / (N + a), and a new one with a / (N + a) (a Chinese restaurant process, on each side).
"""

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.geometry.elements import Array
from contact_tracker.map.elements import MapElement, prior_variance
from contact_tracker.map.sighting import Sighting

CONCENTRATION: Final = 0.06
"""a: how readily contacts touch elements that no other contact has touched (docs/theory.md, section 22).
With 0.03, recordings of everyday handling are right 0.69 of the time instead of 0.65 (0.52 without a map),
but one of 32 others loses 0.08, which with 0.06 none does."""
MOST_SIGHTINGS: Final = 60
"""Most contacts in a map, those with the most information: if nothing is shared, 60 take some seconds."""
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
        by_information = by_information[:MOST_SIGHTINGS]
        self.sightings = sorted(by_information, key=lambda one: one.first)
        self._reach_m = reach_m
        self._elements: dict[Key, MapElement] = {}
        self.pairs: dict[int, tuple[Key, Key]] = {}  # by the first tick of the sighting
        self._whole: MapView | None = None
        self._latest: tuple[frozenset[int], MapView] | None = None
        for sighting in by_information:
            self._associate(sighting)
        for _ in range(MOST_SWEEPS):
            before = self._partition()
            for sighting in self.sightings:
                self._forget(sighting)
                self._associate(sighting)
            if self._partition() == before:
                break
        self._solve(SOLVER_ROUNDS)

    def without(self, left_out: Iterable[int] = ()) -> MapView:
        """The map without the sightings that begin with these ticks; the whole and the latest are kept."""
        some = frozenset(left_out)
        if not some:
            if self._whole is None:
                self._whole = self._view(some)
            return self._whole
        if self._latest is None or self._latest[0] != some:
            self._latest = some, self._view(some)
        return self._latest[1]

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

    def _partition(self) -> set[frozenset[tuple[int, int]]]:
        """Which sightings (by first tick) share an element of a side, however it is numbered."""
        sharing = dict[Key, list[tuple[int, int]]]()
        for first, pair in self.pairs.items():
            for key in pair:
                sharing.setdefault(key, []).append((key[0], first))
        return {frozenset(one) for one in sharing.values()}

    def _view(self, left_out: frozenset[int]) -> MapView:
        used = {first: pair for first, pair in self.pairs.items() if first not in left_out}
        counts, slots = Counter(key for pair in used.values() for key in pair), self._slots(used)
        covariance = np.asarray(np.linalg.inv(self._normal_equations(slots, used)[0]))
        return MapView({key: self._elements[key] for key in slots}, counts, slots, covariance)

    def _slots(self, used: Mapping[int, tuple[Key, Key]]) -> dict[Key, slice]:
        """Rows of the free coordinates of each element that these pairs have."""
        slots, end = dict[Key, slice](), 0
        for key in sorted({key for pair in used.values() for key in pair}):
            slots[key] = slice(end, end + self._elements[key].size)
            end = slots[key].stop
        return slots

    def _normal_equations(
        self, slots: Mapping[Key, slice], used: Mapping[int, tuple[Key, Key]]
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
        slots = self._slots(self.pairs)
        for _ in range(rounds):
            information, gradient = self._normal_equations(slots, self.pairs)
            change = np.asarray(-np.linalg.solve(information, gradient))
            for key, rows in slots.items():
                one = self._elements[key]
                turn = float(np.linalg.norm(change[rows][:2])) if one.kind != "v" else 0.0
                share = min(1.0, LONGEST_TURN_RAD / max(turn, CONVERGED))
                self._elements[key] = one.moved(change[rows] * share)
            if np.abs(change).max(initial=0.0) < CONVERGED:
                break
        self._whole = self._latest = None

    def _forget(self, sighting: Sighting) -> None:
        for key in self.pairs.pop(sighting.first):
            if all(key not in pair for pair in self.pairs.values()):
                del self._elements[key]
        self._whole = self._latest = None

    def _associate(self, sighting: Sighting) -> None:
        """Let a sighting touch the pair of elements, known or new, that is most probable for it."""
        view = self.without()
        choices = [view.choices(side, kind) for side, kind in enumerate(sighting.kinds)]
        log_weight = _log_evidence(sighting, view, choices, self._reach_m)
        log_weight += np.add.outer(*([log_p for _, log_p in side] for side in choices))
        best = np.unravel_index(log_weight.argmax(), log_weight.shape)
        keys = [side[int(row)][0] for side, row in zip(choices, best, strict=True)]
        pair = [
            mine if key is None else view.elements[key]
            for key, mine in zip(keys, sighting.own_pair, strict=True)
        ]
        is_new = keys[0] is None, keys[1] is None
        number = 1 + max((number for _, number in self._elements), default=0)
        named = [(side, number) if key is None else key for side, key in enumerate(keys)]
        self._elements.update(zip(named, sighting.completed((pair[0], pair[1]), is_new), strict=True))
        self.pairs[sighting.first] = named[0], named[1]
        if not all(is_new):
            self._solve(1)
        self._whole = self._latest = None


def _log_evidence(
    sighting: Sighting, view: MapView, choices: Sequence[Sequence[tuple[Key | None, float]]], reach_m: float
) -> Array:
    """Log evidence (I, J) of a sighting if it touched the i-th of the object's choices and the j-th of the
    environment's; None stands for a new element, which is as estimated."""
    parts = [_Side.of(sighting, view, side, [key for key, _ in choices[side]], reach_m) for side in (0, 1)]
    ours, theirs = parts
    residual = ours.offset[:, None] + theirs.offset[None]
    if sighting.has_one_height:  # a new face has the offset that was estimated
        residual[0, :, -1] = residual[:, 0, -1] = 0.0
    whitened = residual @ sighting.root
    known = view.covariance if view.slots else np.zeros((1, 1))
    joint = known[ours.rows[:, None, :, None], theirs.rows[None, :, None, :]]
    joint[0] = joint[:, 0] = 0.0  # new elements are independent of all others
    across = ours.derivative[:, None] @ joint @ np.swapaxes(theirs.derivative, 1, 2)[None]
    spread = ours.variance[:, None] + theirs.variance[None] + across + np.swapaxes(across, 2, 3)
    ratio = np.eye(residual.shape[-1]) + sighting.root.T @ spread @ sighting.root
    misfit = (whitened * np.linalg.solve(ratio, whitened[..., None])[..., 0]).sum(axis=-1)
    return np.asarray(-0.5 * (np.linalg.slogdet(ratio)[1] + misfit))


class _Side(NamedTuple):
    """What the choices (I) of one side contribute to a sighting's residual (P,).

    ``offset`` (I, P) from the sighting's own element, ``derivative`` (I, P, p) by the p free coordinates of
    the element, ``rows`` (I, p) of these in the map (any for a new one, the first), and ``variance`` (I, P,
    P) by its uncertainty.
    """

    offset: Array
    derivative: Array
    rows: NDArray[np.int64]
    variance: Array

    @classmethod
    def of(
        cls, sighting: Sighting, view: MapView, side: int, keys: list[Key | None], reach_m: float
    ) -> "_Side":
        own = sighting.own_pair
        columns = slice(0, own[0].size) if side == 0 else slice(own[0].size, None)
        offsets, derivatives, rows, variances = [], [], [], []
        for key in keys:
            one = own[side] if key is None else view.elements[key]
            pair = (one, own[1]) if side == 0 else (own[0], one)
            residual, derivative = sighting.linearised(pair)
            by_own = derivative[:, columns]
            if key is None:
                row, covariance = np.zeros(one.size, np.int64), np.diag(prior_variance(one.kind, reach_m))
            else:
                row = np.arange(view.slots[key].start, view.slots[key].stop)
                covariance = view.covariance[view.slots[key], view.slots[key]]
            offsets.append(residual)
            derivatives.append(by_own)
            rows.append(row)
            variances.append(by_own @ covariance @ by_own.T)
        return cls(np.array(offsets), np.array(derivatives), np.array(rows), np.array(variances))


def _gain(information: Array, reach_m: float) -> float:
    """Information (nats) of a sighting relative to about what is known before."""
    return float(np.linalg.slogdet(np.eye(len(information)) + reach_m**2 * information)[1])
