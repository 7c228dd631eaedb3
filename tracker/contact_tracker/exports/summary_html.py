"""HTML of a ribbon and a table of segments, for notebooks and reports."""

from collections.abc import Iterator, Mapping, Sequence
from html import escape
from typing import Final

from contact_tracker.errors import printable
from contact_tracker.outputs.text import COLOUR, segment_rows
from contact_tracker.states import Contact
from contact_tracker.tracking.belief import Segment

MOST_ROWS: Final = 200
_BANNER: Final = "border-left:4px solid #e08000;margin:3px 0;padding:2px 8px"
_CELL: Final = "padding:2px 10px 2px 0;text-align:left;vertical-align:top"


def ribbon_html(segments: Sequence[Segment], height_px: int = 22) -> str:
    """Segments by duration, paler with lower probability; below them their further contacts."""
    first = [_bar(_lasts_ns(s), s.contact, s.probability) for s in segments]
    lanes = [_lane(first, height_px)]
    for number in range(max((len(s.further) for s in segments), default=0)):
        bars = [bar for s in segments for bar in _further_bars(s, number)]
        lanes.append(_lane(bars, height_px // 2))
    return "".join(lanes)


def _lane(bars: Sequence[str], height_px: int) -> str:
    style = f"display:flex;height:{height_px}px;width:100%;margin-bottom:3px"
    return f'<div style="{style}">{"".join(bars)}</div>'


def _bar(lasts_ns: int, contact: Contact, probability: float, joins: str = "") -> str:
    red, green, blue = COLOUR[contact]
    colour = f"rgba({red},{green},{blue},{0.25 + 0.75 * probability:.3f})"
    style = f"flex:{lasts_ns} 0 0;background:{colour};overflow:hidden"
    title = escape(f"{joins}{contact.value}, probability {probability:.2f}")
    return f'<div style="{style}" title="{title}"></div>'


def _further_bars(segment: Segment, number: int) -> Iterator[str]:
    """The bar of a further contact, and the gaps before and after it."""
    if number >= len(segment.further):
        yield _gap(_lasts_ns(segment))
        return
    one = segment.further[number]
    start_ns = min(max(one.start_ns, segment.start_ns), segment.end_ns)
    end_ns = segment.end_ns if one.end_ns is None else min(max(one.end_ns, start_ns), segment.end_ns)
    yield _gap(start_ns - segment.start_ns)
    yield _bar(max(end_ns - start_ns, 1), one.contact, one.probability, "+ ")
    yield _gap(segment.end_ns - end_ns)


def _gap(lasts_ns: int) -> str:
    return f'<div style="flex:{lasts_ns} 0 0"></div>' if lasts_ns > 0 else ""


def _lasts_ns(segment: Segment) -> int:
    return max(segment.end_ns - segment.start_ns, 1)


def table_html(segments: Sequence[Segment], origin_ns: int) -> str:
    """A row per segment, up to ``MOST_ROWS``, and per further contact; times in seconds after
    ``origin_ns``."""
    titles = ("start s", "end s", "contact", "p", "the object's element on the surroundings'")
    head = "".join(f'<th style="{_CELL}">{escape(title)}</th>' for title in titles)
    shown = (row for segment in segments[:MOST_ROWS] for row in segment_rows(segment, origin_ns))
    rows = [
        _row((f"{r.start_s:.2f}", f"{r.end_s:.2f}", r.kind, f"{r.probability:.2f}", printable(r.where)))
        for r in shown
    ]
    more = len(segments) - MOST_ROWS
    note = f"<p>and {more} more segments</p>" if more > 0 else ""
    return f"<table><thead><tr>{head}</tr></thead><tbody>{''.join(rows)}</tbody></table>{note}"


def _row(texts: Sequence[str]) -> str:
    cells = "".join(f'<td style="{_CELL}">{escape(text)}</td>' for text in texts)
    return f"<tr>{cells}</tr>"


def counts_html(counts: Mapping[str, int]) -> str:
    """Counts of dropped and repaired poses."""
    noted = ", ".join(f"{kind} {count}" for kind, count in counts.items() if count)
    return f"<p>noted: {escape(noted)}</p>" if noted else ""


def warnings_html(warnings: Sequence[str]) -> str:
    """A paragraph for each warning."""
    return "".join(f'<p style="{_BANNER}"><b>warning:</b> {escape(printable(text))}</p>' for text in warnings)
