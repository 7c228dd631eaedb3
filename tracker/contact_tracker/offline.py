"""Offline segmentation of a trajectory, also with the wrenches that were recorded beside it."""

from collections.abc import Callable, Iterable
from concurrent.futures import Executor

from contact_tracker.config.parameters import Model
from contact_tracker.map.map import EMPTY_MAP, Map
from contact_tracker.motion.poses import Poses
from contact_tracker.outputs.outcome import Outcome
from contact_tracker.recording.log import PoseLog
from contact_tracker.recording.wrenches import WrenchLog, read_wrenches
from contact_tracker.segmenting import OfflineTracker
from contact_tracker.states import Contact
from contact_tracker.tracking.belief import Detail
from contact_tracker.tracking.segmentation import Segmentation
from contact_tracker.trajectory import Trajectory
from contact_tracker.wrenches.contact_evidence import WrenchEvidence
from contact_tracker.wrenches.load import Load, NoLoad, contact_wrenches, mass_doubt, require_load
from contact_tracker.wrenches.wrenches import Wrenches


def segmented(
    trajectory: Trajectory,
    model: Model,
    known_map: Map = EMPTY_MAP,
    wrenches: WrenchEvidence | None = None,
    executor: Executor | None = None,
    progress: Callable[[int], None] | None = None,
    notes: Iterable[str] = (),
    detail: Detail = Detail.SHARED,
) -> Outcome:
    """Segment a trajectory; the parameters are those of ``OfflineTracker`` and ``Outcome``."""
    tracker = OfflineTracker(model, known_map, executor, wrenches, trajectory.read_as)
    found = Segmentation.join(list(tracker.pieces(trajectory, progress, detail)))
    has_wrenches = wrenches is not None
    return Outcome(trajectory, found, tracker.report, tuple(notes), has_wrenches, known_map, tracker.map)


RecordedEvidence = tuple[WrenchEvidence | None, str, tuple[str, ...]]
"""What wrenches say, None if they are not usable; one line with the load, empty if there is none or it is a
warning; and lines of warnings, where wrenches, some of them or the mass that was given are not used."""


def recorded_evidence(
    path: str,
    topic: str,
    log: PoseLog,
    model: Model,
    known_map: Map,
    mass_kg: float | None = None,
    progress: Callable[[int], None] | None = None,
) -> RecordedEvidence:
    """What the wrenches on ``topic`` say; nothing of a recording without poses.

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
        return None, "", ()
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
        return None, "", (f"{name} is not used: {reason}{noted}",)
    text = (
        f"{len(found.wrenches)} wrenches {found.taken}{noted}; "
        f"the hand carries {load.mass_kg:.3f} kg, by {load.ticks:.0f} ticks of free motion"
    )
    warnings = filter(None, (noted and text, mass_doubt(load, mass_kg)))
    return evidence, "" if noted else text, tuple(warnings)


def evidence_as_given(
    wrenches: Wrenches, name: str, poses: Poses, model: Model, known_map: Map, mass_kg: float | None = None
) -> RecordedEvidence:
    """What wrenches about the body's origin, in its axes, say; otherwise as ``evidence_of``."""
    valid = wrenches.valid
    found = WrenchLog(valid, len(wrenches) - len(valid), 0, 0, "", "as given")
    return evidence_of(found, name, poses, model, known_map, mass_kg)


def wrench_evidence(
    poses: Poses,
    wrenches: Wrenches,
    model: Model,
    known_map: Map = EMPTY_MAP,
    mass_kg: float | None = None,
    progress: Callable[[int], None] | None = None,
) -> tuple[WrenchEvidence, Load]:
    """Evidence of the wrenches of the hand on the object for its contacts, in a whole recording.

    Parameters
    ----------
    poses : all of them, validated.
    wrenches : about the body's origin, in its axes, on the clock of the poses.
    mass_kg : of the object and all else that the sensor carries, if known.
    progress : called at intervals with the number of poses read so far.

    Raises
    ------
    NoLoad
        Wrenches and poses do not overlap, there is too little free motion to determine the load, or the
        wrenches are none of a hand that carries one.
    """
    by_motion = OfflineTracker(model, known_map, uses_map=False)
    found = Segmentation.join(list(by_motion.pieces(poses, progress, Detail.WEIGHTS)))
    column = Contact.FREE.column
    is_free, p_free = found.beliefs.rows["contact"] == column, found.beliefs.probability[:, column]
    ticks, load = require_load(poses, wrenches.valid, found.stamp_ns, is_free, p_free, mass_kg)
    return WrenchEvidence(contact_wrenches(ticks, load)), load
