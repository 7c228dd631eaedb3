"""The writer of each output, by the suffix of its file."""

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from contact_tracker.atomic_file import whole_file
from contact_tracker.exports.columns import BELIEF_COLUMNS, belief_columns
from contact_tracker.exports.outcome import Outcome
from contact_tracker.exports.subtitles import write_srt
from contact_tracker.exports.suffixes import TICKS, require_library
from contact_tracker.outputs.tables import write_csv, write_jsonl
from contact_tracker.tracking.belief import Belief
from contact_tracker.tracking.segmentation import Segmentation


@contextmanager
def open_ticks(path: Path) -> Iterator[Callable[[Iterable[Belief]], None]]:
    """Give the function that appends beliefs to a file of JSON lines or Parquet, which appears at the end.

    On any failure it does not appear at all.
    """
    require_library(path)
    with whole_file(path) as temporary:
        if path.suffix.lower() == ".parquet":
            from contact_tracker.exports.parquet import open_parquet

            with open_parquet(BELIEF_COLUMNS, temporary) as append:
                yield lambda beliefs: append(belief_columns(beliefs))
        else:
            with open(temporary, "w", encoding="utf-8", newline="") as file:
                yield lambda beliefs: write_jsonl(beliefs, file)


def write_pieces(found: Iterable[Segmentation], path: Path, origin_ns: Callable[[], int]) -> None:
    """Write a segmentation as it comes, whole or not at all: CSV, JSON lines, Parquet or subtitles.

    Parameters
    ----------
    path : its suffix says which, in whatever case.
    origin_ns : gives the stamp from which times for people count, once the first piece is there.
    """
    suffix = path.suffix.lower()
    if suffix in TICKS:
        with open_ticks(path) as append:
            for piece in found:
                append(piece.beliefs)
        return
    with whole_file(path) as temporary, open(temporary, "w", encoding="utf-8", newline="") as file:
        segments = (one for piece in found for one in piece.segments)
        if suffix == ".csv":
            write_csv(segments, file)
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
