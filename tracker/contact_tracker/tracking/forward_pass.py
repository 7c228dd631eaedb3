"""The forward pass over a whole recording."""

from collections.abc import Callable, Iterable, Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.config.parameters import Model
from contact_tracker.hypotheses.bank import Bank
from contact_tracker.motion.poses import Pose, batches
from contact_tracker.motion.tick_averaging import Tick
from contact_tracker.motion.tick_grid import ORIGIN_M, TickGrid
from contact_tracker.tracking.belief import Belief, Detail
from contact_tracker.tracking.contact_filter import ContactFilter
from contact_tracker.tracking.state import FilterState

Array = NDArray[np.float64]
Index = NDArray[np.int64]


class FilteredTick(NamedTuple):
    """One tick of the pass: the ``state`` after it, the ``tick``, and the ``belief``."""

    state: FilterState
    tick: Tick
    belief: Belief

    @property
    def numbers(self) -> Index:
        """Numbers (A,) that identify the active hypotheses in the whole recording."""
        return np.append(Bank.of_all(self.state.banks, "number"), self.state.next_hypothesis_id - 1)


def ticks_of(
    poses: Iterable[Pose],
    model: Model,
    progress: Callable[[int], None] | None = None,
    body_m: Array = ORIGIN_M,
) -> Iterator[Tick]:
    """The ticks of a recording, each as soon as it is over.

    Parameters
    ----------
    poses : validated poses in order of time.
    progress : called after each batch of poses with the number of those read so far.
    body_m : (3,) point of the body that is tracked, see ``sensor_noise.independent_point``.
    """
    grid, count = TickGrid(model, body_m), 0
    for batch in batches(poses):
        yield from grid.add(batch) if len(batch) else ()
        count += len(batch)
        if progress is not None:
            progress(count)
    yield from grid.close()


def forward(
    ticks: Iterable[Tick], one: ContactFilter, detail: Detail = Detail.GEOMETRY
) -> Iterator[FilteredTick]:
    """Update a filter by ticks; the beliefs have this ``detail``."""
    for tick in ticks:
        belief = one.update(tick, detail)
        yield FilteredTick(one.state, tick, belief)
