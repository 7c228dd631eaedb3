"""Noise models of recorded poses: white, or filtered."""

from collections.abc import Callable, Mapping
from functools import partial
from types import MappingProxyType
from typing import Final

from contact_tracker.motion.poses import Poses
from contact_tracker_lab.simulate.filters import low_pass

CUTOFF_HZ: Final = 20.0


def _as_measured(poses: Poses) -> Poses:
    return poses


NOISES: Final[Mapping[str, Callable[[Poses], Poses]]] = MappingProxyType(
    {"white": _as_measured, "filtered": partial(low_pass, cutoff_hz=CUTOFF_HZ)}
)
"""``filtered``: a Butterworth low-pass, forward and backward, as in motion-capture software."""
