"""Parquet files, written incrementally, and updates of tables, by pyarrow."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import pyarrow
from pyarrow import Table as Table
from pyarrow import compute
from pyarrow.parquet import ParquetFile, ParquetWriter, read_table, write_table

from contact_tracker.errors import StateError, first_line
from contact_tracker.exports.columns import Columns, Kind

_TYPES: Final = {"integer": pyarrow.int64(), "number": pyarrow.float64(), "text": pyarrow.string()}
_SMALL: Final = {"write_statistics": False, "use_dictionary": False, "store_schema": False}
"""Options for files of a few rows: without statistics, which would be more than half of the file."""
_GROUP: Final = 100_000


@contextmanager
def open_parquet(
    kinds: dict[str, Kind], path: Path, is_small: bool = False
) -> Iterator[Callable[[Columns], None]]:
    """Give the function that appends rows of the columns ``kinds``; OSError if the file cannot be written.

    ``is_small`` is for few rows: the file has no statistics.
    """
    schema = _schema(kinds)
    with ParquetWriter(path, schema, compression="zstd", **(_SMALL if is_small else {})) as writer:

        def append(columns: Columns) -> None:
            if any(columns.values()):
                writer.write_table(pyarrow.table(columns, schema=schema))

        yield append


def to_arrow(columns: Columns, kinds: dict[str, Kind]) -> Table:
    """The columns as a table, with types independent of the values."""
    return pyarrow.table(columns, schema=_schema(kinds))


def require_kind(kind: Kind, value: Any) -> None:
    """Raise TypeError or ValueError if a value does not fit a column of this kind."""
    pyarrow.scalar(value, _TYPES[kind])
    if isinstance(value, bool):
        raise TypeError("a flag is neither a number nor a text")


def read_rows(path: Path, kinds: Mapping[str, Kind]) -> Iterator[tuple[Any, ...]]:
    """The rows of the columns ``kinds``, in file order; raises StateError if it is damaged or lacks one."""
    names = list(kinds)
    with _damage_of(path), ParquetFile(path) as file:
        missing = set(names) - set(file.schema_arrow.names)
        if missing:
            raise StateError(f"{path}: it has no column {missing.pop()}")
        for name, kind in kinds.items():
            if file.schema_arrow.field(name).type != _TYPES[kind]:
                raise StateError(f"{path}: its column {name} is of another kind")
        for batch in file.iter_batches(columns=names):
            yield from zip(*(batch.column(name).to_pylist() for name in names), strict=True)


def write_merged(
    kinds: dict[str, Kind], previous: Path, rows: Sequence[dict[str, Any]], key: str, path: Path
) -> None:
    """Write the rows of the file ``previous``, if it exists, to ``path``, updated with ``rows`` of the same
    ``key`` and sorted by it. Equal rows make equal files. Raises StateError as ``read_rows`` does."""
    schema = _schema(kinds)
    table = pyarrow.Table.from_pylist(list(rows), schema=schema)
    if previous.exists():
        with _damage_of(previous):
            kept = read_table(previous, schema=schema, memory_map=False)
        is_old = compute.is_in(kept[key], table[key].combine_chunks())
        table = pyarrow.concat_tables([kept.filter(compute.invert(is_old)), table])
    table = table.sort_by(key).combine_chunks()
    write_table(table, path, compression="zstd", row_group_size=_GROUP)


def _schema(kinds: dict[str, Kind]) -> pyarrow.Schema:
    return pyarrow.schema([(name, _TYPES[kind]) for name, kind in kinds.items()])


@contextmanager
def _damage_of(path: Path) -> Iterator[None]:
    try:
        yield
    except (pyarrow.ArrowException, OSError) as error:
        raise StateError(f"{path}: it is damaged ({first_line(error)})") from error
