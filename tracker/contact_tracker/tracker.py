"""The tracker, online: ``step(state, pose) -> (state, belief)``. It reads like the figure in docs/theory.md.

pose -> tick -> window -> hypotheses (fit, evidence) -> weights of the states -> belief
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from contact_tracker import fixed_lag, hmm, hypotheses, ticks
from contact_tracker.answers import answer, believe, remaining, touching, weighed_up
from contact_tracker.bank import Births
from contact_tracker.belief import Belief, Detail
from contact_tracker.contacts import CONTACT_MODELS
from contact_tracker.free_motion import NO_EXCESS
from contact_tracker.labels import STATES, Contact
from contact_tracker.lift import R, T
from contact_tracker.memory import SURE
from contact_tracker.outlook import outlook
from contact_tracker.poses import Pose, Poses
from contact_tracker.sliding import Sliding, slid
from contact_tracker.state import TrackerState, scales_of, start
from contact_tracker.table import Bank
from contact_tracker.ticks import Tick
from contact_tracker.transitions import chances, exposure

__all__ = [
    "TrackerState",
    "answer",
    "finish",
    "gather",
    "gather_rest",
    "gather_some",
    "observe",
    "remaining",
    "scales_of",
    "start",
    "step",
]

Array = NDArray[np.float64]

FREE: Final = Contact.FREE.column


def step(state: TrackerState, pose: Pose) -> tuple[TrackerState, Belief | None]:
    """Take in one pose; a belief comes out when the pose closes a tick, from data up to that tick only.

    After a gap in the stream one pose closes several ticks, of which the last is told; who wants them all
    calls what this is made of: ``gather``, ``observe`` and ``answer``.
    """
    state, closed = gather(state, pose)
    belief = None
    for tick in closed:
        state, online = observe(state, tick)
        belief = answer(state, online)
    return state, belief


def finish(state: TrackerState) -> tuple[TrackerState, list[Belief]]:
    """The stream has ended: beliefs of the last, partial tick and of what the lag still holds back.

    Should it go on after all, it has paused: ``step`` takes the next pose as it does after a gap, and says
    nothing twice.
    """
    state, closed = gather_rest(state)
    beliefs = []
    for tick in closed:
        state, online = observe(state, tick)
        beliefs.append(answer(state, online))
    rest = remaining(state)
    return state._replace(recent=()), [*(b for b in beliefs if b is not None), *rest]


def gather(state: TrackerState, pose: Pose) -> tuple[TrackerState, list[Tick]]:
    """Average poses into ticks; returns the ticks that this pose closes (several after a gap).

    The pose is kept as it is until its tick is over.
    """
    averaging = state.averaging
    if averaging is None or not ticks.goes_on(averaging, pose, state.model):
        state, closed, left = gather_some(state, Poses.collect((pose,)))
        return (gather_some(state, left)[0] if len(left) else state), closed
    return state._replace(averaging=averaging._replace(frames=(*averaging.frames, pose))), []


def gather_some(state: TrackerState, poses: Poses) -> tuple[TrackerState, list[Tick], Poses]:
    """The same of many poses at once, as far as a tick goes; returns the rest of them, too."""
    averaging = ticks.begin(state.model, poses) if state.averaging is None else state.averaging
    averaging, closed, left = ticks.advance(averaging, poses, state.model)
    return state._replace(averaging=averaging), closed, left


def gather_rest(state: TrackerState) -> tuple[TrackerState, list[Tick]]:
    """Close the tick under way."""
    if state.averaging is None or not state.averaging.frames:
        return state, []
    averaging, tick = ticks.close(state.averaging, state.model)
    return state._replace(averaging=averaging), [tick]


def observe(state: TrackerState, tick: Tick, detail: Detail = Detail.GEOMETRY) -> tuple[TrackerState, Belief]:
    """Take in one tick, and tell of it in ``detail``."""
    if _is_mute(state, tick):
        assert state.belief is not None
        return _remember(_wait(state, tick), replace(state.belief, stamp_ns=tick.stamp_ns))
    state = _weigh(state, tick)
    belief = believe(state, tick.stamp_ns)
    shared, learns = belief, _learns(state, belief)
    if learns or detail >= Detail.SHARED:  # which leaves the label no more than it has
        shared = weighed_up(state, belief)
        learns = learns and _learns(state, shared)
    if detail >= Detail.SHARED:
        belief = shared
    where = touching(state, belief.contact) if learns or detail >= Detail.GEOMETRY else None
    if learns and where is not None:
        assert state.averaging is not None
        position_m = state.window.zeta[-1, T] + state.averaging.origin_m
        state = state._replace(memory=state.memory.learn(where, belief.onset_ns, tick.stamp_ns, position_m))
    if where is not None and detail >= Detail.GEOMETRY:
        belief = replace(belief, geometry=where)
    return _remember(state, belief)


def _remember(state: TrackerState, belief: Belief) -> tuple[TrackerState, Belief]:
    length = state.past.shape[1]
    recent = (*state.recent, belief)[-length:] if length else ()
    return state._replace(recent=recent, belief=belief), belief


def _learns(state: TrackerState, belief: Belief) -> bool:
    """Elements that are certain enough are remembered, and looked at again now and then."""
    if belief.contact is Contact.FREE or belief.probability.max() < SURE:
        return False
    return state.memory.is_due(belief.onset_ns, belief.stamp_ns)


def _is_mute(state: TrackerState, tick: Tick) -> bool:
    """Whether neither this tick nor the one before says anything: at rest, while nothing is known yet of how
    the object moves, in a gap. What could begin with it could as well begin with the first that does. (Of
    known elements every tick says whether they touch.)"""
    before = state.window.excess[-1:]
    return not state.knowledge and bool(len(before)) and not before.any() and tick.excess == NO_EXCESS


def _wait(state: TrackerState, tick: Tick) -> TrackerState:
    """The window moves on, and nothing else; what may have changed meanwhile is made up for later."""
    sliding = _slid(state, tick)
    oldest, scales = state.window.lost_by(sliding.window), scales_of(state.model)
    errors = state.model.noise.beyond_floor
    settled = [
        hypotheses.settle(bank, contact, oldest.with_error(beyond), scales)
        for bank, contact, beyond in zip(state.banks, CONTACT_MODELS, errors, strict=True)
    ]
    change = chances(state.model, 0.0).change
    return state._replace(
        sliding=sliding,
        banks=tuple(_older(b, column) for column, b in enumerate(settled)),
        alive=hypotheses.Alive.of(settled, state.ticks),
        ticks=state.ticks + 1,
        numbers=state.numbers + 1,
        outliers=state.outliers + tick.outliers,
        exposure=0.0,
        change=change,
        entry=hmm.enter(state.log_left, change),
        withheld=state.withheld + exposure(0.0),
        past=np.array([fixed_lag.grown(past, i) for i, past in enumerate(state.past)]),
    )


def _weigh(state: TrackerState, tick: Tick) -> TrackerState:
    """The window moves on, hypotheses begin, grow and are weighed."""
    model, scales = state.model, scales_of(state.model)
    sliding = _slid(state, tick)
    window = sliding.window
    begins, reminded, exposed, change, stay, entry = outlook(state, window)
    past = fixed_lag.inherited(state.past, state.log_left, change)
    turn = tick.zeta[R].reshape(3, 3)
    births = Births(begins, state.ticks, tick.start_ns, state.numbers, entry, past, turn)
    seen, margin = (window, state.window, model.noise.beyond_floor), model.search.margin_nats
    living = hypotheses.advance(state.banks, births, *seen, scales, stay, margin)
    kept = tuple(_older(b, column) for column, b in enumerate(living.banks))
    label = STATES[int(np.argmax(living.log_left))]
    return state._replace(
        sliding=sliding,
        banks=kept,
        reminded=reminded,
        log_left=living.log_left,
        residual=living.residual,
        leaders=living.leaders,
        alive=living.alive,
        ticks=state.ticks + 1,
        numbers=state.numbers + births.many + 1,
        outliers=state.outliers + tick.outliers,
        label=label,
        free_since=state.free_since if state.label is Contact.FREE else state.ticks,
        free_since_ns=state.free_since_ns if state.label is Contact.FREE else tick.start_ns,
        exposure=exposed,
        change=change,
        entry=entry,
        withheld=0.0,
        past=_pasts(kept, past[FREE]),
    )


def _older(living: Bank, column: int) -> Bank:
    """With pasts that are one tick longer."""
    return replace(living, past=fixed_lag.grown(living.past, column)) if living.past.shape[1] else living


def _pasts(banks: Sequence[Bank], free: Array) -> Array:
    """Past (7, L, 7) of each state: that of its hypotheses, and what ``free`` motion (L, 7) has inherited."""
    if not free.size:  # answers do not lag
        return np.zeros((len(STATES), *free.shape))
    return np.array([*(fixed_lag.mixed(b.past, b.joint) for b in banks), fixed_lag.grown(free, FREE)])


def _slid(state: TrackerState, tick: Tick) -> Sliding:
    """The window with the tick."""
    assert state.averaging is not None
    return slid(state.sliding, state.ticks, tick, state.averaging.noise, state.model)
