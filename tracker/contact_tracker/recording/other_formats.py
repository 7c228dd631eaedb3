"""Files of formats that are not read: what they are, and the two lines of Python that open them."""

import os
from collections.abc import Callable
from typing import Final

from contact_tracker.errors import printable

_FROM: Final = "contact_tracker.Trajectory.from_"
_ARRAYS: Final = f"{_FROM}arrays(t, p, q) takes times, positions and rotations"
_PACKED: Final = {
    b"\x04\x22\x4d\x18": "lz4 -d",
    b"\x1f\x8b": "gunzip",
    b"PK\x03\x04": "unzip",
    b"BZh": "bunzip2",
}
"""First bytes of compressed files, and the commands that decompress them."""
_HDF5: Final = b"\x89HDF\r\n\x1a\n"
_MATLAB: Final = b"MATLAB "
_C3D: Final = b"P"
"""The second byte."""
_SHOWN: Final = 8


def what_it_is(path: str, begin: bytes) -> str | None:
    """One line on a file with these first bytes, if it is of a known format that is not read."""
    name = os.path.basename(path)
    for magic, command in _PACKED.items():
        if begin.startswith(magic):
            return f"it is compressed: {command} {name} first"
    for magic, describe in _KNOWN.items():
        if begin.startswith(magic):
            return describe(path, repr(name))
    return _c3d(repr(name)) if _is_c3d(path, begin) else None


def is_other_format(begin: bytes) -> bool:
    """Whether a file begins as one of a known format that is not read; some of these begin with text."""
    return begin.startswith((*_PACKED, *_KNOWN))


def _is_c3d(path: str, begin: bytes) -> bool:
    return begin[1:2] == _C3D and path.lower().endswith(".c3d")


def _c3d(name: str) -> str:
    return (
        f"it is C3D, which has markers, not bodies: export bodies (6D) as text; or points = "
        f"ezc3d.c3d({name})['data']['points'] (4, markers, N), of which scipy's Rotation.align_vectors finds "
        f"rotations; {_ARRAYS}"
    )


def _hdf5(path: str, name: str) -> str:
    return (
        f"it is HDF5, which is not read: file = h5py.File({name}); file.visit(print) shows the names of its "
        f"arrays; {_ARRAYS}"
    )


def _matlab(path: str, name: str) -> str:
    return (
        f"it is a file of MATLAB{_arrays_in(path)}, which is not read: "
        f"data = scipy.io.loadmat({name}, squeeze_me=True); {_ARRAYS}"
    )


def _arrays_in(path: str) -> str:
    """Names and shapes of the arrays in a file of MATLAB."""
    from scipy.io import whosmat

    try:
        found = whosmat(path)
    except Exception:  # damaged files can raise anything
        return ""
    shown = ", ".join(f"{printable(name)} {shape}" for name, shape, _ in found[:_SHOWN])
    return f" with {shown}{', ...' if len(found) > _SHOWN else ''}"


def _feather(path: str, name: str) -> str:
    return (
        f"it is a table of Arrow (Feather), which is not read: table = pyarrow.feather.read_table({name}); "
        f"{_FROM}dataframe(table) takes it"
    )


def _pickle(path: str, name: str) -> str:
    return f"it is a pickle, which runs code when it is loaded: if you trust it, load it in Python; {_ARRAYS}"


def _rerun(path: str, name: str) -> str:
    return f"it is a recording of rerun, which is not read: give the file from which it was made; {_ARRAYS}"


def _lfs(path: str, name: str) -> str:
    return "it is a pointer of Git LFS, not the file itself: git lfs pull"


_KNOWN: Final[dict[bytes, Callable[[str, str], str]]] = {
    _HDF5: _hdf5,
    _MATLAB: _matlab,
    b"ARROW1": _feather,
    b"\x80\x04\x95": _pickle,
    b"\x80\x05\x95": _pickle,
    b"RRF": _rerun,
    b"version https://git-lfs": _lfs,
}
