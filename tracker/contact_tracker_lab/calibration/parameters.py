"""The parameters that calibration learns: their table, values by key, direct search, and a model as TOML."""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, is_dataclass, replace
from enum import StrEnum
from operator import attrgetter
from typing import Any, Final, NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar

from contact_tracker.config.loading import limits
from contact_tracker.config.parameters import ByChange, ByState, Model
from contact_tracker.errors import UsageError
from contact_tracker.states import STATES

EVALUATIONS: Final = 7
"""Number of evaluations of the loss per parameter; each is a pass over all recordings."""
FACTOR: Final = 5.0
"""Factor of the initial value within which a value is searched."""
WORTH: Final = 1e-3
"""Least relative decrease of the loss for which a parameter is changed."""


class How(StrEnum):
    """How a parameter is learned."""

    STREAM = "the sensor noise of the streams"
    RESIDUALS = "residuals of contacts"
    CONTACTS = "residuals of each contact"
    COUNTS = "states that follow each other"
    SEARCH = "search for the least log-loss"


ONLY_IF_NAMED: Final = (How.SEARCH, How.CONTACTS)
LEARNED: Final[Mapping[str, How]] = {
    "noise.sigma_position_m": How.STREAM,
    "noise.sigma_rotation_rad": How.STREAM,
    "noise.floor_position_m": How.RESIDUALS,
    "noise.floor_rotation_rad": How.RESIDUALS,
    "noise.contact_position_m": How.CONTACTS,
    "noise.contact_rotation_rad": How.CONTACTS,
    "transitions.counts": How.COUNTS,
    "motion.body_radius_m": How.SEARCH,
    "motion.prior_predictive_share": How.SEARCH,
    "motion.likelihood_exponent": How.SEARCH,
    "geometry.reach_m": How.SEARCH,
    "geometry.revisit_prior": How.SEARCH,
    "certainty.posterior_power": How.SEARCH,
}
"""How each parameter is learned, by its key in the file."""


def select(only: Sequence[str]) -> dict[str, How]:
    """The parameters named in ``only`` by key or by table; without names, those that need not be named.

    Raises
    ------
    UsageError
        A name is neither a key nor a table.
    """
    for name in only:
        if name not in LEARNED and not any(key.startswith(f"{name}.") for key in LEARNED):
            raise UsageError(f"{name} is not learned; what is: {', '.join(LEARNED)}, or their tables")
    if not only:
        return {key: how for key, how in LEARNED.items() if how not in ONLY_IF_NAMED}
    return {key: how for key, how in LEARNED.items() if {key, key.partition(".")[0]} & set(only)}


def value_of(model: Model, key: str) -> Any:
    """The value of ``key``."""
    return attrgetter(key)(model)


def with_value(model: Any, key: str, value: Any) -> Any:
    """The model, or a table of it, with another value of ``key``."""
    name, _, remainder = key.partition(".")
    part = with_value(getattr(model, name), remainder, value) if remainder else value
    return replace(model, **{name: part})


def rounded(value: float) -> float:
    """Round to the significant digits of the file, so that the file has exactly the learned value."""
    return float(f"{value:.3g}")


Tried = list[tuple[float, float]]
"""Values of a parameter, each with its loss (nats)."""


class Searched(NamedTuple):
    """A parameter's loss (nats) before and after, and all (value, loss) pairs that were evaluated."""

    key: str
    before: float
    after: float
    tried: tuple[tuple[float, float], ...]


def coordinate_search(
    model: Model, keys: Sequence[str], loss: Callable[[Model], float]
) -> tuple[Model, tuple[Searched, ...]]:
    """Lower ``loss`` along each of ``keys`` in turn, on a logarithmic scale; parameters with too little gain
    stay."""
    searched = []
    best = loss(model) if keys else 0.0
    for key in keys:
        before, tried = best, [(float(value_of(model, key)), best)]

        def at(log_value: float, key: str = key, model: Model = model, tried: Tried = tried) -> float:
            value = rounded(float(np.exp(log_value)))
            tried.append((value, loss(with_value(model, key, value))))
            return tried[-1][1]

        (start, _), (low, high) = tried[0], limits(key)
        bounds = np.log([max(start / FACTOR, low * 1.01), min(start * FACTOR, high * 0.99)])
        options = {"maxiter": EVALUATIONS, "xatol": 0.05}
        minimize_scalar(at, bounds=bounds, method="bounded", options=options)
        value, least = min(tried, key=lambda pair: pair[1])
        if least < before * (1.0 - WORTH):
            model, best = with_value(model, key, value), least
        searched.append(Searched(key, before, best, tuple(tried)))
    return model, tuple(searched)


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
