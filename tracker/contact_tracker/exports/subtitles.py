"""Segments as SubRip subtitles, for a video that starts with the recording."""

from collections.abc import Callable, Iterable
from typing import TextIO

from contact_tracker.errors import printable
from contact_tracker.tracking.belief import Segment


def write_srt(segments: Iterable[Segment], file: TextIO, origin_ns: Callable[[], int]) -> None:
    """One subtitle per segment, or per part between changes of its further contacts; times count from the
    stamp that ``origin_ns`` returns.

    Each lasts at least a millisecond.
    """
    parts = ((segment, part) for segment in segments for part in segment.parts)
    for number, (segment, part) in enumerate(parts, start=1):
        start_ms = max(part.start_ns - origin_ns(), 0) // 1_000_000
        end_ms = max((part.end_ns - origin_ns()) // 1_000_000, start_ms + 1)
        others = f" or {', '.join(segment.inseparable)}" if segment.inseparable else ""
        names = [printable(name) if name else "?" for name in segment.touching]
        named = " on ".join(names) if any(segment.touching) else ""
        lines = [f"{segment.contact.value} ({segment.probability:.2f}){others}", named]
        lines += [f"+ {one.contact.value} ({one.probability:.2f})" for one in part.further]
        if segment.joint is not None:
            lines.append(f"= {segment.joint.kind.value} ({segment.joint.probability:.2f})")
        text = "\n".join(filter(None, lines))
        file.write(f"{number}\n{_time(start_ms)} --> {_time(end_ms)}\n{text}\n\n")


def _time(total_ms: int) -> str:
    seconds, ms = divmod(total_ms, 1000)
    minutes, second = divmod(seconds, 60)
    hours, minute = divmod(minutes, 60)
    return f"{hours:02d}:{minute:02d}:{second:02d},{ms:03d}"
