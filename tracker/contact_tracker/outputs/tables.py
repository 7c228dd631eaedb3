"""Beliefs as JSON lines and segments as CSV (docs/conventions.md)."""

import csv
import json
from collections.abc import Iterable
from typing import Final, TextIO

from contact_tracker.tracking.belief import Belief, Segment

CSV_COLUMNS: Final = (
    *("start_ns", "end_ns", "contact", "probability", "geometry", "inseparable", "contacts", "joint"),
    "decided",
)


OPEN: Final = "open"


def decided(one: Belief | Segment) -> str:
    """The contact, or ``open`` where the motion does not distinguish it from others."""
    return OPEN if one.inseparable else one.contact.value


def json_line(belief: Belief) -> str:
    """One belief as one JSON object, without newline."""
    return json.dumps(belief.to_json(), allow_nan=False)


def write_jsonl(beliefs: Iterable[Belief], file: TextIO) -> None:
    for belief in beliefs:
        file.write(json_line(belief) + "\n")


def write_csv(segments: Iterable[Segment], file: TextIO) -> None:
    """One row per segment; ``geometry`` is JSON text, ``{}`` for free; ``inseparable`` names with blanks;
    ``contacts`` is JSON text, a list of all contacts of the segment, and ``joint``, ``{}`` without one."""
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(CSV_COLUMNS)
    for segment in segments:
        geometry = segment.geometry.to_json() if segment.geometry else {}
        writer.writerow(
            (
                segment.start_ns,
                segment.end_ns,
                segment.contact.value,
                segment.probability,
                json.dumps(geometry, allow_nan=False),
                " ".join(segment.inseparable),
                json.dumps(segment.contacts_json, allow_nan=False),
                json.dumps(segment.joint.to_json() if segment.joint else {}, allow_nan=False),
                decided(segment),
            )
        )
