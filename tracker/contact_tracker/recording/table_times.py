"""Stamps of the rows of a table: their times are numbers in some unit, or dates (ISO 8601)."""

from collections.abc import Callable
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from contact_tracker.config.quantities import RANGE_NS, TIMES_NS
from contact_tracker.errors import ChoiceError
from contact_tracker.recording.table_layouts import TableLayout
from contact_tracker.recording.time_units import doubt_of_unit, unit_of

NEVER: Final = np.iinfo(np.int64).min
"""The stamp of text that is no time."""
OWN_UNIT: Final = "its times have a unit: leave out --time-unit, which is for tables whose times have none"
DATES: Final = "its times are dates: leave out --time-unit, which is for tables whose times are numbers"
_DATE: Final = r"^\s*\d{4}-\d\d-\d\d[T ]\d\d:\d\d"
_ZONE: Final = r"[+-]\d\d:?\d\d$"
_FORMAT: Final = "%Y-%m-%dT%H:%M:%S%.f%:z"
_YEARS: Final = (1900, 2110)
"""Years of dates that are read: stamps in nanoseconds reach from 1824 to 2116."""


class TableTimes:
    """Stamps of the times in a table, some rows after others; most of the first ones decide what they are.

    Parameters
    ----------
    name : of the table.
    time_unit : a key of ``config.quantities.TIMES_NS``, as the user gives it; None to take that of the
        layout, or to guess it.
    assume : called with one line on an assumption.

    Raises
    ------
    ChoiceError
        The layout says the unit of its times.
    """

    def __init__(
        self, name: str, layout: TableLayout, time_unit: str | None, assume: Callable[[str], None]
    ) -> None:
        if time_unit is not None and layout.has_own_unit:
            raise ChoiceError(f"{name}: {OWN_UNIT}")
        self._name, self._assume = name, assume
        self._is_given = time_unit is not None
        self._scale = layout.time_ns if time_unit is None else TIMES_NS[time_unit]
        self._is_certain = self._is_given or layout.has_own_unit
        self._are_dates: bool | None = None

    def stamps_ns(self, polars: Any, times: Any) -> NDArray[np.int64]:
        """Stamps (N,) of times, a series of ``polars`` with text; ``NEVER`` for other text.

        Raises
        ------
        ChoiceError
            The user gives a unit, but they are dates.
        """
        if self._are_dates is None:
            dates, numbers = int(times.str.contains(_DATE).sum() or 0), len(_numbers(polars, times))
            if not dates and not numbers:
                return np.full(len(times), NEVER)
            self._are_dates = dates > numbers
            if self._are_dates and self._is_given:
                raise ChoiceError(f"{self._name}: {DATES}")
        if self._are_dates:
            return _stamps_of_dates(polars, times)
        return _stamps_of_numbers(polars, times, self._unit_ns(polars, times))

    def _unit_ns(self, polars: Any, times: Any) -> float:
        """The unit of times that are numbers; the first are checked."""
        scale, doubt = self._scale, None
        if scale is None:
            unit, doubt = unit_of(_numbers(polars, times))
            scale = self._scale = TIMES_NS[unit]
        elif not self._is_certain:
            doubt = doubt_of_unit(_numbers(polars, times), scale)
        self._is_certain = True
        if doubt is not None:
            self._assume(doubt)
        return scale


def _numbers(polars: Any, times: Any) -> NDArray[np.float64]:
    """The times that are finite numbers, in the unit of the table."""
    floats = times.cast(polars.Float64, strict=False).drop_nulls().to_numpy()
    return np.asarray(floats[np.isfinite(floats)], np.float64)


def _stamps_of_numbers(polars: Any, times: Any, unit_ns: float) -> NDArray[np.int64]:
    """Stamps of numbers as text, exact to the written nanosecond."""
    floats = times.cast(polars.Float64, strict=False).fill_null(np.nan).to_numpy() * unit_ns
    known = np.isfinite(floats) & (np.abs(floats) < RANGE_NS)
    stamps = np.where(known, np.round(np.where(known, floats, 0.0)), 0.0).astype(np.int64)
    if unit_ns in (1e9, 1e6, 1e3, 1.0):
        usual = times.set(~polars.Series(known, dtype=polars.Boolean), None)  # others may overflow
        exact = usual.cast(polars.Decimal(38, 9), strict=False)
        whole = (exact * round(unit_ns)).cast(polars.Int64, strict=False)
        stamps = np.where(whole.is_null().to_numpy(), stamps, whole.fill_null(0).to_numpy())
    return np.asarray(np.where(known, stamps, NEVER), np.int64)


def _stamps_of_dates(polars: Any, dates: Any) -> NDArray[np.int64]:
    """Nanoseconds since 1970 of dates as text; those without a time zone are taken as UTC, since only
    differences matter."""
    text = dates.str.strip_chars().str.replace(" ", "T", literal=True)
    text = text.str.replace(r" ?(?:Z|UTC)$", "+00:00").str.replace(r"(T.*[+-]\d\d)$", "${1}:00")
    text = text.str.replace(r"(T\d\d:\d\d)($|[+-])", "${1}:00${2}")  # without seconds
    has_zone = text.str.contains(_ZONE).fill_null(value=False)
    zoned = text.zip_with(has_zone, text + "+00:00")
    stamps = zoned.str.to_datetime(_FORMAT, time_unit="ns", strict=False).dt.timestamp("ns")
    is_usual = text.str.slice(0, 4).cast(polars.Int32, strict=False).is_between(*_YEARS, closed="left")
    return np.where(is_usual.fill_null(value=False).to_numpy(), stamps.fill_null(NEVER).to_numpy(), NEVER)
