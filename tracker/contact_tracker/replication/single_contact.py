"""The paper's first experiment: estimation of the touching elements of an object in one contact.

SLSQP minimises the paper's objective of the known contact from ten random starts. The tracker segments the
same poses without prior knowledge.
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from contact_tracker.adaptation import offline
from contact_tracker.config.loading import load_model
from contact_tracker.contacts import CONTACT_MODELS
from contact_tracker.evaluation.bound import angles_and_distances, cramer_rao
from contact_tracker.evaluation.geometry_errors import SIDES, ElementError, geometry_errors
from contact_tracker.geometry.elements import ContactGeometry, Element, Line, Plane, Point
from contact_tracker.motion.poses import Poses
from contact_tracker.paper import form, matrix, minimise_slsqp, motion
from contact_tracker.paper.kronecker import Kind
from contact_tracker.replication.noises import NOISES
from contact_tracker.states import Contact
from contact_tracker.tracking.belief import Segment
from contact_tracker_lab.simulate import Phase, Scenario, Simulated, simulate

Array = NDArray[np.float64]

MOVED: Final = (Contact.FF, Contact.EF, Contact.VF, Contact.EE)
"""The contacts of the paper's cube, in its order."""
SECONDS: Final = 10.0
STARTS: Final = 10


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
    found = offline.segment(poses, load_model()).segments
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
    found = minimise_slsqp(contact, k, rng, STARTS)
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
    return cramer_rao(CONTACT_MODELS[contact.column], interval.geometry, true_poses, *sigma)
