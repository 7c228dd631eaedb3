"""What ``live`` answers to a stream of poses, and when."""

from array import array
from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.config.parameters import Model
from contact_tracker.map.map import EMPTY_MAP, Map
from contact_tracker.motion.pose_validation import Arrival, PoseGate
from contact_tracker.motion.poses import AS_GIVEN, Pose, ReadAs
from contact_tracker.tracker import Tracker
from contact_tracker.tracking.belief import Belief, Detail
from contact_tracker.tracking.segmentation import Beliefs


class Answers(NamedTuple):
    """Online ``beliefs`` in the order in which they were given out, and the time of the stream (T,) at which
    each was. That is later than its stamp by the time for which poses are held, and by what a tick waits for
    its last pose."""

    beliefs: Beliefs
    arrival_ns: NDArray[np.int64]


class Answering:
    """Tracks a stream online while it passes through.

    Parameters
    ----------
    read_as : how poses were read, as the user asked.
    """

    def __init__(self, model: Model, known_map: Map = EMPTY_MAP, read_as: ReadAs = AS_GIVEN) -> None:
        self._tracker = Tracker.start(model, known_map=known_map, read_as=read_as)
        self._parts: list[Beliefs] = []
        self._arrival_ns = array("q")

    def through(self, arrivals: Iterable[Arrival]) -> Iterator[Pose]:
        """The poses of the stream, after they were tracked."""
        for arrival in arrivals:
            self._note(self._tracker.update(arrival, Detail.SHARED), arrival.time_ns)
            yield from arrival.poses

    def finish(self) -> Answers:
        """All answers, at the end of the stream."""
        self._note(self._tracker.finish(), self._tracker.last_ns)
        return Answers(Beliefs.join(self._parts), np.array(self._arrival_ns, np.int64))

    def _note(self, beliefs: list[Belief], time_ns: int | None) -> None:
        if beliefs:
            self._parts.append(Beliefs.of(beliefs))
            self._arrival_ns.extend([time_ns or beliefs[-1].stamp_ns] * len(beliefs))


def answers_to(poses: Iterable[Pose], model: Model, known_map: Map = EMPTY_MAP) -> Answers:
    """The answers to ``poses`` as measured, which pass the gate one by one."""
    gate, answering = PoseGate(), Answering(model, known_map)

    def arrivals() -> Iterator[Arrival]:
        yield from map(gate.arrive, poses)
        yield gate.end()

    for _ in answering.through(arrivals()):
        pass
    return answering.finish()
