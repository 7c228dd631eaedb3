"""Formatting of a recording's summary: text and JSON."""

import math
from collections.abc import Iterator, Mapping
from itertools import islice
from typing import Any, Final

from contact_tracker.adaptation.report import Report
from contact_tracker.errors import printable
from contact_tracker.motion.pose_validation import remarks_on
from contact_tracker.outputs.adaptation import noise_text, report_json, warnings
from contact_tracker.recording import WRENCH_TYPE, PoseSource, RecordingSummary, SourceSummary

Reports = Mapping[PoseSource, Report | None]
"""A tracker's adaptation report for each source, if known."""
_KEYS_SHOWN: Final = 24
"""Most keys of a metadata record that text shows; JSON has all."""


def summary_lines(summary: RecordingSummary, reports: Reports) -> Iterator[str]:
    """A block for each pose source, then other topics, metadata and attachments."""
    for source in summary.sources:
        yield printable(str(source.source))
        for name, text in _source_rows(source, reports.get(source.source)):
            yield f"  {name:<10}{text}"
    if summary.more_sources:
        yield f"more than {len(summary.sources)} sources of poses: the others are not shown"
    if sum(1 for source in summary.sources if source.poses) > len(reports):
        yield "what the tracker adapts to is shown of the first sources: choose with --topic or --frame"
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
        shown = ", ".join(islice(values, _KEYS_SHOWN)) or "empty"
        more = f", and {len(values) - _KEYS_SHOWN} more" if len(values) > _KEYS_SHOWN else ""
        yield printable(f"metadata {name}: {shown}{more}")
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
        rate, jitter_ms = source.median_rate_hz, source.jitter_s * 1e3
        yield "time", f"{source.duration_s:.2f} s at {rate:.1f} Hz, jitter {jitter_ms:.2f} ms"
        extent = " x ".join(f"{metres:.2f}" for metres in source.extent_m)
        yield "motion", f"{source.path_m:.2f} m of path within {extent} m"
    position_m, rotation_rad = _finite(source.sigma_position_m), _finite(source.sigma_rotation_rad)
    if position_m is not None and rotation_rad is not None:
        where = " at the body's origin" if adapted is not None and any(adapted.point_m) else ""
        deviations = f"{position_m * 1e3:.3f} mm and {math.degrees(rotation_rad):.3f} deg per axis"
        yield "noise", f"about {deviations}{where}"
    if adapted is not None:
        yield "tracking", noise_text(adapted)
        yield from (("warning", line) for line in warnings(adapted))
    yield from (("warning", line) for line in remarks_on(source.counts, source.observed))
    if source.counts:
        yield "noted", ", ".join(f"{kind} {count}" for kind, count in source.counts.items())


def _source_json(source: SourceSummary, adapted: Report | None) -> dict[str, Any]:
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
        "rate_hz": _finite(source.median_rate_hz),
        "jitter_s": _finite(source.jitter_s),
        "log_offset_s": _finite(source.log_offset_s),
        "path_m": _finite(source.path_m),
        "extent_m": [_finite(metres) for metres in source.extent_m],
        "noise": {
            "sigma_position_m": _finite(source.sigma_position_m),
            "sigma_rotation_rad": _finite(source.sigma_rotation_rad),
        },
        "counts": dict(source.counts),
        "tracking": None if adapted is None else report_json(adapted),
    }


def _finite(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None
