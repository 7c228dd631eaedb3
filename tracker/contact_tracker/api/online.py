"""Online tracking, pose by pose."""

import operator
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Self, SupportsIndex

from contact_tracker import adaptation
from contact_tracker.adaptation import AdaptiveState
from contact_tracker.api.given import Deviations, Known, ModelLike, knowledge_of, model_from
from contact_tracker.errors import InvalidPose, StateError, UsageError
from contact_tracker.motion.pose_validation import Arrival, PoseGate, remark_on_excursions
from contact_tracker.motion.poses import Pose
from contact_tracker.outputs.adaptation import warnings
from contact_tracker.saved_state import load, save
from contact_tracker.tracking.belief import Belief


class Tracker:
    """Tracks the contacts of one object online.

    Parameters
    ----------
    model, known, noise, accuracy : as of ``segment``.
    lag_s : delay of the beliefs (s), for which they are smoothed.

    Raises
    ------
    UsageError
        An argument is invalid.
    """

    def __init__(
        self,
        model: ModelLike = "default",
        lag_s: float = 0.0,
        known: Known = None,
        noise: Deviations = None,
        accuracy: Deviations = None,
    ) -> None:
        given, notes = model_from(model, noise, accuracy), list[str]()
        if not isinstance(lag_s, int | float) or not 0.0 <= lag_s <= given.search.window_s:
            raise UsageError(f"lag_s is 0 to {given.search.window_s:g} s, not {lag_s!r}")
        self._notes = notes
        self._state = adaptation.start(given, lag_s, knowledge_of(known, notes.append))
        self._gate = PoseGate()

    def update(
        self, stamp_ns: SupportsIndex, position_m: Sequence[float], quat_xyzw: Sequence[float]
    ) -> Belief | None:
        """Update with one pose.

        Parameters
        ----------
        stamp_ns : of the measurement, integer nanoseconds.
        position_m : (3,) of the body's origin in the world (m).
        quat_xyzw : (4,) from body to world.

        Returns
        -------
        The newest belief if the pose completes a tick (usually 0.1 s), else None. Poses dropped or held back
        by the gate are counted in ``counts``.

        Raises
        ------
        InvalidPose
            The stamp is not an integer, or there are not three and four numbers.
        """
        beliefs = self._take(self._gate.arrive(_pose(stamp_ns, position_m, quat_xyzw)))
        return beliefs[-1] if beliefs else None

    def finish(self) -> list[Belief]:
        """End the stream; returns the beliefs of the last, partial tick and those delayed by the lag."""
        beliefs = self._take(self._gate.end())
        self._state, rest = adaptation.finish(self._state)
        return [*beliefs, *rest]

    @property
    def counts(self) -> Mapping[str, int]:
        """Numbers of poses dropped or repaired so far, by kind (docs/conventions.md)."""
        left_out = {"late": self._state.late, "outlier": self._state.outliers}
        return {**self._gate.counts, **{kind: count for kind, count in left_out.items() if count}}

    @property
    def warnings(self) -> tuple[str, ...]:
        """One line per warning so far."""
        found = adaptation.report(self._state)
        remark = remark_on_excursions(self._gate.counts)
        return (*self._notes, *filter(None, [remark]), *(() if found is None else warnings(found)))

    def save(self, path: str | os.PathLike[str]) -> None:
        """Save the state to a file, atomically; raises OSError."""
        save(Path(path), (self._state, self._gate, tuple(self._notes)))

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Self:
        """A tracker from a saved state; it continues with bit-identical results. No code in the file is run.

        Raises
        ------
        StateError
            The file is not a tracker's state, is damaged, or was saved by another version.
        OSError
            The file cannot be read.
        """
        match load(Path(path)):
            case (AdaptiveState() as state, PoseGate() as gate, tuple() as notes):
                tracker = cls.__new__(cls)
                tracker._state, tracker._gate, tracker._notes = state, gate, [*map(str, notes)]
                return tracker
        raise StateError(f"{os.fspath(path)}: it is no state of a tracker")

    def _take(self, arrival: Arrival) -> list[Belief]:
        self._state, beliefs = adaptation.take(self._state, arrival)
        return beliefs


def _pose(stamp_ns: SupportsIndex, position_m: Sequence[float], quat_xyzw: Sequence[float]) -> Pose:
    """A pose of plain numbers, not validated yet."""
    try:
        stamp = operator.index(stamp_ns)
    except TypeError as error:
        text = f"stamps are integers in nanoseconds, not {stamp_ns!r}: multiply seconds by 1e9 and round"
        raise InvalidPose(text) from error
    try:
        x, y, z = map(float, position_m)
        qx, qy, qz, qw = map(float, quat_xyzw)
    except (TypeError, ValueError) as error:
        raise InvalidPose("a pose has three coordinates and a quaternion xyzw") from error
    return Pose(stamp, (x, y, z), (qx, qy, qz, qw))
