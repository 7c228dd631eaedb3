"""All parameters of the tracker, by what they are about (docs/models.md)."""

from dataclasses import dataclass, replace
from functools import cached_property
from math import exp
from typing import Final

from contact_tracker.states import CONTACTS, STATES

ByState = tuple[float, ...]
"""A number for each of the seven states; in the file a table of their names, without those that are zero."""
ZERO: Final[ByState] = (0.0,) * len(STATES)
ByChange = tuple[ByState, ...]
"""Numbers (7, 7), from row to column; in the file a table of tables."""


@dataclass(frozen=True)
class Noise:
    """Standard deviations of one pose, and how the noise of a tick is found."""

    sigma_position_m: float
    sigma_rotation_rad: float
    floor_position_m: float
    """Deviation of real contacts from ideal geometry, which no averaging removes."""
    floor_rotation_rad: float
    outlier_sigmas: float
    contact_position_m: ByState = ZERO
    """Of each contact, beyond the floor of all."""
    contact_rotation_rad: ByState = ZERO
    estimated: bool = True
    """Whether the deviations of a pose only start an estimate, which then follows the stream, and the floors
    of a tick are chosen by the evidence; if not, both are what the user knows."""
    wander_position_m: float = 0.0
    wander_rotation_rad: float = 0.0
    """Of errors that last for a while, as of calibration, beyond those that are new in each pose."""
    wander_s: float = 2.0
    """For how long they last: their autocorrelation falls by e."""
    estimate_share: float = 1.0
    """Share of the estimated deviations that is noise: of slow streams the rest is motion."""

    @cached_property
    def wander_variance(self) -> tuple[float, float]:
        """Variances (m^2, rad^2) of the errors that last."""
        return self.wander_position_m**2, self.wander_rotation_rad**2

    @cached_property
    def extra_contact_variance(self) -> tuple[tuple[float, float], ...]:
        """Variances (m^2, rad^2) that each contact has beyond the floor."""
        deviations = zip(self.contact_position_m, self.contact_rotation_rad, strict=True)
        return tuple((m**2, rad**2) for m, rad in deviations)[: len(CONTACTS)]


@dataclass(frozen=True)
class Motion:
    """Yardstick of free motion."""

    error_memory_s: float
    """Time over which the strength of the motion is averaged."""
    body_radius_m: float
    """Lever with which free rotation moves a point of the object."""
    prior_predictive_share: float
    """How much of the geometry free motion, continued, is taken to foretell (share of T19's last term)."""
    likelihood_exponent: float
    """Share of what a tick says that the ticks before have not said: the power to which likelihoods count."""


@dataclass(frozen=True)
class Geometry:
    """What is expected of elements before they are found."""

    reach_m: float
    """Distance of touching points from the body's origin."""
    revisit_prior: float
    """Prior probability that an element has been met before in the recording, where one of its kind was."""


@dataclass(frozen=True)
class TransitionCounts:
    """What calibration has counted: how states began, lasted and ended in recordings; zeros without."""

    begins: ByState
    """Recordings that began in each state."""
    moving_s: ByState
    """Time in each state, weighted by the activity."""
    changes: ByChange
    """Changes from state to state; of a contact into itself those to other elements."""


@dataclass(frozen=True)
class Transitions:
    """How states follow each other: a prior from the containment lattice, and what was seen."""

    leave_per_s: float
    """How often a state of a moving object ends; at rest it hardly ever does."""
    skip: float
    """Weight of a change that skips constraints, relative to one that gains or loses one."""
    initial_f_f: float
    """Probability that the recording starts in f-f: things lie on faces."""
    prior_changes: float
    """What the three above weigh against what was seen: as much as so many changes out of each state."""
    counts: TransitionCounts


@dataclass(frozen=True)
class Certainty:
    """How far the probabilities are trusted."""

    posterior_power: float
    """Power of the posterior that is told: what the model does not know of its own faults."""


@dataclass(frozen=True)
class Search:
    """What is kept of the hypotheses."""

    window_s: float
    """Poses older than this are summed up, not looked at again."""
    margin_nats: float
    """Hypotheses this much worse than the best are dropped, once they have been weighed anew."""


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
    """A tick holds so many poses of the stream at least: of a slow one it is longer than ``tick_s``."""

    def with_noise(self, sigma_position_m: float, sigma_rotation_rad: float) -> "Model":
        """A copy for poses of which the noise is known: nothing of it is estimated."""
        noise = replace(
            self.noise,
            sigma_position_m=sigma_position_m,
            sigma_rotation_rad=sigma_rotation_rad,
            estimated=False,
        )
        return replace(self, noise=noise)

    @property
    def correlation(self) -> float:
        """Of the errors of a tick with those of the next, where errors wander; else zero."""
        return exp(-self.tick_s / self.noise.wander_s) if any(self.noise.wander_variance) else 0.0

    @property
    def tick_ns(self) -> int:
        """As long as ``tick_s``."""
        return round(self.tick_s * 1e9)
