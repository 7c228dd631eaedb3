"""All parameters of the tracker (docs/models.md)."""

from dataclasses import dataclass, replace
from functools import cached_property
from math import exp
from typing import Final

from contact_tracker.states import CONTACTS, STATES

ByState = tuple[float, ...]
"""A number for each of the seven states; in the file a table by name, without zeros."""
ZERO: Final[ByState] = (0.0,) * len(STATES)
ByChange = tuple[ByState, ...]
"""Numbers (7, 7) from row to column; in the file a table of tables."""


@dataclass(frozen=True)
class Noise:
    """Noise of one pose (standard deviations per axis), and of a tick."""

    sigma_position_m: float
    sigma_rotation_rad: float
    floor_position_m: float
    """Deviation of real contacts from ideal geometry, which averaging does not reduce."""
    floor_rotation_rad: float
    outlier_sigmas: float
    contact_position_m: ByState = ZERO
    """Floor of each contact beyond the common one, in quadrature."""
    contact_rotation_rad: ByState = ZERO
    estimated: bool = True
    """Whether the noise of a pose is estimated from the stream, with the deviations above as a prior, and the
    noise of a tick chosen by evidence; otherwise both are given."""
    wander_position_m: float = 0.0
    wander_rotation_rad: float = 0.0
    """Errors that are correlated over seconds, such as those of calibration, beyond white noise."""
    wander_s: float = 2.0
    """Correlation time of these errors (autocorrelation 1/e)."""
    estimate_share: float = 1.0
    """Share of the estimated deviations that is noise; in slow streams the rest is motion."""

    @cached_property
    def wander_variance(self) -> tuple[float, float]:
        """Variances (m^2, rad^2) of the correlated errors."""
        return self.wander_position_m**2, self.wander_rotation_rad**2

    @cached_property
    def extra_contact_variance(self) -> tuple[tuple[float, float], ...]:
        """Variances (m^2, rad^2) that each contact has beyond the floor."""
        deviations = zip(self.contact_position_m, self.contact_rotation_rad, strict=True)
        return tuple((m**2, rad**2) for m, rad in deviations)[: len(CONTACTS)]


@dataclass(frozen=True)
class SystematicErrors:
    """Errors of poses that depend on the pose, as those of calibration; standard deviations per axis.

    They hardly show in the noise or in residuals. They add to the covariance of elements; the
    evidence of contacts and the map do not use them.
    """

    position_m: float = 0.0
    rotation_rad: float = 0.0
    length_m: float = 0.1
    """Distance over which the error of the position changes."""
    angle_rad: float = 0.5
    """Turn over which the error of the orientation changes."""

    @cached_property
    def are_given(self) -> bool:
        """Whether systematic errors are given."""
        return self.position_m > 0.0 or self.rotation_rad > 0.0


@dataclass(frozen=True)
class Motion:
    """The model of free motion."""

    error_memory_s: float
    """Time over which the strength of the motion is averaged."""
    body_radius_m: float
    """Lever with which free rotation moves a point of the object."""
    prior_predictive_share: float
    """Share of the information on the geometry that the free-motion prediction provides (last term of
    T19)."""
    likelihood_exponent: float
    """Power of the likelihood: share of a tick's information that is independent of the ticks before."""
    initial_autocorrelation: float = 0.0
    """Autocorrelation of the prediction errors of free motion until some are known."""


@dataclass(frozen=True)
class Geometry:
    """Priors of the elements."""

    reach_m: float
    """Prior distance (m) of touching points from the body's origin."""
    revisit_prior: float
    """Prior probability that a contact whose elements are of other kinds than those of the last one is with
    elements incident to them."""


@dataclass(frozen=True)
class TransitionCounts:
    """Counts from calibration of how states began, lasted and ended; zeros without calibration."""

    begins: ByState
    """Number of recordings that began in each state."""
    moving_s: ByState
    """Time (s) in each state, weighted by the activity."""
    changes: ByChange
    """Number of changes from state to state; from a contact to itself: to other elements."""


@dataclass(frozen=True)
class Transitions:
    """Changes between states: a prior from the containment lattice, and counts."""

    leave_per_s: float
    """Rate (1/s) at which states of a moving object end; nearly zero at rest."""
    skip: float
    """Relative rate of a change that skips a step of the lattice."""
    initial_f_f: float
    """Probability that the recording starts in f-f: objects lie on faces."""
    prior_changes: float
    """Weight of the three parameters above against the counts, as a number of changes out of each state."""
    counts: TransitionCounts


@dataclass(frozen=True)
class Certainty:
    """Calibration of the probabilities."""

    posterior_power: float
    """Power of the reported posterior; below one for errors that the model lacks."""


@dataclass(frozen=True)
class Search:
    """Bounds of memory and work."""

    window_s: float
    """Length (s) of the window that is evaluated in full; older ticks are summed."""
    margin_nats: float
    """Hypotheses this far (nats) behind the best are pruned after a refit."""


@dataclass(frozen=True)
class Model:
    """All parameters of the tracker."""

    name: str
    tick_s: float
    noise: Noise
    motion: Motion
    geometry: Geometry
    transitions: Transitions
    certainty: Certainty
    search: Search
    poses_per_tick: float = 1.5
    """Least mean number of poses per tick: for a slow stream ticks are longer than ``tick_s``."""
    systematic: SystematicErrors = SystematicErrors()

    def with_systematic_errors(self, position_m: float, rotation_rad: float) -> "Model":
        """A copy with systematic errors of the poses."""
        errors = replace(self.systematic, position_m=position_m, rotation_rad=rotation_rad)
        return replace(self, systematic=errors)

    def with_noise(self, sigma_position_m: float, sigma_rotation_rad: float) -> "Model":
        """A copy with known noise of the poses, which is not estimated."""
        sigma_m, sigma_rad = sigma_position_m, sigma_rotation_rad
        noise = replace(self.noise, sigma_position_m=sigma_m, sigma_rotation_rad=sigma_rad, estimated=False)
        return replace(self, noise=noise)

    @cached_property
    def correlation(self) -> float:
        """Correlation of the errors of successive ticks, if errors wander; else zero."""
        return exp(-self.tick_s / self.noise.wander_s) if any(self.noise.wander_variance) else 0.0

    @cached_property
    def tick_ns(self) -> int:
        """Length of a tick in nanoseconds."""
        return round(self.tick_s * 1e9)
