"""Rows of arrays of NumPy (.npy and .npz), as columns."""

import os
import zipfile
import zlib
from collections import Counter
from collections.abc import Iterator
from contextlib import closing
from typing import IO, Any, Final

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from contact_tracker.config.table_reading import TableReading
from contact_tracker.errors import UnreadableRecording, printable
from contact_tracker.recording.bytestream import TooMuchWork, WorkBudget
from contact_tracker.recording.items import ROWS_AT_ONCE
from contact_tracker.recording.table_layouts import layout_of_names
from contact_tracker.recording.text_tables import layout_without_names

_WIDEST: Final = 64
_MOST_ARRAYS: Final = 200
_ERRORS: Final = (
    ValueError,
    OSError,
    EOFError,
    zipfile.BadZipFile,
    zlib.error,
    NotImplementedError,
    RuntimeError,
    MemoryError,
)


class ArrayRows:
    """The columns of arrays with as many rows, some rows after others.

    Raises
    ------
    UnreadableRecording
        It is damaged, too large when decompressed, or it is not known which columns are what.
    """

    def __init__(self, path: str, reading: TableReading, budget: WorkBudget) -> None:
        self.damage: tuple[str, ...] = ()
        try:
            arrays = _read(path, budget)
        except TooMuchWork as error:
            raise UnreadableRecording(f"it is too much for its size: {error}") from error
        except _ERRORS as error:
            raise UnreadableRecording(f"it cannot be read as arrays of NumPy: {error}") from error
        lengths = Counter(len(array) for array in arrays.values())
        if not lengths:
            raise UnreadableRecording("it has no array of numbers with a row for each pose")
        self._rows = lengths.most_common(1)[0][0]
        whole = [one for one in arrays.items() if len(one[1]) == self._rows]
        columns = [column for one in whole for column in _columns(*one)]
        self._values = [values for _, values in columns]
        if list(arrays) == [""]:
            first = [str(values[0]) for values in self._values] if self._rows else []
            self.layout = layout_without_names(first, reading, path, "NumPy")
        else:
            self.layout = layout_of_names([name for name, _ in columns], reading, path, "NumPy")

    def __iter__(self) -> Iterator[dict[int, Any]]:
        layout = self.layout
        for begin in range(0, self._rows, ROWS_AT_ONCE):
            part = slice(begin, min(begin + ROWS_AT_ONCE, self._rows))
            found: dict[int, Any] = {}
            for place in layout.places:
                if place < 0:
                    found[place] = [str(i) for i in range(part.start, part.stop)]
                elif place in (layout.time, layout.rest):
                    found[place] = [str(value) for value in self._values[place][part].tolist()]
                else:
                    found[place] = self._values[place][part].astype(np.float64)
            yield found


def _columns(name: str, array: NDArray[Any]) -> list[tuple[str, NDArray[Any]]]:
    if array.ndim == 1:
        return [(name, array)]
    rows = array.reshape(len(array), -1)
    return [(f"{name}[{i}]", rows[:, i]) for i in range(rows.shape[1])]


def _read(path: str, budget: WorkBudget) -> dict[str, NDArray[Any]]:
    """The arrays of numbers by name; that of an ``.npy`` file has none."""
    if not path.lower().endswith(".npz"):
        with open(path, "rb") as file:
            array = _array(file, os.path.getsize(path), os.path.getsize(path), budget)
        return {} if array is None else {"": array}
    found = dict[str, NDArray[Any]]()
    with closing(zipfile.ZipFile(path)) as archive:
        for info in archive.infolist()[:_MOST_ARRAYS]:
            with archive.open(info) as file:
                array = _array(file, info.compress_size, info.file_size, budget)
            if array is not None:
                found[printable(info.filename.removesuffix(".npy"))] = array
    return found


def _array(file: IO[bytes], packed: int, size: int, budget: WorkBudget) -> NDArray[Any] | None:
    """An array in a file of so many bytes, ``packed`` and not, if it has numbers in rows of few values."""
    version = npy.read_magic(file)
    read_header = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
    shape, by_columns, kind = read_header(file)
    width = int(np.prod(shape[1:], dtype=object)) if shape else 0
    if not 1 <= width <= _WIDEST or kind.kind not in "iuf":
        return None
    if min(shape) < 0 or width * shape[0] * kind.itemsize > size:
        raise ValueError("an array is longer than its file")
    budget.inflate(packed, size)
    values = np.frombuffer(file.read(width * shape[0] * kind.itemsize), kind)
    return values.reshape(shape, order="F" if by_columns else "C")
