"""Offline segmentation of a trajectory, also with recorded wrenches: a first pass labels by motion, and its
ticks of free motion determine the load."""

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
    """Segment a trajectory; for the parameters see ``OfflineTracker`` and ``Outcome``."""
    tracker = OfflineTracker(model, known_map, executor, wrenches, trajectory.read_as)
    result = Segmentation.join(list(tracker.pieces(trajectory, progress, detail)))
    has_wrenches = wrenches is not None
    return Outcome(trajectory, result, tracker.report, tuple(notes), has_wrenches, known_map, tracker.map)


RecordedEvidence = tuple[WrenchEvidence | None, str, tuple[str, ...]]
"""The evidence, None if the wrenches are not usable; a line with the load, empty if it is unknown or part of
a warning; and warnings, if wrenches or the mass that was given are not used."""


def recorded_evidence(
    path: str,
    topic: str,
    log: PoseLog,
    model: Model,
    known_map: Map,
    mass_kg: float | None = None,
    progress: Callable[[int], None] | None = None,
) -> RecordedEvidence:
    """Evidence of the wrenches on ``topic``, None for a recording without poses.

    Parameters
    ----------
    log : of the poses of the same recording, all of which are read.
    mass_kg : of the object, if known.
    progress : called at intervals with the number of poses read so far.

    Raises
    ------
    ChoiceError
        The topic does not exist or cannot be used.
    """
    poses = Poses.join(list(log.batches()))
    if not len(poses):
        return None, "", ()
    wrench_log = read_wrenches(path, topic, log.source, poses, log.stamping.by_log_time)
    return evidence_of(wrench_log, topic, poses, model, known_map, mass_kg, progress)


def evidence_of(
    wrench_log: WrenchLog,
    name: str,
    poses: Poses,
    model: Model,
    known_map: Map,
    mass_kg: float | None = None,
    progress: Callable[[int], None] | None = None,
) -> RecordedEvidence:
    """Evidence of the wrenches of a log, as ``recorded_evidence``; messages call them ``name``."""
    noted = f"; {wrench_log.noted}" if wrench_log.noted else ""
    try:
        evidence, load = wrench_evidence(poses, wrench_log.wrenches, model, known_map, mass_kg, progress)
    except NoLoad as reason:
        return None, "", (f"{name} is not used: {reason}{noted}",)
    text = (
        f"{len(wrench_log.wrenches)} wrenches {wrench_log.taken}{noted}; "
        f"the hand carries {load.mass_kg:.3f} kg, by {load.ticks:.0f} ticks of free motion"
    )
    warnings = filter(None, (noted and text, mass_doubt(load, mass_kg)))
    return evidence, "" if noted else text, tuple(warnings)


def evidence_as_given(
    wrenches: Wrenches, name: str, poses: Poses, model: Model, known_map: Map, mass_kg: float | None = None
) -> RecordedEvidence:
    """Evidence of wrenches about the body's origin, in its axes, as ``evidence_of``."""
    valid = wrenches.valid
    wrench_log = WrenchLog(valid, len(wrenches) - len(valid), 0, 0, "", "as given")
    return evidence_of(wrench_log, name, poses, model, known_map, mass_kg)


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
    mass_kg : of all that the sensor carries, if known.
    progress : called at intervals with the number of poses read so far.

    Raises
    ------
    NoLoad
        Wrenches and poses do not overlap, there is too little free motion to determine the load, or no load
        explains the wrenches.
    """
    by_motion = OfflineTracker(model, known_map, uses_map=False)
    result = Segmentation.join(list(by_motion.pieces(poses, progress, Detail.WEIGHTS)))
    beliefs, column = result.beliefs, Contact.FREE.column
    is_free, p_free = beliefs.rows["contact"] == column, beliefs.probability[:, column]
    ticks, load = require_load(poses, wrenches.valid, result.stamp_ns, is_free, p_free, mass_kg)
    return WrenchEvidence(contact_wrenches(ticks, load)), load
