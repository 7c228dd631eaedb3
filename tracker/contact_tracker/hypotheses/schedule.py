"""The schedule of the hypotheses: steps per tick, when they search, and how long they are kept."""

from typing import Final

import numpy as np

FIRST_TICKS: Final = 6.0
FIRST_STEPS: Final = 3
"""Gauss-Newton steps in each of the ``FIRST_TICKS`` with motion, in which the estimate changes most, and one
later. With one step a change of contact within 0.15 s is not seen."""
REST_WEIGHT: Final = 1e-7
"""Weight of a tick without motion. It keeps the position determined and carries almost no information."""
NEAR_NATS: Final = 14.0
"""A hypothesis further behind the best only accumulates moments, is refitted when a search is due, does not
search after burn-in, and is no evidence for its contact."""
RECOVERY_STEPS: Final = 12
"""Further steps of a hypothesis that falls behind in a tick; without, `live` is right for 0.009 less of the
time on the six recordings of the set `hard`."""
SEARCH_AGES: Final = np.array([3.0, 4, 5, 6, 8, 10, 13, 16, 20, 25, 30, 36, 44, 54, 66, 80, 100])
"""Ages in ticks with motion at which a hypothesis searches: a minimum of a short window need not remain
one."""
SEARCH_INTERVAL: Final = 3
"""Ticks between searches of a contact, so that hypotheses that are due are searched in one batch."""
IS_SEARCH_AGE: Final = np.any(
    [
        np.isin(np.arange(int(SEARCH_AGES[-1]) + SEARCH_INTERVAL + 1) - i, SEARCH_AGES)
        for i in range(SEARCH_INTERVAL)
    ],
    axis=0,
)
"""By age in ticks, whether one of ``SEARCH_AGES`` was reached since the last batch."""
FOLLOWED_STARTS: Final = 7
"""How many starts of a search are followed: those with the lowest cost before the first step."""
ROUNDS: Final = ((2, 3), (3, 2))
"""Rounds of a search: (steps, number of the best starts that go on)."""
UNTHINNED_TICKS: Final = 24
"""Up to this age in ticks every onset keeps a hypothesis; older onsets are thinned. A belief's residuals are
taken over as many ticks with motion."""


def burn_in_ticks(needed: float) -> float:
    """Burn-in in ticks with motion, for a contact whose geometry ``needed`` poses determine.

    In it a hypothesis is not pruned, and searches, whatever its weight: its minimum may not be found yet. It
    is short for f-f, most of whose hypotheses never search unless they are near the best.
    """
    return 2.0 * needed
