"""Sightings of faces by rests alone: what an object stood on in several places (docs/theory.md, section 22).

A single rest fits any face on any other. Two rests on one pair of faces differ by a turn about their normal
and a shift along them, as a turn about an axis does, and each further rest agrees in three numbers more.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from typing import Final, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from contact_tracker.arrays import Array, Bools, Ints
from contact_tracker.config.parameters import Model
from contact_tracker.contacts import CONTACT_MODELS, face_face
from contact_tracker.geometry.lifted_pose import R, T
from contact_tracker.geometry.linalg import matrices, nearest
from contact_tracker.hypotheses.births import ANY_DIRECTION
from contact_tracker.hypotheses.evidence import DECISIVE
from contact_tracker.map.association import ElementEstimate, Sighting
from contact_tracker.map.elements import LOOSE_M, LOOSE_RAD
from contact_tracker.motion.tick_averaging import Tick, tick_variances
from contact_tracker.motion.window import Window, at_rest
from contact_tracker.states import Contact

MOST_RESTS: Final = 60
"""Most rests of a recording that are compared, the first ones: as many as a map has contacts. They take up to
1 s on a surface so uneven that each two propose faces of their own, 0.1 s on one face."""
FEWEST_RESTS: Final = 3
"""Fewest rests that show faces: two whose turn is about the faces' normal are also a turn about an axis."""
SIGMAS: Final = 4.0
"""A rest that is farther from two faces than this many standard deviations stands on others, and two rests
that turn by less propose none. Half and double give the same sightings in 24 simulations of four or five
rests, as of the next constant."""
ROUNDS: Final = 2
"""Steps in which faces are fitted to the rests that agree with them."""

AXIS_SHARE: Final = 1e-2
"""Largest singular value, of all, that the noise of orientations gives to a point's place along an axis."""

_FACES: Final = CONTACT_MODELS[Contact.FF.column]


class RestSighting(NamedTuple):
    """The ``sighting`` of a pair of faces by one rest, and its ``evidence`` (nats): how much likelier the
    pose is on these faces than anywhere."""

    sighting: Sighting
    evidence: float


def sightings_at_rest(ticks: Sequence[Tick], model: Model, reach_m: float) -> list[RestSighting]:
    """The sightings of all pairs of faces on which the object has surely stood in several places."""
    if not ticks:
        return []
    count = np.array([tick.count for tick in ticks], float)
    window = Window(
        np.arange(len(ticks)),
        np.array([tick.zeta for tick in ticks]),
        tick_variances(ticks[-1].noise, count, model),
        np.array([tick.innovation_excess for tick in ticks]),
        frames=count,
    )
    rests = _Rests.of(window, model.tick_s)
    return [
        RestSighting(
            Sighting(first, end, estimate, ticks[first].start_ns, ticks[end - 1].stamp_ns), float(evidence)
        )
        for faces in _faces_of(rests, reach_m)
        for (first, end), estimate, evidence in faces.by_rest(rests)
    ]


@dataclass(frozen=True, eq=False)
class _Rests:
    """K rests: their ``rows`` (K, 2), the first tick and the end (excluded), mean lifted poses ``zeta``
    (K, 25), the ``rotation`` (K, 3, 3), and the ``variance`` (K, 2) of place (m^2) and turn (rad^2), with
    that by which faces differ from one place to the next."""

    rows: Ints
    zeta: Array
    rotation: Array
    variance: Array

    @classmethod
    def of(cls, window: Window, tick_s: float) -> "_Rests":
        assert window.frames is not None
        resting = at_rest(window, tick_s)
        rows = np.flatnonzero(np.diff(resting, prepend=False, append=False)).reshape(-1, 2)[:MOST_RESTS]
        zeta, variance = np.empty((len(rows), window.zeta.shape[1])), np.empty((len(rows), 2))
        for k, (first, end) in enumerate(rows):
            within = first + np.flatnonzero(window.frames[first:end])
            zeta[k] = np.average(window.zeta[within], axis=0, weights=window.frames[within])
            variance[k] = window.variance[within].mean(axis=0) / len(within)
        rotation = matrices(np.array([nearest(mean) for mean in zeta[:, R]]).reshape(-1, 4))
        return cls(rows, zeta, rotation, np.add(variance, (LOOSE_M**2, LOOSE_RAD**2)))

    @property
    def row_variance(self) -> Array:
        """Variances (K, 3) of the residuals of f-f: two angles, one distance."""
        return self.variance[:, [1, 1, 0]]

    @cached_property
    def turns(self) -> Array:
        """Rotation vectors (K, K, 3), in the world, from the orientation of the row to that of the column."""
        between = np.einsum("jab,icb->ijac", self.rotation, self.rotation)
        vectors = Rotation.from_matrix(between.reshape(-1, 3, 3)).as_rotvec()
        return np.asarray(vectors.reshape(*between.shape[:2], 3))

    def moved_variance(self, members: Ints, reach_m: float) -> Array:
        """Variances (n, 3) of the residuals of the ``members`` if no face held the object: of the first one
        anywhere, of each other by how far it is from the nearest before it. For whatever moves the object may
        return to a place or an orientation on purpose."""
        place_m = self.zeta[members][:, T]
        turned = (self.turns[np.ix_(members, members)] ** 2).sum(axis=-1)
        shifted = ((place_m[:, None] - place_m) ** 2).sum(axis=-1)
        is_later = np.triu(np.ones_like(turned, dtype=bool))
        turned, shifted = (np.where(is_later, np.inf, square).min(axis=1) for square in (turned, shifted))
        moved = np.stack([turned, turned, shifted], axis=1)
        return np.asarray(np.minimum(moved, [ANY_DIRECTION, ANY_DIRECTION, reach_m**2]))

    def are_about_one_axis(self, members: Ints) -> bool:
        """Whether the object has turned about one fixed axis between the ``members``, as on a hinge: a point
        of the body stays where it is. Any face across the axis fits that."""
        rotation, place_m = self.rotation[members], self.zeta[members][:, T]
        points = np.concatenate([np.tile(np.eye(3), (len(members), 1, 1)), -rotation], axis=2).reshape(-1, 6)
        # in the world, and in the body; along the axis, both are open together
        fixed = np.linalg.lstsq(points, place_m.ravel(), rcond=AXIS_SHARE)[0]
        apart_m = (points @ fixed).reshape(-1, 3) - place_m
        variance = self.variance[members] @ np.array([1.0, fixed[3:] @ fixed[3:]])
        return bool((apart_m**2 <= SIGMAS**2 * variance[:, None]).all())


@dataclass(frozen=True, eq=False)
class _Faces:
    """A pair of faces x (7,) with its free directions ``tangent`` (7, 5), the ``members`` (n,) among the
    rests that agree with it, and of each the ``information`` (n, 5, 5) and the evidence ``by_member`` (n,);
    all together are likelier by ``evidence`` (nats) than rests anywhere."""

    x: Array
    tangent: Array
    members: Ints
    information: Array
    by_member: Array
    evidence: float

    def by_rest(self, rests: _Rests) -> Iterator[tuple[Ints, ElementEstimate, float]]:
        for k, information, evidence in zip(self.members, self.information, self.by_member, strict=True):
            arguments = self.x, self.tangent, information, np.zeros(6), rests.rotation[k]
            yield rests.rows[k], ElementEstimate(Contact.FF, *arguments), evidence


def _faces_of(rests: _Rests, reach_m: float) -> list[_Faces]:
    """The pairs of faces that explain most, without rests in common."""
    count, found, taken = len(rests.rows), list[_Faces](), set[int]()
    for fit in sorted(_fits(rests, reach_m), key=lambda fit: -fit.evidence):
        if fit.evidence < DECISIVE + np.log(count * (count - 1) / 2):
            break
        members = fit.members.tolist()
        if taken.isdisjoint(members) and not rests.are_about_one_axis(fit.members):
            found.append(fit)
            taken.update(members)
    return found


def _fits(rests: _Rests, reach_m: float) -> Iterator[_Faces]:
    """The faces that each two rests propose, as the object turned about their normal, if others agree."""
    tried, every = set[frozenset[int]](), np.arange(len(rests.rows))
    for i, j in combinations(every.tolist(), 2):
        turn = rests.turns[i, j]
        angle = float(np.linalg.norm(turn))
        sigma_rad = float(np.sqrt(rests.variance[i, 1] + rests.variance[j, 1]))
        if angle < SIGMAS * sigma_rad:
            continue
        normal, place_m = turn / angle, 0.5 * (rests.zeta[i, T] + rests.zeta[j, T])
        x = np.concatenate([rests.rotation[i].T @ normal, normal, [normal @ place_m]])
        # the error of the normal
        arm_m = np.linalg.norm(rests.zeta[:, T] - place_m, axis=1)
        tilt = (sigma_rad / (2.0 * np.sin(0.5 * angle))) ** 2
        variance = rests.row_variance + tilt * np.stack([arm_m**0, arm_m**0, arm_m**2], axis=1)
        members = every[_agree(_residual(x, rests, every), variance)]
        agreeing = frozenset(members.tolist())
        if len(members) < FEWEST_RESTS or not agreeing >= {i, j} or agreeing in tried:
            continue
        tried.add(agreeing)
        if (fit := _fitted(x, rests, members, reach_m)) is not None:
            yield fit


def _residual(x: Array, rests: _Rests, members: Ints) -> Array:
    """Residuals (n, 3) of the ``members``."""
    return np.asarray(_FACES.measure(x[None], rests.zeta[members]).residual[0].T)


def _agree(residual: Array, variance: Array) -> Bools:
    return np.asarray((residual**2 <= SIGMAS**2 * variance).all(axis=1))


def _fitted(x: Array, rests: _Rests, members: Ints, reach_m: float) -> _Faces | None:
    """The faces fitted to the ``members``, which are chosen again in each step; None if few are left."""
    every = np.arange(len(rests.rows))
    for _ in range(ROUNDS):
        tangent, derivative = _derivative(x, rests, members)
        weight = 1.0 / rests.row_variance[members]
        information = np.einsum("nkp,nk,nkq->npq", derivative, weight, derivative)
        gradient = np.einsum("nkp,nk->p", derivative, weight * _residual(x, rests, members))
        change = np.linalg.solve(np.eye(len(gradient)) + information.sum(axis=0), gradient)
        x = face_face.normalise(x - tangent @ change, np.zeros(6))
        members = every[_agree(_residual(x, rests, every), rests.row_variance)]
        if len(members) < FEWEST_RESTS:
            return None
    tangent, derivative = _derivative(x, rests, members)
    variance = rests.row_variance[members]
    ratio = rests.moved_variance(members, reach_m) / variance
    shown = ratio / (1.0 + ratio)
    misfit = _residual(x, rests, members) ** 2 / variance * shown
    by_member = 0.5 * (np.log1p(ratio) - misfit).sum(axis=1)
    information = np.einsum("nkp,nk,nkq->npq", derivative, shown / variance, derivative)
    volume = 0.5 * np.linalg.slogdet(np.eye(information.shape[1]) + information.sum(axis=0))[1]
    return _Faces(x, tangent, members, information, by_member, float(by_member.sum() - volume))


def _derivative(x: Array, rests: _Rests, members: Ints) -> tuple[Array, Array]:
    """The free directions (7, 5) of the faces, and the derivative (n, 3, 5) of the residuals by them."""
    tangent = face_face.tangent(x, np.zeros(6))
    by_x = face_face.rows_derivative(x) @ rests.zeta[members][:, face_face.COLUMNS].T  # (3, 7, n)
    return tangent, np.moveaxis(by_x, -1, 0) @ tangent
