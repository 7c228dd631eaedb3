"""The formats of outputs, by suffix, their writing, and what they do not replace. Importing this is cheap."""

import csv
import json
import os
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from importlib import import_module
from itertools import chain, count
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple, TextIO

from contact_tracker.errors import MissingExtra, UnreadableRecording, UsageError, extra, printable
from contact_tracker.files import accept_any, whole_file

if TYPE_CHECKING:
    from contact_tracker.exports.columns import Rows
    from contact_tracker.outputs.outcome import Outcome
    from contact_tracker.tracking.belief import Belief, Segment, SegmentPart
    from contact_tracker.tracking.segmentation import Segmentation

Append = Callable[[Iterable[Any]], None]
_TOGETHER: Final = 256
"""Rows of Parquet that are written at a time, at least."""


class Format(NamedTuple):
    """An output with an entry per tick or segment, or of a whole recording in memory.

    ``rows`` are those that it can have an entry of, the usual ones first; none for a whole recording. That is
    written by the function ``write`` of a ``module``, which may need a library of an ``extra`` for the
    ``purpose``.
    """

    rows: "tuple[Rows, ...]" = ()
    module: str = ""
    write: str = ""
    extra: str = ""
    purpose: str = ""


FIGURES: Final = (".png", ".pdf", ".svg")
FORMATS: Final = {
    ".csv": Format(("segments", "ticks")),
    ".jsonl": Format(("ticks", "segments")),
    ".parquet": Format(("ticks", "segments")),
    ".mcap": Format((), "exports.foxglove_scene", "write_mcap", "foxglove", "an MCAP file for Foxglove"),
    ".html": Format((), "exports.report_html", "write_report"),
    **dict.fromkeys(FIGURES, Format((), "exports.figure", "write_figure")),
    ".srt": Format(("segments",)),
    ".tex": Format(("segments",)),
    ".toml": Format((), "sequences.plan", "write_plan"),
    ".graphml": Format((), "sequences.graph", "write_graph"),
    ".contacts": Format((), "exports.saved_result", "write_result"),
    ".rrd": Format((), "viewer.views", "write_rrd"),
}
SUFFIXES: Final = tuple(suffix for suffix in FORMATS if suffix != ".rrd")
"""Of what ``segment`` writes; ``view`` writes the recording of rerun."""
TICKS: Final = tuple(suffix for suffix, one in FORMATS.items() if "ticks" in one.rows)
ROWS: Final = ("ticks", "segments")


def rows_of(path: Path, asked: str | None = None) -> "Rows | None":
    """What the output of this name has an entry per, the ``asked`` rows or the usual ones; None if it is of a
    whole recording. Raises UsageError if it cannot have those that are asked for."""
    rows = FORMATS[path.suffix.lower()].rows
    if asked is None:
        return rows[0] if rows else None
    for one in rows:
        if one == asked:
            return one
    if asked not in ROWS:
        raise UsageError(f"rows are {' or '.join(ROWS)}, not {asked!r}")
    able = ", ".join(suffix for suffix, other in FORMATS.items() if asked in other.rows)
    raise UsageError(f"rows of {asked} are for {able}, not {path}")


def require_library(path: Path) -> None:
    """Raise MissingExtra, before any work, if a library for writing ``path`` is not installed."""
    one = FORMATS[path.suffix.lower()]
    if one.extra:
        with extra(one.extra, one.purpose):
            import_module(f"contact_tracker.{one.module}")


@contextmanager
def open_rows(
    path: Path, rows: "Rows", origin_ns: Callable[[], int], check: Callable[[], None] = accept_any
) -> Iterator[Append]:
    """Give the function that appends beliefs or segments, as ``rows`` says, to a file, which is written
    atomically.

    There is no file after a failure, or if an existing one does not pass ``check`` at the end. ``origin_ns``
    returns the stamp from which displayed times count; it is called after the first entry.
    """
    with whole_file(path, check) as temporary:
        if path.suffix.lower() == ".parquet":
            from contact_tracker.exports.columns import COLUMNS, columns_of
            from contact_tracker.exports.parquet import open_parquet

            with open_parquet(COLUMNS[rows], temporary) as write:
                waiting = list[Any]()

                def append_together(entries: Iterable[Any]) -> None:
                    waiting.extend(entries)
                    if len(waiting) >= _TOGETHER:
                        write(columns_of(rows, waiting))
                        waiting.clear()

                yield append_together
                write(columns_of(rows, waiting))
            return
        with (
            open(temporary, "w", encoding="utf-8", newline="") as file,
            open_text(path.suffix.lower(), file, rows, origin_ns) as append,
        ):
            yield append


def write_pieces(
    found: "Iterable[Segmentation]",
    path: Path,
    rows: "Rows",
    origin_ns: Callable[[], int],
    check: Callable[[], None] = accept_any,
) -> int:
    """Write a segmentation incrementally but atomically, the parameters as of ``open_rows``; returns the
    number of entries."""
    count = 0
    with open_rows(path, rows, origin_ns, check) as append:
        for piece in found:
            entries: Sequence[Any] = piece.beliefs if rows == "ticks" else piece.segments
            append(entries)
            count += len(entries)
    return count


def write_outcome(
    outcome: "Outcome", path: Path, rows: str | None = None, check: Callable[[], None] = accept_any
) -> None:
    """Write the output of a whole recording that the suffix selects, atomically; ``rows`` as of ``rows_of``,
    ``check`` as of ``whole_file``."""
    entries = rows_of(path, rows)
    if entries is not None:
        write_pieces([outcome.segmentation], path, entries, lambda: outcome.origin_ns, check)
        return
    require_library(path)
    one = FORMATS[path.suffix.lower()]
    write = getattr(import_module(f"contact_tracker.{one.module}"), one.write)
    with whole_file(path, check) as temporary:
        write(outcome, temporary, path.suffix.lower())


def json_line(entry: "Belief | Segment", more: Mapping[str, object] | None = None) -> str:
    """One belief or segment, with ``more`` keys, as one JSON object, without newline."""
    return json.dumps({**entry.to_json(), **(more or {})}, allow_nan=False)


@contextmanager
def open_text(suffix: str, file: TextIO, rows: "Rows", origin_ns: Callable[[], int]) -> Iterator[Append]:
    """Text by its suffix: JSON lines; CSV with the columns of ``csv_columns``; a table of LaTeX with the rows
    of that on a terminal; or SubRip subtitles for a video that starts with the recording, one per segment, or
    per part between changes of its further contacts, that lasts at least a millisecond."""
    from contact_tracker.exports.columns import csv_columns
    from contact_tracker.outputs.text import GEOMETRY_TITLE, segment_rows

    numbers, table = count(1), csv.writer(file, lineterminator="\n")
    if suffix == ".csv":
        table.writerow(csv_columns(rows, (), 0))
    elif suffix == ".tex":
        file.write(_TEX_BEGIN.format(title=GEOMETRY_TITLE))

    def write(entries: Iterable[Any]) -> None:
        match suffix:
            case ".csv":
                if entries := list(entries):
                    table.writerows(zip(*csv_columns(rows, entries, origin_ns()).values(), strict=True))
            case ".jsonl":
                file.writelines(f"{json_line(one)}\n" for one in entries)
            case ".tex":
                for *figures, where in chain.from_iterable(segment_rows(one, origin_ns()) for one in entries):
                    file.write(" & ".join([*figures, f"{_tex(where)} \\\\\n"]))
            case ".srt":
                for segment in entries:
                    for part in segment.parts:
                        file.write(f"{next(numbers)}\n{_subtitle(segment, part, origin_ns())}\n\n")

    yield write
    if suffix == ".tex":
        file.write("\\bottomrule\n\\end{tabular}\n")


_TEX_BEGIN: Final = r"""% \usepackage{{array,booktabs}}
\begin{{tabular}}{{rrlr>{{\raggedright\arraybackslash}}p{{0.6\linewidth}}}}
\toprule
start (s) & end (s) & contact & $p$ & {title} \\
\midrule
"""
_TEX: Final = {
    **{sign: rf"\{sign}" for sign in "&%$#_{}"},
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
}


def _tex(text: str) -> str:
    """Geometry in words as LaTeX; names of elements may have any letters."""
    escaped = "".join(_TEX.get(sign, sign) for sign in printable(text))
    with_units = re.sub(r"(?<=[\d)]) (m|mm)\b", r"~\1", escaped)
    with_units = re.sub(r"(?<=\d) deg\b(?!\\_)", r"$^\\circ$", with_units)
    return with_units.replace(" +/- ", r"~$\pm$~")


def _subtitle(segment: "Segment", part: "SegmentPart", origin_ns: int) -> str:
    start_ms = max(part.start_ns - origin_ns, 0) // 1_000_000
    end_ms = max((part.end_ns - origin_ns) // 1_000_000, start_ms + 1)
    times = [
        f"{ms // 3_600_000:02d}:{ms // 60_000 % 60:02d}:{ms // 1000 % 60:02d},{ms % 1000:03d}"
        for ms in (start_ms, end_ms)
    ]
    others = f" or {', '.join(segment.inseparable)}" if segment.inseparable else ""
    lines = [" --> ".join(times), f"{segment.contact.value} ({segment.probability:.2f}){others}"]
    if any(segment.touching):
        lines.append(" on ".join(printable(name) if name else "?" for name in segment.touching))
    lines += [f"+ {one.contact.value} ({one.probability:.2f})" for one in part.further]
    if segment.joint is not None:
        lines.append(f"= {segment.joint.kind.value} ({segment.joint.probability:.2f})")
    return "\n".join(lines)


def check_output(
    path: Path | None,
    overwrite: bool,
    read: Iterable[str] = (),
    how: str = "--overwrite",
    written: Iterable[Path | None] = (),
) -> Callable[[], None]:
    """Refuse an output that is one of the files ``read`` or of the other outputs ``written``, under any name,
    or that would replace a recording: raises UsageError.

    The message contains ``how`` to overwrite a recording after all.

    Returns
    -------
    The same check for ``whole_file``, as files may be renamed and linked in the meantime.
    """
    names = {
        **{str(one): "another output," for one in written if one is not None},
        **dict.fromkeys(read, "the input"),
    }
    before = {name: _status(name) for name in names}

    def check() -> None:
        from contact_tracker.recording import may_be_recording

        if path is None:
            return
        there, real = _status(str(path)), os.path.realpath(path)
        for name, what in names.items():
            states = before[name], _status(name)
            is_same = name != "-" and os.path.realpath(name) == real  # which need not exist yet
            if is_same or any(there and one and os.path.samestat(there, one) for one in states):
                shown = "standard input" if name == "-" else name
                raise UsageError(f"cannot write {path}: it is {what} {shown}; name another file")
        if not there or overwrite:
            return
        try:
            reason = "it is a recording" if may_be_recording(str(path)) else None
        except (OSError, UnreadableRecording, MissingExtra) as error:
            why = getattr(error, "strerror", None) or error
            reason = f"it may be a recording, but cannot be read ({why})"
        if reason is not None:
            raise UsageError(f"cannot write {path}: {reason}; {how} replaces it")

    check()
    return check


def _status(name: str) -> os.stat_result | None:
    """The status of a file, None on errors, which reading it reports."""
    with suppress(OSError, ValueError):
        return os.fstat(sys.stdin.fileno()) if name == "-" else os.stat(name)
    return None
