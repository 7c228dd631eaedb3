"""Which suffix means which output, and the writer of each."""

from collections.abc import Callable, Iterable
from importlib import import_module
from pathlib import Path
from typing import Final, NamedTuple

from contact_tracker.atomic_file import whole_file
from contact_tracker.exports.columns import BELIEF_COLUMNS, belief_columns
from contact_tracker.exports.extras import extra
from contact_tracker.exports.outcome import Outcome
from contact_tracker.exports.subtitles import write_srt
from contact_tracker.outputs.tables import write_csv, write_jsonl
from contact_tracker.tracking.segmentation import Segmentation


class Library(NamedTuple):
    """The ``module`` of ours that needs it, its ``extra``, and what for."""

    module: str
    extra: str
    purpose: str


LIBRARIES: Final = {
    ".parquet": Library("parquet", "parquet", "a Parquet file"),
    ".mcap": Library("foxglove_scene", "foxglove", "an MCAP file for Foxglove"),
    ".html": Library("report_html", "report", "a report"),
}
SUFFIXES: Final = (".csv", ".jsonl", *LIBRARIES, ".srt")
WHOLE: Final = (".mcap", ".html")
"""Outputs that are made of all of a recording at once: it is kept in memory until then."""


def require_library(path: Path) -> None:
    """Raise MissingExtra, before any work, if a library is not installed that writing ``path`` takes."""
    library = LIBRARIES.get(path.suffix.lower())
    if library is not None:
        with extra(library.extra, library.purpose):
            import_module(f"contact_tracker.exports.{library.module}")


def write_pieces(found: Iterable[Segmentation], path: Path, origin_ns: Callable[[], int]) -> None:
    """Write a segmentation as it comes, whole or not at all: CSV, JSON lines, Parquet or subtitles.

    Parameters
    ----------
    path : its suffix says which, in whatever case.
    origin_ns : gives the stamp from which times for people count, once the first piece is there.
    """
    require_library(path)
    suffix = path.suffix.lower()
    with whole_file(path) as temporary:
        if suffix == ".parquet":
            from contact_tracker.exports.parquet import write_parquet

            write_parquet((belief_columns(piece.beliefs) for piece in found), BELIEF_COLUMNS, temporary)
            return
        with open(temporary, "w", encoding="utf-8", newline="") as file:
            segments = (one for piece in found for one in piece.segments)
            if suffix == ".csv":
                write_csv(segments, file)
            elif suffix == ".jsonl":
                write_jsonl((one for piece in found for one in piece.beliefs), file)
            else:
                write_srt(segments, file, origin_ns)


def write_outcome(outcome: Outcome, path: Path, log: str | None = None, log_offset_ns: int = 0) -> None:
    """Write what is made of a whole recording, whole or not at all: MCAP for Foxglove or a report.

    Parameters
    ----------
    log, log_offset_ns : as of ``foxglove_scene.write_mcap``.
    """
    require_library(path)
    with whole_file(path) as temporary:
        if path.suffix.lower() == ".mcap":
            from contact_tracker.exports.foxglove_scene import write_mcap

            write_mcap(outcome, temporary, log, log_offset_ns)
        else:
            from contact_tracker.exports.report_html import write_report

            write_report(outcome, temporary)
