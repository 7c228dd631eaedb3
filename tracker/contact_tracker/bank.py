"""The living hypotheses of one contact as columns: what each knows, how they join and which are dropped."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from contact_tracker.contacts import ContactModel
from contact_tracker.labels import STATES

Array = NDArray[np.float64]
Index = NDArray[np.int64]

PATIENCE: Final = 30
"""Up to this many ticks with motion a hypothesis is kept however bad: its geometry may not be found yet."""
YOUNG: Final = 10
"""Up to this age in ticks every onset has its own hypothesis; older ones get sparser."""


@dataclass(frozen=True, eq=False)
class Bank:
    """H hypotheses of one contact, in order of onset; C, S, K, P as in ``contacts.base``.

    Parameters
    ----------
    onset, onset_ns : (H,) first tick, and when it began.
    number : (H,) tells hypotheses apart over the whole recording.
    entry : (H,) log weight with which it began.
    first : (H, C) lifted first tick over its noise: what was given at the onset.
    moments, place_sum, weight : (H, C, C), (H, 3), (H,) weighted sums over the window.
    told : (H,) how many ticks with motion it has seen.
    x, hessian : (H, S), (H, K, P, P) geometry that fits the window best, and its information by row.
    row_weight : (H, K) precision of the residuals relative to that of the position.
    settled, earned : (H,) of the log-likelihood and of its gain, what is no longer looked at: ticks that have
        left the window, and of the former what staying has cost.
    log_likelihood : (H,) of all data since the onset, against free motion.
    rms : (H,) whitened root mean square residual.
    past : (H, L, 7) states at the last L ticks (see ``fixed_lag``); L is 0 without lag.
    """

    onset: Index
    onset_ns: Index
    number: Index
    entry: Array
    first: Array
    moments: Array
    place_sum: Array
    weight: Array
    told: Array
    x: Array
    hessian: Array
    row_weight: Array
    settled: Array
    earned: Array
    log_likelihood: Array
    rms: Array
    past: Array

    def __len__(self) -> int:
        return len(self.onset)

    @property
    def joint(self) -> Array:
        """Log weight (H,) of a hypothesis with all that led to it."""
        return self.entry + self.log_likelihood

    def pick(self, rows: NDArray[np.generic]) -> "Bank":
        """The hypotheses in ``rows``."""
        return Bank(**{name: value[rows] for name, value in vars(self).items()})


def blank(model: ContactModel, count: int, lag: int = 0) -> Bank:
    """``count`` hypotheses of which nothing is known."""
    family = model.family
    c, s, k, p = len(family.COLUMNS), family.SIZE, family.ROWS, family.PARAMETERS
    column, index = np.zeros(count), np.zeros(count, np.int64)
    # some directions; points at the body, which starts at the origin
    anywhere = family.normalise((1.0 - family.SPREAD) * (1.0 + np.arange(s) % 2), np.zeros(6))
    return Bank(
        onset=index,
        onset_ns=index,
        number=index,
        entry=column,
        first=np.zeros((count, c)),
        moments=np.zeros((count, c, c)),
        place_sum=np.zeros((count, 3)),
        weight=column,
        told=column,
        x=np.tile(anywhere, (count, 1)),
        hessian=np.zeros((count, k, p, p)),
        row_weight=np.ones((count, k)),
        settled=column,
        earned=column,
        log_likelihood=column,
        rms=column + 1.0,
        past=np.zeros((count, lag, len(STATES))),
    )


def add(
    bank: Bank, model: ContactModel, onset: int, onset_ns: int, number: int, entry: float, past: Array
) -> Bank:
    """One more hypothesis, from tick ``onset`` on; it starts from the geometry of the best one so far."""
    values = dict(vars(blank(model, 1)))
    values |= {
        "onset": np.array([onset]),
        "onset_ns": np.array([onset_ns]),
        "number": np.array([number]),
        "entry": np.array([entry]),
        "past": past[None],
    }
    if len(bank):
        best = int(np.argmax(bank.joint))
        values |= {"x": bank.x[best : best + 1], "row_weight": bank.row_weight[best : best + 1]}
    return Bank(**{name: np.concatenate([vars(bank)[name], values[name]]) for name in values})


def prune(bank: Bank, now: int, best: float, margin: float) -> Bank:
    """Drop what is hopeless against ``best``, and thin out onsets the more the older they are."""
    if not len(bank):
        return bank
    joint = bank.joint
    age = now + 1 - bank.onset
    span = 2 ** np.maximum(np.floor(np.log2(np.maximum(age, 1) / YOUNG)) + 1, 0).astype(np.int64)
    group = np.where(age <= YOUNG, -bank.onset - 1, bank.onset // span + (span << 40))
    order = np.lexsort((-joint, group))
    first = np.ones(len(order), bool)
    first[1:] = group[order][1:] != group[order][:-1]
    keep = np.zeros(len(bank), bool)
    keep[order[first]] = True
    keep &= (joint > best - margin) | (bank.told <= PATIENCE)
    return bank if keep.all() else bank.pick(keep)
