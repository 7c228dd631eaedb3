"""Rows of several bodies in tables: the column that names the body of each row."""

import re
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from contact_tracker.arrays import Array
from contact_tracker.recording.table_layouts import BLANKS, Columns, TableLayout, numbers

_BODIES: Final = "body|obj|object|tracker|device|marker|tag|hand|sensor|controller|track|target|child_frame"
OF_BODY: Final = re.compile(rf"(?:.*[._ ])?(?:u?id|name|{_BODIES})")
"""Names of columns of the names of bodies, which may be numbers; columns of text may have any name."""
_NAMES_ONE: Final = re.compile(rf"(?:.*[._ ])?(?:{_BODIES})(?:[._ ]?(?:u?id|name))?|(?:.*\.)?(?:u?id|name)")
"""Names of columns that name a body also where they do not change; others may be of a phase or a person."""
_OF_OTHERS: Final = re.compile(r"(?:.*[._ ])?(?<!child_)frame_id|.*\[.*")
"""Names of columns of the names of parent frames, and of elements of lists, as of joints."""


_MISSING: Final = ("", "nan", "NaN", "None", "null")
"""Cells without a name."""


def with_body(layout: TableLayout, columns: Columns) -> TableLayout:
    """The layout with the column of the names of bodies, if the first rows are of several ones, or of one of
    which others may follow."""
    read, first_rows, constant = layout.places, columns.rows() if len(layout.bodies) == 1 else (), list[int]()
    others = [(i, name) for i, name in enumerate(columns.plain) if i not in read]
    for place, name in others if first_rows else ():
        first = [row for row in first_rows if len(row) > max(place, *read)]
        names = [row[place].strip(BLANKS) for row in first]
        is_text = bool(np.isnan(numbers(names)).all())
        if not names or not (is_text or OF_BODY.fullmatch(name)):
            continue
        if len({*names}) == 1:
            is_name = OF_BODY.fullmatch(name) is not None and not _OF_OTHERS.fullmatch(name)
            is_given = is_text or (name.endswith("id") and names[0].isdigit())
            constant += [place] * (is_name and is_given and names[0] not in _MISSING)
            continue
        times = [row[layout.time] if layout.time >= 0 else str(i) for i, row in enumerate(first)]
        positions = np.array([numbers([row[i] for i in layout.bodies[0].columns[:3]]) for row in first])
        if _are_bodies(names, times, positions):
            return replace(layout, body=place)
    if not constant:
        return layout
    naming = [place for place in constant if _NAMES_ONE.fullmatch(columns.plain[place])]
    place = (naming or constant)[0]
    first_body = next(row[place].strip(BLANKS) for row in first_rows if len(row) > place)
    return replace(layout, body=place, first_body=first_body if naming else "")


def begin_body(texts: Sequence[str], times: NDArray[Any]) -> NDArray[np.bool_]:
    """Which of the rows after the first (N - 1,) begin another of successive bodies: with other text, while
    the time goes back. Where it goes on, the text tells something else, as the step of a task."""
    return np.not_equal(texts[1:], texts[:-1]) & (times[1:] < times[:-1])


def _are_bodies(names: Sequence[str], times: Sequence[str], positions: Array) -> bool:
    """Whether N names, which change at most rows and come back, are of bodies: rows of one time mostly have
    different ones, or positions (N, 3) of one name are nearer to each other than those of successive rows
    are, as they are not if rows are numbered, again and again."""
    pairs = [*pairwise(range(len(names)))]
    changes = [(i, j) for i, j in pairs if names[i] != names[j]]
    if not 1 < len({*names}) <= len(changes) or 2 * len(changes) < len(names):
        return False
    at_one_time = [pair for pair in pairs if times[pair[0]] == times[pair[1]]]
    count = len({*changes}.intersection(at_one_time))
    if count > 1 and 8 * count >= 7 * len(at_one_time):  # an object may be found twice
        return True
    latest, of_one_name = dict[str, int](), list[tuple[int, int]]()
    for i, name in enumerate(names):
        if name in latest:
            of_one_name.append((latest[name], i))
        latest[name] = i
    places = np.nan_to_num(positions, posinf=0.0, neginf=0.0)
    with np.errstate(over="ignore"):
        steps, between = (
            float(np.median(np.abs(np.diff(places[np.array(both)], axis=1)).max(axis=2)))
            for both in (of_one_name, changes)
        )
    return 2.0 * steps < between
