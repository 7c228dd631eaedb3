"""What ``tracker/kernels`` is built into; ``calls`` says what for."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Numbers = NDArray[np.float64]
Index = NDArray[np.int64]
Bools = NDArray[np.bool_]

FINGERPRINT: str
"""Of the sources."""

class Model:
    """What sort of contact it is.

    Of the rows of both tables how many words they have, and where columns begin.

    Raises
    ------
    ValueError
        Where the kernels know no family of this ``form`` and these ``sizes`` (S, C, K, P).
    """

    def __init__(
        self,
        form: tuple[int, ...],
        sizes: tuple[int, int, int, int],
        bank: tuple[int, Mapping[str, int]],
        onsets: tuple[int, Mapping[str, int]],
        body_in_1: bool,
        needed: float,
        patience: float,
        lifted: Sequence[int],
        pull: Sequence[float],
        relaxed: int,
    ) -> None: ...

class Ticks:
    """As ``window.Window``."""

    def __init__(
        self,
        number: Index,
        pose: Numbers,
        inverse: Numbers,
        variance: Numbers,
        excess: Numbers,
        unheld: Numbers,
        uneven: Numbers | None,
    ) -> None: ...

class Weights:
    """As ``evidence.Scales``; ``pull`` is what a touching point far away costs, per m^2."""

    def __init__(self, radius_sq: float, pull: float, foreknowledge: float, independence: float) -> None: ...

class Moment:
    """As ``hypotheses.Moment``, see ``calls.moment``."""

    def __init__(
        self,
        assumed: Sequence[tuple[Numbers, Bools]],
        directions: Sequence[Numbers | None],
        turn: Numbers,
        onset: int,
        onset_ns: int,
        stamp_ns: int,
        window: Ticks,
        before: Ticks | None,
        change: Numbers,
        log_stay: Numbers,
    ) -> None: ...

class Until:
    """As ``hypotheses.Until``."""

    def __init__(self, probability: float, sureness: float, due: Sequence[tuple[int, int]]) -> None: ...

def summed(
    model: Model, x: Numbers, onset: Index, certain: Bools, ticks: Ticks, weights: Weights
) -> tuple[Numbers, Numbers, Numbers]: ...
def strode(
    models: Sequence[Model],
    words: Sequence[tuple[Numbers, Numbers]],
    moments: Sequence[Moment],
    number: int,
    entry: Numbers,
    beyond: Sequence[tuple[float, float]],
    weights: Weights,
    margin: float,
    until: Until | None,
) -> tuple[
    list[tuple[Numbers, Numbers]],
    list[Index],
    list[tuple[Numbers, Numbers, Numbers, Index, tuple[Index, Index, Numbers]]],
]: ...
def used_directions(
    poses: Numbers, activity: Numbers, variance: Sequence[float], stride: int, tiny: float, used: float
) -> int: ...
def rivals(
    models: Sequence[Model], words: Sequence[Numbers], label: int, onset: int, slack: int, far: float
) -> tuple[Numbers, Numbers]: ...
def entered(log_left: Numbers, change: Numbers) -> Numbers: ...
def learned(
    model: Model, words: Numbers, onsets: Numbers, ticks: Ticks, steps: Index, weights: Weights
) -> None: ...
def shown(
    model: Model,
    words: Numbers,
    onsets: Numbers,
    variance: Sequence[float],
    off: Numbers,
    vague: Numbers,
    information: Numbers | None,
) -> tuple[Numbers, Numbers, Numbers, Numbers, Numbers]: ...
def searched(
    model: Model,
    words: Numbers,
    onsets: Numbers,
    ticks: Ticks,
    rows: Index,
    directions: Numbers,
    turn: Numbers,
    weights: Weights,
) -> None: ...
def begun(
    model: Model,
    blank: Numbers,
    first: Sequence[Numbers],
    second: Sequence[Numbers],
    near_m: Numbers | None,
    log_share: Sequence[float],
    pair: Sequence[int],
    certain: Sequence[bool],
    met: Sequence[bool],
) -> tuple[Numbers, Bools]: ...
def part_row(numbers: Numbers, covariance: Numbers, lengths: int, smallest: float) -> Numbers: ...
def face_row(numbers: Numbers, covariance: Numbers, smallest: float) -> Numbers: ...
def polished(
    model: Model, words: Numbers, onsets: Numbers, ticks: Ticks
) -> tuple[Numbers, Numbers, Numbers, Numbers, bool, bool]: ...
def minimised(
    of_x: str, of_y: str, k: Numbers, x: Numbers, y: Numbers, tolerance: float, iterations: int
) -> tuple[Numbers, Numbers, Numbers, Bools]: ...

class Averaging:
    """How ticks are averaged: their length, the model's deviations and variances of a frame (m, rad), whether
    the noise is estimated from the stream, and ``free_motion.Onward``."""

    def __init__(
        self,
        tick_ns: int,
        prior: tuple[float, float],
        floor: tuple[float, float],
        outlier_sigmas: float,
        estimated: bool,
        onward: Numbers,
        jerk: Numbers,
        fade: float,
        fade_shape: float,
    ) -> None: ...

def averaged(
    how: Averaging,
    ends: Index,
    first_ns: int,
    origin_m: Numbers,
    is_rest: bool,
    frames: tuple[Index, Numbers, Numbers],
    noise: tuple[Numbers, Numbers, Numbers, Numbers],
    differences: Numbers,
    waiting: tuple[Index, Numbers, Numbers],
    motion: tuple[Any, ...] | None,
) -> tuple[
    list[tuple[int, tuple[Numbers, Numbers, Numbers, Numbers]]],
    Numbers | None,
    tuple[Index, Numbers, Numbers],
    tuple[Any, ...] | None,
    tuple[list[Numbers], list[int], list[int], list[tuple[float, float]]],
]:
    """As ``averaging.averaged``.

    The noise after each tick that tells it anew, and the differences that do, where some are new; the frames
    that wait; the motion; and of each tick ``zeta``, ``count``, ``outliers`` and ``excess``.
    """

class Forward:
    """As ``hmm.Forward``, the tuples as ``hmm.Step`` and ``hmm.Living``."""

    def __init__(self, log_initial: Sequence[float], negligible: float) -> None: ...
    def advance(
        self, state: Index, onset: Index, log_likelihood: Numbers, log_transition: Numbers
    ) -> tuple[Numbers, NDArray[np.int32], NDArray[np.int8], Numbers, NDArray[np.int32]]: ...
    def living(self) -> tuple[Index, Index, Numbers, Numbers, Index]: ...

def covered(steps: list[Any], first: int, onset: Index, state: Index, probability: Numbers) -> Numbers: ...
def in_common(
    steps: list[Any],
    first: int,
    onset: Index,
    state: Index,
    futures: Numbers,
    tolerance: float,
    checked: int,
) -> int: ...
def slid(
    trail: tuple[Index, Numbers, Numbers, Numbers, Numbers, Numbers],
    first: int,
    end: int,
    number: int,
    newest: Numbers,
    excess: tuple[float, float],
    count: float,
    sensor: tuple[float, float],
    floor: tuple[float, float],
    position_m2: Numbers,
) -> tuple[Numbers, Numbers]:
    """Variances and unevenness of the ticks in rows ``first`` to ``end``, which is written."""
