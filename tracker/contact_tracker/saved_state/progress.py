"""How far the stream of one log has come: what is known of it, and what was taken from the log."""

from typing import NamedTuple

from contact_tracker.adaptation.online import AdaptiveState
from contact_tracker.motion.pose_validation import PoseGate
from contact_tracker.states import Contact
from contact_tracker.tracking.belief import FurtherContact


class Progress(NamedTuple):
    """A stream between two poses.

    ``initial`` is the state that it began with: the same model, lag and knowledge give the same again.
    ``log`` are the topic, type and frames of its source, with the log time of the first pose there (ns);
    ``taken`` poses went through the ``gate`` with the ``stamping`` (see ``recording.stamping``).
    ``origin_ns``, ``first_ns`` and ``last_ns`` are stamps, ``used`` poses came through; ``label`` is the last
    that was shown, ``settled`` whether as settled, and ``further`` the contacts beside it.
    """

    initial: AdaptiveState
    now: AdaptiveState
    log: tuple[str, str, str, str, int]
    taken: int
    gate: PoseGate
    stamping: tuple[bool, int | None, int]
    origin_ns: int
    first_ns: int
    last_ns: int
    used: int
    label: Contact | None
    settled: bool
    further: tuple[FurtherContact, ...]
