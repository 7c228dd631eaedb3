"""What a tracker has adapted to, for people: noise, ticks, and what the stream shows of itself."""

import math
from collections.abc import Iterator
from typing import Any

from contact_tracker.adaptive import Report


def report_lines(report: Report) -> Iterator[str]:
    """A line of the noise, and one of each thing that has to be known about the stream."""
    pose, tick = _deviations(report.noise), _deviations(report.tick)
    yield f"noise {pose} a pose{_given(report)}, {tick} a tick{_chosen(report)}"
    if report.chosen.tick_s > report.model.tick_s:
        yield (
            f"few poses: ticks of {report.chosen.tick_s:.2f} s instead of {report.model.tick_s:g} s, so that each "
            f"holds {report.model.poses_per_tick:g}; shorter contacts are not found: record more poses a second"
        )
    elif report.poses_per_tick < report.model.poses_per_tick:
        yield (
            f"few poses: {report.poses_per_tick:g} in a tick of {report.chosen.tick_s:g} s; "
            "record more poses a second, or take a model with longer ticks (tick_s)"
        )
    yield from (finding.text for finding in report.findings)


def report_json(report: Report) -> dict[str, Any]:
    """The same as one object."""
    return {
        "sigma_position_m": report.noise[0],
        "sigma_rotation_rad": report.noise[1],
        "estimated": report.model.noise.estimated,
        "tick_sigma_position_m": report.tick[0],
        "tick_sigma_rotation_rad": report.tick[1],
        "decided": report.is_decided,
        "tick_s": report.chosen.tick_s,
        "poses_per_tick": report.poses_per_tick,
        "findings": [{"kind": finding.kind, "text": finding.text} for finding in report.findings],
    }


def _given(report: Report) -> str:
    return "" if report.model.noise.estimated else " (as given)"


def _chosen(report: Report) -> str:
    """How the noise of a tick was found, where it is more than what white noise leaves."""
    if not report.model.noise.estimated:
        return ""
    if not report.is_decided:
        return " (to be decided: too little motion so far)"
    if report.chosen.noise.floor_position_m > report.model.noise.floor_position_m:
        return " (chosen by the evidence: more than white noise would leave)"
    return ""


def _deviations(sigma: tuple[float, float]) -> str:
    return f"{sigma[0] * 1e3:.2g} mm {math.degrees(sigma[1]):.2g} deg"
