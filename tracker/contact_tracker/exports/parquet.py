"""Parquet files, written piece by piece; pyarrow comes with the extra ``parquet``."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

import pyarrow
from pyarrow.parquet import ParquetWriter

from contact_tracker.exports.columns import Columns, Kind

_TYPES: Final = {"integer": pyarrow.int64(), "number": pyarrow.float64(), "text": pyarrow.string()}


@contextmanager
def open_parquet(kinds: dict[str, Kind], path: Path) -> Iterator[Callable[[Columns], None]]:
    """Give the function that appends rows of the columns ``kinds``; OSError if the file cannot be written."""
    schema = pyarrow.schema([(name, _TYPES[kind]) for name, kind in kinds.items()])
    with ParquetWriter(path, schema, compression="zstd") as writer:

        def append(columns: Columns) -> None:
            if any(columns.values()):
                writer.write_table(pyarrow.table(columns, schema=schema))

        yield append
