"""Arrays of numbers by name in files of NumPy, MATLAB and HDF5.

Files of MATLAB up to version 7 are elements with a type, a size and data; each variable is compressed alone,
and structs contain variables (https://www.mathworks.com/help/pdf_doc/matlab/matfile_format.pdf).
They are parsed here, since scipy allocates lists as long as a file says: 400 bytes take 800 MB. Files of
version 7.3 are HDF5 with reversed axes, which h5py reads if it is installed.
"""

import math
import mmap
import os
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterator, Set
from contextlib import closing
from functools import cache, partial
from tokenize import TokenError
from typing import IO, Any, Final

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from contact_tracker.errors import UnreadableRecording, first_line, printable
from contact_tracker.recording.bytestream import TooMuchWork, WorkBudget
from contact_tracker.recording.table_layouts import BY_ROW, MOST_COLUMNS, NUMBERED, UNNAMED, Columns

Shape = tuple[int, ...]
Arrays = Iterator[tuple[str, Shape, Callable[[], NDArray[Any]]]]
"""Name and shape of each array, and the function that reads its values before the next one is looked for."""
WIDEST: Final = 64
"""Most values per row of a list or an array that become columns without being named; an image has more."""
MOST_ARRAYS: Final = 200
"""Most arrays that are read without being named."""
DEEPEST: Final = 5
"""Most levels of structs in structs that are read."""
_ERRORS: Final = (
    *(ValueError, OSError, EOFError, RuntimeError, MemoryError, LookupError, TypeError, struct.error),
    *(zipfile.BadZipFile, zlib.error, NotImplementedError, TokenError),
)


def arrays_in(
    path: str, kind: str, stated: Set[str], budget: WorkBudget
) -> tuple[dict[str, tuple[Shape, NDArray[Any] | None]], int]:
    """The shapes and values of arrays of numbers by name, or by path in structs and groups (the name is empty
    for an ``.npy`` file), and the number of further arrays.

    Parameters
    ----------
    kind : format of the file: ``NumPy``, ``MATLAB`` or ``HDF5``.
    stated : lower-case names of arrays that are always among them; of other arrays only the first 200 are.
        Arrays with more values per row than ``widest_of`` have no values here.

    Raises UnreadableRecording if it is damaged, too large when decompressed, or h5py is not installed.
    """
    arrays, left_out = dict[str, tuple[Shape, NDArray[Any] | None]](), 0
    try:
        stored = {"NumPy": _of_numpy, "MATLAB": _of_matlab, "HDF5": _of_hdf5}[kind](path, budget)
        for number, (name, shape, read) in enumerate(stored):
            if number >= MOST_ARRAYS and not _may_be_meant(name, stated):
                left_out += 1
                continue
            is_read = math.prod(shape) <= widest_of(name, stated) * max(shape[0], shape[-1])
            arrays[printable(name)] = shape, read() if is_read else None
        return arrays, left_out
    except TooMuchWork as error:
        raise UnreadableRecording(f"it is too much for its size: {error}") from error
    except _ERRORS as error:
        raise UnreadableRecording(f"it cannot be read as arrays of {kind}: {first_line(error)}") from error


def widest_of(name: str, stated: Set[str]) -> int:
    """Most values per row of an array that is read."""
    return MOST_COLUMNS if (name or UNNAMED).lower() in stated else WIDEST


def _may_be_meant(name: str, stated: Set[str]) -> bool:
    """Whether a stated name can be that of the array, with or without its unit, or of a group of numbered
    ones."""
    names = {name.lower(), Columns([name]).plain[0]}
    names |= {match[1] for pattern in (NUMBERED, BY_ROW) if (match := pattern.fullmatch(name.lower()))}
    return not names.isdisjoint(stated)


def _of_numpy(path: str, budget: WorkBudget) -> Arrays:
    if not path.lower().endswith(".npz"):
        with open(path, "rb") as file:
            yield from _numpy_array("", file, os.path.getsize(path), os.path.getsize(path), budget)
        return
    with closing(zipfile.ZipFile(path)) as archive:
        for info in archive.infolist():
            name, sizes = info.filename.removesuffix(".npy"), (info.compress_size, info.file_size)
            with archive.open(info) as file:
                yield from _numpy_array(name, file, *sizes, budget)


def _numpy_array(name: str, file: IO[bytes], packed: int, size: int, budget: WorkBudget) -> Arrays:
    """The array in a file of ``size`` bytes, ``packed`` when compressed, if it has numbers."""
    version = npy.read_magic(file)
    read_header = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
    shape, by_columns, kind = read_header(file)
    count = math.prod(shape)
    if not shape or not count or kind.hasobject:
        return
    if min(shape) < 0 or count * kind.itemsize > size:
        raise ValueError("an array is longer than its file")

    def read() -> NDArray[Any]:
        budget.inflate(packed, size)
        flat = np.frombuffer(file.read(count * kind.itemsize), kind)
        return flat.reshape(shape, order="F" if by_columns else "C")

    yield from _numbers_in(name, shape, kind, read)


def _numbers_in(name: str, shape: Shape, kind: np.dtype[Any], read: Callable[[], NDArray[Any]]) -> Arrays:
    """The array if it has numbers or texts, dates as nanoseconds, or those of its fields."""
    if kind.kind in "iufSU":
        yield name, shape, read
    elif kind.kind in "mM":
        yield name, shape, lambda: read().astype(f"{kind.kind}8[ns]").astype(np.int64)
    whole = cache(read)
    for field in kind.names or ():
        part = kind[field]
        of_field = partial(lambda field: whole()[field], field)
        yield from _numbers_in(f"{name}.{field}".lstrip("."), shape + part.shape, part.base, of_field)


_COMPRESSED, _MATRIX, _STRUCT = 15, 14, 2
_CLASSES: Final = range(6, 16)
"""Classes of arrays of numbers."""
_COMPLEX: Final = 8
_TYPES: Final = dict(
    zip((*range(1, 8), 9, 12, 13), ("i1", "u1", "i2", "u2", "i4", "u4", "f4", "f8", "i8", "u8"), strict=True)
)
_HEAD: Final = 128


def _of_matlab(path: str, budget: WorkBudget) -> Arrays:
    with open(path, "rb") as file:
        data = memoryview(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ))
    if bytes(data[:6]) != b"MATLAB":
        from scipy.io.matlab import MatReadError, loadmat

        try:
            stored = loadmat(path, appendmat=False)  # of version 4, which has no lists
        except MatReadError as error:
            raise ValueError(str(error)) from error
        for name, values in stored.items():
            if isinstance(values, np.ndarray) and values.dtype.kind in "iuf" and values.size:
                yield name, values.shape, partial(np.asarray, values)
        return
    order = "<" if bytes(data[126:128]) == b"IM" else ">"
    for kind, element in _elements(data[_HEAD:], order):
        if kind == _COMPRESSED:
            unpack = zlib.decompressobj()
            kind, size = struct.unpack(f"{order}II", unpack.decompress(element, 8))
            budget.inflate(len(element), size)
            element = memoryview(unpack.decompress(unpack.unconsumed_tail, max(size, 1)))
        if kind == _MATRIX:
            yield from _variable(element, order, "", budget)


def _elements(data: memoryview, order: str) -> Iterator[tuple[int, memoryview]]:
    """Types and data of the elements in order; the last may be cut off."""
    at = 0
    while at + 8 <= len(data):
        kind, size = struct.unpack_from(f"{order}II", data, at)
        if kind >> 16:  # a small one, in eight bytes
            yield kind & 0xFFFF, data[at + 4 : at + 4 + min(kind >> 16, 4)]
            at += 8
        else:
            yield kind, data[at + 8 : at + 8 + size]
            at += 8 + size + (0 if kind == _COMPRESSED else -size % 8)


def _variable(data: memoryview, order: str, path: str, budget: WorkBudget, depth: int = 0) -> Arrays:
    """The arrays of numbers in a variable; arrays in a struct are named ``path.name``."""
    budget.spend(1)
    elements = _elements(data, order)
    if depth > DEEPEST or (head := next(elements, None)) is None:
        return
    (flags,) = struct.unpack_from(f"{order}I", head[1])
    if flags & 0xFF not in (_STRUCT, *_CLASSES):  # an object, which has no shape
        return
    shape = tuple(np.frombuffer(next(elements)[1], f"{order}i4").tolist())
    name, kind, count = bytes(next(elements)[1]).decode("latin-1"), flags & 0xFF, math.prod(shape)
    path = path or name
    if kind == _STRUCT and count == 1:
        (width,), names = np.frombuffer(next(elements)[1], f"{order}i4"), bytes(next(elements)[1])
        starts = range(0, len(names), max(int(width), 1))
        for start, (_, element) in zip(starts, elements, strict=False):
            name = names[start : start + width].split(b"\0")[0].decode("latin-1")
            yield from _variable(element, order, f"{path}.{name}", budget, depth + 1)
    elif path and kind in _CLASSES and not flags >> 8 & _COMPLEX and count > 0:
        stored, flat = next(elements)
        yield path, shape, lambda: np.frombuffer(flat, order + _TYPES[stored]).reshape(shape, order="F")


def _of_hdf5(path: str, budget: WorkBudget) -> Arrays:
    try:
        import h5py
    except ImportError:
        raise UnreadableRecording("it is HDF5: pip install h5py, with which it is read") from None
    with open(path, "rb") as start:
        is_matlab = start.read(6) == b"MATLAB"
    with h5py.File(path, "r") as file:
        names = list[str]()
        file.visit(names.append)

        def read(stored: Any) -> NDArray[Any]:
            budget.inflate(stored.id.get_storage_size(), stored.nbytes)
            return np.asarray(stored[()].T if is_matlab else stored[()])

        for name, stored in ((name, file[name]) for name in names if not name.startswith("#")):
            is_inside = isinstance(stored, h5py.Dataset) and not (stored.is_virtual or stored.external)
            if is_inside and stored.shape and stored.size:
                shape = stored.shape[::-1] if is_matlab else stored.shape
                name = name.replace("/", ".") if is_matlab else name
                yield from _numbers_in(name, shape, stored.dtype, partial(read, stored))
