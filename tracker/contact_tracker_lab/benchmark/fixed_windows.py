"""Alternatives on the paper's fixed windows of 500 frames: the smallest normalised objective, and an HMM.

Windows advance by 0.1 s, as the tracker's ticks; 500 frames are 2.5 s at 200 Hz, 0.5 s at 1 kHz and 17 s at
30 Hz. Before the end of the first window an online method has no label.

The smallest objective: each of the six curves divided by its maximum, as in the paper's Fig. 5; the label is
the contact with the lowest curve, never free. The maximum is over the whole recording, also online.

The HMM: ``contact_tracker.hmm`` over fixed windows instead of hypotheses with windows of their own. It is
calibrated on the tuning split of the set: emissions are normal densities of the log of the six minima, with
mean and covariance by true state; states that do not occur there are impossible; the rate of leaving is that
of the split, the distribution of the next state that of the lattice. Windows overlap, so emissions have an
exponent: for labels the one with the highest accuracy, for probabilities the one with the least log-loss.
Offline a window labels its middle, online its last frame.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from scipy.special import softmax

import contact_tracker.hmm as hmm
from contact_tracker.arrays import Array, Ints
from contact_tracker.config.parameters import Model
from contact_tracker.motion.poses import Poses
from contact_tracker.paper.window_curves import curves
from contact_tracker.states import STATES
from contact_tracker.tracking.transition_model import destinations
from contact_tracker_lab.benchmark.scores import OFFLINE, Answer, Method, Score, Scores
from contact_tracker_lab.evaluation.scoring import Scoring, Subset, tick_in_force

FRAMES: Final = 500
STEP_S: Final = 0.1
SMALLEST: Final = "smallest objective"
HMM: Final = "HMM on windows"
EXPONENTS: Final = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0)
SHRINKAGE: Final = 0.5
"""Share of the pooled covariance in each state's, since some states have few windows."""
LEAST_SD: Final = 0.05


@dataclass(frozen=True, eq=False)
class Windows:
    """The W windows of a recording, and its scoring: ``end_ns`` (W,) last stamp, ``normalised`` and
    ``log_minimum`` (W, 6) of the objectives, ``half_ns`` and ``step_s``."""

    scored: Scoring
    end_ns: Ints
    normalised: Array
    log_minimum: Array
    half_ns: int
    step_s: float

    @classmethod
    def of(cls, poses: Poses, scored: Scoring) -> "Windows":
        frame_s = float(np.median(np.diff(poses.stamp_ns))) * 1e-9 if len(poses) > 1 else STEP_S
        step = max(1, round(STEP_S / frame_s))
        minima = curves(poses, FRAMES, step)
        log_minimum = 0.5 * np.log(np.maximum(minima.minimum / FRAMES, np.finfo(float).tiny))
        half_ns = round(FRAMES * frame_s * 0.5e9)
        return cls(scored, minima.stamp_ns, minima.normalised, log_minimum, half_ns, step * frame_s)

    def labelled_ns(self, wait_s: float) -> Ints:
        """Stamps (W,) of the frames that windows label, offline or without a lag."""
        return self.end_ns - (self.half_ns if wait_s == OFFLINE else 0)

    def ticks(self, wait_s: float) -> Ints:
        """Window (N,) that labels each frame; -1 for none."""
        stamp_ns, labelled_ns = self.scored.stamp_ns, self.labelled_ns(wait_s)
        if wait_s == OFFLINE and len(labelled_ns):
            return np.searchsorted((labelled_ns[1:] + labelled_ns[:-1]) // 2, stamp_ns).astype(np.int64)
        return tick_in_force(stamp_ns, labelled_ns)

    def truth(self, wait_s: float) -> Ints:
        """True state (W,) of the frame that each window labels, -1 where it is not identifiable."""
        stamp_ns = self.scored.stamp_ns
        frame = np.searchsorted(stamp_ns, self.labelled_ns(wait_s)).clip(0, len(stamp_ns) - 1)
        is_identifiable = self.scored.subsets[Subset.IDENTIFIABLE][frame]
        return np.where(is_identifiable, self.scored.truth[frame], -1)


def smallest_answers(windows: Windows) -> dict[Method, Answer]:
    """Labels by the smallest normalised objective of the window around a frame, or online before it."""
    label = windows.normalised.argmin(axis=1).astype(np.int64)
    return {
        Method(SMALLEST, wait_s, False): Answer.certain(windows.ticks(wait_s), label)
        for wait_s in (OFFLINE, 0.0)
    }


class Emission(NamedTuple):
    """Normal densities of the S states in a set: ``mean`` (S, 6), ``covariance`` (S, 6, 6)."""

    states: Ints
    mean: Array
    covariance: Array

    @classmethod
    def fit(cls, values: Array, state: Ints) -> "Emission":
        """Densities fitted to values (W, 6) and their true states (W,)."""
        states = np.unique(state)
        mean = np.array([values[state == s].mean(axis=0) for s in states])
        centred = values - mean[np.searchsorted(states, state)]
        pooled = centred.T @ centred / len(centred) + LEAST_SD**2 * np.eye(values.shape[1])
        groups = [centred[state == s] for s in states]
        by_state = np.array([group.T @ group / len(group) for group in groups])
        return cls(states.astype(np.int64), mean, (1 - SHRINKAGE) * by_state + SHRINKAGE * pooled)

    def log_density(self, values: Array) -> Array:
        """(W, S), up to a constant."""
        deviation = values[:, None] - self.mean
        square = np.einsum("wsi,sij,wsj->ws", deviation, np.linalg.inv(self.covariance), deviation)
        return np.asarray(-0.5 * (square + np.linalg.slogdet(self.covariance)[1]))


def hmm_scores(recordings: Sequence[Windows], tuning: Sequence[Windows], model: Model) -> list[Scores]:
    """Scores of the HMM on fixed windows, calibrated on the ``tuning`` recordings, for each recording."""
    by_wait = {wait_s: _scores(recordings, tuning, model, wait_s) for wait_s in (OFFLINE, 0.0)}
    return [
        {Method(HMM, wait_s): scores[i] for wait_s, scores in by_wait.items()} for i in range(len(recordings))
    ]


def _scores(
    recordings: Sequence[Windows], tuning: Sequence[Windows], model: Model, wait_s: float
) -> list[Score]:
    """Scores with the labels of the exponent with the highest accuracy on the tuning split, and the
    probabilities of the one with the least log-loss."""
    values = np.concatenate([np.zeros((0, 6)), *(r.log_minimum for r in tuning)])
    truth = np.concatenate([np.zeros(0, np.int64), *(r.truth(wait_s) for r in tuning)])
    if not (truth >= 0).any():
        frames = [np.full(len(r.scored.stamp_ns), -1) for r in recordings]
        answers = [Answer.certain(no_tick, truth[:0]) for no_tick in frames]
        return [Score.of(answer, r.scored) for answer, r in zip(answers, recordings, strict=True)]
    emission = Emission.fit(values[truth >= 0], truth[truth >= 0])

    def answer(recorded: Windows, exponent: float) -> Answer:
        chain = _chain(tuning, model, emission.states, recorded.step_s)
        log_density = exponent * emission.log_density(recorded.log_minimum)
        tick, probability = recorded.ticks(wait_s), np.zeros((len(log_density), len(STATES)))
        if wait_s == OFFLINE and len(log_density):
            probability[:, emission.states], label = smoothed(log_density, *chain)
            return Answer(tick, emission.states[label], probability)
        probability[:, emission.states] = filtered(log_density, *chain)
        return Answer.most_probable(tick, probability)

    right_s, loss_s = [], []
    for exponent in EXPONENTS:
        main = [Score.of(answer(r, exponent), r.scored).main for r in tuning]
        right_s.append(sum(float(m.seconds_by_state @ np.nan_to_num(m.recall)) for m in main))
        loss_s.append(sum(m.log_loss_s for m in main))
    label_exponent, posterior_exponent = EXPONENTS[int(np.argmax(right_s))], EXPONENTS[int(np.argmin(loss_s))]
    scores = list[Score]()
    for recorded in recordings:
        labelled, believed = answer(recorded, label_exponent), answer(recorded, posterior_exponent)
        scores.append(Score.of(labelled._replace(probability=believed.probability), recorded.scored))
    return scores


def _chain(recordings: Sequence[Windows], model: Model, states: Ints, step_s: float) -> tuple[Array, Array]:
    """Log initial (S,) and transition (S, S) probabilities over windows, from the changes in the set."""
    main = [r.scored.within(Subset.IDENTIFIABLE) for r in recordings]
    seconds = sum(float(m.seconds[m.subsets[Subset.ALL]].sum()) for m in main)
    leave = min(0.5, step_s * (1 + sum(len(m.changes) for m in main)) / seconds)
    change = destinations(model.transitions)[np.ix_(states, states)] * (1 - np.eye(len(states)))
    total = change.sum(axis=1, keepdims=True)
    shares = np.divide(change, total, out=np.eye(len(states)), where=total > 0)
    matrix = (1 - leave) * np.eye(len(states)) + leave * shares
    with np.errstate(divide="ignore"):
        return np.full(len(states), -np.log(len(states))), np.log(matrix)


def smoothed(log_density: Array, log_initial: Array, log_transition: Array) -> tuple[Array, Ints]:
    """Posterior (W, S) given all windows, and the most probable path (W,)."""
    later, onward = np.zeros_like(log_density), np.zeros_like(log_density)  # sums and largest of later paths
    for row in range(len(log_density) - 2, -1, -1):
        after = log_transition + log_density[row + 1]
        later[row] = hmm.log_sum_exp(after + later[row + 1])
        onward[row] = (after + onward[row + 1]).max(axis=1)
    path = [int((log_initial + log_density[0] + onward[0]).argmax())]
    for row in range(1, len(log_density)):
        path.append(int((log_transition[path[-1]] + log_density[row] + onward[row]).argmax()))
    with np.errstate(divide="ignore"):
        joint = np.log(filtered(log_density, log_initial, log_transition)) + later
    return softmax(joint, axis=1), np.array(path)


def filtered(log_density: Array, log_initial: Array, log_transition: Array) -> Array:
    """Posterior (W, S) of each window given the windows up to it."""
    prior, posterior = log_initial, np.zeros_like(log_density)
    for row, density in enumerate(log_density):
        joint = prior + density
        joint -= hmm.log_sum_exp(joint)
        posterior[row] = np.exp(joint)
        prior = hmm.birth_log_weights(joint, log_transition)
    return posterior
