"""Columns as a DataFrame of pandas, which comes with the extra ``pandas``."""

from typing import Final

from pandas import DataFrame as DataFrame
from pandas import Series

from contact_tracker.exports.columns import Columns, Kind

_TYPES: Final = {"integer": "int64", "number": "float64", "text": "string"}


def to_pandas(columns: Columns, kinds: dict[str, Kind]) -> DataFrame:
    """The columns with types that do not depend on the values."""
    return DataFrame({name: Series(columns[name], dtype=_TYPES[kind]) for name, kind in kinds.items()})
