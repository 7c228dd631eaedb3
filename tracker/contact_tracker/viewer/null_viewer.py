"""The interface of live views, and a view that shows nothing."""

from typing import Protocol, Self

from contact_tracker.motion.poses import Pose
from contact_tracker.tracking.belief import Belief


class SelfClosing:
    """A context manager that calls ``close`` on exit."""

    def close(self) -> None:
        pass

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class LiveView(Protocol):
    """Receives every pose, and every belief once it is due; a context manager that closes itself."""

    def pose(self, pose: Pose) -> None: ...

    def belief(self, belief: Belief) -> None: ...

    def close(self) -> None: ...

    def __enter__(self) -> Self: ...

    def __exit__(self, *_: object) -> None: ...


class NoViewer(SelfClosing):
    """Shows nothing, at no cost."""

    def pose(self, pose: Pose) -> None:
        pass

    def belief(self, belief: Belief) -> None:
        pass
