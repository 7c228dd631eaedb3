"""A whole recording and what was found in it: what reports and scenes are made of."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from contact_tracker.geometry.elements import Array
from contact_tracker.motion.poses import Poses
from contact_tracker.tracking.segmentation import Segmentation


@dataclass(frozen=True, eq=False)
class Outcome:
    """``poses`` that were used and what was ``found``.

    Parameters
    ----------
    name : of the recording, for people.
    origin_ns : times for people count from there.
    counts : what was dropped or repaired, by kind (docs/conventions.md).
    warnings : one line of each thing that has to be known.
    noise : what the tracker has adapted to, in words; empty where it is not known.
    world, body : names of the frames of the poses; empty where they have none.
    vertices_m : (V, 3) of the object in the body frame, where known.
    """

    name: str
    poses: Poses
    found: Segmentation
    origin_ns: int
    counts: Mapping[str, int] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    noise: str = ""
    world: str = ""
    body: str = ""
    vertices_m: Array | None = None
