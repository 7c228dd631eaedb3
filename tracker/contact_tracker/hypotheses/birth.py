"""What hypotheses of one contact assume when they begin: rows of a bank that have seen nothing yet."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from contact_tracker.contacts import ContactModel
from contact_tracker.contacts.parameter_layout import directions
from contact_tracker.geometry.elements import Pair
from contact_tracker.hypotheses.bank import Bank, blank
from contact_tracker.hypotheses.element_prior import by_feet, given
from contact_tracker.hypotheses.schedule import patience

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Begins:
    """Hypotheses ``rows`` (n) that may begin, without an onset; and what of their x is ``told`` (n, S) by
    what they assume (see ``Given``)."""

    rows: Bank
    told: Bools

    @property
    def many(self) -> int:
        return len(self.rows)

    @property
    def log_share(self) -> Array:
        """Of the contact's weight (n,)."""
        return self.rows.log_likelihood

    def sharing(self, log_share: Array) -> "Begins":
        """The same with other shares."""
        return replace(self, rows=self.rows.having(lasted=log_share, log_likelihood=log_share))

    def pick(self, rows: NDArray[np.generic]) -> "Begins":
        return Begins(self.rows.pick(np.arange(self.many)[rows]), self.told[rows])


def begun(
    model: ContactModel,
    pairs: Sequence[Pair],
    near_m: Array | None,
    log_share: Sequence[float],
    pair: Sequence[int],
    certain: Sequence[bool],
    met: Sequence[bool],
) -> Begins:
    """One hypothesis of each of the ``pairs`` of elements.

    Lines of the surroundings are given by their points nearest to ``near_m`` (3,), lest these hang on
    directions. The rest as in ``Bank``; it may search, and has the grace to, where directions are not told.
    """
    none = blank(model, 0)
    prior, pivot = given(model, pairs)
    if near_m is not None:
        prior, pivot = by_feet(model, prior, pivot, near_m)
    told = prior.told(model)
    searched = np.asarray(~told[:, directions(model.family.FORM)].all(axis=1))  # the rest is a linear problem
    something = prior.information.any(axis=(1, 2)) | np.array(met, bool)
    rows = blank(model, len(pairs)).having(
        source=np.where(something, 1 + np.arange(len(pairs)), 0),
        pair=np.array(pair, np.int64),
        certain=np.array(certain, np.int64),
        searched=searched,
        met=np.array(met, np.int64),
        grace=np.where(searched, patience(model.needed), 0.0),
        known_mean=prior.mean,
        known=prior.information,
        pivot=pivot,
        lasted=np.array(log_share),
        log_likelihood=np.array(log_share),
        onset=0,
    )
    return Begins(replace(rows, onsets=none.onsets), told)


@lru_cache(maxsize=16)
def fresh(model: ContactModel) -> Begins:
    """One of which nothing is known."""
    return begun(model, [(None, None)], None, [0.0], [0], [False], [False])
