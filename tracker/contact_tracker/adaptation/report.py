"""Report of the adaptation to a stream: ticks, noise and findings."""

from typing import NamedTuple

import numpy as np

from contact_tracker.adaptation.filter_bank import FilterBank
from contact_tracker.config.parameters import Model
from contact_tracker.inspection.stream_checks import Finding
from contact_tracker.map.world_map import GrowingMap
from contact_tracker.motion.tick_averaging import white_variances


class Report(NamedTuple):
    """The requested ``model`` and the one ``chosen``, whether the choice ``is_decided``; standard deviations
    (m, rad) of the ``noise`` of a pose, as estimated or given, of a ``tick``, with usually
    ``poses_per_tick``, and of ``lasting`` errors, correlated over ticks; the ``findings``. ``point_m``
    (3,): point of the body that is tracked, to which these belong. ``is_cut_short``: more of the stream could
    decide what is not decided. ``map_use``: how a learned map is used, in words."""

    model: Model
    chosen: Model
    is_decided: bool
    noise: tuple[float, float]
    tick: tuple[float, float]
    lasting: tuple[float, float]
    poses_per_tick: float
    findings: tuple[Finding, ...]
    point_m: tuple[float, ...] = (0.0, 0.0, 0.0)
    is_cut_short: bool = False
    map_use: str = ""


def map_use(world: GrowingMap) -> str:
    """How many contacts touch elements of the map of another recording, in words; empty without one."""
    if not world.prior:
        return ""
    used = sum(any(key in world.prior.elements for key in pair) for pair in world.pairs.values())
    return f"the learned map is used: {used} of {len(world.pairs)} sure contacts touch its elements"


def map_findings(world: GrowingMap) -> tuple[Finding, ...]:
    """Whether the map of another recording was of no use."""
    if not world.prior_is_dropped:
        return ()
    text = "the learned map explains no contact, and is not used: is it of this object and this frame?"
    return (Finding("map", text, False),)


def report_of(filters: FilterBank, is_decided: bool, findings: tuple[Finding, ...]) -> Report | None:
    """The report of a stream, and of its map; None before the second pose."""
    best = filters.best
    if best is None or filters.grid is None or filters.grid.stream is None:
        return None
    frames, chosen, estimate = filters.filters[0].state.window.frames, best.model, filters.grid.stream.noise
    typical = 1.0 if frames is None or not len(frames) else float(np.median(frames))
    variance = white_variances(estimate, np.array(typical), chosen)
    tick = float(variance[0]) ** 0.5, float(variance[1]) ** 0.5
    share = chosen.noise.estimate_share
    noise = share * estimate.sigma_position_m, share * estimate.sigma_rotation_rad
    lasting = chosen.noise.wander_position_m, chosen.noise.wander_rotation_rad
    figures = noise, tick, lasting, typical
    found, point_m = (*findings, *map_findings(best.map)), tuple(filters.body_m.tolist())
    return Report(filters.model, chosen, is_decided, *figures, found, point_m, map_use=map_use(best.map))
