"""Birth proposals of one contact: rows of a bank with a prior, before any data."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from contact_tracker.contacts import ContactModel
from contact_tracker.contacts.parameter_layout import directions
from contact_tracker.geometry.elements import Pair
from contact_tracker.hypotheses.bank import Bank, blank
from contact_tracker.hypotheses.schedule import burn_in_ticks
from contact_tracker.map.element_prior import PairPrior, by_feet, known_entries, pair_priors

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class BirthProposals:
    """n hypotheses of one contact that may begin, still without an onset."""

    rows: Bank
    """(n) hypotheses without data."""
    is_given: Bools
    """(n, S) which entries of x their prior fixes, see ``known_entries``."""
    are_both_known: Bools
    """(n,) whether their prior has both elements, so that a pose shows whether these touch."""

    @property
    def count(self) -> int:
        return len(self.rows)

    @property
    def log_share(self) -> Array:
        """Log share (n,) of the contact's birth weight."""
        return self.rows.log_likelihood

    def sharing(self, log_share: Array) -> "BirthProposals":
        """A copy with other log shares (n,)."""
        return replace(self, rows=self.rows.replace_columns(log_prior=log_share, log_likelihood=log_share))

    def pick(self, rows: NDArray[np.generic]) -> "BirthProposals":
        return BirthProposals(
            self.rows.pick(np.arange(self.count)[rows]), self.is_given[rows], self.are_both_known[rows]
        )


def make_proposals(
    model: ContactModel,
    pairs: Sequence[Pair],
    near_m: Array | None,
    log_share: Sequence[float],
    known_pair_index: Sequence[int],
    elements_known: Sequence[bool],
) -> BirthProposals:
    """One proposal for each of the ``pairs`` of elements.

    Lines of the surroundings are parametrised by their points nearest to ``near_m`` (3,), so that the points
    are not correlated with the directions. Proposals whose directions the prior leaves open may search, and
    are protected from pruning during burn-in. The other parameters are columns of ``Bank``.
    """
    prior = pair_priors(model, pairs)
    if near_m is not None:
        prior = by_feet(model, prior, near_m)
    both = np.array(elements_known, bool)
    return with_prior(model, prior, np.array(log_share), np.array(known_pair_index), both, both)


def with_prior(
    model: ContactModel,
    prior: PairPrior,
    log_share: Array,
    known_pair_index: NDArray[np.int64],
    are_both_known: Bools,
    elements_known: Bools,
) -> BirthProposals:
    """One proposal for each of n priors on x.

    Elements that are known by others than this motion (``elements_known``) cannot follow it.
    """
    none, given = blank(model, 0), known_entries(model, prior.mean, prior.information)
    needs_search = np.asarray(
        ~given[:, directions(model.family.FORM)].all(axis=1)
    )  # the rest is a linear problem
    is_informed = prior.information.any(axis=(1, 2))
    rows = blank(model, len(given)).replace_columns(
        prior_index=np.where(is_informed, 1 + np.arange(len(given)), 0),
        known_pair_index=known_pair_index,
        elements_known=np.array(elements_known, np.int64),
        needs_search=needs_search,
        protected_until=np.where(needs_search, burn_in_ticks(model.needed), 0.0),
        prior_mean=prior.mean,
        prior_information=prior.information,
        line_anchor=prior.line_points_m,
        log_prior=log_share,
        log_likelihood=log_share,
        onset=0,
    )
    return BirthProposals(replace(rows, onsets=none.onsets), given, are_both_known)


@lru_cache(maxsize=16)
def uninformed_proposal(model: ContactModel) -> BirthProposals:
    """A proposal of elements that nothing is known of."""
    return make_proposals(model, [(None, None)], None, [0.0], [0], [False])
