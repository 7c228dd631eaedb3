"""The evidence of a recording's wrenches, which are read once, before the recording is tracked."""

from collections.abc import Callable
from typing import NamedTuple

from contact_tracker.adaptation.with_wrenches import NoLoad, mass_doubt, wrench_evidence
from contact_tracker.config.parameters import Model
from contact_tracker.landmarks.prior_map import PriorMap
from contact_tracker.motion.poses import Poses
from contact_tracker.recording.log import PoseLog
from contact_tracker.recording.wrenches import read_wrenches
from contact_tracker.wrenches.contact_evidence import WrenchEvidence


class RecordedEvidence(NamedTuple):
    """``evidence`` is None if the wrenches are not usable; ``text`` is one line with the load or the reason.

    ``is_doubtful``: some of the wrenches were left out, or they overrule the mass that was given.
    """

    evidence: WrenchEvidence | None
    text: str
    is_doubtful: bool

    @property
    def warning(self) -> str | None:
        """The line where wrenches, some of them or the mass that was given are not used."""
        return self.text if self.evidence is None or self.is_doubtful else None


def recorded_evidence(
    path: str,
    topic: str,
    log: PoseLog,
    model: Model,
    knowledge: PriorMap,
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
    noted = f"; {found.noted}" if found.noted else ""
    try:
        evidence, load = wrench_evidence(poses, found.wrenches, model, knowledge, mass_kg, progress)
    except NoLoad as reason:
        return RecordedEvidence(None, f"{topic} is not used: {reason}{noted}", bool(noted))
    doubt = mass_doubt(load, mass_kg)
    return RecordedEvidence(
        evidence,
        f"{len(found.wrenches)} wrenches {found.taken}{noted}; "
        f"the hand carries {load.mass_kg:.3f} kg, by {load.ticks:.0f} ticks of free motion"
        f"{doubt and '; '}{doubt}",
        bool(noted or doubt),
    )
