"""Viterbi tick by tick: the prefix that all surviving paths share is decided."""

from bisect import bisect_left
from heapq import heapify, heappop, heappush

import numpy as np
from numpy.typing import NDArray

from contact_tracker.hmm.forward_filter import FilterFrontier, ForwardMessage

PathSegment = tuple[int, int, int]
"""State, onset, end."""
Node = tuple[int, int]
"""Minus a boundary (so that the latest comes first), and the state that ends there."""


class Survivors:
    """The best path to each state at each boundary after ``first``; up to ``first`` the path is decided."""

    def __init__(self) -> None:
        self.first = 0
        self._end = 0
        self._ticks: list[int] = []
        self._best: list[NDArray[np.int32]] = []

    def append(self, step: ForwardMessage) -> None:
        self._ticks.append(step.tick)
        self._best.append(step.best)
        self._end = step.tick + 1

    def skip(self) -> None:
        """Append a tick that the filter has skipped: each path stays in its state."""
        self._end += 1

    def decided_prefix(self, frontier: FilterFrontier) -> list[PathSegment]:
        """The segments that later data cannot change; each is returned once."""
        nodes = {(-a, i) for a, i in zip(frontier.onset.tolist(), frontier.origin.tolist(), strict=True)}
        latest = list(nodes)
        heapify(latest)
        while len(nodes) > 1 and -latest[0][0] > self.first:
            node = heappop(latest)
            nodes.remove(node)
            previous = self._before(node)
            if previous not in nodes:
                nodes.add(previous)
                heappush(latest, previous)
        return self._release(latest[0])

    def finish(self, frontier: FilterFrontier) -> list[PathSegment]:
        """The undecided part of the best path, at the end of the stream."""
        return self._release((-self._end, int(frontier.state[frontier.best.argmax()])))

    def _before(self, node: Node) -> Node:
        """The previous node on the best path to a node."""
        onset, origin = self._best[bisect_left(self._ticks, -node[0]) - 1][:, node[1]].tolist()
        return -onset, origin

    def _release(self, node: Node) -> list[PathSegment]:
        """The segments up to a node, which are then dropped from memory."""
        path: list[PathSegment] = []
        end = -node[0]
        while -node[0] > self.first:
            previous = self._before(node)
            path.append((node[1], -previous[0], -node[0]))
            node = previous
        count = bisect_left(self._ticks, end)
        del self._ticks[:count], self._best[:count]
        self.first = end
        return path[::-1]
