"""Fits to simulated intervals of a known contact, with the Cramer-Rao bound of their errors."""

from dataclasses import dataclass, replace
from math import radians
from typing import Final, NamedTuple

import numpy as np
from scipy.signal import lfilter

from contact_tracker.arrays import Array
from contact_tracker.config.loading import load_model
from contact_tracker.config.parameters import Model, SystematicErrors
from contact_tracker.config.parameters import Noise as ModelNoise
from contact_tracker.contacts import CONTACT_MODELS
from contact_tracker.geometry.elements import ContactGeometry, Line, Plane
from contact_tracker.hypotheses.bank_update import fit_window
from contact_tracker.hypotheses.observability import fitted_contact
from contact_tracker.hypotheses.refinement import refine
from contact_tracker.motion.poses import Poses, batches
from contact_tracker.motion.window import window_of
from contact_tracker.states import Contact
from contact_tracker.tracking.belief import Segment
from contact_tracker.tracking.contact_filter import ticks_of
from contact_tracker.tracking.state import scales_of
from contact_tracker_lab.evaluation.bound import cramer_rao, errors
from contact_tracker_lab.evaluation.geometry_errors import Deviation, geometry_errors
from contact_tracker_lab.simulate import Scenario, simulate
from contact_tracker_lab.simulate.scenarios import Phase
from distortions import turned


class Noise(NamedTuple):
    """White noise of single poses, the duration of the contact, and errors that are not white.

    The compliance is an error along the normal with the standard deviation ``compliance_m`` and the
    correlation time ``correlation_s``. ``wander_*`` are errors of the poses with the correlation time of the
    model, ``systematic_*`` errors that depend on the pose. The model knows the size of both.
    """

    rate_hz: float
    sigma_m: float
    sigma_deg: float
    seconds: float
    compliance_m: float = 0.0
    correlation_s: float = 1.0
    wander_m: float = 0.0
    wander_deg: float = 0.0
    systematic_m: float = 0.0
    systematic_deg: float = 0.0

    @property
    def model(self) -> Model:
        """The shipped model with the errors that do not show in the noise."""
        shipped = load_model()
        wander_m, wander_rad = self.wander_m, radians(self.wander_deg)
        noise = replace(shipped.noise, wander_position_m=wander_m, wander_rotation_rad=wander_rad)
        known = replace(shipped, noise=noise)
        return known.with_systematic_errors(self.systematic_m, radians(self.systematic_deg))


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
    bound = cramer_rao(CONTACT_MODELS[contact.column], true, true_poses, sigma)
    model, poses = noise.model, _with_compliance(measured.poses, true, noise, seed)
    poses = with_systematic_errors(_with_wander(poses, model.noise, seed), model.systematic, seed)
    geometry = fitted_geometry(poses, contact, model)
    whole = Segment(int(true_poses.stamp_ns[0]), int(true_poses.stamp_ns[-1]), contact, 1.0, geometry)
    compared = geometry_errors(true_poses, measured.truth, [whole])
    return Fitted(errors(geometry, true, true_poses), bound, tuple(row.deviation for row in compared.rows))


def _with_compliance(poses: Poses, true: ContactGeometry, noise: Noise, seed: int) -> Poses:
    """The poses with the compliance of ``noise``."""
    if not noise.compliance_m:
        return poses
    error = _correlated(np.random.default_rng(seed), len(poses), noise.rate_hz * noise.correlation_s)
    along = _normals(true, poses.rotation)
    return replace(poses, position_m=poses.position_m + noise.compliance_m * error[:, None] * along)


def _with_wander(poses: Poses, noise: ModelNoise, seed: int) -> Poses:
    """The poses with the correlated errors of the model."""
    if not any(noise.wander_variance):
        return poses
    rng, memory = np.random.default_rng([seed, 1]), noise.wander_s * 1e9 / np.diff(poses.stamp_ns).mean()
    error = np.stack([_correlated(rng, len(poses), memory) for _ in range(6)], axis=1)
    shift, turn = noise.wander_position_m * error[:, :3], noise.wander_rotation_rad * error[:, 3:]
    return replace(poses, position_m=poses.position_m + shift, quat_xyzw=turned(poses, turn))


def with_systematic_errors(poses: Poses, errors: SystematicErrors, seed: int) -> Poses:
    """The poses with errors drawn from the Gaussian process of the model."""
    if not errors.are_given:
        return poses
    rng, rotation = np.random.default_rng([seed, 2]), poses.rotation.reshape(-1, 9)
    away_m = np.linalg.norm(poses.position_m[:, None] - poses.position_m, axis=2)
    apart = np.linalg.norm(rotation[:, None] - rotation, axis=2) / np.sqrt(2.0)
    shift = errors.position_m * _drawn(rng, away_m / errors.length_m)
    turn = errors.rotation_rad * _drawn(rng, apart / errors.angle_rad)
    return replace(poses, position_m=poses.position_m + shift, quat_xyzw=turned(poses, turn))


def _drawn(rng: np.random.Generator, apart: Array) -> Array:
    """Three independent draws (N, 3) of a process whose covariance is a bell curve of ``apart`` (N, N)."""
    values, vectors = np.linalg.eigh(np.exp(-0.5 * apart**2))
    scaled = np.sqrt(np.maximum(values, 0.0))[:, None] * rng.normal(size=(len(apart), 3))
    return np.asarray(vectors @ scaled)


def _correlated(rng: np.random.Generator, count: int, memory: float) -> Array:
    """An autoregressive error (N,) of order one with unit variance and a correlation time in poses."""
    rho = np.exp(-1.0 / memory)
    white = rng.normal(size=count + SETTLING)
    return np.asarray(lfilter([np.sqrt(1.0 - rho**2)], [1.0, -rho], white)[SETTLING:])


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


def fitted_geometry(poses: Poses, contact: Contact, model: Model | None = None) -> ContactGeometry:
    """The geometry that the offline tracker fits to a segment of these poses with this label."""
    model = load_model() if model is None else model
    closed = list(ticks_of(batches(poses), model))
    window = window_of(closed, model)
    kind, scales = CONTACT_MODELS[contact.column], scales_of(model)
    fitted, information = refine(fit_window(kind, window, scales), kind, window, scales)
    origins = closed[0].origins
    return fitted_contact(fitted, 0, kind, scales, window, origins, model.systematic, information).geometry
