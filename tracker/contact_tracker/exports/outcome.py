"""A whole recording with its segmentation, as input of reports and scenes."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property

from contact_tracker.geometry.elements import Array
from contact_tracker.ground_truth import Truth
from contact_tracker.motion.poses import Poses
from contact_tracker.tracking.segmentation import Segmentation
from contact_tracker.viewer.parts import Part
from contact_tracker.viewer.scene import UNKNOWN_EXTENT, Extent, hull


@dataclass(frozen=True, eq=False)
class Outcome:
    """The ``poses`` that were used and the segmentation ``found``.

    Parameters
    ----------
    name : of the recording, for display.
    origin_ns : stamp from which displayed times count.
    counts : what was dropped or repaired, by kind (docs/conventions.md).
    warnings : one line each.
    noise : the noise that the tracker has adapted to, in words; empty if unknown.
    world, body : frame names of the poses; empty if they have none.
    vertices_m : (V, 3) of the object in the body frame, if known.
    parts : all that is known of the object and its surroundings, to draw.
    truth : returns that of the recording, if it has one.
    log : the recording, if it can be read again.
    log_offset_ns : delay from a pose's stamp to its log time.
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
    parts: tuple[Part, ...] = ()
    truth: Callable[[], Truth | None] = lambda: None
    log: str | None = None
    log_offset_ns: int = 0

    @cached_property
    def extent(self) -> Extent:
        """The size of the object, by its vertices."""
        solid = None if self.vertices_m is None else hull(self.vertices_m)
        return UNKNOWN_EXTENT if solid is None else solid.extent
