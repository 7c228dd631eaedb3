"""One contact filter with ticks of its own, fed pose by pose, without any choice of the noise."""

from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np

from contact_tracker.arrays import Ints
from contact_tracker.config.parameters import Model
from contact_tracker.map.map import EMPTY_MAP, Map
from contact_tracker.motion.poses import Pose, Poses, batches
from contact_tracker.motion.tick_averaging import Tick, TickGrid
from contact_tracker.tracking.belief import Belief, Detail
from contact_tracker.tracking.contact_filter import ContactFilter, ticks_of
from contact_tracker.tracking.state import FilterState


class FilteredTick(NamedTuple):
    """One tick of a pass: the ``state`` after it, the ``tick``, and the ``belief``."""

    state: FilterState
    tick: Tick
    belief: Belief

    @property
    def numbers(self) -> Ints:
        """Numbers (A,) that identify the active hypotheses in the whole recording."""
        numbers = [bank.number for bank in self.state.banks]
        return np.append(np.concatenate(numbers), self.state.next_hypothesis_id - 1)


def filtered(ticks: Iterable[Tick], one: ContactFilter, detail: Detail) -> Iterator[FilteredTick]:
    """The ticks by one filter."""
    for tick in ticks:
        belief = one.update(tick, detail)
        yield FilteredTick(one.state, tick, belief)


def forward(
    poses: Poses, model: Model, known_map: Map = EMPTY_MAP, detail: Detail = Detail.GEOMETRY
) -> Iterator[FilteredTick]:
    """The ticks of a recording by one filter."""
    one = ContactFilter.start(model, known_map=known_map)
    return filtered(ticks_of(batches(poses), model), one, detail)


def after(state: FilterState, tick: Tick) -> tuple[FilterState, Belief]:
    """The state after one more tick, and its belief."""
    one = ContactFilter(state)
    belief = one.update(tick)
    return one.state, belief


class PoseFilter:
    """A filter and its ticks."""

    def __init__(self, model: Model, lag_s: float = 0.0, known_map: Map = EMPTY_MAP) -> None:
        self.grid, self.filter = TickGrid(model), ContactFilter.start(model, lag_s, known_map)

    @property
    def state(self) -> FilterState:
        return self.filter.state

    def update(self, pose: Pose) -> list[Belief]:
        """The beliefs to report of the ticks that a pose closes, none of most poses."""
        return self._followed(self.grid.add(Poses.collect([pose])))

    def finish(self) -> list[Belief]:
        """The beliefs at the end of the stream, which may go on."""
        return [*self._followed(self.grid.close()), *self.filter.finish()]

    def _followed(self, ticks: list[Tick]) -> list[Belief]:
        beliefs = list[Belief]()
        for tick in ticks:
            self.filter.update(tick)
            beliefs += filter(None, [self.filter.reported])
        return beliefs
