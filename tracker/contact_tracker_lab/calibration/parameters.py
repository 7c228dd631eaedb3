"""The parameters that calibration learns: their keys, and a model as TOML."""

import json
from collections.abc import Sequence
from dataclasses import fields, is_dataclass
from typing import Any, Final

from contact_tracker.config.parameters import ByChange, ByState, Model
from contact_tracker.errors import UsageError
from contact_tracker.states import STATES

SIGMAS: Final = ("noise.sigma_position_m", "noise.sigma_rotation_rad")
COUNTS: Final = "transitions.counts"
LEARNED: Final = (*SIGMAS, COUNTS)
"""Keys of the parameters that are learned."""


def select(only: Sequence[str]) -> tuple[str, ...]:
    """The keys named in ``only``, also by their table; all without names.

    Raises
    ------
    UsageError
        A name is neither a key nor a table.
    """
    for name in only:
        if not any(name in (key, key.partition(".")[0]) for key in LEARNED):
            raise UsageError(f"{name} is not learned; what is: {', '.join(LEARNED)}, or their tables")
    names = set(only or LEARNED)
    return tuple(key for key in LEARNED if {key, key.partition(".")[0]} & names)


def model_text(model: Model, header: Sequence[str] = ()) -> str:
    """TOML text from which ``load_model`` makes ``model`` again, under comment lines ``header``."""
    lines = [f"# {_printable(' '.join(line.split()))}".rstrip() for line in header]
    return "\n".join([*lines, *_table(model, ""), ""])


def _table(table: Any, name: str) -> list[str]:
    """Lines of a table: its own keys, then the tables in it."""
    lines = ["", f"[{name}]"] if name else []
    for f in sorted(fields(table), key=lambda f: is_dataclass(f.type)):
        value = getattr(table, f.name)
        if is_dataclass(f.type):
            lines += _table(value, f"{name}.{f.name}".lstrip("."))
        else:
            lines += _entry(f.name, f.type, value)
    return lines


def _entry(key: str, kind: Any, value: Any) -> list[str]:
    if kind in (str, bool):  # written in TOML as in JSON
        return [f"{key} = {json.dumps(_printable(value) if kind is str else value, ensure_ascii=False)}"]
    if kind == ByState:  # in one line; zeros are left out
        inside = [f"{state} = {float(x)!r}" for state, x in zip(STATES, value, strict=True) if x]
        return [f"{key} = {{ {', '.join(inside)} }}" if inside else f"{key} = {{}}"]
    if kind == ByChange:
        rows = [(state, row) for state, row in zip(STATES, value, strict=True) if any(row)]
        lines = [line for state, row in rows for line in _entry(f"{key}.{state}", ByState, row)]
        return lines or [f"{key} = {{}}"]
    return [f"{key} = {float(value)!r}"]


def _printable(text: str) -> str:
    """The text with question marks for characters that TOML or terminals do not accept."""
    return "".join(c if c.isprintable() else "?" for c in text)
