"""Columns as a DataFrame of pandas (extra ``pandas``)."""

from typing import Final

from pandas import DataFrame as DataFrame
from pandas import Series

from contact_tracker.exports.columns import Columns, Kind

_TYPES: Final = {"integer": "int64", "number": "float64", "text": "string"}


def to_pandas(columns: Columns, kinds: dict[str, Kind]) -> DataFrame:
    """The columns as a DataFrame, with types independent of the values."""
    return DataFrame({name: Series(columns[name], dtype=_TYPES[kind]) for name, kind in kinds.items()})
