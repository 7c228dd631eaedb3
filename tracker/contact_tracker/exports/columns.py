"""Beliefs and segments as flat columns, with the same schema for all contacts (docs/conventions.md), and as a
DataFrame of pandas (an extra), with types that do not depend on the values."""

import json
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, Final, Literal

from contact_tracker.contacts.contact_motion import MEANS
from contact_tracker.errors import extra
from contact_tracker.geometry.elements import Element, Point, flat
from contact_tracker.states import STATES, Contact
from contact_tracker.tracking.belief import Belief, Segment

if TYPE_CHECKING:
    import pandas

Kind = Literal["integer", "number", "text"]
Rows = Literal["ticks", "segments"]
"""Entry of a row or of a line of JSON: a tick or a segment."""
Columns = dict[str, list[Any]]
"""Values by column; None if unknown or not applicable."""

PROBABILITIES: Final = tuple(f"p_{state.value.replace('-', '')}" for state in STATES)
"""Columns of the posterior in the order of ``STATES``: ``p_ff`` to ``p_free``."""


def kinds_of(kind: Kind, *names: str) -> dict[str, Kind]:
    """Columns of one kind."""
    return dict.fromkeys(names, kind)


def _numbers(name: str, unit: str = "") -> dict[str, Kind]:
    """The columns of the three components of a vector."""
    return kinds_of("number", *(f"{name}_{axis}{unit}" for axis in "xyz"))


_ELEMENT: Final = {
    **kinds_of("text", "type", "name"),
    **_numbers("axis"),
    **_numbers("point", "_m"),
    **_numbers("axis_sd"),
    **_numbers("point_sd", "_m"),
    **kinds_of("text", "unobserved"),
}
_GEOMETRY: Final = {
    f"{side}_{name}": kind for side in ("object", "environment") for name, kind in _ELEMENT.items()
}
_LABEL: Final[dict[str, Kind]] = {"contact": "text", "probability": "number", "inseparable": "text"}
_JOINT: Final[dict[str, Kind]] = {
    "joint": "text",
    "joint_probability": "number",
    **_numbers("joint_axis"),
    **_numbers("joint_point", "_m"),
    "joint_pitch_m_per_rad": "number",
}
"""Columns of the joint's axis in the world frame."""
_MOTION: Final = kinds_of("text", "motion") | kinds_of("number", *MEANS)
_TASK: Final = {
    **_numbers("task_origin", "_m"),
    **kinds_of("number", *(f"task_q{part}" for part in "xyzw")),
    **kinds_of("text", "task_name", "task_constrained"),
    **_numbers("task_sd", "_m"),
    **_numbers("task_sd", "_rad"),
}
"""Columns of the task frame in the world frame."""
_ELEMENTS: Final = {**_GEOMETRY, **kinds_of("text", "contacts"), **_JOINT, **kinds_of("text", "decided")}
COLUMNS: Final[dict[Rows, dict[str, Kind]]] = {
    "ticks": {
        **kinds_of("integer", "stamp_ns", "onset_ns"),
        **_LABEL,
        **kinds_of("number", *PROBABILITIES),
        **_ELEMENTS,
    },
    "segments": kinds_of("integer", "start_ns", "end_ns") | _LABEL | _ELEMENTS | _MOTION | _TASK,
}
"""Names and kinds of the columns; ``probability`` is the posterior of the label."""
OPEN: Final = "open"


def columns_of(rows: Rows, entries: Iterable[Any]) -> Columns:
    """The columns of beliefs or segments, with a row for each."""
    table = [_known_cells(entry) for entry in entries]
    return {name: [cells.get(name) for cells in table] for name in COLUMNS[rows]}


def _known_cells(entry: Belief | Segment) -> dict[str, Any]:
    """The cells of a row by column, without unknown ones."""
    contacts = [entry.contact, *(further.contact for further in entry.further)]
    cells: dict[str, Any] = {
        "contact": entry.contact.value,
        "inseparable": " ".join(entry.inseparable),
        "contacts": "" if entry.contact is Contact.FREE else " ".join(contacts),
        "decided": decided(entry),
    }
    if (pair := entry.geometry) is not None:
        values = [*_element_cells(pair.object), *_element_cells(pair.environment)]
        cells |= zip(_GEOMETRY, values, strict=True)
    if (joint := entry.joint) is not None:
        axis_and_point = _element_cells(joint.environment)[2:8]
        values = [joint.kind.value, float(joint.probability), *axis_and_point, joint.pitch_m_per_rad]
        cells |= zip(_JOINT, values, strict=True)
    if isinstance(entry, Belief):
        posterior = entry.probability.tolist()
        cells |= {"stamp_ns": entry.stamp_ns, "onset_ns": entry.onset_ns}
        cells |= {"probability": posterior[entry.contact.column]}
        return cells | dict(zip(PROBABILITIES, posterior, strict=True))
    cells |= {"start_ns": entry.start_ns, "end_ns": entry.end_ns, "probability": entry.probability}
    if entry.motion is not None:
        cells |= {"motion": ", ".join(entry.motion.kinds), **entry.motion.means}
    if (frame := entry.task_frame) is not None:
        values = [*frame.T_world_task[:3, 3].tolist(), *frame.quat_xyzw.tolist(), frame.name]
        values += [" ".join(frame.to_json()["constrained"]), *(frame.sd or (None,) * 6)]
        cells |= zip(_TASK, values, strict=True)
    return cells


def csv_columns(rows: Rows, entries: Iterable[Any], origin_ns: int) -> Columns:
    """The columns of CSV: as in ``columns_of``, and stamps in seconds after ``origin_ns`` (``start_s``). For
    segments ``contacts``, ``joint`` and a further column ``geometry`` are JSON text."""
    entries = list(entries)
    columns = columns_of(rows, entries)
    seconds = {
        f"{name.removesuffix('_ns')}_s": [round((stamp_ns - origin_ns) * 1e-9, 9) for stamp_ns in values]
        for name, values in columns.items()
        if name.endswith("_ns")
    }
    if rows == "ticks":
        return columns | seconds
    values: Columns = {
        "geometry": [entry.geometry.to_json() if entry.geometry else {} for entry in entries],
        "contacts": [entry.contacts_json for entry in entries],
        "joint": [entry.joint.to_json() if entry.joint else {} for entry in entries],
    }
    texts = {name: [json.dumps(cell, allow_nan=False) for cell in column] for name, column in values.items()}
    leading = ("start_ns", "end_ns", "contact", "probability", "geometry", "inseparable", "contacts", "joint")
    return {name: (columns | texts)[name] for name in (*leading, "decided")} | seconds | columns | texts


def decided(entry: Belief | Segment) -> str:
    """The contact, or ``open`` where the motion does not distinguish it from others."""
    return OPEN if entry.inseparable else entry.contact.value


def _element_cells(element: Element) -> list[Any]:
    """The cells of ``_ELEMENT``; a vertex has no axis."""
    values, no_axis = flat(element), [None] * 3
    axis, axis_sd = (no_axis, no_axis) if isinstance(element, Point) else (values["axis"], values["axis_sd"])
    vectors = [*axis, *values["point_m"], *axis_sd, *values["point_sd_m"]]
    return [values["type"], values["name"] or None, *vectors, values["unobserved"]]


def to_pandas(columns: Columns, kinds: dict[str, Kind]) -> "pandas.DataFrame":
    """The columns as a DataFrame of pandas; raises MissingExtra."""
    with extra("pandas", "a DataFrame of pandas"):
        from pandas import DataFrame, Series

    types = {"integer": "int64", "number": "float64", "text": "string"}
    return DataFrame({name: Series(columns[name], dtype=types[kind]) for name, kind in kinds.items()})
