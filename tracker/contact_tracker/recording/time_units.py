"""Units of the times in a table, by name or guessed from the values."""

from collections.abc import Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

from contact_tracker.config.quantities import TIMES_NS

_WORDS: Final = {"s": "seconds", "ms": "milliseconds", "us": "microseconds", "ns": "nanoseconds"}
NAMED_NS: Final[Mapping[str, int]] = {
    **TIMES_NS,
    **{word: TIMES_NS[unit] for unit, word in _WORDS.items()},
    **{word[:-1]: TIMES_NS[unit] for unit, word in _WORDS.items()},
    **dict.fromkeys(("sec", "secs"), TIMES_NS["s"]),
    **{f"{unit}ec": TIMES_NS[unit] for unit in ("ms", "us", "ns")},
    **dict.fromkeys(("\u00b5s", "\u03bcs"), TIMES_NS["us"]),
}
"""Units in names of columns."""
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
        f"its times have no unit and are taken as {_WORDS[unit]}, with steps of {step:g}: if they are not, "
        "say so with --time-unit s, ms, us or ns, or in the name of their column, as in time_ms; the rate of "
        "numbers of frames is given as --time-unit 200Hz"
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
        f"they look like {_WORDS[likely]}: give --time-unit {likely}, or name their column time_{likely}"
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
