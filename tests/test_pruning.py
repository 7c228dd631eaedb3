"""Dropping hopeless hypotheses changes next to nothing of what is said."""

import numpy as np
import pruning
import pytest

from contact_tracker.bank import blank, prune
from contact_tracker.contacts import CONTACT_MODELS
from contact_tracker.pace import DUE, patience
from contact_tracker.search import lost
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


@pytest.mark.parametrize("model", CONTACT_MODELS, ids=lambda model: model.contact.value)
def test_what_looks_hopeless_has_as_long_as_its_geometry_may_take(model):
    """Three rows a pose tell five unknowns sooner than one row eight."""
    told = np.array([0.9, 1.1]) * patience(model.family.PARAMETERS / model.family.ROWS)
    bank = blank(model, 2).having(told=told, searched=1.0, log_likelihood=-1000.0, rms=10.0, number=[0, 1])
    assert prune(bank, model, 50, 0.0, 40.0).number.tolist() == [0]
    impatient, near = bank.pick(np.array([1])), bank.having(log_likelihood=-1.0).pick(np.array([1]))
    assert not len(lost(impatient, model))
    assert len(lost(near, model)) == DUE[int(told[1])]
    due = int(np.flatnonzero(DUE[: int(told[0]) + 1])[-1])
    assert len(lost(bank.having(told=float(due)).pick(np.array([0])), model)) == 1
