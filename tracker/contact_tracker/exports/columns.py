"""Beliefs and segments as flat columns of one schema for all contacts (docs/conventions.md), also as a
DataFrame of pandas, whose types do not depend on the values (an extra)."""

import json
from collections.abc import Callable, Iterable
from itertools import chain
from typing import TYPE_CHECKING, Any, Final, Literal

from contact_tracker.contacts.contact_motion import MEANS, ContactMotion
from contact_tracker.contacts.task_frame import TaskFrame
from contact_tracker.errors import extra
from contact_tracker.explanations.joint_evidence import Joint
from contact_tracker.geometry.elements import ContactGeometry, Element, Point, flat
from contact_tracker.states import STATES, Contact
from contact_tracker.tracking.belief import Belief, Segment

if TYPE_CHECKING:
    import pandas

Kind = Literal["integer", "number", "text"]
Rows = Literal["ticks", "segments"]
"""What a row, or a line of JSON, is of."""
Columns = dict[str, list[Any]]
"""Values by column; None is unknown or not applicable."""

PROBABILITIES: Final = tuple(f"p_{state.value.replace('-', '')}" for state in STATES)
"""In the order of ``STATES``: ``p_ff`` to ``p_free``."""


def _numbers(name: str, unit: str = "") -> dict[str, Kind]:
    """The columns of the three components of a vector."""
    return {f"{name}_{axis}{unit}": "number" for axis in "xyz"}


def _element_kinds(side: str) -> dict[str, Kind]:
    kinds: dict[str, Kind] = {f"{side}_type": "text", f"{side}_name": "text"}
    kinds |= _numbers(f"{side}_axis") | _numbers(f"{side}_point", "_m")
    kinds |= _numbers(f"{side}_axis_sd") | _numbers(f"{side}_point_sd", "_m")
    return kinds | {f"{side}_unobserved": "text"}


_GEOMETRY: Final = _element_kinds("object") | _element_kinds("environment")
_LABEL: Final[dict[str, Kind]] = {"contact": "text", "probability": "number", "inseparable": "text"}
_CONTACTS: Final[dict[str, Kind]] = {"contacts": "text"}
_JOINT: Final[dict[str, Kind]] = {
    "joint": "text",
    "joint_probability": "number",
    **_numbers("joint_axis"),
    **_numbers("joint_point", "_m"),
    "joint_pitch_m_per_rad": "number",
}
"""Columns of the joint's axis in the world frame."""
_TICK: Final[dict[str, Kind]] = {"stamp_ns": "integer", "onset_ns": "integer"}
_SPAN: Final[dict[str, Kind]] = {"start_ns": "integer", "end_ns": "integer"}
_NUMBER: Final[Kind] = "number"
_POSTERIOR: Final = dict.fromkeys(PROBABILITIES, _NUMBER)
_DECIDED: Final[dict[str, Kind]] = {"decided": "text"}
BELIEF_COLUMNS: Final = _TICK | _LABEL | _POSTERIOR | _GEOMETRY | _CONTACTS | _JOINT | _DECIDED
_MOTION: Final[dict[str, Kind]] = {"motion": "text", **dict.fromkeys(MEANS, _NUMBER)}
_TASK: Final[dict[str, Kind]] = {
    **_numbers("task_origin", "_m"),
    **{f"task_q{part}": "number" for part in "xyzw"},
    "task_name": "text",
    "task_constrained": "text",
    **_numbers("task_sd", "_m"),
    **_numbers("task_sd", "_rad"),
}
"""Columns of the task frame in the world frame."""
SEGMENT_COLUMNS: Final = _SPAN | _LABEL | _GEOMETRY | _CONTACTS | _JOINT | _DECIDED | _MOTION | _TASK
OPEN: Final = "open"


def belief_columns(beliefs: Iterable[Belief]) -> Columns:
    """A row per tick with the columns ``BELIEF_COLUMNS``; ``probability`` is that of the label."""

    def cells(one: Belief) -> dict[str, Any]:
        posterior = [float(p) for p in one.probability]
        times = {"stamp_ns": one.stamp_ns, "onset_ns": one.onset_ns}
        own = times | dict(zip(PROBABILITIES, posterior, strict=True))
        return own | _contact_cells(one, posterior[one.contact.column])

    return _columns(BELIEF_COLUMNS, ((cells(one), one.geometry) for one in beliefs))


def segment_columns(segments: Iterable[Segment]) -> Columns:
    """A row per segment with the columns ``SEGMENT_COLUMNS``."""

    def cells(one: Segment) -> dict[str, Any]:
        times = {"start_ns": one.start_ns, "end_ns": one.end_ns}
        own = _motion_cells(one.motion) | _task_cells(one.task_frame)
        return times | _contact_cells(one, one.probability) | own

    return _columns(SEGMENT_COLUMNS, ((cells(one), one.geometry) for one in segments))


TABLES: Final[dict[Rows, tuple[dict[str, Kind], Callable[[Iterable[Any]], Columns]]]] = {
    "ticks": (BELIEF_COLUMNS, belief_columns),
    "segments": (SEGMENT_COLUMNS, segment_columns),
}
"""Names and kinds of the columns, and the function that makes them from beliefs or segments."""


def csv_columns(rows: Rows, entries: Iterable[Any], origin_ns: int) -> Columns:
    """The columns of CSV: those above, with stamps in seconds after ``origin_ns`` as well (``start_s``). Of
    segments ``contacts`` and ``joint`` are JSON text, and there is ``geometry``."""
    entries = list(entries)
    columns = TABLES[rows][1](entries)
    seconds = {
        f"{name.removesuffix('_ns')}_s": [round((stamp_ns - origin_ns) * 1e-9, 9) for stamp_ns in values]
        for name, values in columns.items()
        if name.endswith("_ns")
    }
    if rows == "ticks":
        return columns | seconds
    texts: Columns = {
        "geometry": [_json(one.geometry.to_json() if one.geometry else {}) for one in entries],
        "contacts": [_json(one.contacts_json) for one in entries],
        "joint": [_json(one.joint.to_json() if one.joint else {}) for one in entries],
    }
    first = ("start_ns", "end_ns", "contact", "probability", "geometry", "inseparable", "contacts", "joint")
    return {name: (columns | texts)[name] for name in (*first, "decided")} | seconds | columns | texts


def _json(value: Any) -> str:
    return json.dumps(value, allow_nan=False)


def _contact_cells(one: Belief | Segment, probability: float) -> dict[str, Any]:
    label = {"contact": one.contact.value, "probability": probability, "decided": decided(one)}
    others = {"inseparable": " ".join(one.inseparable), "contacts": _kinds(one)}
    return label | others | _joint_cells(one.joint)


def _joint_cells(joint: Joint | None) -> dict[str, Any]:
    if joint is None:
        return dict.fromkeys(_JOINT)
    axis_and_point = _element_cells(joint.environment)[2:8]
    cells = joint.kind.value, float(joint.probability), *axis_and_point, joint.pitch_m_per_rad
    return dict(zip(_JOINT, cells, strict=True))


def _motion_cells(motion: ContactMotion | None) -> dict[str, Any]:
    if motion is None:
        return dict.fromkeys(_MOTION)
    return {"motion": ", ".join(motion.kinds), **motion.means}


def _task_cells(frame: TaskFrame | None) -> dict[str, Any]:
    if frame is None:
        return dict.fromkeys(_TASK)
    values = frame.to_json()
    cells = [*values["origin_m"], *values["quat_xyzw"], frame.name, " ".join(values["constrained"])]
    cells += frame.sd or [None] * 6
    return dict(zip(_TASK, cells, strict=True))


def decided(one: Belief | Segment) -> str:
    """The contact, or ``open`` where the motion does not distinguish it from others."""
    return OPEN if one.inseparable else one.contact.value


def _kinds(one: Belief | Segment) -> str:
    """All simultaneous contacts, separated by blanks (``e-f v-f``); empty for free."""
    return "" if one.contact is Contact.FREE else " ".join((one.contact, *(f.contact for f in one.further)))


def _columns(
    kinds: dict[str, Kind], rows: Iterable[tuple[dict[str, Any], ContactGeometry | None]]
) -> Columns:
    """Columns of rows, each with the cells beside its geometry, which consecutive rows often share."""
    columns: Columns = {name: [] for name in kinds}
    last, shared = None, _geometry_cells(None)
    for cells, geometry in rows:
        if last is not geometry:
            last, shared = geometry, _geometry_cells(geometry)
        cells |= shared
        for name, column in columns.items():
            column.append(cells[name])
    return columns


def _geometry_cells(geometry: ContactGeometry | None) -> dict[str, Any]:
    pair = (None, None) if geometry is None else (geometry.object, geometry.environment)
    return dict(zip(_GEOMETRY, chain.from_iterable(map(_element_cells, pair)), strict=True))


def _element_cells(element: Element | None) -> list[Any]:
    """The cells of ``_element_kinds``; a vertex has no axis."""
    if element is None:
        return [None] * len(_element_kinds(""))
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
