"""Units of positions and angles in tables, as far as their values show them."""

from dataclasses import replace
from typing import Final

import numpy as np

from contact_tracker.arrays import Array
from contact_tracker.config.table_reading import TableReading, reading_of
from contact_tracker.recording.table_layouts import LOST_DEG, Body

FARTHEST_M: Final = 10.0
"""Median distance (m) from which a proposed command has millimetres, and says that the unit is the user's."""
_OUTLIER_SHARE: Final = 0.01
"""Largest share of rows with angles beyond a turn that are outliers, not in another unit."""
_LEAST_DEG: Final = 0.5
_MOST_DEG: Final = round(np.pi, 4)
"""A largest angle between these is also one in radians of an object that is handled; in degrees it hardly
turns. Of 74 recordings none has such angles in degrees, and all in radians, also from 0.25 or 1 on."""


def are_no_radians(numbers: Array) -> bool:
    """Whether angles, or components of rotation vectors, of the rows (N, 3) exceed one turn in radians: in
    more rows than are outliers."""
    sizes = np.abs(numbers)
    rows = ((sizes > 2.0 * np.pi) & (sizes < LOST_DEG)).any(axis=1).sum()
    return bool(rows > _OUTLIER_SHARE * len(numbers))


def reach_of(values: Array) -> float:
    """The median of the largest coordinates of positions, the first of ``values`` (N, k); 0 without any."""
    sizes = np.abs(values[:, :3]).max(axis=1)
    return float(np.nanmedian(sizes)) if np.isfinite(sizes).any() else 0.0


def in_unit(reading: TableReading, body: Body, values: Array) -> tuple[TableReading, str]:
    """The reading to be proposed for a body's ``values`` (N, k): with millimetres if its positions have no
    unit and are too far for metres; then, in words, what the user has to replace."""
    reach = 0.0 if body.has_unit else reach_of(values)
    if reach <= FARTHEST_M:
        return reading, ""
    return replace(reading, unit="mm"), f"your unit instead of mm (positions are about {reach:.4g})"


def doubt_angles(values: Array, body: Body, reading: TableReading, path: str) -> str:
    """What to do if angles among the ``values`` (N, k) of a body's columns exceed a turn in radians, without
    names of columns that state radians; empty if they do not."""
    if body.assumed_angles != "rad" or not are_no_radians(values[:, 3:]):
        return ""
    order = body.how.rpartition(":")[0] or "xyz"
    way, about = in_unit(reading.with_(reading_of(euler=f"{order}:deg")), body, values)
    command = f"{way.command(path)}{', with ' * bool(about)}{about}"
    return (
        f"its angles as radians are larger than a turn: if they are degrees, read them by {command}; if "
        "not, write the unit into the names of their columns, as in 'rx [rad]'"
    )


def largest_deg(values: Array, body: Body) -> float:
    """Largest angle (deg) among the ``values`` (N, k) of a body's columns whose names do not state the unit;
    NaN without any."""
    if body.assumed_angles != "deg" or not np.isfinite(values[:, 3:]).any():
        return np.nan
    return float(np.nanmax(np.abs(values[:, 3:])))


def doubt_degrees(largest: float, reading: TableReading, path: str) -> str:
    """What to do if the largest angle (deg) of a table is one that radians have; empty if it is not."""
    if not _LEAST_DEG < largest <= _MOST_DEG or reading.euler is None:
        return ""
    way = reading.with_(reading_of(euler=reading.euler.replace(":deg", ":rad")))
    return (
        f"its angles are within {largest:.2f} deg: if they are radians, read them by {way.command(path)}; if "
        "not, write the unit into the names of their columns, as in 'rx [deg]'"
    )
