"""Stamps of the rows of a table: numbers in a unit that is named or guessed, or dates (ISO 8601)."""

import re
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from decimal import Decimal
from typing import Final

import numpy as np
from numpy.typing import NDArray

from contact_tracker.config.quantities import RANGE_NS, TIMES_NS
from contact_tracker.config.table_reading import TICK, TIME_UNITS_NS, TableReading
from contact_tracker.errors import ChoiceError, UnreadableRecording
from contact_tracker.recording.table_layouts import BLANKS, TIME_WORDS, TableLayout, number

_STEP_S: Final = (0.0005, 0.2)
"""Steps between poses at 5 to 2000 Hz; the ranges of different units do not overlap."""
_DATE_S: Final = (946684800.0, 4102444800.0)
"""Range of dates since 1970: the years 2000 to 2100."""
_EPOCHS_S: Final = (11_644_473_600, 62_135_596_800)
"""Seconds from the years 1601 and 1 to 1970."""
_FASTEST_HZ: Final = 20_000.0
"""No tracker of poses is faster: the unit is another one."""
_FEW: Final = 10
"""Times from which on their steps say something."""
_SECONDS: Final = 1.0
"""Shorter steps may also be those of a low pose rate."""
_LONGEST_STEP_S: Final = 100.0
"""Longest step between dates."""


def unit_of(times: NDArray[np.float64]) -> tuple[str, str | None]:
    """Guess the unit of times; returns it and one line on the assumption, if it is one.

    Decided by the steps or as dates; as dates if both fit and poses would not be minutes apart.
    """
    if not len(times):
        return "s", None
    step = _median_step(times)
    by_date = _first_within(_DATE_S, float(times[0]))
    by_step = None if step is None else _first_within(_STEP_S, step)
    if by_date is not None and (step is None or step * TIMES_NS[by_date] <= _LONGEST_STEP_S * 1e9):
        return by_date, None
    if step is None or by_step == "s":
        return "s", None
    unit = by_step if by_step is not None and step >= _SECONDS else "s"
    return unit, (
        f"its times have no unit and are taken as {TIME_WORDS[unit]}, with steps of {step:g}: if they are "
        "not, say so with --time-unit s, ms, us or ns, or in the name of their column, as in time_ms; the "
        "rate of numbers of frames is given as --time-unit 200Hz"
    )


def doubt_of_unit(times: NDArray[np.float64], unit_ns: float) -> str | None:
    """One line if times with the unit in their name would be those of a rate that no tracker has."""
    step = _median_step(times)
    if step == 1.0 and unit_ns == TIMES_NS["s"] and len(times) > _FEW and (np.diff(times) == 1.0).all():
        return (
            "its times are whole seconds, one after the other: if they are numbers of frames, give their "
            "rate, as --time-unit 200Hz"
        )
    if step is None or 1e9 / (step * unit_ns) <= _FASTEST_HZ:
        return None
    named = next((unit for unit, ns in TIMES_NS.items() if ns == unit_ns), f"{unit_ns:g} ns")
    likely = _first_within(_STEP_S, step)
    remedy = (
        f"they look like {TIME_WORDS[likely]}: give --time-unit {likely}, or name their column time_{likely}"
        if likely is not None
        else "give their unit with --time-unit s, ms, us or ns, or in the name of their column"
    )
    return f"its times, taken as {named}, are those of {1e9 / (step * unit_ns):.0f} poses a second; {remedy}"


def epoch_of_ticks(times: NDArray[np.float64]) -> int | None:
    """The year 1970 in nanoseconds since the epoch of dates in ticks of 100 ns, 1601 (Windows) or the year 1
    (.NET); None if the times are no such dates."""
    for epoch_s in _EPOCHS_S:
        if len(times) and _DATE_S[0] <= float(times[0]) * 1e-7 - epoch_s <= _DATE_S[1]:
            return epoch_s * 10**9
    return None


def _median_step(times: NDArray[np.float64]) -> float | None:
    """The median of the steps forward; None if there is none."""
    steps = np.diff(times)
    steps = steps[steps > 0]
    return float(np.median(steps)) if len(steps) else None


def _first_within(bounds_s: tuple[float, float], value: float) -> str | None:
    least, most = bounds_s
    return next((unit for unit, ns in TIMES_NS.items() if least <= value * ns * 1e-9 <= most), None)


NEVER: Final = np.iinfo(np.int64).min
"""The stamp of text that is no time."""
OWN_UNIT: Final = "its times have a unit: leave out --time-unit, which is for tables whose times have none"
DATES: Final = "its times are dates: leave out --time-unit, which is for tables whose times are numbers"
_DATE: Final = re.compile(
    r"\s*(\d{4})-(\d\d)-(\d\d)[T ](\d\d?):(\d\d)(?::(\d\d)(?:[.,](\d{1,18}))?)?"
    r"(?: ?(?:Z|UTC)| ?([+-])(\d\d)(?::?(\d\d))?)?\s*"
)
_YEARS: Final = range(1900, 2110)
"""Years of dates that are read: stamps in nanoseconds reach from 1824 to 2116."""
_EPOCH: Final = datetime(1970, 1, 1, tzinfo=UTC)


class TableTimes:
    """Stamps of the times in a table, some rows after others; most of the first ones decide what they are.

    Parameters
    ----------
    path : of the table.
    reading : its time unit is used, else that of the layout; without either the unit is guessed.
    assume : called with one line on an assumption.

    Raises
    ------
    ChoiceError
        The layout says the unit of its times.
    """

    def __init__(
        self, path: str, layout: TableLayout, reading: TableReading, assume: Callable[[str], None]
    ) -> None:
        if reading.time_unit is not None and layout.has_own_unit:
            raise ChoiceError(f"{path}: {OWN_UNIT}")
        self._path, self._assume, self._reading = path, assume, reading
        self._scale = layout.time_ns if layout.rest is not None else reading.time_ns or layout.time_ns
        self._is_certain = reading.time_unit is not None or layout.has_own_unit or layout.rest is not None
        self._are_dates: bool | None = None
        self._epoch_ns = 0

    def stamps_ns(self, times: Sequence[str], rests: Sequence[str] | None = None) -> NDArray[np.int64]:
        """Stamps (N,) of times as text, and of the nanoseconds of their seconds if these have a column;
        ``NEVER`` for other text.

        Raises
        ------
        ChoiceError
            The user gives a unit, but they are dates.
        UnreadableRecording
            They are ticks since another year than 1970.
        """
        floats = np.array([_float(time) for time in times])
        known = np.isfinite(floats)
        if self._are_dates is None:
            dates = sum(map(bool, map(_DATE.fullmatch, times)))
            if not dates and not known.any():
                return np.full(len(times), NEVER)
            self._are_dates = dates > known.sum()
            if self._are_dates and self._reading.time_unit is not None:
                raise ChoiceError(f"{self._path}: {DATES}")
            if not self._are_dates:
                self._find_unit(floats[known])
        if self._are_dates:
            dated = map(stamp_of_date, times)
            return np.array([NEVER if stamp is None else stamp for stamp in dated], np.int64)
        assert self._scale is not None
        stamps = _stamps_of_numbers(times, floats, self._scale, self._epoch_ns)
        if rests is not None:
            floats = np.array([_float(rest) for rest in rests])
            is_rest = (stamps != NEVER) & (floats >= 0) & (floats < 1e9)
            stamps = np.where(is_rest, stamps + np.where(is_rest, floats, 0.0).astype(np.int64), NEVER)
        return stamps

    def _find_unit(self, times: NDArray[np.float64]) -> None:
        """The unit and epoch of times that are numbers, by the first ones."""
        doubt, epoch_ns = None, epoch_of_ticks(times)
        if self._reading.time_unit == TICK:
            self._epoch_ns = epoch_ns or 0
        elif epoch_ns is not None and not self._is_certain:
            command = TableReading(time_unit=TICK).with_(self._reading).command(self._path)
            raise UnreadableRecording(
                f"its times look like ticks of 100 ns since the year 1 or 1601: read them by {command}"
            )
        if self._scale is None:
            unit, doubt = unit_of(times)
            self._scale = TIME_UNITS_NS[unit]
        elif not self._is_certain:
            doubt = doubt_of_unit(times, self._scale)
        if doubt is not None:
            self._assume(doubt)


def _float(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        pass
    try:
        return number(text)
    except ValueError:
        return np.nan


def numbers(cells: Sequence[str]) -> NDArray[np.float64]:
    """The numbers in cells, which may have decimal commas; NaN for other text."""
    return np.array([_float(cell) for cell in cells], np.float64)


def _stamps_of_numbers(
    times: Sequence[str], floats: NDArray[np.float64], unit_ns: float, epoch_ns: int
) -> NDArray[np.int64]:
    """Stamps of numbers as text, exact to the written nanosecond, after an epoch."""
    known = np.isfinite(floats) & (np.abs(floats * unit_ns - epoch_ns) < RANGE_NS)
    if unit_ns != round(unit_ns):
        return np.where(known, np.round(np.where(known, floats, 0.0) * unit_ns), NEVER).astype(np.int64)
    unit = round(unit_ns)
    exact = [
        exact_ns(time, unit) - epoch_ns if one else NEVER for time, one in zip(times, known, strict=True)
    ]
    return np.array(exact, np.int64)


def exact_ns(time: str, unit_ns: int) -> int:
    """Nanoseconds of a number as text; raises ValueError or OverflowError if it is none."""
    plain = time.strip(BLANKS).replace(",", ".")
    try:
        return round(Decimal(plain) * unit_ns)
    except ArithmeticError:  # an exponent of many digits
        return round(float(plain) * unit_ns)


def stamp_of_date(text: str) -> int | None:
    """Nanoseconds since 1970 of a date, None for other text; without a time zone it is taken as UTC, since
    only differences matter."""
    match = _DATE.fullmatch(text)
    if match is None or int(match[1]) not in _YEARS:
        return None
    year, month, day, hour, minute = map(int, match.groups()[:5])
    try:
        since = datetime(year, month, day, hour, minute, int(match[6] or 0), tzinfo=UTC) - _EPOCH
    except ValueError:  # as the 31st of June
        return None
    zone_s = 60 * (60 * int(match[9] or 0) + int(match[10] or 0)) * (-1 if match[8] == "-" else 1)
    fraction_ns = int(f"{match[7] or 0:0<9}"[:9])
    return (since.days * 86_400 + since.seconds - zone_s) * 10**9 + fraction_ns
