"""Online tracking, pose by pose."""

import operator
import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Final, Self, SupportsIndex

import contact_tracker.tracker as tracker
from contact_tracker.api.learned_map import Known, Map, map_of
from contact_tracker.errors import InvalidPose, OutputError, StateError, shown
from contact_tracker.motion.losses import remark_on_loss, remarks_on
from contact_tracker.motion.pose_validation import PoseGate
from contact_tracker.motion.poses import Pose, real_number
from contact_tracker.outputs.adaptation import not_given, warnings
from contact_tracker.saved_state import continued, load, save
from contact_tracker.tracking.belief import Belief
from contact_tracker.tracking.informative_motion import InformativeMotion, informative_motions
from contact_tracker.trajectory.arguments import (
    Deviations,
    ModelLike,
    errors_as,
    log_counts,
    model_from,
    number_from,
    path_from,
    python_words,
    warn_of,
    with_known_arguments_of_methods,
)

_CHECK_POSES: Final = 100
"""Number of poses after which the dropped ones are judged, and again after as many while no tick is
complete."""


@with_known_arguments_of_methods
class Tracker:
    """Tracks the contacts of one object online.

    Parameters
    ----------
    model, known, noise, accuracy, states : as in ``segment``.
    lag_s : delay of the beliefs (s); they are smoothed with the poses up to then.

    Raises
    ------
    UsageError : an argument is invalid.

    Warns
    -----
    ContactTrackerWarning : the map is doubtful; in ``update`` and ``finish``: the poses are. Once per stream.
    """

    def __init__(
        self,
        model: ModelLike = "default",
        lag_s: float = 0.0,
        known: Known = None,
        noise: Deviations = None,
        accuracy: Deviations = None,
        states: Iterable[str] | None = None,
    ) -> None:
        parameters, notes = model_from(model, noise, accuracy), list[str]()
        most_s = parameters.search.window_s
        lag_s = number_from(lag_s, "lag_s", f"from 0 to {most_s:g}", lambda lag_s: 0.0 <= lag_s <= most_s)
        self._notes = notes
        self._tracker = tracker.Tracker.start(parameters, lag_s, map_of(known, notes.append, states))
        self._gate = PoseGate()
        self._arrived = 0
        self._restored: Path | None = None
        self._warned = set[str]()
        self._warn_of_news(notes)

    def update(
        self, stamp_ns: SupportsIndex, position_m: Sequence[float], quat_xyzw: Sequence[float]
    ) -> Belief | None:
        """Update with one pose.

        Parameters
        ----------
        stamp_ns : time of the measurement, integer nanoseconds.
        position_m : (3,) position of the body's origin in the world (m).
        quat_xyzw : (4,) rotation from body to world.

        Returns
        -------
        The newest belief if the pose completes a tick (usually 0.1 s), else None. Poses dropped or held back
        by the gate are counted in ``counts``.

        Raises
        ------
        InvalidPose : the stamp is not an integer, or there are not three and four numbers.
        """
        pose = _pose(stamp_ns, position_m, quat_xyzw)
        self._arrived += 1
        with continued(self._restored):
            beliefs = self._tracker.update(self._gate.arrive(pose))
            if beliefs or self._arrived % _CHECK_POSES == 0:
                self._warn_of_news(warnings(self._tracker.report_so_far))
                if self._arrived >= _CHECK_POSES:
                    self._warn_of_news(self._count_warnings())
        return beliefs[-1] if beliefs else None

    def finish(self) -> list[Belief]:
        """End the stream; returns the beliefs of the last, partial tick and those delayed by the lag."""
        with continued(self._restored):
            beliefs = self._tracker.update(self._gate.end())
            delayed = self._tracker.finish()
            self._warn_of_news(self.warnings)
        log_counts("poses", self.counts)
        return [*beliefs, *delayed]

    @property
    def counts(self) -> Mapping[str, int]:
        """Numbers of poses dropped or repaired so far, by kind (docs/conventions.md)."""
        with continued(self._restored):
            left_out = {"late": self._tracker.late, "outlier": self._tracker.outliers.total}
            return {**self._gate.counts, **{kind: count for kind, count in left_out.items() if count}}

    @property
    def warnings(self) -> tuple[str, ...]:
        """One line per warning so far."""
        with continued(self._restored):
            texts = *self._count_warnings(), *self._notes, *warnings(self._tracker.report)
            return tuple(map(python_words, texts))

    @property
    def map(self) -> Map | None:
        """The elements touched so far, for ``known`` with another stream; None before a contact is sure
        enough."""
        with continued(self._restored):
            best = self._tracker.best
            learned = None if best is None else best.map.learned
            return Map(learned=learned) if learned else None

    @property
    def suggestions(self) -> tuple[InformativeMotion, ...]:
        """Small motions that would distinguish the label from contacts that fit the motion so far equally
        well, the most informative first; empty if no contact is open."""
        with continued(self._restored):
            best = self._tracker.best
            return () if best is None else informative_motions(best)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Save the state to a file, atomically; raises UsageError or OutputError."""
        name = path_from(path)
        with errors_as(OutputError, name):
            save(Path(name), (self._tracker, self._gate, tuple(self._notes), self._arrived))

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Self:
        """Load a tracker from a saved state; it continues with bit-identical results. No code in it is run.

        Raises
        ------
        StateError : the file cannot be read, is not a tracker's state, is damaged, or was saved by another
            version.
        """
        name = path_from(path)
        with errors_as(StateError, name):
            saved = load(Path(name))
        match saved:
            case (tracker.Tracker() as state, PoseGate() as gate, tuple() as notes, int() as arrived):
                restored = cls.__new__(cls)
                restored._tracker, restored._gate, restored._notes = state, gate, [*map(str, notes)]
                restored._arrived, restored._restored, restored._warned = arrived, Path(name), set()
                not_given(restored.warnings, restored._warned)
                return restored
        raise StateError(f"{name}: it is no state of a tracker")

    def _count_warnings(self) -> Sequence[str]:
        loss = remark_on_loss(self._gate.counts, self._arrived, self._gate.refused_xyzw)
        return remarks_on(self._gate.counts, self._arrived) if loss is None else (loss,)

    def _warn_of_news(self, texts: Iterable[str]) -> None:
        warn_of(not_given(map(python_words, texts), self._warned))


def _pose(stamp_ns: SupportsIndex, position_m: Sequence[float], quat_xyzw: Sequence[float]) -> Pose:
    """A pose of plain numbers, not validated yet."""
    try:
        if isinstance(stamp_ns, bool):  # which is an integer, too
            raise TypeError
        stamp = operator.index(stamp_ns)
    except TypeError as error:
        text = f"stamps are integers in nanoseconds, not {shown(stamp_ns)}: multiply seconds by 1e9 and round"
        raise InvalidPose(text) from error
    try:
        x, y, z = map(real_number, position_m)
        qx, qy, qz, qw = map(real_number, quat_xyzw)
    except (TypeError, ValueError, OverflowError, LookupError) as error:
        raise InvalidPose("a pose has three coordinates and a quaternion xyzw") from error
    return Pose(stamp, (x, y, z), (qx, qy, qz, qw))
