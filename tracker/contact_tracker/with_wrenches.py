"""Evidence of wrenches: a first pass labels by motion, and its ticks of free motion determine the load."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from contact_tracker.config.parameters import Model
from contact_tracker.map.map import EMPTY_MAP, Map
from contact_tracker.motion.poses import Poses
from contact_tracker.segmenting import OfflineTracker
from contact_tracker.states import Contact
from contact_tracker.tracking.belief import Detail
from contact_tracker.tracking.segmentation import Segmentation
from contact_tracker.wrenches.contact_evidence import WrenchEvidence
from contact_tracker.wrenches.load import AGREES, FEWEST_TICKS, Load, contact_wrenches, estimate_load
from contact_tracker.wrenches.wrenches import (
    TickWrenches,
    Wrenches,
    about_body,
    average,
    reversed_wrenches,
    turned_to_body,
)

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

LEAST_SHARE: Final = 0.1
"""Share of the ticks that must have wrenches: with fewer the two streams may have different clocks."""

FITS_BETTER: Final = 1.25
"""Least ratio of fit at which another reading overrules a load without doubt. Where the object hardly turns,
the opposite sign of the moments fits right wrenches as well, with the centre of mass on the other side: at
most 1.01 times in 224 simulated recordings; wrong ones, 1.49 times or more."""

TOO_LITTLE: Final = "too little free motion shows what the hand carries: weight and sensor bias are not known"


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


def require_load(
    poses: Poses,
    wrenches: Wrenches,
    stamp_ns: NDArray[np.int64],
    is_free: Bools,
    p_free: Array,
    mass_kg: float | None = None,
) -> tuple[TickWrenches, Load]:
    """Wrenches in the ticks that end at ``stamp_ns`` (T,), and the load of the hand that they show.

    Parameters
    ----------
    is_free, p_free, mass_kg : as of ``estimate_load``.

    Raises
    ------
    NoLoad
        As ``wrench_evidence``.
    """
    ticks = average(poses, wrenches, stamp_ns)
    if ticks.is_measured.mean() < LEAST_SHARE:
        raise NoLoad("wrenches and poses hardly overlap in time: are their stamps of one clock?")
    load = estimate_load(ticks, is_free, p_free, mass_kg)
    if load is None and mass_kg is not None:  # one that is far off fits no tick
        load = estimate_load(ticks, is_free, p_free)
    if load is None:
        raise NoLoad(TOO_LITTLE)
    others = (
        (estimate_load(average(poses, other, stamp_ns), is_free, p_free), what)
        for what, other in _other_readings(poses, wrenches)
    )
    fits = [(one.fit, what) for one, what in others if one is not None and not one.doubt]
    best, what = max(fits, default=(0.0, ""))
    if best > (1.0 if load.doubt else FITS_BETTER) * load.fit:
        less = "they explain less of the free motion as they are than otherwise"
        raise NoLoad(f"{load.doubt or less}. They fit {what}")
    if not load.doubt:
        return ticks, load
    reason = TOO_LITTLE if load.ticks < FEWEST_TICKS else load.doubt
    raise NoLoad(
        f"{reason}. Check their sign, their frame, the sensor's bias, and "
        "whether there are some seconds of free motion"
    )


def _other_readings(poses: Poses, wrenches: Wrenches) -> Iterator[tuple[str, Wrenches]]:
    """The same numbers with other signs, and in the axes of the world, about its origin or the body's."""
    reverse = "with the opposite sign: they are those of the object on the hand"
    in_world = {
        "in the frame of the poses instead of the object's: set header.frame_id": about_body(wrenches, poses),
        "in the axes of the poses' frame, about the object's origin: turn them into its axes": turned_to_body(
            wrenches, poses
        ),
    }
    yield reverse, reversed_wrenches(wrenches)
    yield "with the opposite sign of the forces only", replace(wrenches, force_n=-wrenches.force_n)
    yield "with the opposite sign of the moments only", replace(wrenches, moment_nm=-wrenches.moment_nm)
    yield from in_world.items()
    for text, other in in_world.items():
        yield f"{reverse}, {text}", reversed_wrenches(other)
