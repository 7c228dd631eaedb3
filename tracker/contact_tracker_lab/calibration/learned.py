"""The table of parameters that calibration learns; access to a model's numbers by key."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any, Final

from contact_tracker.config.parameters import Model
from contact_tracker.errors import UsageError


class How(StrEnum):
    """How a parameter is learned."""

    STREAM = "the sensor noise of the streams"
    RESIDUALS = "residuals of contacts"
    CONTACTS = "residuals of each contact"
    COUNTS = "states that follow each other"
    SEARCH = "search for the least log-loss"


@dataclass(frozen=True)
class Learned:
    """A parameter, by its key in the file."""

    key: str
    how: How

    @property
    def if_named(self) -> bool:
        """Whether it is learned only if named."""
        return self.how in (How.SEARCH, How.CONTACTS)


LEARNED: Final = (
    Learned("noise.sigma_position_m", How.STREAM),
    Learned("noise.sigma_rotation_rad", How.STREAM),
    Learned("noise.floor_position_m", How.RESIDUALS),
    Learned("noise.floor_rotation_rad", How.RESIDUALS),
    Learned("noise.contact_position_m", How.CONTACTS),
    Learned("noise.contact_rotation_rad", How.CONTACTS),
    Learned("transitions.counts", How.COUNTS),
    Learned("motion.body_radius_m", How.SEARCH),
    Learned("motion.prior_predictive_share", How.SEARCH),
    Learned("motion.likelihood_exponent", How.SEARCH),
    Learned("geometry.reach_m", How.SEARCH),
    Learned("geometry.revisit_prior", How.SEARCH),
    Learned("certainty.posterior_power", How.SEARCH),
)


def select(only: Sequence[str]) -> tuple[Learned, ...]:
    """The parameters named in ``only`` by key or by table; without names, those that need not be named.

    Raises
    ------
    UsageError
        A name is neither a key nor a table.
    """
    for name in only:
        if not any(_names(name, learned) for learned in LEARNED):
            known = ", ".join(learned.key for learned in LEARNED)
            raise UsageError(f"{name} is not learned; what is: {known}, or their tables")
    if not only:
        return tuple(learned for learned in LEARNED if not learned.if_named)
    return tuple(learned for learned in LEARNED if any(_names(name, learned) for name in only))


def value_of(model: Model, key: str) -> Any:
    """The value of ``key``."""
    value: Any = model
    for name in key.split("."):
        value = getattr(value, name)
    return value


def with_value(model: Model, key: str, value: Any) -> Model:
    """The model with another value of ``key``."""
    table, _, name = key.rpartition(".")
    if not table:
        return replace(model, **{name: value})
    return replace(model, **{table: replace(getattr(model, table), **{name: value})})


def rounded(value: float, digits: int = 3) -> float:
    """Round to the significant digits of the file, so that the file has exactly the learned value."""
    return float(f"{value:.{digits}g}")


def _names(name: str, learned: Learned) -> bool:
    return name in (learned.key, learned.key.partition(".")[0])
