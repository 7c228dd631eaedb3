"""Convert arrays of the numpy code to those of the kernels, and back."""

from functools import cache, lru_cache

import numpy as np

from contact_tracker.contacts import CONTACT_MODELS, ContactModel, edge_edge, family
from contact_tracker.geometry import linalg
from contact_tracker.geometry.lifted_pose import lift_of_inverse
from contact_tracker.hypotheses import evidence, gauss_newton, schedule
from contact_tracker.hypotheses.bank import Bank, Onsets, layout
from contact_tracker.hypotheses.compiled import kernels
from contact_tracker.hypotheses.evidence import EvidenceParameters
from contact_tracker.hypotheses.global_search import drawn
from contact_tracker.hypotheses.schedule import burn_in_ticks
from contact_tracker.motion import window as motion
from contact_tracker.motion.window import Window

weigh_births = kernels.weigh_births
competing_evidence = kernels.competing_evidence
motion_since = kernels.motion_since
fit_window = kernels.fit_window


@lru_cache(maxsize=64)
def model_of(model: ContactModel, reach_m: float) -> kernels.Model:
    """The kernels' form of a contact model."""
    family, bank, onsets = model.family, layout(Bank, model), layout(Onsets, model)
    columns = family.COLUMNS.tolist()
    return kernels.Model(
        tuple(family.FORM),
        (family.SIZE, len(columns), family.ROWS, family.PARAMETERS),
        _words_of(bank),
        _words_of(onsets),
        model.body_in_1,
        model.needed,
        burn_in_ticks(model.needed),
        columns,
        (family.SPREAD / reach_m**2).tolist(),
        family.starts(np.eye(len(columns))[None]).shape[1],
        model.contact.column,
        schedule.SEARCH_INTERVAL,
        drawn(family.RANDOM_STARTS, family.SIZE),
    )


def _words_of(layout: np.dtype[np.void]) -> tuple[int, dict[str, int]]:
    """Number of words per row, and the first word of each column."""
    return layout.itemsize // 8, {name: field[1] // 8 for name, field in (layout.fields or {}).items()}


@lru_cache(maxsize=8)
def models(reach_m: float) -> list[kernels.Model]:
    return [model_of(model, reach_m) for model in CONTACT_MODELS]


@lru_cache(maxsize=32)  # of a tick and of the one before, for each of the filters side by side
def ticks_of(window: Window) -> kernels.Ticks:
    """The kernels' form of a window."""
    before = window.before
    return kernels.Ticks(
        window.index,
        window.zeta,
        window.inverse,
        window.variance,
        window.innovation_excess,
        window.displacement_variance,
        window.position_anisotropy,
        None if before is None else np.array([before, lift_of_inverse(before[None])[0]]),
    )


@cache
def weights_of(scales: EvidenceParameters) -> kernels.EvidenceParameters:
    """The kernels' form of the evidence parameters."""
    pull = 0.5 / (2.0 * scales.reach_m) ** 2 * scales.tick_s
    return kernels.EvidenceParameters(
        scales.body_radius_m**2,
        pull,
        scales.correlation,
        scales.prior_predictive_share,
        scales.likelihood_exponent,
    )


@lru_cache(maxsize=8)
def birth_limits(any_direction: float, reach_m: float, hopeless: float, most: int) -> kernels.BirthLimits:
    """The kernels' form of the constants of ``births``."""
    return kernels.BirthLimits(any_direction, reach_m**2, hopeless, most)


def _settings() -> dict[str, object]:
    """Constants of the algorithm by their names in C++ (``tracker/core/settings.hpp``)."""
    names = (
        *("FIRST_TICKS", "FIRST_STEPS", "REST_WEIGHT", "NEAR_NATS", "RECOVERY_STEPS"),
        *("FOLLOWED_STARTS", "UNTHINNED_TICKS", "ROUNDS"),
    )
    fits = ("FIRST_DAMPING", "LEAST_CURVATURE", "TOLERANCE")
    moving = ("USED", "LEVER_M", "ONE_AXIS", "NO_MOTION", "STRIDE_TICKS")
    shared = ("LEAST_SHARE", "LEAST_DAMPING", "MOST_DAMPING", "DAMPING_DECREASE", "DAMPING_INCREASE")
    return {
        **{name.lower(): getattr(schedule, name) for name in names},
        **{name.lower(): getattr(gauss_newton, name) for name in fits},
        **{name.lower(): getattr(linalg, name) for name in shared},
        **{name.lower(): getattr(motion, name) for name in moving},
        "sine_sq_floor": edge_edge.SINE_SQ_FLOOR,
        "tiny": linalg.TINY,
        "ridge": family.RIDGE,
        "decisive": evidence.DECISIVE,
        "fitting_rms": evidence.SAME_FIT_RATIO,
        "search_ages": schedule.SEARCH_AGES.tolist(),
        "is_search_age": schedule.IS_SEARCH_AGE.tolist(),
    }


kernels.configure(_settings())
