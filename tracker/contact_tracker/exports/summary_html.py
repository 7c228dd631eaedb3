"""HTML of a table of segments, of counts and warnings, for notebooks and reports."""

from collections.abc import Sequence
from html import escape
from typing import Final

from contact_tracker.errors import printable
from contact_tracker.outputs.text import counted, segment_rows
from contact_tracker.tracking.belief import Segment

MOST_ROWS: Final = 200
_BANNER: Final = "border-left:4px solid #e08000;margin:3px 0;padding:2px 8px"
_CELL: Final = "padding:2px 10px 2px 0;text-align:left;vertical-align:top"


def table_html(segments: Sequence[Segment], origin_ns: int) -> str:
    """A row per segment, up to ``MOST_ROWS``, and per further contact, with the segment's number; times in
    seconds after ``origin_ns``."""
    titles = ("start s", "end s", "contact", "p", "the object's element on the surroundings'")
    head = "".join(f'<th style="{_CELL}">{escape(title)}</th>' for title in titles)
    rows = [
        _row(i, row)
        for i, segment in enumerate(segments[:MOST_ROWS])
        for row in segment_rows(segment, origin_ns)
    ]
    more = len(segments) - MOST_ROWS
    note = f"<p>and {counted(more, 'more segment')}</p>" if more > 0 else ""
    return f"<table><thead><tr>{head}</tr></thead><tbody>{''.join(rows)}</tbody></table>{note}"


def _row(number: int, texts: Sequence[str]) -> str:
    cells = "".join(f'<td style="{_CELL}">{escape(printable(text))}</td>' for text in texts)
    return f'<tr data-segments="{number}">{cells}</tr>'


def counts_html(noted: str) -> str:
    """Counts of dropped and repaired poses, as ``counts_text`` has them."""
    return f"<p>noted: {escape(noted)}</p>" if noted else ""


def warnings_html(warnings: Sequence[str]) -> str:
    """A paragraph for each warning."""
    return "".join(f'<p style="{_BANNER}"><b>warning:</b> {escape(printable(text))}</p>' for text in warnings)
