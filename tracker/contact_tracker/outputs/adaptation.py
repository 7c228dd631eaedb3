"""Formatting of a tracker's adaptation report and of a recording's summary: text, warnings and JSON."""

import math
import re
from collections.abc import Iterable, Iterator, Mapping
from itertools import islice
from typing import Any, Final

from contact_tracker.errors import printable
from contact_tracker.motion.losses import remarks_on
from contact_tracker.motion.sensor_noise import estimate_noise
from contact_tracker.outputs.text import LEAST_DEVIATION
from contact_tracker.recording import WRENCH_TYPE, PoseSource, RecordingSummary, SourceSummary
from contact_tracker.tracking.filter_bank import TOLERANCE, Report
from contact_tracker.tracking.noise_choice import DECIDED_AFTER_S, LONGEST_S

_NUMBERS: Final = re.compile(r"\d[\d.,]*(?:e[-+]?\d+)?")


def not_given(texts: Iterable[str], reported: set[str]) -> list[str]:
    """The warnings that differ from the ``reported`` ones in more than numbers; adds them to ``reported``."""
    words = {_NUMBERS.sub("", text): text for text in texts}
    new = [text for key, text in words.items() if key not in reported]
    reported.update(words)
    return new


def noise_text(report: Report) -> str:
    """The noise of a pose and of a tick in words, with their origin."""
    nominal, used, lasts = report.model.noise, report.chosen.noise, any(report.lasting)
    point = " ".join(f"{metres:.2f}" for metres in report.point_m)
    per_pose = f"noise {_deviations(report.noise)} a pose"
    per_pose += f" at the point ({point}) m of the body" if any(report.point_m) else ""
    per_tick, lasting = (
        f"{_deviations(report.tick)} a tick",
        f"slowly varying errors of {_deviations(report.lasting)}",
    )
    if used.contact_rotation_rad != nominal.contact_rotation_rad:
        lasting += ", f-f to a tolerance"
    if not nominal.estimated:
        return f"{per_pose} (as given), {per_tick}{f', {lasting}' if lasts else ''}"
    if not report.is_decided:  # the motion does not determine the noise of a tick, so it is a prior
        cause = "too short a part was read" if report.is_cut_short else "there is too little motion"
        least = "up" if report.moved_s >= DECIDED_AFTER_S else f"{DECIDED_AFTER_S:g}"
        needed = f"{report.moved_s:.1f} s of motion; {least} to {LONGEST_S:g} s are needed"
        assumed = f"{per_tick}{f' and {lasting}' if lasts else ''} are assumed (set it by --noise)"
        return f"{per_pose}; {cause} to estimate the noise of ticks ({needed}): {assumed}"
    origin = ""
    if used.estimate_share < nominal.estimate_share:
        origin = " (chosen by the evidence; poses differ by motion, too)"
    elif lasts:
        origin = " (chosen by the evidence)"
    elif used.floor_position_m > nominal.floor_position_m:
        origin = " (chosen by the evidence; white noise would leave less)"
    return f"{per_pose}, {per_tick}{f', {lasting}' if lasts else ''}{origin}"


def warnings(report: Report | None) -> Iterator[str]:
    """One line per problem of the stream, with a remedy; none without a report."""
    if report is None:
        return
    model, chosen = report.model, report.chosen
    if chosen.tick_s > model.tick_s:
        yield (
            f"few poses: ticks of {chosen.tick_s:.2f} s instead of {model.tick_s:g} s, to hold "
            f"{model.poses_per_tick:g} poses each; shorter contacts are not found: record more poses a second"
        )
    elif TOLERANCE * report.poses_per_tick < model.poses_per_tick:
        yield (
            f"few poses: {report.poses_per_tick:.2g} in a tick of {chosen.tick_s:g} s; "
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


def _deviations(sigma: tuple[float, float]) -> str:
    """Standard deviations (m and rad) in mm and degrees, with two significant digits, without an exponent."""
    values = _in_mm_and_deg(*sigma)
    mm, deg = (f"{sd:.0f}" if sd >= 10.0 else f"{sd:.2g}" if sd >= 1e-4 else "0" for sd in values)
    return f"{mm} mm {deg} deg"


def _in_mm_and_deg(position_m: float, rotation_rad: float) -> tuple[float, float]:
    return 1e3 * position_m, math.degrees(rotation_rad)


Reports = Mapping[PoseSource, Report | None]
"""A tracker's adaptation report for each source, if known."""
_KEYS_SHOWN: Final = 24
"""Largest number of keys of a metadata record in text; JSON has all."""


def summary_lines(summary: RecordingSummary, reports: Reports) -> Iterator[str]:
    """A block for each pose source, then other topics, metadata and attachments."""
    for source in summary.sources:
        yield printable(str(source.source))
        for name, text in _source_rows(source, reports.get(source.source)):
            yield f"  {name:<10}{text}"
    if summary.more_sources:
        yield f"more than {len(summary.sources)} sources of poses: the others are not shown"
    if sum(1 for source in summary.sources if source.poses) > len(reports):
        yield "the tracker's adaptation is shown for the first sources only: choose with --topic or --frame"
    poses = {source.source.topic for source in summary.sources}
    for (topic, type_name, encoding), count in sorted(summary.topics.items()):
        if topic not in poses:
            yield printable(
                f"{topic} ({type_name or 'no type'}, {encoding or 'no encoding'}): {count} messages"
                + (f"; segment --wrench {topic} uses them" if type_name == WRENCH_TYPE else "")
            )
    if summary.undecodable:
        yield f"{summary.undecodable} messages of pose topics cannot be decoded"
    for name, values in summary.metadata.items():
        entries = ", ".join(islice(values, _KEYS_SHOWN)) or "empty"
        omitted = f", and {len(values) - _KEYS_SHOWN} more" if len(values) > _KEYS_SHOWN else ""
        yield printable(f"metadata {name}: {entries}{omitted}")
    for name in summary.attachments:
        yield printable(f"attachment {name}")


def summary_json(summary: RecordingSummary, reports: Reports) -> dict[str, Any]:
    """The summary as one JSON object; null for unknown figures."""
    return {
        "sources": [_source_json(source, reports.get(source.source)) for source in summary.sources],
        "more_sources": summary.more_sources,
        "topics": [
            {"topic": topic, "type": type_name, "encoding": encoding, "messages": count}
            for (topic, type_name, encoding), count in sorted(summary.topics.items())
        ],
        "metadata": {name: dict(values) for name, values in summary.metadata.items()},
        "attachments": list(summary.attachments),
        "undecodable": summary.undecodable,
        "damage": summary.damage,
    }


def _source_rows(source: SourceSummary, adapted: Report | None) -> Iterator[tuple[str, str]]:
    usable = "" if source.poses == source.observed else f" of {source.observed} published"
    yield "poses", f"{source.poses}{usable}"
    if source.poses > 1:
        rate, jitter_ms = source.rate_hz, source.jitter_s * 1e3
        yield "time", f"{source.duration_s:.2f} s at {rate:.1f} Hz, jitter {jitter_ms:.2f} ms"
        extent = " x ".join(f"{metres:.2f}" for metres in source.extent_m)
        yield "motion", f"{source.path_m:.2f} m of path within {extent} m"
    position_m, rotation_rad = map(_finite, estimate_noise(source.beginning))
    if position_m is not None and rotation_rad is not None:
        place = " at the body's origin" if adapted is not None and any(adapted.point_m) else ""
        values = _in_mm_and_deg(position_m, rotation_rad)
        mm, deg = (f"{sd:.3f}" if sd >= LEAST_DEVIATION else f"below {LEAST_DEVIATION:g}" for sd in values)
        about = "about " if values[0] >= LEAST_DEVIATION else ""
        yield "noise", f"{about}{mm} mm and {deg} deg per axis{place}"
    if adapted is not None:
        yield "tracking", noise_text(adapted)
    for line in (*warnings(adapted), *remarks_on(source.counts, source.observed)):
        yield "warning", line
    if source.counts:
        yield "noted", ", ".join(f"{kind} {count}" for kind, count in source.counts.items())


def _source_json(source: SourceSummary, adapted: Report | None) -> dict[str, Any]:
    sigma_position_m, sigma_rotation_rad = map(_finite, estimate_noise(source.beginning))
    return {
        "topic": source.source.topic,
        "type": source.source.type,
        "frame_id": source.source.frame_id,
        "child_frame_id": source.source.child_frame_id,
        "poses": source.poses,
        "published": source.observed,
        "first_ns": source.first_ns,
        "last_ns": source.last_ns,
        "duration_s": _finite(source.duration_s),
        "rate_hz": _finite(source.rate_hz),
        "jitter_s": _finite(source.jitter_s),
        "log_offset_s": _finite(source.log_offset_s),
        "path_m": _finite(source.path_m),
        "extent_m": [_finite(metres) for metres in source.extent_m],
        "noise": {"sigma_position_m": sigma_position_m, "sigma_rotation_rad": sigma_rotation_rad},
        "counts": dict(source.counts),
        "tracking": None if adapted is None else report_json(adapted),
    }


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
