"""Finding recordings by names and in folders without reading them, and whether their content has changed."""

import hashlib
import os
import shlex
from collections.abc import Collection, Iterable, Iterator
from itertools import chain
from typing import Final, NamedTuple

from contact_tracker.errors import UnreadableRecording
from contact_tracker.files import why_not_regular
from contact_tracker.recording import parts_of

SUFFIXES: Final = (".mcap", ".mcap.zst", ".mcap.zstd", ".db3", ".bag")
"""Suffixes by which recordings in folders are found; tables, which may have no poses, must be named."""
_OF_TABLES: Final = (".csv", ".tsv", ".tum")
_METADATA: Final = "metadata.yaml"
_BLOCK: Final = 2**20


class Recording(NamedTuple):
    """A recording with its absolute ``name``; ``signature`` is empty if there is no readable file."""

    name: str
    signature: str


def missing_among(names: Iterable[str]) -> list[str]:
    """The names that are neither a file nor a folder."""
    return [name for name in names if not os.path.exists(name)]


def tables_beside(name: str) -> list[str]:
    """The tables beside the recordings in a folder; empty for a file, a bag, and a folder of tables alone."""
    if os.path.exists(os.path.join(name, _METADATA)):
        return []
    inside = _files_in(name)
    return _tables_among(inside) if recordings_among(inside) else []


def find(names: Iterable[str]) -> Iterator[Recording]:
    """Each recording once, with folders replaced by the recordings in them, sorted.

    A folder with a ``metadata.yaml`` is one recording. Missing recordings are included; their result is that
    they cannot be read. Raises UnreadableRecording for a folder without recordings.
    """
    paths = chain.from_iterable(recordings_in(os.path.abspath(name)) for name in names)
    for path in dict.fromkeys(paths):
        yield Recording(path, signature_of(path))


def recordings_in(name: str) -> list[str]:
    """The recordings of a file or folder, by name; raises UnreadableRecording if it has none."""
    if not os.path.isdir(name) or os.path.exists(os.path.join(name, _METADATA)):
        return [name]
    files = _files_in(name)
    inside, tables = recordings_among(files), _tables_among(files)
    if not inside:
        remedy = f"; name its tables, as {pattern_beside(tables[0])}" if tables else ""
        raise UnreadableRecording(f"{name}: this folder holds no recording ({', '.join(SUFFIXES)}){remedy}")
    return inside


def _tables_among(files: Iterable[str]) -> list[str]:
    return sorted(path for path in files if path.lower().endswith(_OF_TABLES))


def pattern_beside(table: str) -> str:
    """A shell's pattern for the files beside a table with its suffix."""
    folder, name = os.path.split(table)
    return f"{shlex.quote(folder)}/*{os.path.splitext(name)[1]}"


def _files_in(folder: str) -> list[str]:
    return [os.path.join(parent, name) for parent, _, names in os.walk(folder) for name in names]


def recordings_among(files: Collection[str]) -> list[str]:
    """The recordings among these paths, sorted; a folder with a ``metadata.yaml`` is one recording."""
    bags = {os.path.dirname(path) for path in files if os.path.basename(path) == _METADATA}
    single = {path for path in files if path.lower().endswith(SUFFIXES) and os.path.dirname(path) not in bags}
    return sorted(bags | single)


def files_of(name: str) -> list[str]:
    """The files of a recording; raises UnreadableRecording."""
    beside = os.path.join(name, _METADATA)
    return [*([beside] if os.path.isfile(beside) else []), *parts_of(name)]


def signature_of(name: str) -> str:
    """Sizes, modification times and inodes of a recording's files, empty if it cannot be read. Equal
    signatures mean equal content, unless a time was set back."""
    try:
        states = [os.stat(path) for path in files_of(name)]
    except (OSError, UnreadableRecording, ValueError):
        return ""
    return " ".join(f"{state.st_size:x}.{state.st_mtime_ns:x}.{state.st_ino:x}" for state in states)


def read_content(name: str) -> tuple[str, int]:
    """A hash of a recording's files (BLAKE2b, 32 hexadecimal digits), and their size in bytes. Raises
    OSError, or UnreadableRecording if one of its files is missing or not a regular file."""
    digest, size = hashlib.blake2b(digest_size=16), 0
    for path in files_of(name):
        descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
        with open(descriptor, "rb") as file:
            state = os.fstat(descriptor)
            if (reason := why_not_regular(state.st_mode)) is not None:
                raise UnreadableRecording(f"{path}: {reason}")
            digest.update(f"{state.st_size} ".encode())
            while block := file.read(_BLOCK):
                digest.update(block)
                size += len(block)
    return digest.hexdigest(), size
