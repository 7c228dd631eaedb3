"""Formatting of a tracker's adaptation report: text, warnings and JSON."""

import math
import re
from collections.abc import Iterable, Iterator
from typing import Any, Final

from contact_tracker.adaptation.report import Report
from contact_tracker.inspection.stream_checks import STILL

_NUMBERS: Final = re.compile(r"\d[\d.,]*(?:e[-+]?\d+)?")


class News:
    """Those warnings of a stream that it has not given yet; their numbers change while it goes on.

    Parameters
    ----------
    given : warnings that were given before.
    """

    def __init__(self, given: Iterable[str] = ()) -> None:
        self._words = {_words(text) for text in given}

    def of(self, texts: Iterable[str]) -> list[str]:
        """The new ones of these, which count as given from now on."""
        new = {words: text for text in texts if (words := _words(text)) not in self._words}
        self._words.update(new)
        return [*new.values()]


def _words(text: str) -> str:
    return _NUMBERS.sub("", text)


def noise_text(report: Report) -> str:
    """The noise of a pose and of a tick, and their origin."""
    if report.model.noise.estimated and not report.is_decided:
        return _assumed_text(report)
    given = "" if report.model.noise.estimated else " (as given)"
    lasting = f", errors that last {_deviations(report.lasting)}" if any(report.lasting) else ""
    return (
        f"noise {_deviations(report.noise)} a pose{_point(report)}{given}, {_deviations(report.tick)} a tick"
        f"{lasting}{_chosen(report)}"
    )


def warnings(report: Report) -> Iterator[str]:
    """One line for each problem of the stream, with a remedy."""
    asked, chosen = report.model, report.chosen
    if chosen.tick_s > asked.tick_s:
        yield (
            f"few poses: ticks of {chosen.tick_s:.2f} s instead of {asked.tick_s:g} s, to hold "
            f"{asked.poses_per_tick:g} poses each; shorter contacts are not found: record more poses a second"
        )
    elif report.poses_per_tick < asked.poses_per_tick and not any(f.kind == STILL for f in report.findings):
        yield (
            f"few poses: {report.poses_per_tick:g} in a tick of {chosen.tick_s:g} s; "
            "if the unit of their times is right, record more poses a second, or take a model with "
            "longer ticks (tick_s)"
        )
    yield from (finding.text for finding in report.findings)


def report_json(report: Report) -> dict[str, Any]:
    """The report as one JSON object."""
    return {
        "noise_estimated": report.model.noise.estimated,
        "noise_decided": report.is_decided,
        "sigma_position_m": report.noise[0],
        "sigma_rotation_rad": report.noise[1],
        "tick_s": report.chosen.tick_s,
        "tick_sigma_position_m": report.tick[0],
        "tick_sigma_rotation_rad": report.tick[1],
        "lasting_sigma_position_m": report.lasting[0],
        "lasting_sigma_rotation_rad": report.lasting[1],
        "poses_per_tick": report.poses_per_tick,
        "point_m": [*report.point_m],
        "findings": [finding.kind for finding in report.findings],
        "warnings": [*warnings(report)],
    }


def _assumed_text(report: Report) -> str:
    """The noise where the motion does not show what averaging leaves of it, so that a tick's is a prior."""
    lasting = f" and errors that last {_deviations(report.lasting)}" if any(report.lasting) else ""
    why = "the part that was looked at does not tell" if report.is_cut_short else "too little motion to tell"
    return (
        f"noise {_deviations(report.noise)} a pose{_point(report)}; {why} what averaging leaves of it: "
        f"{_deviations(report.tick)} a tick{lasting} are assumed (--noise sets it)"
    )


def _point(report: Report) -> str:
    """The point of the body to which the noise belongs, if it is not the origin."""
    if not any(report.point_m):
        return ""
    return f" at the point ({' '.join(f'{metres:.2f}' for metres in report.point_m)}) m of the body"


def _chosen(report: Report) -> str:
    """The origin of a tick's noise, where it is not that of averaged white noise."""
    if not report.model.noise.estimated:
        return ""
    if report.chosen.noise.estimate_share < report.model.noise.estimate_share:
        return " (chosen by the evidence; poses differ by motion, too)"
    if any(report.lasting):
        return " (chosen by the evidence)"
    if report.chosen.noise.floor_position_m > report.model.noise.floor_position_m:
        return " (chosen by the evidence; white noise would leave less)"
    return ""


def _deviations(sigma: tuple[float, float]) -> str:
    return f"{_two_figures(1e3 * sigma[0])} mm {_two_figures(math.degrees(sigma[1]))} deg"


def _two_figures(value: float) -> str:
    """Two significant digits, without an exponent."""
    return f"{value:.0f}" if value >= 10.0 else f"{value:.2g}" if value >= 1e-4 else "0"
