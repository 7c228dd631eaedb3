"""Formats of outputs by suffix, their writing, and the protection of files. Importing this is cheap."""

import csv
import json
import os
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from importlib import import_module
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple, TextIO

from contact_tracker.errors import MissingExtra, UnreadableRecording, UsageError, extra, printable, shown
from contact_tracker.files import accept_any, whole_file

if TYPE_CHECKING:
    from contact_tracker.exports.columns import Rows
    from contact_tracker.outputs.outcome import Outcome
    from contact_tracker.tracking.belief import Belief, Segment
    from contact_tracker.tracking.segmentation import Segmentation

Append = Callable[[Iterable[Any]], None]
_LEAST_ROWS: Final = 256
"""Least number of rows of Parquet that are written at a time."""


class Format(NamedTuple):
    """An output with an entry per tick or segment, or an output of a whole recording in memory.

    ``rows`` are its possible entries, the default first; empty for an output of a whole recording, which the
    function ``write`` of ``module`` writes. This may need a library of ``extra`` for a ``purpose``.
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
    ".contacts": Format((), "saved_result", "write_result"),
    ".rrd": Format((), "viewer.views", "write_rrd"),
}
SUFFIXES: Final = tuple(suffix for suffix in FORMATS if suffix != ".rrd")
"""Suffixes of the outputs of ``segment``; ``view`` writes ``.rrd``, a recording of rerun."""
TICKS: Final = tuple(suffix for suffix, entry in FORMATS.items() if "ticks" in entry.rows)
ROWS: Final = ("ticks", "segments")


def rows_of(path: Path, rows: str | None = None) -> "Rows | None":
    """The entries of the output ``path``, ``rows`` or the default of its format; None if the output is of a
    whole recording. Raises UsageError if the format does not have ``rows``."""
    possible = FORMATS[path.suffix.lower()].rows
    if rows is None:
        return possible[0] if possible else None
    if not isinstance(rows, str) or rows not in ROWS:
        raise UsageError(f"rows are {' or '.join(ROWS)}, not {shown(rows)}")
    for kind in possible:
        if kind == rows:
            return kind
    suffixes = ", ".join(suffix for suffix, entry in FORMATS.items() if rows in entry.rows)
    raise UsageError(f"rows of {rows} are for {suffixes}, not {path}")


def require_library(path: Path) -> None:
    """Raise MissingExtra, before any work, if a library for writing ``path`` is not installed."""
    output = FORMATS[path.suffix.lower()]
    if output.extra:
        with extra(output.extra, output.purpose):
            import_module(f"contact_tracker.{output.module}")


@contextmanager
def open_rows(
    path: Path, rows: "Rows", origin_ns: Callable[[], int], check: Callable[[], None] = accept_any
) -> Iterator[Append]:
    """Give the function that appends beliefs or segments (``rows``) to a file, which is written atomically.

    There is no new file after a failure, or if ``check`` raises at the end. ``origin_ns`` returns the stamp
    from which displayed times count; it is called after the first entry.
    """
    with whole_file(path, check) as temporary:
        if path.suffix.lower() == ".parquet":
            from contact_tracker.exports.columns import COLUMNS, columns_of
            from contact_tracker.exports.parquet import open_parquet

            with open_parquet(COLUMNS[rows], temporary) as write:
                waiting = list[Any]()

                def append_together(entries: Iterable[Any]) -> None:
                    waiting.extend(entries)
                    if len(waiting) >= _LEAST_ROWS:
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
    pieces: "Iterable[Segmentation]",
    path: Path,
    rows: "Rows",
    origin_ns: Callable[[], int],
    check: Callable[[], None] = accept_any,
) -> int:
    """Write a segmentation incrementally but atomically; parameters as in ``open_rows``. Returns the number
    of entries."""
    count = 0
    with open_rows(path, rows, origin_ns, check) as append:
        for piece in pieces:
            entries: Sequence[Any] = piece.beliefs if rows == "ticks" else piece.segments
            append(entries)
            count += len(entries)
    return count


def write_outcome(
    outcome: "Outcome", path: Path, rows: str | None = None, check: Callable[[], None] = accept_any
) -> None:
    """Write the output of a whole recording that the suffix selects, atomically; ``rows`` as in ``rows_of``,
    ``check`` as in ``whole_file``."""
    entries = rows_of(path, rows)
    if entries is not None:
        write_pieces([outcome.segmentation], path, entries, lambda: outcome.origin_ns, check)
        return
    require_library(path)
    output = FORMATS[path.suffix.lower()]
    write = getattr(import_module(f"contact_tracker.{output.module}"), output.write)
    with whole_file(path, check) as temporary:
        write(outcome, temporary, path.suffix.lower())


def json_line(entry: "Belief | Segment", additional: Mapping[str, object] | None = None) -> str:
    """A belief or segment, with ``additional`` keys, as a JSON object without newline."""
    return json.dumps({**entry.to_json(), **(additional or {})}, allow_nan=False)


@contextmanager
def open_text(suffix: str, file: TextIO, rows: "Rows", origin_ns: Callable[[], int]) -> Iterator[Append]:
    """Give the function that appends entries as text, in a format by suffix: JSON lines; CSV with the columns
    of ``csv_columns``; a LaTeX table with the rows of a terminal; or SubRip subtitles for a video that starts
    with the recording, at least 1 ms each, one per part of a segment with the same further contacts."""
    from contact_tracker.exports.columns import csv_columns
    from contact_tracker.outputs.text import GEOMETRY_TITLE, table_rows

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
                file.writelines(f"{json_line(entry)}\n" for entry in entries)
            case ".tex":
                for _, (*figures, pair) in table_rows([*entries], origin_ns()):
                    file.write(" & ".join([*figures, f"{_tex(pair)} \\\\\n"]))
            case ".srt":
                for segment in entries:
                    for part in segment.parts:
                        file.write(f"{next(numbers)}\n{_subtitle(part, origin_ns())}\n\n")

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


def _subtitle(segment: "Segment", origin_ns: int) -> str:
    from contact_tracker.outputs.text import alternatives, likely_others

    start_ms = max(segment.start_ns - origin_ns, 0) // 1_000_000
    end_ms = max((segment.end_ns - origin_ns) // 1_000_000, start_ms + 1)
    times = [
        f"{ms // 3_600_000:02d}:{ms // 60_000 % 60:02d}:{ms // 1000 % 60:02d},{ms % 1000:03d}"
        for ms in (start_ms, end_ms)
    ]
    others = alternatives(segment.inseparable, likely_others(segment))
    label = f"{segment.contact.value} ({segment.probability:.2f}){others and f' or {others}'}"
    lines = [" --> ".join(times), label]
    if any(segment.touching):
        lines.append(" on ".join(printable(name) if name else "?" for name in segment.touching))
    lines += [f"+ {further.contact.value} ({further.probability:.2f})" for further in segment.further]
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
    """Raise UsageError if an output is, under any name, one of the files ``read`` or of the further outputs
    ``written``, or would replace a recording or a user's labels; the message says ``how`` to replace these
    nevertheless.

    Returns
    -------
    The same check for ``whole_file``, as files may be renamed and linked in the meantime.
    """
    names = {
        **{str(output): "another output," for output in written if output is not None},
        **dict.fromkeys(read, "the input"),
    }
    states_before = {name: _status(name) for name in names}

    def check() -> None:
        from contact_tracker.recording import has_labels, may_be_recording

        if path is None:
            return
        state, real = _status(str(path)), os.path.realpath(path)
        for name, role in names.items():
            states = states_before[name], _status(name)
            is_same = name != "-" and os.path.realpath(name) == real  # which need not exist yet
            if is_same or any(state and s and os.path.samestat(state, s) for s in states):
                label = "standard input" if name == "-" else name
                raise UsageError(f"cannot write {path}: it is {role} {label}; name another file")
        if not state or overwrite:
            return
        try:
            reason = "it is a recording" if may_be_recording(str(path)) else None
            if reason is None and has_labels(str(path)):
                reason = "it has labels of yours"
        except (OSError, UnreadableRecording, MissingExtra) as error:
            why = getattr(error, "strerror", None) or error
            reason = f"it may be a recording, but cannot be read ({why})"
        if reason is not None:
            raise UsageError(f"cannot write {path}: {reason}; {how} replaces it")

    check()
    return check


def _status(name: str) -> os.stat_result | None:
    """The status of a file, None on errors, which are reported when the file is read."""
    with suppress(OSError, ValueError):
        return os.fstat(sys.stdin.fileno()) if name == "-" else os.stat(name)
    return None
