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

from contact_tracker.arrays import Array, Ints
from contact_tracker.config.parameters import Model
from contact_tracker.contacts import CONTACT_MODELS, face_face
from contact_tracker.geometry.lifted_pose import R, T
from contact_tracker.hypotheses.births import ANY_DIRECTION
from contact_tracker.hypotheses.evidence import DECISIVE, gain_and_misfit
from contact_tracker.map.association import ElementEstimate, Sighting
from contact_tracker.map.elements import LOOSE_M, LOOSE_RAD
from contact_tracker.map.world_map import MOST_SIGHTINGS
from contact_tracker.motion.tick_averaging import Tick
from contact_tracker.motion.window import Window, at_rest, window_of
from contact_tracker.states import Contact

SIGMAS: Final = 4.0
"""A rest that is farther from two faces than this many standard deviations stands on others, and two rests
that turn by less propose none. Half and double give the same sightings in 24 simulations of four or five
rests."""

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
    rests, found = _Rests.of(window_of(ticks, model), model.tick_s, reach_m), list[RestSighting]()
    for faces in _faces_of(rests):
        for k, information, evidence in zip(faces.members, faces.information, faces.by_member, strict=True):
            arguments = faces.x, faces.tangent, information, np.zeros(6), rests.rotation[k]
            (first, end), estimate = rests.rows[k], ElementEstimate(Contact.FF, *arguments)
            sighting = Sighting(first, end, estimate, ticks[first].start_ns, ticks[end - 1].stamp_ns)
            found.append(RestSighting(sighting, float(evidence)))
    return found


@dataclass(frozen=True, eq=False)
class _Rests:
    """The first K rests: their ``rows`` (K, 2), the first tick and the end (excluded), mean lifted poses
    ``zeta`` (K, 25), and ``variance`` (K, 3) of the residuals of f-f, two angles and a distance, with that by
    which faces differ from one place to the next. An object reaches ``reach_m`` from its origin."""

    rows: Ints
    zeta: Array
    variance: Array
    reach_m: float

    @classmethod
    def of(cls, window: Window, tick_s: float, reach_m: float) -> "_Rests":
        assert window.frames is not None
        resting = at_rest(window, tick_s)
        rows = np.flatnonzero(np.diff(resting, prepend=False, append=False)).reshape(-1, 2)[:MOST_SIGHTINGS]
        zeta, variance = np.empty((len(rows), window.zeta.shape[1])), np.empty((len(rows), 2))
        for k, (first, end) in enumerate(rows):
            within = first + np.flatnonzero(window.frames[first:end])
            zeta[k] = np.average(window.zeta[within], axis=0, weights=window.frames[within])
            variance[k] = window.variance[within].mean(axis=0) / len(within)
        return cls(rows, zeta, np.add(variance, (LOOSE_M**2, LOOSE_RAD**2))[:, [1, 1, 0]], reach_m)

    @cached_property
    def rotation(self) -> Array:
        """(K, 3, 3) the nearest rotations."""
        return np.asarray(Rotation.from_matrix(self.zeta[:, R].reshape(-1, 3, 3)).as_matrix())

    @cached_property
    def turns(self) -> Array:
        """Rotation vectors (K, K, 3), in the world, from the orientation of the row to that of the column."""
        between = np.einsum("jab,icb->ijac", self.rotation, self.rotation)
        vectors = Rotation.from_matrix(between.reshape(-1, 3, 3)).as_rotvec()
        return np.asarray(vectors.reshape(*between.shape[:2], 3))

    def moved_variance(self, members: Ints) -> Array:
        """Variances (n, 3) of the residuals of the ``members`` if no face held the object: of the first one
        anywhere, of each other by how far it is from the nearest before it. For whatever moves the object may
        return to a place or an orientation on purpose."""
        place_m = self.zeta[members][:, T]
        turned = (self.turns[np.ix_(members, members)] ** 2).sum(axis=-1)
        shifted = ((place_m[:, None] - place_m) ** 2).sum(axis=-1)
        is_later = np.triu(np.ones_like(turned, dtype=bool))
        turned, shifted = (np.where(is_later, np.inf, square).min(axis=1) for square in (turned, shifted))
        moved = np.stack([turned, turned, shifted], axis=1)
        return np.asarray(np.minimum(moved, [ANY_DIRECTION, ANY_DIRECTION, self.reach_m**2]))

    def are_about_one_axis(self, members: Ints) -> bool:
        """Whether the object has turned about one fixed axis between the ``members``, as on a hinge: a point
        of the body, within its reach, stays where it is. Any face across the axis fits that, and two rests
        on one pair of faces always do."""
        rotation, place_m = self.rotation[members], self.zeta[members][:, T].ravel()
        points = np.concatenate([np.tile(np.eye(3), (len(members), 1, 1)), -rotation], axis=2).reshape(-1, 6)
        noise = self.variance[members][:, [2, 0]] @ np.array([1.0, self.reach_m**2])  # m^2, of the point
        prior = noise.mean() / self.reach_m**2 * np.eye(6)  # of its place in the world, and in the body
        fixed_m = np.linalg.solve(points.T @ points + prior, points.T @ place_m)
        apart_m = (points @ fixed_m - place_m).reshape(-1, 3)
        return bool((apart_m**2 <= SIGMAS**2 * noise[:, None]).all())

    def residual(self, x: Array) -> Array:
        """Residuals (K, 3) of all rests on the faces x (7,)."""
        return np.asarray(_FACES.measure(x[None], self.zeta).residual[0].T)


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

    @classmethod
    def fitted(cls, x: Array, members: Ints, rests: _Rests) -> "_Faces":
        """Fitted to the ``members`` by one step of Gauss and Newton from near-by faces x (7,)."""
        tangent, variance = face_face.tangent(x, np.zeros(6)), rests.variance[members]
        by_x = face_face.rows_derivative(x) @ rests.zeta[members][:, face_face.COLUMNS].T  # (3, 7, n)
        derivative = np.moveaxis(by_x, -1, 0) @ tangent
        information = np.einsum("nkp,nk,nkq->npq", derivative, 1.0 / variance, derivative)
        gradient = np.einsum("nkp,nk->p", derivative, rests.residual(x)[members] / variance)
        posterior = np.eye(len(gradient)) + information.sum(axis=0)
        x = face_face.normalise(x - tangent @ np.linalg.solve(posterior, gradient), np.zeros(6))
        free = rests.moved_variance(members)
        gain, misfit = gain_and_misfit(rests.residual(x)[members] ** 2, variance, free)
        by_member = (gain - misfit).sum(axis=1)
        shown = free / (free + variance) / variance
        information = np.einsum("nkp,nk,nkq->npq", derivative, shown, derivative)
        volume = 0.5 * np.linalg.slogdet(np.eye(len(gradient)) + information.sum(axis=0))[1]
        tangent = face_face.tangent(x, np.zeros(6))
        return cls(x, tangent, members, information, by_member, float(by_member.sum() - volume))


def _faces_of(rests: _Rests) -> list[_Faces]:
    """The pairs of faces that explain most, without rests in common."""
    count, found, taken = len(rests.rows), list[_Faces](), set[int]()
    for fit in sorted(_fits(rests), key=lambda fit: -fit.evidence):
        if fit.evidence < DECISIVE + np.log(count * (count - 1) / 2):
            break
        members = fit.members.tolist()
        if taken.isdisjoint(members) and not rests.are_about_one_axis(fit.members):
            found.append(fit)
            taken.update(members)
    return found


def _fits(rests: _Rests) -> Iterator[_Faces]:
    """The faces that each two rests propose, as the object turned about their normal."""
    tried = set[frozenset[int]]()
    for i, j in combinations(range(len(rests.rows)), 2):
        turn = rests.turns[i, j]
        angle = float(np.linalg.norm(turn))
        sigma_rad = float(np.sqrt(rests.variance[i, 0] + rests.variance[j, 0]))
        if angle < SIGMAS * sigma_rad:
            continue
        normal, place_m = turn / angle, 0.5 * (rests.zeta[i, T] + rests.zeta[j, T])
        x = np.concatenate([rests.rotation[i].T @ normal, normal, [normal @ place_m]])
        # the error of the normal
        arm_sq = ((rests.zeta[:, T] - place_m) ** 2).sum(axis=1)
        tilt = (sigma_rad / (2.0 * np.sin(0.5 * angle))) ** 2
        variance = rests.variance + tilt * np.stack([arm_sq**0, arm_sq**0, arm_sq], axis=1)
        members = np.flatnonzero((rests.residual(x) ** 2 <= SIGMAS**2 * variance).all(axis=1))
        agreeing = frozenset(members.tolist())
        if agreeing >= {i, j} and agreeing not in tried:
            tried.add(agreeing)
            yield _Faces.fitted(x, members, rests)
