"""The extension module built from ``tracker/core``; ``calls`` converts its arguments."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

Numbers = NDArray[np.float64]
Index = NDArray[np.int64]
Bools = NDArray[np.bool_]

FINGERPRINT: str
"""Fingerprint of the sources (``sources.fingerprint``)."""

def configure(settings: Mapping[str, object]) -> None:
    """Set the constants of the algorithm (see ``calls``); required before any other call."""

class Model:
    """A contact model, see ``calls.model_of``.

    ``bank`` and ``onsets`` are the number of words per row of the two tables, and the first word of each
    column.

    Raises
    ------
    ValueError
        If the kernels have no family of this ``form`` and these ``sizes`` (S, C, K, P).
    """

    def __init__(
        self,
        form: tuple[int, ...],
        sizes: tuple[int, int, int, int],
        bank: tuple[int, Mapping[str, int]],
        onsets: tuple[int, Mapping[str, int]],
        body_in_1: bool,
        needed: float,
        burn_in: float,
        lifted: Sequence[int],
        pull: Sequence[float],
        relaxed: int,
        column: int,
        search_interval: int,
        drawn: Numbers,
    ) -> None: ...

class Ticks:
    """The ticks of a ``window.Window``, see ``calls.ticks_of``."""

    def __init__(
        self,
        number: Index,
        pose: Numbers,
        inverse: Numbers,
        variance: Numbers,
        excess: Numbers,
        displacement_variance: Numbers,
        position_anisotropy: Numbers | None,
        before: Numbers | None,
    ) -> None: ...

class EvidenceParameters:
    """Like ``evidence.EvidenceParameters``; ``pull`` is the weak prior's cost of a touching point's squared
    distance (1/m^2)."""

    def __init__(
        self,
        radius_sq: float,
        pull: float,
        correlation: float,
        prior_predictive_share: float,
        likelihood_exponent: float,
    ) -> None: ...

class BirthLimits:
    """Constants of births (``hypotheses/births.py``): the variance of any direction and any distance (m^2),
    the log share below which a birth is left out, and the most known pairs that begin."""

    def __init__(self, any_direction: float, any_distance: float, hopeless: float, most: int) -> None: ...

def update(
    models: Sequence[Model],
    words: Sequence[tuple[Numbers, Numbers]],
    births: Sequence[tuple[Numbers, Bools]],
    turn: Numbers,
    onset: int,
    onset_ns: int,
    number: int,
    log_birth_weight: Numbers,
    window: Ticks,
    before: Ticks | None,
    log_stay: Numbers,
    beyond: Sequence[tuple[float, float]],
    scales: EvidenceParameters,
    margin: float,
) -> tuple[
    list[tuple[Numbers, Numbers]],
    list[Index],
    tuple[Numbers, Numbers, Numbers, Index, tuple[Index, Index, Numbers]],
]: ...
def weigh_births(
    model: Model,
    words: Numbers,
    known: Bools,
    x: Numbers,
    deviation: Numbers,
    window: Ticks,
    beyond: tuple[float, float],
    limits: BirthLimits,
) -> tuple[float, list[float], Index, Numbers]: ...
def competing_evidence(
    models: Sequence[Model], words: Sequence[Numbers], label: int, onset: int, slack: int
) -> tuple[Numbers, Numbers]: ...
def motion_since(window: Ticks, onset: int) -> tuple[int, float]: ...
def fit_window(
    model: Model,
    words: Numbers,
    onsets: Numbers,
    window: Ticks,
    turn: Numbers,
    tick: int,
    scales: EvidenceParameters,
) -> tuple[Numbers, Numbers]: ...
