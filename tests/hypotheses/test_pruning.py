"""Pruning of weak hypotheses hardly changes the beliefs."""

from dataclasses import replace
from typing import Final

import numpy as np

from contact_tracker.contacts import CONTACT_MODELS
from contact_tracker.hypotheses.bank import blank
from contact_tracker.hypotheses.global_search import prune
from contact_tracker.hypotheses.refit import are_near
from contact_tracker.hypotheses.schedule import NEAR_NATS, burn_in_ticks
from contact_tracker.states import Contact
from contact_tracker.tracking.belief import Detail
from pose_filter import forward
from short_recordings import FACE_TO_EDGE, MODEL, recorded

EDGE_FACE: Final = CONTACT_MODELS[Contact.EF.column]


def test_a_wider_margin_does_not_change_the_beliefs() -> None:
    wider = replace(MODEL, search=replace(MODEL.search, margin_nats=40.0))
    probability, hypotheses = [], []
    for model in (MODEL, wider):
        ticks = list(forward(recorded(FACE_TO_EDGE).poses[:800], model, detail=Detail.SHARED))
        probability.append(np.array([tick.belief.probability for tick in ticks]))
        hypotheses.append(sum(len(bank) for tick in ticks for bank in tick.state.banks))
    assert hypotheses[1] > hypotheses[0]
    own, other = probability
    assert np.quantile(np.abs(own - other).max(axis=1), 0.9) < 1e-3
    assert (own.argmax(axis=1) == other.argmax(axis=1)).mean() > 0.99


def test_margins_are_relative_to_the_best_and_known_elements_have_no_burn_in():
    bank = blank(EDGE_FACE, 3).replace_columns(log_birth_weight=1.0)
    behind = np.array([-NEAR_NATS, -1.01 * NEAR_NATS, np.nan])
    assert are_near(bank.replace_columns(log_likelihood=behind - 1.0)).tolist() == [True, False, False]
    bank = bank.replace_columns(needs_search=[0, 1, 1], log_likelihood=-1e3, number=[0, 1, 2])
    ages = burn_in_ticks(EDGE_FACE.needed) * np.array([1.0, 1.0, 1.1])
    assert prune(
        bank.replace_onset_columns(effective_ticks=ages), EDGE_FACE, 3, 0.0, 20.0
    ).number.tolist() == [1]
