"""The pace of a recording, and free motion in a pass with a map that touches of the first pass leave open."""

from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace
from typing import Any, Final

import numpy as np
import pytest

from contact_tracker.config.loading import load_model
from contact_tracker.states import CONTACTS, Contact
from contact_tracker.tracking.belief import Segment
from contact_tracker.tracking.map_passes import _with_touches
from contact_tracker.tracking.offline_smoother import PassRecord
from contact_tracker.tracking.segmentation import BELIEF, Beliefs, Segmentation
from contact_tracker.tracking.transition_model import PACE_SHAPE, leave_per_s

MODEL: Final = load_model()
RATE_PER_S: Final = leave_per_s(MODEL.transitions)


def as_any(**fields: object) -> Any:
    return SimpleNamespace(**fields)


def walked(pace: float, ticks: int, seed: int = 0) -> PassRecord:
    """The record of a walk over the states whose rates are ``pace`` times those of the model."""
    rng, record = np.random.default_rng(seed), PassRecord()
    column, state = 0, np.empty(ticks, int)
    for tick in range(ticks):
        if rng.random() < -np.expm1(-pace * RATE_PER_S[column] * MODEL.tick_s):
            column = (column + int(rng.integers(1, 7))) % 7
        state[tick] = column
        record.note(as_any(hazard_exposure=1.0), as_any())
    for first, end in pairwise([0, ticks // 3, ticks]):  # segments, wherever they end
        ticks = as_any(model=MODEL, window=as_any(index=np.arange(first, end)))
        record._count_changes(as_any(ticks=ticks, posterior=np.eye(7)[state[first:end]]))
    return record


@pytest.mark.parametrize("pace", [0.3, 1.0, 4.0])
def test_the_pace_of_a_recording_is_found(pace: float) -> None:
    assert walked(pace, 6000).pace == pytest.approx(pace, rel=0.25)


def test_little_motion_does_not_show_the_pace() -> None:
    assert PassRecord().pace == 1.0
    assert PACE_SHAPE / (PACE_SHAPE + 1.0) < walked(0.0, 20).pace < 1.0


def passed(p_free: list[float], p_vertex: list[float]) -> Segmentation:
    """A pass of one free segment with these probabilities in its ticks; the rest is that of f-f."""
    rows = np.zeros(len(p_free), BELIEF)
    rows["stamp_ns"] = 100 * np.arange(1, len(p_free) + 1)
    rows["contact"] = Contact.FREE.column
    rows["geometry"] = rows["further"] = rows["joint"] = -1
    rows["probability"][:, Contact.FREE.column] = p_free
    rows["probability"][:, Contact.VF.column] = p_vertex
    rows["probability"][:, 0] = 1.0 - rows["probability"].sum(axis=1)
    whole = Segment(0, int(rows["stamp_ns"][-1]), Contact.FREE, float(np.mean(p_free)), None)
    return Segmentation((whole,), Beliefs(rows))


@pytest.mark.parametrize("pace", [0.3, 3.0])
def test_free_motion_is_open_where_a_touch_is_not_excluded(pace: float) -> None:
    """A map makes contacts of new elements rare; what the motion leaves open stays so, there only. At a quick
    pace touches are more probable."""
    first = passed([0.995] * 5 + [0.7] * 6 + [0.95] * 5, [0.002] * 5 + [0.25] * 6 + [0.03] * 5)
    found = passed([0.99] * 16, [0.005] * 16)
    opened = _with_touches(found, first, pace, 1.0)
    p = opened.beliefs.probability[:, Contact.FREE.column]
    is_open = np.arange(16) >= 5 if pace > 1.0 else np.zeros(16, bool)
    np.testing.assert_array_equal(p[~is_open], 0.99)
    assert ((p[is_open] > 0.89) & (p[is_open] <= 0.9)).all()
    (segment,) = opened.segments
    assert segment.inseparable == ((Contact.VF,) if is_open.mean() > 0.5 else ())
    assert segment.probability == pytest.approx(p.mean())
    rivals = [(Contact.VF,) if one else () for one in is_open]
    assert [belief.inseparable for belief in opened.beliefs] == rivals
    contact = replace(found, segments=(replace(found.segments[0], contact=Contact.EF),))
    assert _with_touches(contact, first, pace, 1.0).segments == contact.segments


def test_a_rest_in_free_motion_stays_open_to_all() -> None:
    found = passed([0.99] * 8, [0.005] * 8)
    resting = replace(found, segments=(replace(found.segments[0], inseparable=CONTACTS),))
    opened = _with_touches(resting, found, 9.0, 1.0)
    assert [segment.inseparable for segment in opened.segments] == [CONTACTS]
    np.testing.assert_allclose(opened.beliefs.probability[:, -1], 0.6)
