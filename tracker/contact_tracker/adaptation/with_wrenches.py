"""Evidence of wrenches: a first pass labels by motion, and its ticks of free motion determine the load."""

from collections.abc import Callable
from typing import Final

from contact_tracker.adaptation.offline import OfflineTracker
from contact_tracker.config.parameters import Model
from contact_tracker.landmarks.prior_map import EMPTY_MAP, PriorMap
from contact_tracker.motion.poses import Poses
from contact_tracker.states import Contact
from contact_tracker.tracking.belief import Detail
from contact_tracker.tracking.segmentation import Segmentation
from contact_tracker.wrenches.contact_evidence import WrenchEvidence
from contact_tracker.wrenches.load import AGREES, Load, contact_wrenches, estimate_load
from contact_tracker.wrenches.tick_wrench import average
from contact_tracker.wrenches.wrenches import Wrenches

LEAST_SHARE: Final = 0.1
"""Share of the ticks that must have wrenches: with fewer the two streams may have different clocks."""


class NoLoad(Exception):
    """The wrenches of a recording cannot be used; the text, one line, has the reason."""


def mass_doubt(load: Load, mass_kg: float | None) -> str:
    """One line where free motion has overruled the mass that is given; empty otherwise."""
    if mass_kg is None or abs(load.mass_kg / mass_kg - 1.0) <= AGREES:
        return ""
    return (
        f"the mass that is given, {mass_kg:g} kg, does not fit the wrenches in free motion: "
        f"{load.mass_kg:.3f} kg is used. Check it (it is that of all the sensor carries), and the unit (N) "
        "and sign of the forces"
    )


def wrench_evidence(
    poses: Poses,
    wrenches: Wrenches,
    model: Model,
    knowledge: PriorMap = EMPTY_MAP,
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
        Wrenches and poses do not overlap, or there is too little free motion to determine the load.
    """
    found = Segmentation.join(list(OfflineTracker(model, knowledge).pieces(poses, progress, Detail.WEIGHTS)))
    ticks = average(poses, wrenches.valid, found.stamp_ns)
    if ticks.is_measured.mean() < LEAST_SHARE:
        raise NoLoad("wrenches and poses hardly overlap in time: are their stamps of one clock?")
    column = Contact.FREE.column
    is_free = found.beliefs.rows["contact"] == column
    load = estimate_load(ticks, is_free, found.beliefs.probability[:, column], mass_kg)
    if load is None and mass_kg is not None:  # one that is far off fits no tick
        load = estimate_load(ticks, is_free, found.beliefs.probability[:, column])
    if load is None:
        raise NoLoad(
            "too little free motion shows what the hand carries: weight and sensor bias are not known"
        )
    return WrenchEvidence(contact_wrenches(ticks, load)), load
