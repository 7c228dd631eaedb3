"""A simulated stretch of a known contact: what is found of it, and how good that could have been at best."""

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
    """White noise of single poses, for how long a contact is seen, and how much it gives way: an error of
    ``gives_m`` (standard deviation) along its normal, of which 1/e is left after ``lasts_s``."""

    rate_hz: float
    sigma_m: float
    sigma_deg: float
    seconds: float
    gives_m: float = 0.0
    lasts_s: float = 1.0


NOISES: Final = {
    "mocap": Noise(200.0, 0.3e-3, 0.15, 8.0),
    "coarse": Noise(200.0, 0.5e-3, 0.3, 8.0),
    "robot": Noise(1000.0, 0.05e-3, 0.02, 4.0),
    "vision": Noise(30.0, 1.5e-3, 0.7, 12.0),
}


BEFORE: Final = 10_000
"""Poses after which an error that lasts has forgotten how it began."""


@dataclass(frozen=True, eq=False)
class Found:
    """Of both elements: the error, the least covariance it can have, and the one claimed."""

    error: tuple[Array, Array]
    bound: tuple[Array, Array]
    deviation: tuple[Deviation, ...]


def find_simulated(contact: Contact, noise: Noise, seed: int) -> Found:
    """Find the elements of one simulated stretch of a known contact."""
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
    found = stretch_geometry(_giving(measured.poses, true, noise, seed), contact)
    whole = Segment(int(true_poses.stamp_ns[0]), int(true_poses.stamp_ns[-1]), contact, 1.0, found)
    judged = geometry_errors(true_poses, measured.truth, [whole])
    return Found(errors(found, true, true_poses), bound, tuple(row.deviation for row in judged.rows))


def _giving(poses: Poses, true: ContactGeometry, noise: Noise, seed: int) -> Poses:
    """The poses where the contact gives way as ``noise`` says."""
    if not noise.gives_m:
        return poses
    rng, left = np.random.default_rng(seed), np.exp(-1.0 / (noise.rate_hz * noise.lasts_s))
    away_m = lfilter([np.sqrt(1.0 - left**2)], [1.0, -left], rng.normal(size=len(poses) + BEFORE))[BEFORE:]
    along = _normals(true, poses.rotation)
    return replace(poses, position_m=poses.position_m + noise.gives_m * away_m[:, None] * along)


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


def stretch_geometry(poses: Poses, contact: Contact) -> ContactGeometry:
    """What the segmenter finds of a segment with this label and just these poses."""
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
