"""Units of the times in a table: by name, or by what they would mean where no name tells."""

from collections.abc import Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

from contact_tracker.config.quantities import TIMES_NS

_WORDS: Final = {"s": "seconds", "ms": "milliseconds", "us": "microseconds", "ns": "nanoseconds"}
NAMED_NS: Final[Mapping[str, int]] = {
    **TIMES_NS,
    **{word: TIMES_NS[unit] for unit, word in _WORDS.items()},
    **dict.fromkeys(("sec", "secs"), TIMES_NS["s"]),
    "nsec": TIMES_NS["ns"],
}
"""Those that names of columns have."""
_STEP_S: Final = (0.0005, 0.2)
"""Between poses: 5 to 2000 a second. Of such steps no two units have any in common."""
_DATE_S: Final = (946684800.0, 4102444800.0)
"""Since 1970: the years 2000 to 2100."""
_SECONDS: Final = 1.0
"""Shorter steps may as well be those of few poses a second."""
_LONGEST_STEP_S: Final = 100.0
"""Steps of dates are no longer."""


def unit_of(times: NDArray[np.float64]) -> tuple[str, str | None]:
    """The unit of times that have none, and what to say of it where it is an assumption.

    By the steps between them, or as dates; as dates where both fit and poses would not be minutes apart.
    """
    if not len(times):
        return "s", None
    steps = np.diff(times)
    steps = steps[steps > 0]
    step = float(np.median(steps)) if len(steps) else None
    by_date = _first_within(_DATE_S, float(times[0]))
    by_step = None if step is None else _first_within(_STEP_S, step)
    if by_date is not None and (step is None or step * TIMES_NS[by_date] <= _LONGEST_STEP_S * 1e9):
        return by_date, None
    if step is None or by_step == "s":
        return "s", None
    unit = by_step if by_step is not None and step >= _SECONDS else "s"
    return unit, (
        f"its times have no unit and are taken as {_WORDS[unit]}, with steps of {step:g}: if they are not, "
        "say so with --time-unit s, ms, us or ns, or in the name of their column, as in time_ms"
    )


def _first_within(bounds_s: tuple[float, float], value: float) -> str | None:
    least, most = bounds_s
    return next((unit for unit, ns in TIMES_NS.items() if least <= value * ns * 1e-9 <= most), None)
