"""A model as the text of its TOML file."""

from collections.abc import Sequence
from dataclasses import fields, is_dataclass
from typing import Any

from contact_tracker.config.parameters import ByChange, ByState, Model
from contact_tracker.states import STATES


def model_text(model: Model, header: Sequence[str] = ()) -> str:
    """TOML text from which ``load_model`` makes ``model`` again, under comment lines ``header``."""
    lines = [f"# {_printable(' '.join(line.split()))}".rstrip() for line in header]
    return "\n".join([*lines, *_table(model, ""), ""])


def _table(table: Any, name: str) -> list[str]:
    """Lines of a table: its own keys, then the tables in it."""
    kinds = [(f.name, f.type, getattr(table, f.name)) for f in fields(table)]
    lines = ["", f"[{name}]"] if name else []
    for key, kind, value in kinds:
        if not is_dataclass(kind):
            lines += _entry(key, kind, value)
    for key, kind, value in kinds:
        if is_dataclass(kind):
            lines += _table(value, f"{name}.{key}".lstrip("."))
    return lines


def _entry(key: str, kind: Any, value: Any) -> list[str]:
    if kind is str:
        return [f"{key} = {_quoted(value)}"]
    if kind is bool:
        return [f"{key} = {str(value).lower()}"]
    if kind == ByState:
        return [f"{key} = {_inline(value)}"]
    if kind == ByChange:
        rows = zip(STATES, value, strict=True)
        lines = [f"{key}.{state.value} = {_inline(row)}" for state, row in rows if any(row)]
        return lines or [f"{key} = {{}}"]
    return [f"{key} = {float(value)!r}"]


def _inline(values: ByState) -> str:
    """One line of a table; zeros are left out."""
    pairs = zip(STATES, values, strict=True)
    inside = ", ".join(f"{state.value} = {float(value)!r}" for state, value in pairs if value)
    return f"{{ {inside} }}" if inside else "{}"


def _quoted(text: str) -> str:
    """A TOML basic string."""
    escaped = _printable(text).replace("\\", "\\\\").replace('"', '\\"')
    return f'"{escaped}"'


def _printable(text: str) -> str:
    """The text with characters that TOML or terminals do not take replaced by question marks."""
    return "".join(c if c.isprintable() else "?" for c in text)
