"""How the tracker takes in a tick: the window moves on; hypotheses begin, grow and are weighed, or wait."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker import hmm
from contact_tracker.contacts import CONTACT_MODELS
from contact_tracker.hmm import fixed_lag
from contact_tracker.hypotheses import bank_update
from contact_tracker.hypotheses.bank import Bank
from contact_tracker.hypotheses.bank_update import Moment, Weighed
from contact_tracker.hypotheses.pruning import Births
from contact_tracker.motion.free_motion import NO_EXCESS
from contact_tracker.motion.lifted_pose import R
from contact_tracker.motion.sliding import Sliding, slid
from contact_tracker.motion.tick_averaging import Tick
from contact_tracker.states import STATES, Contact
from contact_tracker.tracking.prediction import Outlook, outlook
from contact_tracker.tracking.state import TrackerState, scales_of
from contact_tracker.tracking.transition_model import chances, exposure

Array = NDArray[np.float64]

FREE: Final = Contact.FREE.column


class Coming(NamedTuple):
    """A tick that is about to be weighed: the window with it, its outlook, and what hypotheses meet."""

    sliding: Sliding
    outlook: Outlook
    moment: Moment


def is_mute(state: TrackerState, tick: Tick) -> bool:
    """Whether neither this tick nor the one before says anything: at rest, while nothing is known yet of how
    the object moves, in a gap. What could begin with it could as well begin with the first that does. (Of
    known elements every tick says whether they touch.)"""
    before = state.window.excess[-1:]
    return not state.knowledge and bool(len(before)) and not before.any() and tick.excess == NO_EXCESS


def wait(state: TrackerState, tick: Tick, sliding: Sliding) -> TrackerState:
    """The window moves on, and nothing else; what may have changed meanwhile is made up for later."""
    oldest, scales = state.window.lost_by(sliding.window), scales_of(state.model)
    errors = state.model.noise.beyond_floor
    settled = [
        bank_update.settle(bank, contact, oldest.with_error(beyond), scales)
        for bank, contact, beyond in zip(state.banks, CONTACT_MODELS, errors, strict=True)
    ]
    change = chances(state.model, 0.0).change
    return state._replace(
        sliding=sliding,
        banks=tuple(_older(b, column) for column, b in enumerate(settled)),
        alive=bank_update.Alive.of(settled, state.ticks),
        ticks=state.ticks + 1,
        numbers=state.numbers + 1,
        outliers=state.outliers + tick.outliers,
        exposure=0.0,
        change=change,
        entry=hmm.enter(state.log_left, change),
        withheld=state.withheld + exposure(0.0),
        past=np.array([fixed_lag.grown(past, i) for i, past in enumerate(state.past)]),
    )


def weigh(state: TrackerState, tick: Tick, sliding: Sliding) -> TrackerState:
    """The window moves on, hypotheses begin, grow and are weighed."""
    model, ahead = state.model, coming(state, tick, sliding)
    beyond, margin = model.noise.beyond_floor, model.search.margin_nats
    living = bank_update.update(state.banks, [ahead.moment], beyond, scales_of(model), margin)
    return after(state, tick, ahead, living.banks, living.weighed[0])


def coming(state: TrackerState, tick: Tick, sliding: Sliding) -> Coming:
    """The tick on to which the window is ``sliding``."""
    window = sliding.window
    ahead = outlook(state, window)
    past = fixed_lag.inherited(state.past, state.log_left, ahead.change)
    turn = tick.zeta[R].reshape(3, 3)
    births = Births(ahead.begins, state.ticks, tick.start_ns, state.numbers, ahead.entry, past, turn)
    moment = Moment(births, tick.stamp_ns, window, state.window, ahead.change, ahead.stay)
    return Coming(sliding, ahead, moment)


def after(
    state: TrackerState, tick: Tick, ahead: Coming, banks: Sequence[Bank], weighed: Weighed
) -> TrackerState:
    """The state that a tick has led to."""
    births = ahead.moment.births
    kept = tuple(_older(bank, column) for column, bank in enumerate(banks))
    was_free = state.label is Contact.FREE
    return passed(state, ahead)._replace(
        banks=kept,
        log_left=weighed.log_left,
        residual=weighed.residual,
        leaders=weighed.leaders,
        alive=weighed.alive,
        outliers=state.outliers + tick.outliers,
        label=STATES[int(np.argmax(weighed.log_left))],
        free_since=state.free_since if was_free else state.ticks,
        free_since_ns=state.free_since_ns if was_free else tick.start_ns,
        exposure=ahead.outlook.exposure,
        change=ahead.outlook.change,
        entry=weighed.entry,
        log_normaliser=state.log_normaliser + float(weighed.entry[FREE] - weighed.log_left[FREE]),
        past=_pasts(kept, births.past[FREE]),
    )


def passed(state: TrackerState, ahead: Coming) -> TrackerState:
    """The state once a tick is over, but for what hypotheses make of it: that is all that one needs for the
    outlook of the next."""
    return state._replace(
        sliding=ahead.sliding,
        reminded=ahead.outlook.reminded,
        ticks=state.ticks + 1,
        numbers=state.numbers + ahead.moment.births.many + 1,
        withheld=0.0,
    )


def slid_on(state: TrackerState, tick: Tick) -> Sliding:
    """The window with the tick."""
    return slid(state.sliding, state.ticks, tick, state.model)


def _older(living: Bank, column: int) -> Bank:
    """With pasts that are one tick longer."""
    return replace(living, past=fixed_lag.grown(living.past, column)) if living.past.shape[1] else living


def _pasts(banks: Sequence[Bank], free: Array) -> Array:
    """Past (7, L, 7) of each state: that of its hypotheses, and what ``free`` motion (L, 7) has inherited."""
    if not free.size:  # answers do not lag
        return np.zeros((len(STATES), *free.shape))
    return np.array([*(fixed_lag.mixed(b.past, b.joint) for b in banks), fixed_lag.grown(free, FREE)])
