"""The evidence of a recording's wrenches, which are read once, before the recording is tracked."""

from collections.abc import Callable
from typing import NamedTuple

from contact_tracker.config.parameters import Model
from contact_tracker.map.map import Map
from contact_tracker.motion.poses import Poses
from contact_tracker.recording.log import PoseLog
from contact_tracker.recording.wrenches import WrenchLog, read_wrenches
from contact_tracker.with_wrenches import NoLoad, mass_doubt, wrench_evidence
from contact_tracker.wrenches.contact_evidence import WrenchEvidence


class RecordedEvidence(NamedTuple):
    """``evidence`` is None if the wrenches are not usable; ``text`` is one line with the load or the reason.

    ``some_left_out``: some of the wrenches are not used. ``mass_doubt`` is a line of its own where they
    overrule the mass that was given.
    """

    evidence: WrenchEvidence | None
    text: str
    some_left_out: bool
    mass_doubt: str | None = None

    @property
    def is_warning(self) -> bool:
        """Whether the text is a warning: wrenches, or some of them, are not used."""
        return self.evidence is None or self.some_left_out

    @property
    def warnings(self) -> tuple[str, ...]:
        """The lines where wrenches, some of them or the mass that was given are not used."""
        return tuple(filter(None, (self.text if self.is_warning else None, self.mass_doubt)))


def recorded_evidence(
    path: str,
    topic: str,
    log: PoseLog,
    model: Model,
    known_map: Map,
    mass_kg: float | None = None,
    progress: Callable[[int], None] | None = None,
) -> RecordedEvidence | None:
    """What the wrenches on ``topic`` say; None of a recording without poses.

    Parameters
    ----------
    log : the poses of the same recording, all of which are read here.
    mass_kg : of the object, where it is known.
    progress : called now and then with the number of poses read so far.

    Raises
    ------
    ChoiceError
        The topic is not there or cannot be used.
    """
    poses = Poses.join(list(log.batches()))
    if not len(poses):
        return None
    found = read_wrenches(path, topic, log.source, poses, log.stamping.by_log_time)
    return evidence_of(found, topic, poses, model, known_map, mass_kg, progress)


def evidence_of(
    found: WrenchLog,
    name: str,
    poses: Poses,
    model: Model,
    known_map: Map,
    mass_kg: float | None = None,
    progress: Callable[[int], None] | None = None,
) -> RecordedEvidence:
    """What wrenches say that were read as ``found`` and that messages call ``name``; otherwise as
    ``recorded_evidence``."""
    noted = f"; {found.noted}" if found.noted else ""
    try:
        evidence, load = wrench_evidence(poses, found.wrenches, model, known_map, mass_kg, progress)
    except NoLoad as reason:
        return RecordedEvidence(None, f"{name} is not used: {reason}{noted}", bool(noted))
    return RecordedEvidence(
        evidence,
        f"{len(found.wrenches)} wrenches {found.taken}{noted}; "
        f"the hand carries {load.mass_kg:.3f} kg, by {load.ticks:.0f} ticks of free motion",
        bool(noted),
        mass_doubt(load, mass_kg) or None,
    )
