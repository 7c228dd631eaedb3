"""What hypotheses of one contact assume when they begin, as columns."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contact_tracker.contacts import ContactModel

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Begins:
    """What n hypotheses that begin assume (see ``Bank``); ``log_share`` (n,) of the contact's weight, and
    what of x is ``told`` (n, S) by that (see ``Given``)."""

    source: Index
    log_share: Array
    known_mean: Array
    known: Array
    pivot: Array
    pair: Index
    certain: Bools
    searched: Bools
    met: Bools
    told: Bools

    @property
    def many(self) -> int:
        return len(self.source)

    @property
    def assumed(self) -> dict[str, NDArray[Any]]:
        """The columns that a bank has as well."""
        return {name: column for name, column in vars(self).items() if name not in {"log_share", "told"}}

    def sharing(self, log_share: Array) -> "Begins":
        """The same with other shares."""
        return replace(self, log_share=log_share)

    def pick(self, rows: NDArray[np.generic]) -> "Begins":
        return Begins(*(column[rows] for column in vars(self).values()))


def fresh(model: ContactModel) -> Begins:
    """One of which nothing is known."""
    size, number, no = model.family.SIZE, np.zeros(1, np.int64), np.zeros(1, bool)
    mean, known, pivot = np.zeros((1, size)), np.zeros((1, size, size)), np.full((1, 6), np.nan)
    return Begins(number, np.zeros(1), mean, known, pivot, number, no, ~no, no, mean != 0.0)
