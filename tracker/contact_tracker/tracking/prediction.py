"""What may come with a new tick: which hypotheses may begin, and how likely states change or last."""

from typing import NamedTuple

import numpy as np

from contact_tracker import hmm
from contact_tracker.contacts import CONTACT_MODELS, ContactModel
from contact_tracker.geometry.elements import Array
from contact_tracker.hypotheses.birth import Begins
from contact_tracker.hypotheses.birth_proposals import Frame, Reminded, beginnings
from contact_tracker.hypotheses.global_search import is_due
from contact_tracker.hypotheses.proximity_prior import foreseen, meeting
from contact_tracker.motion.lifted_pose import T
from contact_tracker.motion.window import Window
from contact_tracker.tracking.state import TrackerState, scales_of
from contact_tracker.tracking.transition_model import chances, exposure


class Outlook(NamedTuple):
    """``begins`` of each contact, and what of the memory it has been ``reminded`` of; ``exposure`` to change;
    ``change`` (7, 7) and ``stay`` (7,), the log chances of changing before the tick and of lasting in it;
    ``entry`` (7,), the log weights with which states begin."""

    begins: tuple[Begins, ...]
    reminded: tuple[Reminded, ...]
    exposure: float
    change: Array
    stay: Array
    entry: Array


def outlook(state: TrackerState, window: Window) -> Outlook:
    """The outlook at the newest tick of ``window``, which ``state`` has not taken in."""
    assert state.averaging is not None
    model = state.model
    first, frame = state.ticks == 0, Frame.around(state.averaging.origin_m, window.zeta[-1, T])
    reminded = tuple(
        _reminded(contact, earlier, state, frame)
        for contact, earlier in zip(CONTACT_MODELS, state.reminded, strict=True)
    )
    begins = tuple(now.begins for now in reminded)
    exposed = exposure(window.latest_activity) + state.withheld
    if not state.knowledge:
        change, stay = chances(model, exposed)
        entry = state.log_left if first else hmm.enter(state.log_left, change)
        return Outlook(begins, reminded, exposed, change, stay, entry)
    # what is known is met by moving, however smoothly
    exposed = max(exposed, window.unrest)
    scales, newest = scales_of(model), window.cut(-1, None)
    met = [
        meeting(contact, some, newest.with_error(model.noise.beyond_floor[column]), scales)
        for column, (contact, some) in enumerate(zip(CONTACT_MODELS, begins, strict=True))
    ]
    begins = tuple(m.of(b) for m, b in zip(met, begins, strict=True))
    change, stay = foreseen(*chances(model, exposed), met)
    if not first:
        return Outlook(begins, reminded, exposed, change, stay, hmm.enter(state.log_left, change))
    entry = state.log_left + np.array([*(m.log_odds for m in met), 0.0])
    return Outlook(begins, reminded, exposed, change, stay, entry - hmm.log_sum_exp(entry))


def _reminded(contact: ContactModel, earlier: Reminded, state: TrackerState, frame: Frame) -> Reminded:
    """Contacts take turns: what one tick has taught is not told to all of them in the next."""
    memory = state.memory if is_due(contact, state.ticks) else earlier.memory
    if memory is earlier.memory and frame == earlier.frame:
        return earlier
    begins = beginnings(contact, state.knowledge, memory, state.model.geometry.recognised, frame)
    return Reminded(memory, frame, begins)
