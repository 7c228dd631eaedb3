"""Hidden Markov inference with explicit onsets, on arrays only.

A *hypothesis* is a stretch of one state that begins at a known boundary between ticks (its onset) and may end
at any later boundary. ``log_likelihood[h]`` at boundary b is the log-likelihood of all data between its onset
and b. ``log_transition[b, i, j]`` is the log probability of a change from state i to j at boundary b; the
likelihood includes the probability of no change (docs/theory.md, T20).
"""

from contact_tracker.hmm.forward_filter import (
    FilterFrontier,
    ForwardFilter,
    ForwardMessage,
    birth_log_weights,
    grown_past,
    inherited_past,
    log_sum_exp,
    mixed_past,
)
from contact_tracker.hmm.smoother import OpenTicks
from contact_tracker.hmm.viterbi_survivors import PathSegment, Survivors

__all__ = [
    "FilterFrontier",
    "ForwardFilter",
    "ForwardMessage",
    "OpenTicks",
    "PathSegment",
    "Survivors",
    "birth_log_weights",
    "grown_past",
    "inherited_past",
    "log_sum_exp",
    "mixed_past",
]
