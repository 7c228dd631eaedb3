"""Queues of rows in blocks: appended at the end, dropped from the start, never copied as a whole."""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

_BLOCK: Final = 1024


class Columns:
    """Rows of a structured ``dtype``, indexed from the oldest."""

    def __init__(self, dtype: np.dtype[Any]) -> None:
        self._dtype = dtype
        self._blocks: list[NDArray[Any]] = []
        self._start = self._end = 0  # within the blocks

    def __len__(self) -> int:
        return self._end - self._start

    def append(self, row: tuple[Any, ...]) -> None:
        block, place = divmod(self._end, _BLOCK)
        if block == len(self._blocks):
            self._blocks.append(np.empty(_BLOCK, self._dtype))
        self._blocks[block][place] = row
        self._end += 1

    def rows(self, first: int, end: int) -> NDArray[Any]:
        """A copy of the rows ``first`` to ``end``."""
        copy = np.empty(end - first, self._dtype)
        place = first + self._start
        while first < end:
            block, row = divmod(place, _BLOCK)
            count = min(_BLOCK - row, end - first)
            copy[len(copy) - (end - first) :][:count] = self._blocks[block][row : row + count]
            first, place = first + count, place + count
        return copy

    def drop(self, count: int) -> None:
        """Drop the oldest rows."""
        self._start += count
        blocks = self._start // _BLOCK
        del self._blocks[:blocks]
        self._start -= blocks * _BLOCK
        self._end -= blocks * _BLOCK

    def take(self, count: int) -> NDArray[Any]:
        """Remove and return the oldest rows."""
        taken = np.empty(count, self._dtype)
        for first in range(0, count, _BLOCK):  # in blocks, so that memory never doubles
            some = min(_BLOCK, count - first)
            taken[first : first + some] = self.rows(0, some)
            self.drop(some)
        return taken
