"""How far hypotheses go in a tick, towards their minimum and in search of it, and how long they are kept."""

from typing import Final

import numpy as np

REFINE_STEPS: Final = 1
FIRST_TICKS: Final = 6.0
FIRST_STEPS: Final = 3
"""In its first ticks with motion the geometry moves far, and takes so many steps."""
AT_REST: Final = 1e-7
"""Weight of a tick without motion: it fixes where the object rests, and tells next to nothing."""
WAIT_NATS: Final = 10.0
"""What is further behind the best learns only when searches are due: until then it grows."""
FAR_NATS: Final = 14.0
"""What is further behind the best neither searches nor offers its geometry once patience is over, and without
grace it takes none from others. It is no evidence for its contact, either."""
FALL_NATS: Final = 3.0
FALLEN_STEPS: Final = 12
"""What learns in every tick, falls by more than so many nats in one and does not fit its window takes so many
steps more: what had been open until then may lie far off."""
GRACE_NATS: Final = 20.0
GRACE_TICKS: Final = 6.0
"""What was no further behind and falls by that much, if need be in spite of those steps, is kept for so many
ticks with motion, however bad, and may take the geometry of others: they may find its own. Old onsets get
sparser all the same."""
AGES: Final = np.array([3.0, 4, 5, 6, 8, 10, 13, 16, 20, 25, 30, 36, 44, 54, 66, 80, 100])
"""After so many ticks with motion a hypothesis searches: what fitted the first of them need not fit more."""
EVERY: Final = 3
"""Searches wait for each other, so that one batch of this many ticks does for all."""
DUE: Final = np.any([np.isin(np.arange(int(AGES[-1]) + EVERY + 1) - i, AGES) for i in range(EVERY)], axis=0)
"""Whether an age has been passed since the last batch."""
LIFT: Final = 1e-12
"""Of the moments' trace, added to their diagonal in relaxed problems."""
SCREENED: Final = 7
"""So many of all starts are followed at all, those that cost least before a step is taken."""
ROUNDS: Final = ((2, 3), (3, 2))
"""So many steps, and on from so many of the best."""
WEIGHED: Final = 1
"""So often what a search has found is weighed: the weights of the rows follow the geometry."""
AT_THE_NOISE: Final = 1.2
"""A whitened residual up to which a hypothesis fits: it neither searches for a better minimum nor takes one
from others, though that may be worth some nats."""
LEAST_GAIN: Final = 1e-3
"""Nats by which another geometry must be better to be taken."""
MET_PATIENCE: Final = 0.5
"""For so much of the patience what assumes elements that were met before searches and offers: part of its
geometry is known, and there are many."""
YOUNG: Final = 24
"""Up to this age in ticks every onset has its own hypothesis; older ones get sparser."""

RESIDUAL_TICKS: Final = 25.0
"""How much motion a belief's residuals are about: so little that hypotheses of it are still kept."""


def burn_in_ticks(needed: float) -> float:
    """Up to so many ticks with motion a hypothesis is kept, searches, offers and takes geometry however bad,
    whose geometry ``needed`` poses tell: it may not be found yet.

    That is short for f-f, of which most never search unless they are near the best.
    """
    return 2.0 * needed
