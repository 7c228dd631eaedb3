"""Models from TOML files, every key checked: shipped presets by name, others by path (docs/models.md)."""

from collections.abc import Callable
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any, Final

from contact_tracker.config import preset_names, shipped
from contact_tracker.config.keys import Keys, read_toml
from contact_tracker.config.parameters import ZERO, ByChange, ByState, Model
from contact_tracker.errors import ModelError
from contact_tracker.states import STATES, Contact
from contact_tracker.suggestions import suggestion

_RANGES: Final = {
    "tick_s": (1e-3, 10.0),
    "poses_per_tick": (0.0, 1000.0),
    "prior_predictive_share": (0.0, 1.0),
    "likelihood_exponent": (0.0, 1.01),
    "initial_autocorrelation": (0.0, 1.0),
    "reach_m": (1e-4, 1e3),
    "revisit_prior": (0.0, 1.0),
    "posterior_power": (0.0, 1.01),
    "estimate_share": (0.0, 1.01),
    "skip": (0.0, 1.0),
    "initial_f_f": (0.0, 1.0),
}
"""Ranges of numbers, both ends excluded; ``_POSITIVE`` for other keys."""
_POSITIVE: Final = (1e-12, 1e9)
MAY_BE_ZERO: Final = frozenset(
    {
        *("noise.wander_position_m", "noise.wander_rotation_rad", "motion.initial_autocorrelation"),
        *("systematic.position_m", "systematic.rotation_rad"),
    }
)
_LEAST_WINDOW_TICKS: Final = 10


def load_model(name_or_path: str = "default") -> Model:
    """Load a shipped preset by name or a TOML file by path.

    Raises
    ------
    ModelError : names the key, if it is one, and the reason.
    """
    names = preset_names()
    unreadable = f"{name_or_path!r} is neither one of {', '.join(names)} nor a file that can be read"
    near = suggestion(name_or_path, names)
    table = read_toml(model_file(name_or_path), ModelError, name_or_path, unreadable, near)
    model: Model = _build(Model, Keys(table, fault=ModelError))
    if model.search.window_s < _LEAST_WINDOW_TICKS * model.tick_s:
        raise ModelError("search.window_s", f"must be {_LEAST_WINDOW_TICKS} ticks (tick_s) at least")
    for name in ("contact_position_m", "contact_rotation_rad"):
        if getattr(model.noise, name)[Contact.FREE.column]:
            raise ModelError(f"noise.{name}.free", "free motion is no contact")
    if model.transitions.counts.changes[Contact.FREE.column][Contact.FREE.column]:
        raise ModelError("transitions.counts.changes.free.free", "free motion does not change into itself")
    return model


def model_file(name_or_path: str) -> Path:
    """The file of a model, with a name as in ``load_model``."""
    return shipped() / f"{name_or_path}.toml" if name_or_path in preset_names() else Path(name_or_path)


def _build(kind: Any, keys: Keys) -> Any:
    """A frozen value of type ``kind`` from the keys of a table."""
    stated = [entry for entry in fields(kind) if entry.name in keys or entry.default is MISSING]
    values = {entry.name: _value(entry.type, keys, entry.name) for entry in stated}
    keys.finish()
    return kind(**values)


def _value(kind: Any, keys: Keys, key: str) -> Any:
    if kind is str:
        return keys.text(key, None)
    if kind is bool:
        return keys.flag(key, default=True)
    if kind is float:
        number, (low, high) = keys.real(key), _RANGES.get(key, _POSITIVE)
        if not (low < number < high or (number == 0.0 and keys.called(key) in MAY_BE_ZERO)):
            raise keys.wrong(key, f"must be more than {low:g} and less than {high:g}")
        return number
    if kind == ByState:
        return _by_state(keys, key)
    if kind == ByChange:
        return _by_state(keys, key, _by_state, ZERO)
    return _build(kind, keys.table(key, is_required=True))


def _count(keys: Keys, key: str) -> float:
    number = keys.real(key)
    if not 0.0 <= number < _POSITIVE[1]:
        raise keys.wrong(key, f"must be zero or more, below {_POSITIVE[1]:g}")
    return number


def _by_state(
    keys: Keys, key: str, entry: Callable[[Keys, str], Any] = _count, absent: Any = 0.0
) -> tuple[Any, ...]:
    """Seven values from a table by the names of states, ``absent`` for missing ones."""
    table = keys.table(key, is_required=True)
    values = tuple(entry(table, state.value) if state.value in table else absent for state in STATES)
    table.finish()
    return values
