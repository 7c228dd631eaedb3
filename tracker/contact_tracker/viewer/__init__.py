"""The viewer: beliefs and segments drawn with rerun, in a window or into a file.

Importing this package is cheap; ``offline`` and ``live`` import rerun.
"""

from typing import TYPE_CHECKING, Final, Self

if TYPE_CHECKING:
    from contact_tracker.map.world_map import GrowingMap
    from contact_tracker.motion.poses import Pose
    from contact_tracker.tracking.belief import Belief

SILENT: Final = "off,contact_tracker=off"
"""``RUST_LOG`` of this process: silences rerun's log; relevant failures are raised as errors."""


class LiveView:
    """Receives every pose, and every belief once it is due; a context manager that closes itself.

    This one shows nothing, at no cost.
    """

    def pose(self, pose: "Pose") -> None:
        """Show a pose."""

    def belief(self, belief: "Belief", world: "GrowingMap | None" = None) -> None:
        """Show a belief about earlier poses, and the map of what contacts have touched."""

    def close(self) -> None:
        """End the view."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
