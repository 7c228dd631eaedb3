"""Hidden Markov inference with explicit onsets; it sees arrays only.

A *hypothesis* is a stretch of one state that begins at a known boundary between ticks (its onset) and may
end at any later boundary. ``log_likelihood[h]`` at boundary b is that of all data between its onset and b.
State i is left for j at boundary b with ``log_transition[b, i, j]``; staying costs nothing here, it belongs
to the likelihood (docs/theory.md, T20).
"""

from contact_tracker.hmm.past import Past
from contact_tracker.hmm.running import Forward, Living, Step
from contact_tracker.hmm.sums import by_state, enter, log_sum_exp
from contact_tracker.hmm.survivors import Stretch, Survivors
from contact_tracker.hmm.whole import Trellis, expect, smooth, viterbi

__all__ = [
    "Forward",
    "Living",
    "Past",
    "Step",
    "Stretch",
    "Survivors",
    "Trellis",
    "by_state",
    "enter",
    "expect",
    "log_sum_exp",
    "smooth",
    "viterbi",
]
