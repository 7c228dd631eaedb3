"""Parquet files, written piece by piece; pyarrow comes with the extra ``parquet``."""

from collections.abc import Iterable
from pathlib import Path
from typing import Final

import pyarrow
from pyarrow.parquet import ParquetWriter

from contact_tracker.exports.columns import Columns, Kind

_TYPES: Final = {"integer": pyarrow.int64(), "number": pyarrow.float64(), "text": pyarrow.string()}


def write_parquet(pieces: Iterable[Columns], kinds: dict[str, Kind], path: Path) -> None:
    """Write tables with the columns ``kinds`` one after the other; OSError if the file cannot be written."""
    schema = pyarrow.schema([(name, _TYPES[kind]) for name, kind in kinds.items()])
    with ParquetWriter(path, schema, compression="zstd") as writer:
        for columns in pieces:
            if any(columns.values()):
                writer.write_table(pyarrow.table(columns, schema=schema))
