"""Finding recordings by names and in folders without reading them, and whether their content has changed."""

import hashlib
import os
import shlex
from collections.abc import Collection, Iterable, Iterator
from glob import escape, glob
from itertools import chain
from typing import Final, NamedTuple

from contact_tracker.errors import UnreadableRecording
from contact_tracker.files import why_not_regular
from contact_tracker.recording import may_be_recording, parts_of

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


def matching(name: str) -> tuple[list[str], list[str]]:
    """The recordings and folders of recordings that match a pattern (``*``, ``?``, ``[...]``, ``**``),
    sorted, and the other files that match. For a name without a match or pattern: the name itself, and the
    tables beside the recordings in this folder.

    A folder with a ``metadata.yaml`` is one recording. Raises UnreadableRecording if files match and none of
    them may be a recording.
    """
    if os.path.lexists(name):
        inside = _files_in(name)  # none if it is no folder
        tables = _tables_among(inside)
        is_whole = os.path.exists(os.path.join(name, _METADATA))
        return [name], [] if is_whole or not recordings_among(inside) else tables
    paths = sorted(glob(name, recursive=True))
    bags = {path.rstrip(os.sep) for path in paths if os.path.exists(os.path.join(path, _METADATA))}
    single = [path for path in paths if os.path.dirname(path) not in bags]
    folders = [path for path in single if os.path.isdir(path)]
    files = [path for path in single if not os.path.isdir(path)]
    chosen = [path for path in files if _may_be_recording(path)]
    chosen += [path for path in folders if path.rstrip(os.sep) in bags or recordings_among(_files_in(path))]
    if paths and not chosen:
        raise UnreadableRecording(
            f"{name}: none of the {len(paths)} files and folders that match holds poses"
        )
    return sorted(chosen) or [name], sorted({*files}.difference(chosen))


def _may_be_recording(path: str) -> bool:
    """Whether a file is a recording by its name or content; an unreadable file counts as a recording."""
    if path.lower().endswith(SUFFIXES) or not os.path.exists(path):
        return True
    try:
        return os.path.isfile(path) and may_be_recording(path)
    except (OSError, UnreadableRecording):
        return True


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
    return shlex.quote(os.path.join(escape(folder), f"*{os.path.splitext(name)[1]}"))


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
