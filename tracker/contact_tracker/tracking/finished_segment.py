"""A segment whose ticks are known, and what is believed of them."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.geometry.packing import pack
from contact_tracker.states import STATES
from contact_tracker.tracking import ambiguity
from contact_tracker.tracking.belief import Segment
from contact_tracker.tracking.segment_fit import SegmentFit, SegmentTicks
from contact_tracker.tracking.segmentation import BELIEF, Beliefs

Array = NDArray[np.float64]


class FinishedSegment(NamedTuple):
    """A segment: the ``column`` of its state, its ``rows`` of n ticks (``start_ns``, ``stamp_ns``,
    ``residual``), when it ends, the ``posterior`` (n, 7), and the ``ticks`` that contacts are fitted to."""

    column: int
    rows: NDArray[np.void]
    end_ns: int
    posterior: Array
    ticks: SegmentTicks

    def with_fit(self, fit: SegmentFit) -> tuple[Segment, Beliefs]:
        """The segment and the beliefs of its ticks."""
        contact = STATES[self.column]
        beliefs = np.zeros(len(self.rows), BELIEF)
        for belief, given in zip(beliefs, self.posterior, strict=True):
            belief["probability"] = ambiguity.redistribute(given, contact, fit.inseparable, fit.restricted)
        start_ns = int(self.rows["start_ns"][0])
        beliefs["stamp_ns"], beliefs["onset_ns"] = self.rows["stamp_ns"], start_ns
        beliefs["contact"], beliefs["residual"] = self.column, self.rows["residual"]
        beliefs["inseparable"] = [state in fit.inseparable for state in STATES]
        beliefs["restricted"] = fit.restricted
        beliefs["geometry"] = -1 if fit.geometry is None else 0
        probability = float(beliefs["probability"][:, self.column].mean())
        segment = Segment(start_ns, self.end_ns, contact, probability, fit.geometry, fit.inseparable)
        return segment, Beliefs(beliefs, [] if fit.geometry is None else [pack(fit.geometry)])
