"""Stamps of the times in tables: numbers in a unit that is named or guessed, or dates (ISO 8601)."""

import re
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime
from decimal import Decimal
from itertools import compress
from typing import Final

import numpy as np
from numpy.typing import NDArray

from contact_tracker.config.quantities import RANGE_NS, TIME_WORDS, TIMES_NS
from contact_tracker.config.table_reading import DAY, TICK, TIME_UNITS_NS, TableReading
from contact_tracker.errors import ChoiceError, UnreadableRecording
from contact_tracker.recording.table_layouts import NO_FRAMES, TableLayout, numbers, plain_number

_STEP_S: Final = (0.0005, 0.2)
"""Steps between poses at 5 to 2000 Hz; the ranges of different units do not overlap."""
_DATE_S: Final = (946684800.0, 4102444800.0)
"""Range of dates since 1970: the years 2000 to 2100."""
_DAY_NS: Final = TIME_UNITS_NS[DAY]
_DAY_S: Final = _DAY_NS // 10**9
_EPOCHS_S: Final[Mapping[str, tuple[tuple[int, int], str]]] = {
    TICK: ((11_644_473_600, 62_135_596_800), "ticks of 100 ns since the year 1 or 1601"),
    DAY: ((25_569 * _DAY_S, 719_529 * _DAY_S), "days since the year 0 or 1900, as of MATLAB and Excel"),
}
"""Units of dates other than seconds: seconds from their epochs to 1970, and their description."""
_FASTEST_HZ: Final = 20_000.0
"""Highest rate of a tracker of poses (Hz); above it, the unit is probably wrong."""
_FEW: Final = 10
"""Number of times above which steps of exactly one are taken for numbers of frames."""
_SECONDS: Final = 1.0
"""Step, in the unit of the times; shorter steps may be seconds at a low pose rate."""
_LONGEST_STEP_S: Final = 100.0
"""Longest step (s) between times that are dates, or that are too few for another unit."""
NEVER: Final = np.iinfo(np.int64).min
"""Stands for the stamp of text that is no time."""
_DATE: Final = re.compile(
    r"\s*(?:(?P<days>\d{1,5}) days?,? )?"
    r"(?:(?:(?P<year>\d{4})(?P<mark>[-/.]?)(?P<month>\d\d?)(?P=mark)(?P<day>\d\d?)"
    r"|(?P<first>\d\d?)(?P<dots>[-/.])(?P<second>\d\d?)(?P=dots)(?P<last>\d{4}))(?:[T_]|,? ))?"
    r"(?P<hour>\d\d?)(?P<colon>:|(?<=[T_]\d\d))(?P<minute>\d\d)"
    r"(?:(?P=colon)(?P<second_>\d\d)(?:(?:[.,]|:(?=\d{3}))(?P<fraction>\d{1,18}))?)?"
    r"(?: ?(?P<half>[AP])M)?(?: ?(?:Z|UTC)| ?(?P<sign>[+-])(?P<zone>\d\d)(?::?(?P<zone_minutes>\d\d))?)?\s*",
    re.IGNORECASE,
)
"""Dates and times of a day, or durations of pandas; 10:22:31:123 has milliseconds, and 10:22:31:12 would have
frames. Digits alone are numbers."""
_YEARS: Final = range(1900, 2110)
"""Years of dates that are read; stamps in nanoseconds reach from 1824 to 2116."""
_EPOCH: Final = datetime(1970, 1, 1, tzinfo=UTC)
_MOST_DAYS: Final = 20
"""Most days between two rows; if days and months are confused, there are steps of a month."""


_LONGEST_RUN_NS: Final = 1e15
"""Larger times are no nanoseconds since a machine has started: 11 days."""


def unit_of(times: NDArray[np.float64]) -> tuple[str, str | None]:
    """Guess the unit of times; returns it and one line on the assumption, if it is one.

    The steps decide, or the times as dates; dates if both fit and poses would not be minutes apart.
    """
    step = _median_step(times)
    by_date = _first_within(_DATE_S, float(times[0]) if len(times) else None)
    if by_date is not None and (step is None or step * TIMES_NS[by_date] <= _LONGEST_STEP_S * 1e9):
        step_s, likely = (step or 0.0) * TIMES_NS[by_date] * 1e-9, _first_within(_STEP_S, step)
        is_date = likely != "ns" or step_s <= _SECONDS or times[0] >= _LONGEST_RUN_NS
        return by_date, None if is_date or likely is None else (
            f"its times, taken as {TIME_WORDS[by_date]} since 1970, are of a pose every {step_s:.3g} s: if "
            f"they are {TIME_WORDS[likely]} since another time, give --time-unit {likely}"
        )
    by_step = _first_within(_STEP_S, step)
    if step is None or by_step == "s":
        return "s", None
    if by_step == "ns" and step * TIME_UNITS_NS[TICK] > _STEP_S[1] * 1e9:  # no other unit is near
        return "ns", None
    unit = by_step if by_step is not None and step >= _SECONDS else "s"
    return unit, (
        f"its times have no unit and are taken as {TIME_WORDS[unit]}, with steps of {step:g}: if they are "
        "not, say so with --time-unit s, ms, us or ns, or in the name of their column, as in time_ms; the "
        "rate of numbers of frames is given as --time-unit 200Hz"
    )


def _epoch_s(first: float, unit: str) -> int:
    """Seconds from the epoch of dates in a unit of ``_EPOCHS_S`` to 1970; 0 if the first one is no date."""
    first_s = first * TIME_UNITS_NS[unit] * 1e-9
    dated = (epoch_s for epoch_s in _EPOCHS_S[unit][0] if _DATE_S[0] <= first_s - epoch_s <= _DATE_S[1])
    return next(dated, 0)


def unit_of_dates(times: NDArray[np.float64]) -> str | None:
    """The unit of ``_EPOCHS_S`` in which times are dates with steps of at most a second; None without one."""
    step = _median_step(times) or 0.0
    units = (unit for unit in _EPOCHS_S if step * TIME_UNITS_NS[unit] <= _SECONDS * 1e9)
    return next((unit for unit in units if len(times) and _epoch_s(float(times[0]), unit)), None)


def doubt_of_unit(times: NDArray[np.float64], unit_ns: float) -> str | None:
    """One line if the times, in this unit, would have a rate that no tracker has; else None. A low
    rate is that of a tracker if the times are dates, or would last less than a second in another unit."""
    step = _median_step(times)
    if step == 1.0 and unit_ns == TIMES_NS["s"] and len(times) > _FEW and (np.diff(times) == 1.0).all():
        return (
            "its times are whole seconds, one after the other: if they are numbers of frames, give their "
            "rate, as --time-unit 200Hz"
        )
    likely = None if step is None else _first_within(_STEP_S, step)
    is_dated = len(times) > 0 and _DATE_S[0] <= times[0] * unit_ns * 1e-9 <= _DATE_S[1]
    is_short = likely is not None and float(np.ptp(times)) * TIMES_NS[likely] <= _SECONDS * 1e9
    longest_s = _LONGEST_STEP_S if is_dated or is_short else _SECONDS
    is_slow = likely is not None and (step or 0.0) * unit_ns > longest_s * 1e9
    if step is None or (1e9 / (step * unit_ns) <= _FASTEST_HZ and not is_slow):
        return None
    named = next((unit for unit, ns in TIMES_NS.items() if ns == unit_ns), f"{unit_ns:g} ns")
    remedy = "give their unit with --time-unit s, ms, us or ns, or in the name of their column"
    if likely is not None:
        advice = f"give --time-unit {likely}, or name their column time_{likely}"
        remedy = f"they look like {TIME_WORDS[likely]}: {advice}"
    return f"its times, taken as {named}, are those of {1e9 / (step * unit_ns):.6g} poses a second; {remedy}"


def _median_step(times: NDArray[np.float64]) -> float | None:
    """The median of the steps forward; None if there is none."""
    steps = np.diff(times)
    return float(np.median(steps[steps > 0])) if (steps > 0).any() else None


def _first_within(bounds_s: tuple[float, float], value: float | None) -> str | None:
    """The first unit in which a value is within bounds."""
    lower, upper = bounds_s
    units = (unit for unit, ns in TIMES_NS.items() if value and lower <= value * ns * 1e-9 <= upper)
    return next(units, None)


def ns_of_date(time: float) -> int:
    """Nanoseconds since 1970 of a date that is a number, in seconds to nanoseconds; zero for others."""
    unit = _first_within(_DATE_S, time)
    return 0 if unit is None else round(time * TIMES_NS[unit])


class TableTimes:
    """Stamps of the times in a table, batch by batch; the majority of the first times decides their kind.

    Parameters
    ----------
    path : path of the table.
    reading : its time unit replaces the unit of the layout; without either the unit is guessed.
    assume : called with one line on an assumption.

    Raises ChoiceError if both the reading and the layout say the unit of the times.
    """

    def __init__(
        self, path: str, layout: TableLayout, reading: TableReading, assume: Callable[[str], None]
    ) -> None:
        if reading.time_unit is not None and layout.has_own_unit:
            raise ChoiceError(
                f"{path}: its times have a unit: leave out --time-unit, which is for tables whose times have "
                "none"
            )
        self._path, self._assume, self._reading = path, assume, reading
        self._rest_ns = layout.rest_ns
        self._scale = layout.time_ns if layout.rest is not None else reading.time_ns or layout.time_ns
        self._is_certain = reading.time_unit is not None or layout.has_own_unit or layout.rest is not None
        self._are_dates: bool | None = None
        self._are_whole = True  # seconds beside their fractions in a column
        self._last_date_ns: int | None = None
        self._days = 0  # midnights so far, if times have no date
        self._epoch_ns = 0

    def stamps_ns(self, times: Sequence[str], rests: Sequence[str] | None = None) -> NDArray[np.int64]:
        """Stamps (N,) of times as text, and of the nanoseconds of their seconds if these have a column;
        ``NEVER`` for other text.

        Raises ChoiceError if the user gives a unit for dates, or the order of days and months is not known;
        UnreadableRecording if times are ticks since another year than 1970.
        """
        floats = numbers(times)
        is_number, stamps = np.isfinite(floats), np.full(len(times), NEVER)
        if self._are_dates is None:
            dates = sum(bool(_DATE.fullmatch(text)) for text in compress(times, ~is_number))
            if not dates and not is_number.any():
                return stamps
            self._are_dates = dates > is_number.sum()
            if not self._are_dates:
                self._find_unit(floats[is_number])
                self._are_whole = not (floats[is_number] % 1.0).any()
            elif self._reading.time_unit is not None:
                raise ChoiceError(
                    f"{self._path}: its times are dates: leave out --time-unit, which is for tables whose "
                    "times are numbers"
                )
        if self._are_dates:
            return self._stamps_of_dates(times)
        assert self._scale is not None
        is_number &= np.abs(floats * self._scale - self._epoch_ns) < RANGE_NS
        written = compress(times, is_number)  # exact to the nanosecond
        stamps[is_number] = [exact_ns(time, self._scale) - self._epoch_ns for time in written]
        if rests is not None and self._are_whole:
            more_ns = numbers(rests) * self._rest_ns
            has_rest = (more_ns >= 0) & (more_ns < 1e9)
            stamps[has_rest & is_number] += more_ns[has_rest & is_number].astype(np.int64)
            stamps[~has_rest] = NEVER
        return stamps

    def _stamps_of_dates(self, times: Sequence[str]) -> NDArray[np.int64]:
        """Stamps (N,) of dates; times of a day continue after midnight."""
        dated = map(stamp_of_date, times)
        stamps = np.array([NEVER if stamp is None else stamp for stamp in dated], np.int64)
        rows = np.flatnonzero(stamps != NEVER)
        if not len(rows):
            return stamps
        last_ns = stamps[rows[0]] if self._last_date_ns is None else self._last_date_ns
        steps = np.diff(stamps[rows], prepend=last_ns)
        self._last_date_ns = int(stamps[rows[-1]])
        if (far := np.flatnonzero(np.abs(steps) > _MOST_DAYS * _DAY_NS)).size:
            raise ChoiceError(
                f"{self._path}: whether the day or the month comes first in its dates is not known "
                f"({times[rows[far[0]]].strip()}): write them as 2026-03-31"
            )
        if np.abs(stamps[rows]).max() < 2 * _DAY_NS:  # there are no dates
            days = self._days + np.cumsum(steps < -_DAY_NS // 2)
            self._days = int(days[-1])
            stamps[rows] += days * _DAY_NS
        return stamps

    def _find_unit(self, times: NDArray[np.float64]) -> None:
        """Find the unit and epoch of times that are numbers, from the first ones; ticks of 100 ns since the
        year 1601 or 1 are recognised by their size."""
        doubt = None
        if self._reading.has_frame_numbers and (times != np.round(times)).any():
            raise ChoiceError(f"{self._path}: its times are not whole, {NO_FRAMES}")
        if (stated := self._reading.time_unit) in _EPOCHS_S:
            self._epoch_ns = _epoch_s(float(times[0]), str(stated)) * 10**9
        elif not self._is_certain and (unit := unit_of_dates(times)) is not None:
            command = TableReading(time_unit=unit).with_(self._reading).command(self._path)
            raise UnreadableRecording(f"its times look like {_EPOCHS_S[unit][1]}: read them by {command}")
        if self._scale is None:
            unit, doubt = unit_of(times)
            self._scale = TIME_UNITS_NS[unit]
        elif stated is not None or not self._is_certain:
            doubt = doubt_of_unit(times, self._scale)
        if doubt is not None:
            self._assume(doubt)


def exact_ns(time: str, unit_ns: float) -> int:
    """Nanoseconds of a number as text; raises ValueError or OverflowError if it is none."""
    plain = plain_number(time)
    try:
        return round(Decimal(plain) * Decimal(unit_ns))
    except ArithmeticError:  # an exponent of many digits
        return round(float(plain) * unit_ns)


def stamp_of_date(text: str) -> int | None:
    """Nanoseconds since 1970 of a date, or since midnight of a time of a day; None for other text.

    Without a time zone it is taken as UTC, since only differences matter. ``3/4/2026`` is of March, as in the
    US, unless the first number is above 12; ``3.4.2026`` of April.
    """
    match = _DATE.fullmatch(text)
    if match is None:
        return None
    part = match.groupdict(default="")
    year, month, day = (
        int(part[name] or default) for name, default in (("year", 1970), ("month", 1), ("day", 1))
    )
    if part["last"]:
        year, month, day = int(part["last"]), int(part["first"]), int(part["second"])
        month, day = (day, month) if part["dots"] == "." or month > 12 else (month, day)
    hour, minute, second = (int(part[name] or 0) for name in ("hour", "minute", "second_"))
    hour = hour % 12 + 12 * (part["half"].upper() == "P") if part["half"] else hour
    if year not in _YEARS:
        return None
    try:
        since = datetime(year, month, day, hour, minute, second, tzinfo=UTC) - _EPOCH
    except ValueError:  # as the 31st of June
        return None
    zone_s = 60 * (60 * int(part["zone"] or 0) + int(part["zone_minutes"] or 0))
    zone_s = -zone_s if part["sign"] == "-" else zone_s
    fraction_ns = int(f"{part['fraction'] or 0:0<9}"[:9])
    return ((since.days + int(part["days"] or 0)) * 86_400 + since.seconds - zone_s) * 10**9 + fraction_ns
