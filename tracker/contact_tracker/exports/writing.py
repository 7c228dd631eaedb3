"""Writers of the outputs, by suffix."""

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from contact_tracker.atomic_file import accept_any, whole_file
from contact_tracker.exports.columns import BELIEF_COLUMNS, belief_columns
from contact_tracker.exports.outcome import Outcome
from contact_tracker.exports.subtitles import write_srt
from contact_tracker.exports.suffixes import TICKS, require_library
from contact_tracker.outputs.tables import write_csv, write_jsonl
from contact_tracker.tracking.belief import Belief
from contact_tracker.tracking.segmentation import Segmentation


@contextmanager
def open_ticks(
    path: Path, check: Callable[[], None] = accept_any
) -> Iterator[Callable[[Iterable[Belief]], None]]:
    """Give the function that appends beliefs to a file of JSON lines or Parquet, which is written atomically.

    There is no file after a failure, or if an existing one does not pass ``check`` at the end.
    """
    require_library(path)
    with whole_file(path, check) as temporary:
        if path.suffix.lower() == ".parquet":
            from contact_tracker.exports.parquet import open_parquet

            with open_parquet(BELIEF_COLUMNS, temporary) as append:
                yield lambda beliefs: append(belief_columns(beliefs))
        else:
            with open(temporary, "w", encoding="utf-8", newline="") as file:
                yield lambda beliefs: write_jsonl(beliefs, file)


def write_pieces(
    found: Iterable[Segmentation],
    path: Path,
    origin_ns: Callable[[], int],
    check: Callable[[], None] = accept_any,
) -> None:
    """Write a segmentation incrementally but atomically: CSV, JSON lines, Parquet or subtitles.

    Parameters
    ----------
    path : its suffix, in any case, selects the format.
    origin_ns : returns the stamp from which displayed times count, after the first piece.
    check : of an existing file, as of ``whole_file``.
    """
    suffix = path.suffix.lower()
    if suffix in TICKS:
        with open_ticks(path, check) as append:
            for piece in found:
                append(piece.beliefs)
        return
    with whole_file(path, check) as temporary, open(temporary, "w", encoding="utf-8", newline="") as file:
        segments = (one for piece in found for one in piece.segments)
        if suffix == ".csv":
            write_csv(segments, file)
        else:
            write_srt(segments, file, origin_ns)


def write_outcome(
    outcome: Outcome,
    path: Path,
    log: str | None = None,
    log_offset_ns: int = 0,
    check: Callable[[], None] = accept_any,
) -> None:
    """Write an output of a whole recording atomically: MCAP for Foxglove, a report or a figure.

    Parameters
    ----------
    log, log_offset_ns : as of ``foxglove_scene.write_mcap``.
    check : of an existing file, as of ``whole_file``.
    """
    require_library(path)
    with whole_file(path, check) as temporary:
        suffix = path.suffix.lower()
        if suffix == ".mcap":
            from contact_tracker.exports.foxglove_scene import write_mcap

            write_mcap(outcome, temporary, log, log_offset_ns)
        elif suffix == ".html":
            from contact_tracker.exports.report_html import write_report

            write_report(outcome, temporary)
        else:
            from contact_tracker.exports.figure import write_figure

            write_figure(outcome, temporary, suffix)
