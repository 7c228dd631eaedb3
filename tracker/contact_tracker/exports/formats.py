"""The formats of outputs, by suffix, their writing, and what they do not replace. Importing this is cheap."""

import csv
import json
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple, TextIO

from contact_tracker.errors import extra, printable
from contact_tracker.files import accept_any, whole_file

if TYPE_CHECKING:
    from contact_tracker.outputs.outcome import Outcome
    from contact_tracker.tracking.belief import Belief, Segment
    from contact_tracker.tracking.segmentation import Segmentation

import os
import sys
from collections.abc import Mapping
from contextlib import suppress
from functools import partial

from contact_tracker.errors import MissingExtra, UnreadableRecording, UsageError

CSV_COLUMNS: Final = (
    *("start_ns", "end_ns", "contact", "probability", "geometry", "inseparable", "contacts", "joint"),
    "decided",
)
_TOGETHER: Final = 256
"""Rows of Parquet that are written at a time, at least."""


class Format(NamedTuple):
    """An output with an entry per tick or segment (``rows``), or of a whole recording in memory.

    That is written by the function ``write`` of a ``module`` of this package, which may need a library of an
    ``extra`` for the ``purpose``.
    """

    rows: str
    module: str = ""
    write: str = ""
    extra: str = ""
    purpose: str = ""


FIGURES: Final = (".png", ".pdf", ".svg")
FORMATS: Final = {
    ".csv": Format("segments"),
    ".jsonl": Format("ticks"),
    ".parquet": Format("ticks"),
    ".mcap": Format("whole", "foxglove_scene", "write_mcap", "foxglove", "an MCAP file for Foxglove"),
    ".html": Format("whole", "report_html", "write_report", "report", "a report"),
    **dict.fromkeys(FIGURES, Format("whole", "figure", "write_figure")),
    ".srt": Format("segments"),
}
SUFFIXES: Final = tuple(FORMATS)
TICKS: Final = tuple(suffix for suffix, one in FORMATS.items() if one.rows == "ticks")


def format_of(path: Path) -> Format:
    """The format that the suffix of a path selects, in any case."""
    return FORMATS[path.suffix.lower()]


def require_library(path: Path) -> None:
    """Raise MissingExtra, before any work, if a library for writing ``path`` is not installed."""
    one = FORMATS.get(path.suffix.lower())
    if one is not None and one.extra:
        with extra(one.extra, one.purpose):
            import_module(f"contact_tracker.exports.{one.module}")


@contextmanager
def open_ticks(
    path: Path, check: Callable[[], None] = accept_any
) -> "Iterator[Callable[[Iterable[Belief]], None]]":
    """Give the function that appends beliefs to a file of JSON lines or Parquet, which is written atomically.

    There is no file after a failure, or if an existing one does not pass ``check`` at the end.
    """
    require_library(path)
    with whole_file(path, check) as temporary:
        if path.suffix.lower() == ".jsonl":
            with _text(temporary) as file:
                yield lambda beliefs: write_jsonl(beliefs, file)
            return
        from contact_tracker.exports.columns import BELIEF_COLUMNS, belief_columns
        from contact_tracker.exports.parquet import open_parquet

        with open_parquet(BELIEF_COLUMNS, temporary) as append:
            waiting = list["Belief"]()

            def write(beliefs: "Iterable[Belief]") -> None:
                waiting.extend(beliefs)
                if len(waiting) >= _TOGETHER:
                    append(belief_columns(waiting))
                    waiting.clear()

            yield write
            append(belief_columns(waiting))


def write_pieces(
    found: "Iterable[Segmentation]",
    path: Path,
    origin_ns: Callable[[], int],
    check: Callable[[], None] = accept_any,
) -> None:
    """Write a segmentation incrementally but atomically: formats with an entry per tick or segment.

    Parameters
    ----------
    origin_ns : returns the stamp from which displayed times count, after the first piece.
    check : of an existing file, as of ``whole_file``.
    """
    if format_of(path).rows == "ticks":
        with open_ticks(path, check) as append:
            for piece in found:
                append(piece.beliefs)
        return
    with whole_file(path, check) as temporary, _text(temporary) as file:
        segments = (one for piece in found for one in piece.segments)
        if path.suffix.lower() == ".csv":
            write_csv(segments, file)
        else:
            write_srt(segments, file, origin_ns)


def write_outcome(outcome: "Outcome", path: Path, check: Callable[[], None] = accept_any) -> None:
    """Write the output of a whole recording that the suffix selects, atomically; ``check`` as of
    ``whole_file``."""
    one = format_of(path)
    if one.rows != "whole":
        write_pieces([outcome.segmentation], path, lambda: outcome.origin_ns, check)
        return
    require_library(path)
    write = getattr(import_module(f"contact_tracker.exports.{one.module}"), one.write)
    with whole_file(path, check) as temporary:
        write(outcome, temporary, path.suffix.lower())


def _text(path: Path) -> TextIO:
    return open(path, "w", encoding="utf-8", newline="")


def json_line(belief: "Belief", more: Mapping[str, object] | None = None) -> str:
    """One belief, with ``more`` keys, as one JSON object, without newline."""
    return json.dumps({**belief.to_json(), **(more or {})}, allow_nan=False)


def write_jsonl(beliefs: "Iterable[Belief]", file: TextIO) -> None:
    for belief in beliefs:
        file.write(json_line(belief) + "\n")


def write_csv(segments: "Iterable[Segment]", file: TextIO) -> None:
    """One row per segment; ``geometry`` is JSON text, ``{}`` for free; ``inseparable`` names with blanks;
    ``contacts`` is JSON text, a list of all contacts of the segment, and ``joint``, ``{}`` without one."""
    from contact_tracker.exports.columns import decided

    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(CSV_COLUMNS)
    for one in segments:
        geometry = one.geometry.to_json() if one.geometry else {}
        joint = one.joint.to_json() if one.joint else {}
        encoded = [json.dumps(value, allow_nan=False) for value in (geometry, one.contacts_json, joint)]
        label = one.start_ns, one.end_ns, one.contact.value, one.probability
        writer.writerow((*label, encoded[0], " ".join(one.inseparable), *encoded[1:], decided(one)))


def write_srt(segments: "Iterable[Segment]", file: TextIO, origin_ns: Callable[[], int]) -> None:
    """SubRip subtitles for a video that starts with the recording: one per segment, or per part between
    changes of its further contacts; times count from the stamp that ``origin_ns`` returns.

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
        file.write(f"{number}\n{_subtitle_time(start_ms)} --> {_subtitle_time(end_ms)}\n{text}\n\n")


def _subtitle_time(total_ms: int) -> str:
    seconds, ms = divmod(total_ms, 1000)
    minutes, second = divmod(seconds, 60)
    hours, minute = divmod(minutes, 60)
    return f"{hours:02d}:{minute:02d}:{second:02d},{ms:03d}"


def check_output(
    path: Path | None,
    overwrite: bool,
    read: Iterable[str] = (),
    how: str = "--overwrite",
    written: Iterable[Path | None] = (),
) -> Callable[[], None]:
    """Refuse an output that is one of the files ``read`` or of the other outputs ``written``, under any name,
    or that would replace a recording.

    The message contains ``how`` to overwrite a recording after all.

    Returns
    -------
    The same check for ``whole_file``, as files may be renamed and linked in the meantime.

    Raises
    ------
    UsageError
        The message says what to do instead.
    """
    names = {
        **{str(one): "another output," for one in written if one is not None},
        **dict.fromkeys(read, "the input"),
    }
    before = {name: _status(name) for name in names}
    check = partial(_check, path, overwrite, how, names, before)
    check()
    return check


def _check(
    path: Path | None,
    overwrite: bool,
    how: str,
    names: Mapping[str, str],
    before: Mapping[str, os.stat_result | None],
) -> None:
    """Check again; ``names`` say what each file is, and ``before`` are these files at the first check."""
    if path is None:
        return
    there, real = _status(str(path)), os.path.realpath(path)
    for name, what in names.items():
        states = before[name], _status(name)
        is_same = name != "-" and os.path.realpath(name) == real  # which need not exist yet
        if is_same or any(there and one and os.path.samestat(there, one) for one in states):
            shown = "standard input" if name == "-" else name
            raise UsageError(f"cannot write {path}: it is {what} {shown}; name another file")
    if there and not overwrite and (reason := _why_kept(path)):
        raise UsageError(f"cannot write {path}: {reason}; {how} replaces it")


def _status(name: str) -> os.stat_result | None:
    """The status of a file, None on errors, which reading it reports."""
    with suppress(OSError, ValueError):
        return os.fstat(sys.stdin.fileno()) if name == "-" else os.stat(name)
    return None


def _why_kept(path: Path) -> str | None:
    from contact_tracker.recording import may_be_recording

    try:
        return "it is a recording" if may_be_recording(str(path)) else None
    except (OSError, UnreadableRecording, MissingExtra) as error:
        return f"it may be a recording, but cannot be read ({getattr(error, 'strerror', None) or error})"
