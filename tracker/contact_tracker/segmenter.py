"""The tracker, offline: the online pass once forward, then Viterbi and smoothing over what it met."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from contact_tracker import hmm, hypotheses, separability, ticks, tracker
from contact_tracker.assumptions import assumptions
from contact_tracker.bank import Bank
from contact_tracker.beginnings import beginnings, named
from contact_tracker.belief import Belief, Segment, Segmentation
from contact_tracker.contacts import CONTACT_MODELS, ContactModel
from contact_tracker.evidence import Window
from contact_tracker.geometry import ContactGeometry
from contact_tracker.knowledge import NOTHING, Knowledge
from contact_tracker.labels import STATES, Contact
from contact_tracker.lift import T
from contact_tracker.memory import Memory
from contact_tracker.model import Model
from contact_tracker.polish import polish
from contact_tracker.poses import Pose
from contact_tracker.readout import geometry_of
from contact_tracker.state import TrackerState, scales_of
from contact_tracker.ticks import Tick
from contact_tracker.tracker import FREE

Array = NDArray[np.float64]


@dataclass
class Pass:
    """What the forward pass leaves behind, tick by tick."""

    beliefs: list[Belief] = field(default_factory=list)
    start_ns: list[int] = field(default_factory=list)
    newest: list[Window] = field(default_factory=list)
    frames: list[int] = field(default_factory=list)
    change: list[Array] = field(default_factory=list)
    entry: list[Array] = field(default_factory=list)
    begun: list[tuple[NDArray[np.int64], NDArray[np.int64]]] = field(default_factory=list)
    alive: list[NDArray[np.int64]] = field(default_factory=list)
    log_likelihood: list[Array] = field(default_factory=list)

    def follow(self, state: TrackerState, closed: list[Tick]) -> TrackerState:
        for tick in closed:
            state, belief = tracker.observe(state, tick)
            self._note(state, tick, belief)
        return state

    @property
    def activity(self) -> Array:
        """How far the motion in each tick (T,) rose above the noise."""
        return np.array([newest.activity for newest in self.newest])

    def window(self, state: TrackerState) -> Window:
        """All ticks, with the variances that the final estimate of the noise gives them."""
        assert state.averaging is not None
        counts = np.array(self.frames, float)
        variance = np.array(ticks.tick_variances(state.averaging.noise, counts, state.model)).T
        uneven = ticks.tick_unevenness(state.averaging.noise, counts)
        return replace(Window.join(self.newest), variance=variance, uneven=uneven)

    @property
    def trellis(self) -> hmm.Trellis:
        """All hypotheses that were met."""
        count = 1 + int(self.alive[-1].max())
        states, onsets = np.full(count, FREE), np.zeros(count, np.int64)
        for tick, (number, state) in enumerate(self.begun):
            states[number], onsets[number] = state, tick
        return hmm.Trellis(states, onsets, self.alive, self.log_likelihood)

    def _note(self, state: TrackerState, tick: Tick, belief: Belief) -> None:
        free = np.array([state.numbers - 1])
        begun = [b.number[b.onset == state.ticks - 1] for b in state.banks] + [free]
        self.begun.append((np.concatenate(begun), np.repeat(np.arange(len(STATES)), [len(b) for b in begun])))
        self.beliefs.append(belief)
        self.start_ns.append(tick.start_ns)
        self.newest.append(state.window.cut(-1, None))
        self.frames.append(tick.count)
        self.change.append(state.change)
        self.entry.append(state.entry)
        self.alive.append(np.concatenate([*(b.number for b in state.banks), free]))
        self.log_likelihood.append(np.concatenate([*(b.log_likelihood for b in state.banks), np.zeros(1)]))


def segment(
    poses: Iterable[Pose],
    model: Model,
    progress: Callable[[int], None] | None = None,
    knowledge: Knowledge = NOTHING,
) -> Segmentation:
    """Segment a whole recording.

    Parameters
    ----------
    poses : validated poses in order of time.
    progress : called now and then with the number of poses read so far.
    knowledge : what is known of the object and its surroundings.

    Returns
    -------
    Segmentation with the Viterbi path, the smoothed posterior and, beside it, what ``step`` said online.
    """
    seen, state = forward(poses, model, progress, knowledge)
    return conclude(seen, state) if seen.beliefs else Segmentation((), (), ())


def forward(
    poses: Iterable[Pose],
    model: Model,
    progress: Callable[[int], None] | None = None,
    knowledge: Knowledge = NOTHING,
) -> tuple[Pass, TrackerState]:
    """The online pass over a whole recording."""
    seen, state = Pass(), tracker.start(model, knowledge=knowledge)
    for count, pose in enumerate(poses, start=1):
        state, closed = tracker.gather(state, pose)
        state = seen.follow(state, closed)
        if progress is not None and closed:
            progress(count)
    return seen, seen.follow(*tracker.gather_rest(state))


def conclude(seen: Pass, state: TrackerState) -> Segmentation:
    """Viterbi and smoothing over a forward pass of at least one tick."""
    trellis = seen.trellis
    initial, transition = seen.entry[0], np.array(seen.change)
    posterior, _ = hmm.smooth(trellis, initial, transition)
    posterior = separability.tempered(posterior, state.model.certainty.sureness)
    stretches = _merge_free(
        [(int(trellis.state[h]), a, b) for h, a, b in hmm.viterbi(trellis, initial, transition)]
    )
    window = seen.window(state)
    segments, beliefs = [], []
    for column, first, end in stretches:
        contact = STATES[column]
        stretch = window.cut(first, end)
        idle = separability.is_idle(contact, stretch, older=False)
        geometry, inseparable = _told(stretch, contact, idle, state)
        purpose = separability.restricted(idle, stretch, state.model.tick_s)
        for tick in range(first, end):
            posterior[tick] = separability.shared(posterior[tick], contact, inseparable, purpose)
        probability = float(posterior[first:end, column].mean())
        stop_ns = seen.start_ns[end] - 1 if end < len(window) else seen.beliefs[-1].stamp_ns
        start_ns = seen.start_ns[first]
        segments.append(Segment(start_ns, stop_ns, contact, probability, geometry, inseparable))
        for tick in range(first, end):
            online = seen.beliefs[tick]
            beliefs.append(
                Belief(
                    online.stamp_ns,
                    contact,
                    posterior[tick],
                    start_ns,
                    geometry,
                    online.residual,
                    inseparable,
                    purpose,
                )
            )
    return Segmentation(tuple(segments), tuple(beliefs), tuple(seen.beliefs), state.outliers)


def _merge_free(stretches: list[tuple[int, int, int]]) -> list[tuple[int, int, int]]:
    """Free motion is remembered tick by tick; a run of free ticks is one stretch."""
    starts = [
        i for i, s in enumerate(stretches) if i == 0 or not (s[0] == FREE and stretches[i - 1][0] == FREE)
    ]
    bounds = [*starts, len(stretches)]
    return [(stretches[i][0], stretches[i][1], stretches[j - 1][2]) for i, j in pairwise(bounds)]


def _told(
    stretch: Window, label: Contact, idle: bool, state: TrackerState
) -> tuple[ContactGeometry | None, tuple[Contact, ...]]:
    """What the ticks of a segment tell, with the final estimate of the noise: elements, and what else fits.

    All contacts are fitted to the same ticks from scratch.
    """
    assert state.averaging is not None
    scales, origin_m = scales_of(state.model), state.averaging.origin_m
    fits = [_fitted(contact, stretch, state) for contact in CONTACT_MODELS]
    rivals = separability.Rivals(
        np.array([*(f.log_likelihood.max(initial=-np.inf) for f in fits), 0.0]),
        np.array([*(f.rms.min(initial=np.inf) for f in fits), 1.0]),
    )
    others = separability.inseparable(label, rivals, idle)
    inseparable = tuple(other for other in others if state.knowledge.allows(other))
    if label is Contact.FREE:
        return None, inseparable
    contact = CONTACT_MODELS[label.column]
    fitted = polish(fits[label.column], contact, stretch, scales)
    pair = assumptions(state.knowledge, contact)[fitted.pair[0]]
    return named(geometry_of(fitted, 0, contact, scales, stretch, origin_m), pair), inseparable


def _fitted(contact: ContactModel, stretch: Window, state: TrackerState) -> Bank:
    """The best hypothesis of a contact about a whole stretch, if there can be one."""
    assert state.averaging is not None
    anchors, origin_m = contact.anchors(stretch.zeta[:, T].mean(axis=0)), state.averaging.origin_m
    begins = beginnings(state.knowledge, Memory(), 0.0, contact, anchors, origin_m)
    return hypotheses.fit_stretch(contact, stretch, scales_of(state.model), begins)
