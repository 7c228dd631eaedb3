"""Parsing of quantities with units."""

import math
import re
from collections.abc import Mapping
from typing import Final

LENGTHS: Final = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6}
ANGLES: Final = {"rad": 1.0, "mrad": 1e-3, "deg": math.pi / 180.0}
TIMES_NS: Final = {"s": 10**9, "ms": 10**6, "us": 10**3, "ns": 1}
"""Units of time in nanoseconds."""
TIME_WORDS: Final = {"s": "seconds", "ms": "milliseconds", "us": "microseconds", "ns": "nanoseconds"}
NAMED_NS: Final[Mapping[str, int]] = {
    **TIMES_NS,
    **{word: TIMES_NS[unit] for unit, word in TIME_WORDS.items()},
    **{word[:-1]: TIMES_NS[unit] for unit, word in TIME_WORDS.items()},
    **dict.fromkeys(("sec", "secs"), TIMES_NS["s"]),
    **{f"{unit}ec": TIMES_NS[unit] for unit in ("ms", "us", "ns")},
    **dict.fromkeys(("\u00b5s", "\u03bcs"), TIMES_NS["us"]),
    **dict.fromkeys(("min", "minute", "minutes"), 60 * TIMES_NS["s"]),
}
"""Units of time in names of columns, in nanoseconds."""
_METRES: Final = {"": 1.0, "centi": 1e-2, "milli": 1e-3, "micro": 1e-6}
LENGTHS_M: Final[Mapping[str, float]] = {
    **LENGTHS,
    **dict.fromkeys(("\u00b5m", "\u03bcm"), LENGTHS["um"]),
    **dict.fromkeys(("in", "inch", "inches"), 0.0254),
    **{f"{part}met{end}": m for part, m in _METRES.items() for end in ("er", "re", "ers", "res")},
}
ANGLE_UNITS: Final[Mapping[str, str]] = {
    **dict.fromkeys(("deg", "degs", "degree", "degrees", "\u00b0"), "deg"),
    **dict.fromkeys(("rad", "rads", "radian", "radians"), "rad"),
}
RANGE_NS: Final = 2**62
"""Largest stamp, in either direction: 146 years from zero."""
_NUMBER: Final = r"\s*((?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:e[-+]?[0-9]+)?)\s*"
_DEVIATIONS: Final = re.compile(f"{_NUMBER}({'|'.join(LENGTHS)})\\s*,{_NUMBER}({'|'.join(ANGLES)})\\s*")
_LEAST: Final = 1e-9
_MOST_M: Final = 0.1
_MOST_RAD: Final = math.radians(10.0)
"""Largest errors of poses with which contacts can be recognised; larger ones are in another unit."""


def deviations(text: str, may_be_zero: bool = False) -> tuple[float, float]:
    """A length and an angle such as ``0.3mm,0.15deg``, in metres and radians.

    Raises
    ------
    ValueError
        It is something else, or no plausible error of a pose.
    """
    parts = _DEVIATIONS.fullmatch(text)
    if parts is None:
        raise ValueError(f"{text!r} is not a length and an angle with units: 0.3mm,0.15deg")
    values = float(parts[1]) * LENGTHS[parts[2]], float(parts[3]) * ANGLES[parts[4]]
    return plausible(values, text, may_be_zero)


def plausible(values: tuple[float, float], text: object, may_be_zero: bool = False) -> tuple[float, float]:
    """The deviations (m, rad); raises ValueError that quotes ``text`` if they are not plausible."""
    for value, limit in zip(values, (_MOST_M, _MOST_RAD), strict=True):
        if not (_LEAST < value <= limit * (1.0 + _LEAST) or (may_be_zero and value == 0.0)):
            raise ValueError(
                f"{text!r} is no error with which contacts can be distinguished: at most 100 mm and 10 deg, "
                "at least 1e-9 m and rad. Are the units right?"
            )
    return values
