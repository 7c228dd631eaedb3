"""What a live view is told, and the view of those who want none."""

from types import TracebackType
from typing import Protocol, Self

from contact_tracker.motion.poses import Pose
from contact_tracker.tracking.belief import Belief


class LiveView(Protocol):
    """Is told every pose, and every belief once it is due; a context manager that closes itself."""

    def pose(self, pose: Pose) -> None: ...

    def belief(self, belief: Belief) -> None: ...

    def close(self) -> None: ...

    def __enter__(self) -> Self: ...

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None: ...


class NoViewer:
    """Shows nothing, at no cost."""

    def pose(self, pose: Pose) -> None:
        pass

    def belief(self, belief: Belief) -> None:
        pass

    def close(self) -> None:
        pass

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        pass
