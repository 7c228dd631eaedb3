"""Progress of the stream of one log: the tracker's state, and the position in the log."""

from typing import NamedTuple

from contact_tracker.adaptation.online import AdaptiveState
from contact_tracker.motion.pose_validation import PoseGate
from contact_tracker.motion.poses import Pose
from contact_tracker.states import Contact
from contact_tracker.tracking.belief import FurtherContact


class Progress(NamedTuple):
    """A stream between the arrivals of two poses.

    ``initial`` is the initial state, which model, lag and prior map determine.
    ``source`` are the topic, type and frames of the poses; ``first`` is the first pose of the log, with its
    log time (ns);
    ``taken`` poses were read, with the ``gate`` and the ``stamping`` (see ``recording.stamping``).
    ``origin_ns``, ``first_ns`` and ``last_ns`` are stamps, ``used`` the number of valid poses; ``label`` is
    the last that was shown, ``settled`` and ``open`` whether as that, and ``further`` the further contacts.
    """

    initial: AdaptiveState
    now: AdaptiveState
    source: tuple[str, str, str, str]
    first: tuple[Pose, int]
    taken: int
    gate: PoseGate
    stamping: tuple[bool, int | None, int]
    origin_ns: int
    first_ns: int
    last_ns: int
    used: int
    label: Contact | None
    settled: bool
    open: bool
    further: tuple[FurtherContact, ...]
