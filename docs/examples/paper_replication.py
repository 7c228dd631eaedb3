"""The experiments of the paper (its section IV) on simulated recordings, and the tracker on the same poses.

The paper moved a real cube by hand and measured it by motion capture. Here both are simulated: the same
contacts, durations and rate, with white noise and with low-pass-filtered noise.

In the first experiment, SLSQP minimises the paper's objective of the known contact from ten random starts;
the tracker segments the same poses without a map. In the second one, the paper's objectives are
minimised on windows of 500 poses, ten poses apart (Fig. 5); the tracker gives a posterior in each tick:
online from the poses so far, and offline from the whole recording.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from types import MappingProxyType
from typing import Final

import numpy as np
from numpy.typing import NDArray

from contact_tracker import segmenting
from contact_tracker.config.loading import load_model
from contact_tracker.contacts import CONTACT_MODELS
from contact_tracker.geometry.elements import ContactGeometry, Element, Line, Plane, Point
from contact_tracker.motion.poses import Poses
from contact_tracker.paper import form, matrix, minimise_slsqp, motion
from contact_tracker.paper.batched import Kind
from contact_tracker.paper.window_curves import WindowCurves, curves
from contact_tracker.states import Contact
from contact_tracker.tracking.belief import Segment
from contact_tracker.tracking.segmentation import Segmentation
from contact_tracker_lab.evaluation.bound import angles_and_distances, cramer_rao
from contact_tracker_lab.evaluation.geometry_errors import SIDES, ElementError, geometry_errors
from contact_tracker_lab.evaluation.scoring import scoring, tick_in_force
from contact_tracker_lab.simulate import Phase, Scenario, Simulated, simulate
from contact_tracker_lab.simulate.simulator import low_pass

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

CUTOFF_HZ: Final = 20.0
NOISES: Final[Mapping[str, Callable[[Poses], Poses]]] = MappingProxyType(
    {"white": lambda poses: poses, "filtered": partial(low_pass, cutoff_hz=CUTOFF_HZ)}
)
"""``filtered``: a Butterworth low-pass, forward and backward, as in motion-capture software."""
MOVED: Final = (Contact.FF, Contact.EF, Contact.VF, Contact.EE)
"""The contacts of the paper's cube, in its order."""
COLUMNS: Final = [contact.column for contact in MOVED]
SECONDS: Final = 10.0
FRAMES: Final = 500
STEP: Final = 10
SINGLE_STARTS: Final = 10
WINDOW_STARTS: Final = 3


@dataclass(frozen=True, eq=False)
class SingleContact:
    """One simulated recording, and the estimates from it.

    Parameters
    ----------
    contact, noise : the true contact, and the name of the noise in ``NOISES``.
    simulated : the recording before any filter, with its truth.
    slsqp, tracker : touching elements; the tracker's are of its longest segment of this contact, None
        without one.
    slsqp_errors, tracker_errors : of these elements against the true ones, object and environment.
    bound : Cramer-Rao bounds (d, d) of the errors of either element, for white noise: filters add no
        information.
    labelled : share of the time in which the tracker's label was right.
    """

    contact: Contact
    noise: str
    simulated: Simulated
    slsqp: ContactGeometry
    tracker: ContactGeometry | None
    slsqp_errors: tuple[ElementError, ...]
    tracker_errors: tuple[ElementError, ...]
    bound: tuple[Array, Array]
    labelled: float

    def bound_of(self, side: str, kind: str) -> Array | None:
        """The bound of the angle (rad) or the distance (m) alone; None if an element has none."""
        index = SIDES.index(side)
        parts = dict(angles_and_distances(self.contact, index, len(self.bound[index])))
        return self.bound[index][parts[kind], parts[kind]] if kind in parts else None


def replicate_contact(contact: Contact, noise: str, seed: int) -> SingleContact:
    """Move the paper's cube on a desk for ten seconds, with the noise of motion capture, and estimate.

    Parameters
    ----------
    noise : a name in ``NOISES``.
    seed : of the recording. Motion and white noise do not depend on ``noise``.
    """
    scenario = Scenario((Phase(contact, SECONDS),), name=f"paper: {contact.value}")
    simulated = simulate(scenario, seed)
    poses = NOISES[noise](simulated.poses)
    found = segmenting.segment(poses, load_model()).segments
    by_slsqp = estimate_by_slsqp(contact, poses, np.random.default_rng(seed))
    whole = Segment(int(poses.stamp_ns[0]), int(poses.stamp_ns[-1]), contact, 1.0, by_slsqp)
    right = [segment for segment in found if segment.contact is contact]
    longest = max(right, key=lambda segment: segment.end_ns - segment.start_ns, default=None)
    return SingleContact(
        contact,
        noise,
        simulated,
        by_slsqp,
        longest.geometry if longest else None,
        geometry_errors(poses, simulated.truth, [whole]).rows,
        geometry_errors(poses, simulated.truth, right).rows,
        _bound(contact, scenario, simulated, seed),
        sum(one.end_ns - one.start_ns for one in right) / (whole.end_ns - whole.start_ns),
    )


def estimate_by_slsqp(contact: Contact, poses: Poses, rng: np.random.Generator) -> ContactGeometry:
    """The elements at the lowest minimum of the paper's objective, by the paper's method.

    The world's origin is shifted to the mean position, which does not change the minima of ``MOVED``
    (docs/theory.md, T8 to T11).
    """
    origin_m = poses.position_m.mean(axis=0)
    k = matrix(contact, *motion(poses.rotation, poses.position_m - origin_m))
    found = minimise_slsqp(contact, k, rng, SINGLE_STARTS)
    kinds = form(contact).x, form(contact).y
    of_object, of_environment = kinds if form(contact).object_first else kinds[::-1]
    return ContactGeometry(
        _element(of_object, found.object, np.zeros(3)), _element(of_environment, found.environment, origin_m)
    )


def _element(kind: Kind, e: Array, origin_m: Array) -> Element:
    """The paper's array, given about ``origin_m``, as an element about zero."""
    match kind:
        case "plane":
            return Plane(e[:3], float(e[3] + e[:3] @ origin_m))
        case "line":
            return Line(e[:3], np.cross(e[:3], e[3:]) + origin_m)
        case "point":
            return Point(e[:3] + origin_m)


def _bound(contact: Contact, scenario: Scenario, simulated: Simulated, seed: int) -> tuple[Array, Array]:
    still = replace(scenario, sigma_position_m=0.0, sigma_rotation_rad=0.0)
    true_poses = simulate(still, seed).poses  # equal seeds: equal motion
    (interval,) = simulated.truth.intervals
    if interval.geometry is None:
        raise ValueError(f"{contact.value} has no elements")
    sigma = scenario.sigma_position_m, scenario.sigma_rotation_rad
    return cramer_rao(CONTACT_MODELS[contact.column], interval.geometry, true_poses, sigma)


@dataclass(frozen=True, eq=False)
class ContactSequence:
    """The W windows of one recording, and the tracker's segmentation.

    Parameters
    ----------
    noise : its name in ``NOISES``.
    poses : as recorded.
    truth : (N,) column of the true state of each pose.
    windows : minima of all six objectives, by the batched minimiser.
    slsqp_window, slsqp_minimum : (S,) some of the windows, and (S, 4) their minima by SLSQP from three random
        starts, for the contacts of ``MOVED``.
    segmentation : of the tracker.
    """

    noise: str
    poses: Poses
    truth: NDArray[np.int8]
    windows: WindowCurves
    slsqp_window: Ints
    slsqp_minimum: Array
    segmentation: Segmentation

    @property
    def curves(self) -> Array:
        """(W, 4) minima for ``MOVED``, each column over its maximum."""
        return self.windows.normalised[:, COLUMNS]

    @property
    def slsqp_points(self) -> Array:
        """(S, 4) minima by SLSQP, in the scale of ``curves``."""
        return np.asarray(self.slsqp_minimum / self.windows.minimum[:, COLUMNS].max(axis=0))

    @property
    def slsqp_gain(self) -> Array:
        """(S, 4) how much lower the minima by SLSQP are, relative to the curves' maximum."""
        return np.asarray(self.curves[self.slsqp_window] - self.slsqp_points)

    def window_at(self, stamp_ns: Ints) -> Array:
        """Fractional index of the window that ends at each stamp (K,); negative before the first."""
        frame = np.interp(stamp_ns, self.poses.stamp_ns, np.arange(len(self.poses)))
        return np.asarray((frame - (FRAMES - 1)) / STEP)

    @property
    def window_truth(self) -> Ints:
        """(W,) column of a window's state, -1 for one with a change."""
        begin = np.arange(len(self.windows.stamp_ns)) * STEP
        changes = np.concatenate([[0], np.cumsum(self.truth[1:] != self.truth[:-1])])
        whole = changes[begin] == changes[begin + FRAMES - 1]
        return np.where(whole, self.truth[begin], -1).astype(np.int64)

    @property
    def online(self) -> Ints:
        """(W,) the last reported tick at the end of a window."""
        return tick_in_force(self.windows.stamp_ns, self.segmentation.filtered.stamp_ns)

    @property
    def offline(self) -> Ints:
        """(W,) the tick in which a window ends."""
        ticks = self.segmentation.beliefs.stamp_ns
        return np.minimum(np.searchsorted(ticks, self.windows.stamp_ns), len(ticks) - 1).astype(np.int64)

    def lowest(self) -> list[Contact]:
        """(W,) the contact of ``MOVED`` whose curve is lowest in each window."""
        return [MOVED[column] for column in self.curves.argmin(axis=1)]

    def online_labels(self) -> list[Contact]:
        """(W,) the tracker's online label at the end of a window."""
        labels = self.segmentation.filtered.contacts
        return [labels[tick] for tick in self.online]

    def offline_labels(self) -> list[Contact]:
        """(W,) the tracker's offline label at the end of a window."""
        labels = self.segmentation.beliefs.contacts
        return [labels[tick] for tick in self.offline]


def replicate_sequence(noise: str, seed: int, slsqp_every: int) -> ContactSequence:
    """Move the paper's cube at rest, then in f-f, e-f, v-f and e-e for ten seconds each.

    Parameters
    ----------
    noise : a name in ``NOISES``.
    seed : of the recording; with 1 and white noise it is ``recordings/paper_experiment.mcap``.
    slsqp_every : SLSQP, which takes a hundred times longer, runs on every so many-th window.
    """
    simulated = simulate("paper_experiment", seed)
    poses = NOISES[noise](simulated.poses)
    windows = curves(poses, FRAMES, STEP)
    some = np.arange(0, len(windows.stamp_ns), slsqp_every)
    return ContactSequence(
        noise,
        poses,
        scoring(poses.stamp_ns, simulated.truth).truth,
        windows,
        some,
        _by_slsqp(poses, some, np.random.default_rng(seed)),
        segmenting.segment(poses, load_model()),
    )


def _by_slsqp(poses: Poses, windows: Ints, rng: np.random.Generator) -> Array:
    rotation, p = motion(poses.rotation, poses.position_m - poses.position_m.mean(axis=0))
    return np.array(
        [
            [
                minimise_slsqp(
                    contact, matrix(contact, rotation[frames], p[frames]), rng, WINDOW_STARTS
                ).value
                for contact in MOVED
            ]
            for frames in (slice(STEP * window, STEP * window + FRAMES) for window in windows)
        ]
    )
