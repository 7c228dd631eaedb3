"""A stream as its checks see it."""

from collections.abc import Iterable
from typing import Any

import numpy as np

from contact_tracker.checks.check import Stream
from contact_tracker.config.loading import load_model
from contact_tracker.inspection.stream_checks import NOTHING_INSPECTED
from contact_tracker.map.map import EMPTY_MAP, Map
from contact_tracker.motion.poses import Poses

MODEL = load_model()


def stream_of(map: Map = EMPTY_MAP, **changes: Any) -> Stream:
    """A stream with a map, whose noise is chosen and whose object moves."""
    whole = Stream(map, MODEL, MODEL, MODEL, (1e-4, 1e-3), np.zeros(3), True, False, NOTHING_INSPECTED)
    return whole._replace(**changes)


def updated(check: Any, batches: Iterable[Poses], stream: Stream) -> Any:
    """The check after all of these poses."""
    for poses in batches:
        check = check.update(poses, stream)
    return check
