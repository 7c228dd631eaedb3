"""Tables of poses, read by polars: TUM trajectories, CSV and Parquet; each row is one message per body."""

import os
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import islice
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from contact_tracker.errors import ChoiceError, UnreadableRecording, printable
from contact_tracker.recording.decoding import row_channel
from contact_tracker.recording.extras import MissingExtra, need
from contact_tracker.recording.items import Channel, RawMessage
from contact_tracker.recording.last_line import CUT_OFF, is_cut_off
from contact_tracker.recording.limits import WorkBudget
from contact_tracker.recording.named_columns import MOST_COLUMNS, layout_of_names, layout_of_text
from contact_tracker.recording.panics import without_panics
from contact_tracker.recording.parquet_pages import PARQUET_MAGIC, check_pages
from contact_tracker.recording.table_layouts import BLANKS, SEPARATORS, TableLayout
from contact_tracker.recording.table_times import NEVER, TableTimes

if TYPE_CHECKING:
    import polars as pl

_HEAD_LINES: Final = 64
_LONGEST_LINE: Final = 120
"""Longest text of an error of polars, which may list all columns."""
_LINE: Final = 2**18
_LONGEST_TIME: Final = 40
_ROWS: Final = 10_000
PARQUET: Final = "Parquet"
"""The kind of a layout."""
_ROW: Final = np.dtype([("stamp_ns", "<i8"), ("numbers", "<f8", (7,))])
_ZLIB: Final = (b"x\x01", b"x\x5e", b"x\x9c", b"x\xda")
"""First bytes of files that polars would decompress."""
_UTF_16: Final = (b"\xff\xfe", b"\xfe\xff")
_HEAD_BYTES: Final = 4096
_ENDINGS: Final = (".csv", ".tsv", ".txt", ".tum", ".dat", ".parquet", ".pq")
"""Usual ends of the names of tables; other text may be one as well."""
_PRINTABLE: Final = bytes(range(32, 127)) + b"\t\r\n\xef\xbb\xbf"


def is_table(path: str, begin: bytes) -> bool:
    """Whether a file with these first bytes may be a table: Parquet, or text without the suffix ``.mcap``."""
    if begin.startswith(PARQUET_MAGIC):
        return True
    if begin[:2] in _ZLIB:
        return False
    return is_text(begin) and not path.lower().endswith((".mcap", ".mcap.zst", ".mcap.zstd"))


def refuse_other_text(path: str, begin: bytes) -> None:
    """Raise UnreadableRecording if a file with these first bytes is text, but not in UTF-8 or without line
    feeds, or is named as a table and is none."""
    if begin.startswith(_UTF_16):
        raise UnreadableRecording("it is text in UTF-16: save it as UTF-8")
    if is_text(begin) and b"\r" in begin and b"\n" not in begin:
        raise UnreadableRecording("its lines end with carriage returns alone: save it with usual line ends")
    if begin and not is_table(path, begin) and path.lower().endswith(_ENDINGS):
        raise UnreadableRecording("it is named as a table, but is not text in UTF-8: save it as that")


def has_poses(path: str) -> bool:
    """Whether a file is a table with the columns of poses; of Parquet only where polars can read it."""
    with open(path, "rb") as file:
        begin = file.read(_HEAD_BYTES)
    try:
        if begin.startswith(PARQUET_MAGIC):
            layout_of_names(_names_in(path), PARQUET, None, 0)
            return True
        if not is_text(begin):
            return False
        layout_of_text(_head(path))
    except (UnreadableRecording, ChoiceError, MissingExtra):
        return False
    return True


def _names_in(path: str) -> list[str]:
    """Names of the columns of a Parquet file."""
    polars = need("polars", "a table")
    try:
        with without_panics():
            return list(polars.scan_parquet(path, glob=False).collect_schema().names())
    except (Exception, polars.exceptions.PanicException) as error:
        raise UnreadableRecording(f"it cannot be read as a table: {_line(error)}") from error


def is_text(begin: bytes) -> bool:
    """Whether the first bytes of a file are text."""
    return bool(begin) and (not begin.translate(None, _PRINTABLE) or _is_utf8(begin))


def _is_utf8(begin: bytes) -> bool:
    text = begin.decode("utf-8", errors="ignore")
    return len(text.encode()) > len(begin) - 4 and all(c.isprintable() or c in "\t\r\n\ufeff" for c in text)


def _no_table(why: UnreadableRecording) -> str:
    return (
        f"it is neither a recording nor a table of poses ({why}). What is read: MCAP files, ROS bags (.db3, "
        ".bag), tables (CSV, TUM, Parquet), and exports of Motive and Vicon"
    )


def read_table(
    path: str,
    wanted: Callable[[Channel], bool],
    report: Callable[[str], None],
    budget: WorkBudget,
    assume: Callable[[str], None],
    time_unit: str | None = None,
) -> Iterator[RawMessage]:
    """The poses of a table by rows; log times are the times in it.

    Parameters
    ----------
    wanted : bodies of other channels are left out.
    report : called with one line on rows that cannot be read.
    budget : bounds the size of a compressed table.
    assume : called with one line on each assumption.
    time_unit : a key of ``config.quantities.TIMES_NS``, for a format without one.

    Raises
    ------
    UnreadableRecording
        It has no pose columns.
    ChoiceError
        It says the unit of its times, or they are dates.
    """
    polars = need("polars", "a table")
    try:
        with without_panics():
            layout, frame, groups, is_cut = _opened(polars, path, budget)
    except UnreadableRecording as error:
        raise error if path.lower().endswith(_ENDINGS) else UnreadableRecording(_no_table(error)) from error
    except MissingExtra:
        raise
    except (Exception, polars.exceptions.PanicException) as error:  # what polars raises has no common base
        raise UnreadableRecording(f"it cannot be read as a table: {_line(error)}") from error
    topic = os.path.basename(path)
    channels = [row_channel(topic, layout.kind, "", body.name) for body in layout.bodies]
    chosen = [
        (channel, body) for channel, body in zip(channels, layout.bodies, strict=True) if wanted(channel)
    ]
    batches = _batches(polars, frame, groups) if chosen else iter(())
    batches = _without_last_row(batches) if is_cut else batches
    times, lost, why = TableTimes(path, layout, time_unit, assume), 0, ""
    while True:
        try:
            with without_panics():
                batch = next(batches)
        except StopIteration:
            break
        except (Exception, polars.exceptions.PanicException) as error:
            report(f"it is damaged: {_line(error)}")
            break
        stamps = times.stamps_ns(polars, batch["time"])
        good = stamps != NEVER
        if not good.all():
            why = why or _without_time(batch[int(good.argmin())], layout)
            lost += int((~good).sum())
        rows = [(channel, _rows(batch, stamps, body)[good]) for channel, body in chosen]
        for i, stamp_ns in enumerate(stamps[good].tolist()):
            for channel, values in rows:
                yield RawMessage(channel, max(stamp_ns, 0), values[i].tobytes())
    if lost:
        report(f"{lost} {'row has' if lost == 1 else 'rows have'} {why}")
    if is_cut:
        report(CUT_OFF)


def _without_time(row: "pl.DataFrame", layout: TableLayout) -> str:
    """What a row without a time lacks: a time, or, if it has nothing but text in its first cell, the
    separators of the others."""
    text, *numbers = row.row(0)
    lacks = "no time that is a number or a date"
    if layout.kind != PARQUET and text and all(number is None for number in numbers):
        named = SEPARATORS[layout.separator or " "]
        return f"{lacks}: separate their values by {named}, as in the first row"
    shown = f" ({printable(text[:_LONGEST_TIME])!r})" if text else ""
    return f"{lacks}{shown}: give each a number, or a date as 2026-03-01T10:00:00.25"


def _batches(polars: Any, frame: "pl.LazyFrame", groups: list[int] | None) -> "Iterator[pl.DataFrame]":
    """Rows that are not empty; of Parquet by row groups, so that no thread reads ahead between two calls."""
    has_time = polars.col("time").is_not_null() & (polars.col("time") != "")
    is_row = has_time | polars.any_horizontal(polars.exclude("time").is_not_null())
    if groups is None:
        yield from frame.filter(is_row).collect_batches(chunk_size=_ROWS, maintain_order=True)
        return
    first = 0
    for rows in groups:
        yield from frame.slice(first, rows).filter(is_row).collect().iter_slices(_ROWS)
        first += rows


def _without_last_row(batches: "Iterator[pl.DataFrame]") -> "Iterator[pl.DataFrame]":
    held = next(batches, None)
    for batch in batches:
        if held is not None:
            yield held
        held = batch
    if held is not None:
        yield held[:-1]


def _opened(
    polars: Any, path: str, budget: WorkBudget
) -> "tuple[TableLayout, pl.LazyFrame, list[int] | None, bool]":
    """The layout, its columns named by index, the rows of each row group of Parquet, and whether the last row
    is cut off.

    The time is text.
    """
    with open(path, "rb") as file:
        is_parquet = file.read(len(PARQUET_MAGIC)) == PARQUET_MAGIC
    if is_parquet:
        frame = polars.scan_parquet(path, glob=False)
        schema = frame.collect_schema()
        names = schema.names()
        layout = layout_of_names(names, PARQUET, None, 0)
        _require_plain(polars, schema, layout)
        places = {layout.time, *(place for body in layout.bodies for place in body.columns)}
        groups = check_pages(path, {names[place] for place in places}, len(layout.bodies), budget)
        if isinstance(schema[names[layout.time]], polars.Duration):
            frame = frame.with_columns(polars.col(names[layout.time]).dt.total_nanoseconds())
            layout = replace(layout, time_ns=1, has_own_unit=True)
        frame = frame.select(polars.col(name).alias(str(i)) for i, name in enumerate(names))
        return layout, _chosen(polars, frame, layout), groups, False
    budget.count_read(os.path.getsize(path))
    lines = _head(path)
    if any(line.count(mark) >= MOST_COLUMNS for line in lines for mark in ",;\t "):
        raise UnreadableRecording(f"its rows have {MOST_COLUMNS} values or more: leave out those of no body")
    layout = layout_of_text(lines)
    if len(lines) < _HEAD_LINES and not any(
        line.strip() and not line.startswith("#") for line in lines[layout.skip :]
    ):
        raise UnreadableRecording("it has a header but no rows")
    many, is_last = _rows_of_section(path, layout.skip) if layout.kind == "Vicon" else (None, True)
    by_lines = layout.separator is None or layout.is_ragged
    frame = polars.scan_csv(
        path,
        has_header=False,
        separator="\x01" if by_lines else layout.separator,
        skip_lines=layout.skip,
        infer_schema=False,
        comment_prefix="#",
        truncate_ragged_lines=True,
        n_rows=many,
        glob=False,
        encoding="utf8-lossy",
        quote_char=None if by_lines else '"',
    )
    names = frame.collect_schema().names()
    if by_lines:
        line = polars.col(names[0])
        words = line.str.extract_all(r"\S+") if layout.separator is None else line.str.split(layout.separator)
        last = max(max(body.columns) for body in layout.bodies)
        columns = [words.list.get(place, null_on_oob=True) for place in range(last + 1)]
    else:
        columns = [polars.col(name) for name in names]
    cells = (column.str.strip_chars(BLANKS) for column in columns)
    if layout.separator != "," or any('"' in line for line in lines):  # else no cell has a comma
        cells = (cell.str.replace(",", ".", literal=True) for cell in cells)
    frame = frame.select(cell.alias(str(place)) for place, cell in enumerate(cells))
    is_cut = is_last and is_cut_off(path, layout.separator)
    return layout, _chosen(polars, frame, layout), None, is_cut


def _require_plain(polars: Any, schema: Any, layout: TableLayout) -> None:
    """Refuse columns of other types than numbers, texts and times."""
    names = schema.names()
    for place in dict.fromkeys([layout.time, *(place for body in layout.bodies for place in body.columns)]):
        kind = schema[names[place]]
        is_time = place == layout.time and kind.is_temporal()
        if not (kind.is_numeric() or is_time or kind in (polars.String, polars.Null)):
            named = f"its column {printable(names[place][:_LONGEST_TIME])} is of the type {kind.base_type()}"
            raise UnreadableRecording(f"{named}: columns of numbers are read")


def _chosen(polars: Any, frame: Any, layout: TableLayout) -> "pl.LazyFrame":
    places = dict.fromkeys(str(place) for body in layout.bodies for place in body.columns)
    numbers = [polars.col(place).cast(polars.Float64, strict=False) for place in places]
    time = polars.col(str(layout.time))
    chosen: pl.LazyFrame = frame.select(time.cast(polars.String).alias("time"), *numbers)
    return chosen


def _head(path: str) -> list[str]:
    """The first lines, without a byte-order mark."""
    with open(path, encoding="utf-8-sig", errors="replace") as file:
        lines = list(islice(iter(lambda: file.readline(_LINE), ""), _HEAD_LINES))
    return lines


def _rows_of_section(path: str, skip: int) -> tuple[int, bool]:
    """Number of lines before an empty one, which ends the section, and whether the file ends before one."""
    many = 0
    with open(path, encoding="utf-8", errors="replace") as file:
        for line in islice(file, skip, None):
            if not line.strip(", \t\r\n"):
                return many, False
            many += 1
    return many, True


def _rows(batch: "pl.DataFrame", stamps: NDArray[np.int64], body: Any) -> NDArray[np.void]:
    """The poses of a body as row messages; empty cells are NaN."""
    rows = np.zeros(len(stamps), _ROW)
    rows["stamp_ns"] = stamps
    for i, place in enumerate(body.columns):
        rows["numbers"][:, i] = batch[str(place)].fill_null(np.nan).to_numpy()
    rows["numbers"][:, :3] *= body.metres
    return rows


def _line(error: BaseException) -> str:
    return (str(error) or type(error).__name__).splitlines()[0][:_LONGEST_LINE]
