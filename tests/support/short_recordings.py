"""Short simulated recordings and their segmentations, and the recordings of the repository, each once."""

from functools import cache
from pathlib import Path
from typing import Final

import numpy as np
import pytest
from numpy.typing import NDArray

from contact_tracker.config.loading import load_model
from contact_tracker.config.parameters import Model
from contact_tracker.hypotheses import compiled
from contact_tracker.motion.poses import Poses
from contact_tracker.recording import open_log
from contact_tracker.states import Contact
from contact_tracker.tracking.offline_smoother import segment
from contact_tracker.tracking.segmentation import Segmentation
from contact_tracker_lab.simulate import Scenario, Simulated, simulate
from contact_tracker_lab.simulate.scenarios import Phase

MODEL: Final[Model] = load_model()
SHIPPED: Final = Path(__file__).parents[2] / "recordings"
needs_kernels = pytest.mark.skipif(not compiled.in_use(), reason="too slow in numpy")
FACE_TO_EDGE: Final = "f-f e-f"
EDGE_TO_EDGES: Final = "f-e e-e"
_SECONDS: Final = {"f-f": 3.5, "e-f": 4.0, "f-e": 3.5, "e-e": 4.5}


@cache
def recorded(contacts: str) -> Simulated:
    """A recording at 200 Hz of successive contacts."""
    phases = tuple(Phase(Contact(name), _SECONDS[name]) for name in contacts.split())
    return simulate(Scenario(phases), 2)


@cache
def shipped(name: str) -> Poses:
    """The poses of a recording of the repository."""
    return Poses.collect(open_log(str(SHIPPED / f"{name}.mcap")))


@cache
def segmented(contacts: str) -> Segmentation:
    return segment(recorded(contacts).poses, MODEL)


def true_contacts(simulated: Simulated, stamp_ns: NDArray[np.int64]) -> list[Contact | None]:
    """The true contact at each stamp."""
    return [simulated.truth.intervals[i].contact for i in simulated.truth.at(stamp_ns)]


def age_s(simulated: Simulated, stamp_ns: NDArray[np.int64]) -> NDArray[np.float64]:
    """The run length of the true contact at each stamp."""
    starts = np.array([interval.start_ns for interval in simulated.truth.intervals])
    return np.asarray((stamp_ns - starts[simulated.truth.at(stamp_ns)]) / 1e9)
