"""What the tracker believes: of a tick, and of a segment."""

from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contact_tracker.geometry.elements import ContactGeometry
from contact_tracker.geometry.flat import flat
from contact_tracker.states import STATES, Contact

Array = NDArray[np.float64]


class Detail(IntEnum):
    """How much is told of each tick right after it: what takes time is left out where nobody asks."""

    WEIGHTS = 0
    """The label, its onset, and the posterior as the hypotheses weigh."""
    SHARED = 1
    """What the motion does not tell from the label shares its probability."""
    GEOMETRY = 2
    """Where it touches."""


@dataclass(frozen=True, eq=False)
class Belief:
    """What is believed of one tick.

    Parameters
    ----------
    stamp_ns : the tick's time (its last pose).
    contact : the label.
    probability : (7,) posterior of the states, in the order of ``STATES``.
    onset_ns : when the labelled contact began, as believed.
    geometry : the touching elements of the labelled contact; None for free.
    residual : (6,) for each contact, in the order of ``CONTACTS``, the whitened root mean square residual
        (1: at the noise) that its objective function leaves at its minimum over the last 25 ticks with
        motion, or a little more; nan before there was so much motion.
    inseparable : states that the motion since the onset does not tell from ``contact``.
    restricted : probability that the object is moved in fewer directions than it could be, on purpose.
    """

    stamp_ns: int
    contact: Contact
    probability: Array
    onset_ns: int
    geometry: ContactGeometry | None
    residual: Array
    inseparable: tuple[Contact, ...] = ()
    p_deliberate: float = 0.0

    @property
    def touching(self) -> tuple[str | None, str | None]:
        """Names of the object's and the environment's element, None for one that nobody knows."""
        return self.geometry.names if self.geometry else (None, None)

    def to_json(self) -> dict[str, Any]:
        """The object that ``live --json`` and ``segment -o FILE.jsonl`` write."""
        return {
            "stamp_ns": int(self.stamp_ns),
            "contact": self.contact.value,
            "probability": {state.value: float(p) for state, p in zip(STATES, self.probability, strict=True)},
            "onset_ns": int(self.onset_ns),
            "inseparable": [state.value for state in self.inseparable],
            "geometry": self.geometry.to_json() if self.geometry else {},
            "inseparable_names": " ".join(self.inseparable),
            "object": flat(self.geometry.object if self.geometry else None),
            "environment": flat(self.geometry.environment if self.geometry else None),
        }


@dataclass(frozen=True, eq=False)
class Segment:
    """One contact from ``start_ns`` to ``end_ns`` (both included), as found offline.

    ``probability`` is the smoothed posterior of ``contact``, averaged over the segment; ``inseparable`` are
    the states that the segment's motion does not tell from ``contact``.
    """

    start_ns: int
    end_ns: int
    contact: Contact
    probability: float
    geometry: ContactGeometry | None
    inseparable: tuple[Contact, ...] = ()

    @property
    def touching(self) -> tuple[str | None, str | None]:
        """As ``Belief.touching``."""
        return self.geometry.names if self.geometry else (None, None)
