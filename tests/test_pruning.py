"""Dropping hopeless hypotheses changes next to nothing of what is said."""

import numpy as np
import pruning

from short import FACE_TO_EDGE, MODEL, recorded


def test_with_twice_the_margin_the_same_is_said() -> None:
    poses = recorded(FACE_TO_EDGE).poses[:800]
    own, other = pruning.follow(poses, MODEL), pruning.follow(poses, pruning.with_margin(MODEL, 80.0))
    assert other.hypotheses > own.hypotheses
    apart = np.abs(own.probability - other.probability).max(axis=1)
    assert np.median(apart) < 1e-3
    assert (own.probability.argmax(axis=1) == other.probability.argmax(axis=1)).mean() > 0.95
    told = pruning.row("short", np.inf, own, other)
    assert len(told) == len(pruning.COLUMNS)
    assert told[:2] == ["short", "none"]
    assert pruning.row("short", 80.0, own, own)[2:8] == ["1.000", *["0.0000"] * 4, "1.00"]
