"""Random trellises, small enough for sums over all paths."""

import numpy as np

from whole_trellis import Trellis

SIZES = ((2, 6), (3, 6), (4, 5), (7, 4))  # numbers of states and ticks with few enough paths


class Case:
    """A random trellis: hypotheses begin at any boundary, several or none of a state, and some end early.

    The last state has no memory, like free motion: a hypothesis per tick, for this tick only.
    """

    def __init__(self, seed, sizes=SIZES, death=0.3, absent=0.2, forbidden=0.15):
        rng = np.random.default_rng(seed)
        self.states, self.ticks = sizes[rng.integers(len(sizes))]
        rows = []  # state, onset, last boundary at which alive
        for onset in range(self.ticks):
            for state in range(self.states - 1):
                for _ in range(1 if self.states == 7 else int(rng.integers(1, 3))):
                    if rng.random() >= absent:
                        lasts = int(rng.geometric(death)) if death else self.ticks
                        rows.append((state, onset, min(onset + lasts, self.ticks)))
            rows.append((self.states - 1, onset, onset + 1))
        rows = [rows[i] for i in rng.permutation(len(rows))]
        self.state, self.onset, self.last = np.array(rows, np.int64).T
        self.value = rng.normal(size=(len(rows), self.ticks + 1)) * rng.choice([0.1, 1.0, 5.0])
        self.log_initial = np.log(rng.dirichlet(np.ones(self.states)))
        self.log_transition = rng.normal(size=(self.ticks, self.states, self.states))
        shut = rng.random(self.log_transition.shape) < forbidden
        shut[:, -1, -1] = False
        self.log_transition[shut] = -np.inf

    @property
    def trellis(self):
        boundaries = range(1, self.ticks + 1)
        alive = [np.flatnonzero((self.onset < b) & (b <= self.last)) for b in boundaries]
        likelihood = [self.value[a, b] for a, b in zip(alive, boundaries, strict=True)]
        return Trellis(self.state, self.onset, alive, likelihood)

    @property
    def model(self):
        return self.log_initial, self.log_transition

    def paths(self):
        """All paths: (log weight, segments) that cover every tick."""

        def extend(boundary, before, weight, segments):
            if boundary == self.ticks:
                yield weight, segments
                return
            for h in np.flatnonzero(self.onset == boundary):
                into = self.log_initial if before is None else self.log_transition[boundary, before]
                for end in range(boundary + 1, self.last[h] + 1):
                    total = weight + into[self.state[h]] + self.value[h, end]
                    yield from extend(end, self.state[h], total, [*segments, (int(h), boundary, end)])

        return list(extend(0, None, 0.0, []))
