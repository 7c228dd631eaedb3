"""The file of a state: a tree of values and arrays, with the version of the package and a checksum."""

import hashlib
import json
import struct
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any, Final

import numpy as np

from contact_tracker import __version__
from contact_tracker.atomic_file import whole_file
from contact_tracker.errors import ContactTrackerError, StateError
from contact_tracker.regular_file import read_regular
from contact_tracker.saved_state.encoding import KINDS, Decoder, Encoder, schema

FORMAT: Final = 1
LARGEST_BYTES: Final = 512 * 2**20
_PARSE_ERRORS: Final = (
    zipfile.BadZipFile,
    *(ValueError, LookupError, TypeError, RuntimeError, EOFError, MemoryError, OverflowError, struct.error),
)
"""Errors of the libraries for invalid zip files, JSON and arrays."""
_TREE: Final = "tree.json"
_HEAD: Final = "head.json"


def save(path: Path, value: Any) -> None:
    """Write a value of the classes of a stream, atomically.

    Raises
    ------
    TypeError
        The value has a part of another class.
    OSError
        The file cannot be written.
    """
    encoder = Encoder()
    tree = json.dumps(encoder.encode(value)).encode()
    parts = {_TREE: tree, **{f"{i}.npy": _bytes_of(array) for i, array in enumerate(encoder.arrays)}}
    with whole_file(path) as temporary, zipfile.ZipFile(temporary, "w", zipfile.ZIP_STORED) as file:
        file.writestr(zipfile.ZipInfo(_HEAD), json.dumps(_head(parts)))
        for name, data in parts.items():
            file.writestr(zipfile.ZipInfo(name), data)


def load(path: Path) -> Any:
    """The saved value; no code in the file is run.

    Raises
    ------
    StateError
        The file is not a state, is damaged, or was saved by another version.
    OSError
        The file cannot be read.
    """
    try:
        parts = _parts(path)
        head = json.loads(parts.pop(_HEAD, b"null"))
        expected = _head(parts)
        if not isinstance(head, dict) or head.get("kind") != expected["kind"]:
            raise StateError("it is no saved state")
        if any(head.get(key) != expected[key] for key in ("schema", "format", "version")):
            raise StateError(
                f"it was saved by another version ({head.get('version')}, this is {__version__})"
            )
        if head.get("sha256") != expected["sha256"]:
            raise StateError("it is damaged: its checksum is wrong")
        tree = json.loads(parts[_TREE])
        arrays = [_array_of(parts[f"{i}.npy"]) for i in range(len(parts) - 1)]
        return Decoder(arrays).decode(tree)
    except StateError as error:
        raise StateError(f"{path}: {error}") from error
    except FileNotFoundError:
        raise
    except OSError as error:
        raise StateError(f"{path}: {error.strerror or error}") from error
    except _PARSE_ERRORS as error:
        raise StateError(f"{path}: it is no saved state: name another file") from error


@contextmanager
def continued(path: Path | None) -> Iterator[None]:
    """Raise StateError for any unexpected error while a stream goes on from the state in ``path``, if any.

    A state has hundreds of arrays and numbers that depend on each other, and a file may hold any: its
    checksum shows damage, but not what somebody has written on purpose.
    """
    try:
        yield
    except (ContactTrackerError, OSError):
        raise
    except Exception as error:
        if path is None:
            raise
        raise StateError(
            f"{path}: it cannot be continued ({type(error).__name__}): name another file"
        ) from error


def _head(parts: dict[str, bytes]) -> dict[str, Any]:
    checksum = hashlib.sha256()
    for name in sorted(parts):
        checksum.update(f"{name} {len(parts[name])}\n".encode())
        checksum.update(parts[name])
    fields = hashlib.sha256(json.dumps(schema()).encode()).hexdigest()
    return {
        "kind": "contact-tracker state",
        "format": FORMAT,
        "version": __version__,
        "schema": fields,
        "sha256": checksum.hexdigest(),
    }


def _parts(path: Path) -> dict[str, bytes]:
    with zipfile.ZipFile(BytesIO(read_regular(path, LARGEST_BYTES))) as file:
        infos = file.infolist()
        if any(info.compress_type != zipfile.ZIP_STORED for info in infos):
            raise StateError("it is no saved state")
        if sum(info.file_size for info in infos) > LARGEST_BYTES:
            raise StateError("it is too large for a state")
        return {info.filename: file.read(info) for info in infos}


def _bytes_of(array: np.ndarray[Any, Any]) -> bytes:
    buffer = BytesIO()
    np.save(buffer, array, allow_pickle=False)
    return buffer.getvalue()


def _array_of(data: bytes) -> np.ndarray[Any, Any]:
    array: np.ndarray[Any, Any] = np.load(BytesIO(data), allow_pickle=False)
    if array.dtype.kind not in KINDS:
        raise StateError("it is no saved state")
    return array
