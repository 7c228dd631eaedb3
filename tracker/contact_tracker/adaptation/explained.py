"""A filter that runs only for the evidence of contacts against free motion."""

from dataclasses import dataclass
from typing import NamedTuple, Self

from contact_tracker.config.parameters import Model
from contact_tracker.landmarks.prior_map import EMPTY_MAP, PriorMap
from contact_tracker.motion.poses import Poses
from contact_tracker.motion.tick_grid import TickGrid
from contact_tracker.tracking.belief import Belief, Detail
from contact_tracker.tracking.contact_filter import ContactFilter


class AfterTick(NamedTuple):
    """``log_evidence`` of contacts against free motion (nats), seconds of motion so far, and the belief."""

    log_evidence: float
    moved_s: float
    belief: Belief


@dataclass(eq=False)
class Explained:
    """A filter with ticks of its own, and the seconds of motion since its start."""

    grid: TickGrid
    filter: ContactFilter
    moved_s: float = 0.0

    @classmethod
    def start(cls, model: Model, knowledge: PriorMap = EMPTY_MAP) -> Self:
        """The filter before the first pose."""
        return cls(TickGrid(model), ContactFilter.start(model, knowledge=knowledge))

    def update(self, poses: Poses, detail: Detail = Detail.WEIGHTS) -> list[AfterTick]:
        """Update by poses; returns the evidence after each tick that they close, and a belief of this
        ``detail``."""
        after = list[AfterTick]()
        for tick in self.grid.add(poses):
            belief = self.filter.update(tick, detail, tests_curvature=False)
            state = self.filter.state
            self.moved_s += state.model.tick_s * state.window.latest_motion_ratio
            after.append(AfterTick(state.log_evidence, self.moved_s, belief))
        return after
