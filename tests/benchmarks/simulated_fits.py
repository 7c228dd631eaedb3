"""Fits to simulated intervals of a known contact, with the Cramer-Rao bound of their errors."""

from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from contact_tracker.config.loading import load_model
from contact_tracker.contacts import CONTACT_MODELS
from contact_tracker.evaluation.bound import cramer_rao, errors
from contact_tracker.evaluation.elements import Deviation
from contact_tracker.evaluation.geometry_errors import geometry_errors
from contact_tracker.geometry.elements import ContactGeometry, Line, Plane
from contact_tracker.hypotheses.contact_geometry import contact_geometry
from contact_tracker.hypotheses.refinement import refine
from contact_tracker.hypotheses.window_fit import fit_window
from contact_tracker.motion.poses import Poses
from contact_tracker.motion.tick_averaging import tick_anisotropy, tick_variances
from contact_tracker.motion.window import Window
from contact_tracker.simulate import Scenario, simulate
from contact_tracker.simulate.scenarios import Phase
from contact_tracker.states import Contact
from contact_tracker.tracking import tracker
from contact_tracker.tracking.belief import Segment

Array = NDArray[np.float64]


class Noise(NamedTuple):
    """White noise of single poses, the duration of the contact, and its compliance: an error along the normal
    with the standard deviation ``compliance_m`` and the correlation time ``correlation_s``."""

    rate_hz: float
    sigma_m: float
    sigma_deg: float
    seconds: float
    compliance_m: float = 0.0
    correlation_s: float = 1.0


NOISES: Final = {
    "mocap": Noise(200.0, 0.3e-3, 0.15, 8.0),
    "coarse": Noise(200.0, 0.5e-3, 0.3, 8.0),
    "robot": Noise(1000.0, 0.05e-3, 0.02, 4.0),
    "vision": Noise(30.0, 1.5e-3, 0.7, 12.0),
}


SETTLING: Final = 10_000
"""Poses after which a correlated error is independent of its initial value."""


@dataclass(frozen=True, eq=False)
class Fitted:
    """Of both elements: the error, its least covariance, and its deviation by the estimated covariance."""

    error: tuple[Array, Array]
    bound: tuple[Array, Array]
    deviation: tuple[Deviation, ...]


def fit_simulated(contact: Contact, noise: Noise, seed: int) -> Fitted:
    """Fit the elements of one simulated interval of a known contact."""
    scenario = Scenario(
        (Phase(contact, noise.seconds),),
        rate_hz=noise.rate_hz,
        sigma_position_m=noise.sigma_m,
        sigma_rotation_rad=float(np.radians(noise.sigma_deg)),
    )
    measured = simulate(scenario, seed)
    still = replace(scenario, sigma_position_m=0.0, sigma_rotation_rad=0.0)
    true_poses = simulate(still, seed).poses  # equal seeds: equal motion
    true = measured.truth.intervals[0].geometry
    assert true is not None
    sigma = scenario.sigma_position_m, scenario.sigma_rotation_rad
    bound = cramer_rao(CONTACT_MODELS[contact.column], true, true_poses, *sigma)
    found = fitted_geometry(_with_compliance(measured.poses, true, noise, seed), contact)
    whole = Segment(int(true_poses.stamp_ns[0]), int(true_poses.stamp_ns[-1]), contact, 1.0, found)
    compared = geometry_errors(true_poses, measured.truth, [whole])
    return Fitted(errors(found, true, true_poses), bound, tuple(row.deviation for row in compared.rows))


def _with_compliance(poses: Poses, true: ContactGeometry, noise: Noise, seed: int) -> Poses:
    """The poses with the compliance of ``noise``."""
    if not noise.compliance_m:
        return poses
    rng, rho = np.random.default_rng(seed), np.exp(-1.0 / (noise.rate_hz * noise.correlation_s))
    white = rng.normal(size=len(poses) + SETTLING)
    error = lfilter([np.sqrt(1.0 - rho**2)], [1.0, -rho], white)[SETTLING:]
    along = _normals(true, poses.rotation)
    return replace(poses, position_m=poses.position_m + noise.compliance_m * error[:, None] * along)


def _normals(true: ContactGeometry, rotation: Array) -> Array:
    """The common normal of both elements in the world, (N, 3)."""
    match true.object, true.environment:
        case _, Plane(normal):
            return np.tile(normal, (len(rotation), 1))
        case Plane(normal), _:
            return rotation @ normal
        case Line(first), Line(second):
            across = np.cross(rotation @ first, second)
            return np.asarray(across / np.linalg.norm(across, axis=1, keepdims=True))
    raise TypeError("no contact")


def fitted_geometry(poses: Poses, contact: Contact) -> ContactGeometry:
    """The geometry that the offline tracker fits to a segment of these poses with this label."""
    state, closed = tracker.start(load_model()), []
    for pose in poses:
        state, some = tracker.accumulate_pose(state, pose)
        closed += some
    state, some = tracker.close_tick(state)
    closed += some
    assert state.averaging is not None
    noise = closed[-1].noise
    counts = np.array([float(tick.count) for tick in closed])
    window = Window(
        np.arange(len(closed)),
        np.array([tick.zeta for tick in closed]),
        tick_variances(noise, counts, state.model),
        np.array(
            [[tick.innovation_excess.position_m2, tick.innovation_excess.rotation_rad2] for tick in closed]
        ),
        tick_anisotropy(noise, counts, state.model),
    )
    model, scales = CONTACT_MODELS[contact.column], tracker.scales_of(state.model)
    fitted, information = refine(fit_window(model, window, scales), model, window, scales)
    return contact_geometry(fitted, 0, model, scales, window, state.averaging.origin_m, information)
