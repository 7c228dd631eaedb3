"""Columns as a DataFrame of polars (extra ``polars``)."""

from typing import Final

import polars
from polars import DataFrame as DataFrame

from contact_tracker.exports.columns import Columns, Kind

_TYPES: Final = {"integer": polars.Int64(), "number": polars.Float64(), "text": polars.String()}


def to_polars(columns: Columns, kinds: dict[str, Kind]) -> DataFrame:
    """The columns as a DataFrame, with types independent of the values."""
    return DataFrame(columns, schema={name: _TYPES[kind] for name, kind in kinds.items()})
