"""What ``tracker/core`` is built into; ``calls`` says what for."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

Numbers = NDArray[np.float64]
Index = NDArray[np.int64]
Bools = NDArray[np.bool_]

FINGERPRINT: str
"""Of the sources."""

def configure(settings: Mapping[str, object]) -> None:
    """Set the constants of the algorithm, see ``calls``; before anything else."""

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
        burn_in: float,
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
        before: Numbers | None,
    ) -> None: ...

class EvidenceParameters:
    """As ``evidence.EvidenceParameters``; ``pull`` is what a touching point far away costs, per m^2."""

    def __init__(
        self, radius_sq: float, pull: float, correlation: float, foreknowledge: float, independence: float
    ) -> None: ...

class TickInput:
    """As ``bank_update.TickInput``, see ``calls.tick_input``."""

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

class StopCondition:
    """As ``bank_update.StopCondition``."""

    def __init__(self, probability: float, sureness: float, due: Sequence[tuple[int, int]]) -> None: ...

def update(
    models: Sequence[Model],
    words: Sequence[tuple[Numbers, Numbers]],
    inputs: Sequence[TickInput],
    number: int,
    entry: Numbers,
    beyond: Sequence[tuple[float, float]],
    scales: EvidenceParameters,
    margin: float,
    until: StopCondition | None,
) -> tuple[
    list[tuple[Numbers, Numbers]],
    list[Index],
    list[tuple[Numbers, Numbers, Numbers, Index, tuple[Index, Index, Numbers]]],
]: ...
