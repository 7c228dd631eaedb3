"""Finding recordings by names and in folders without reading them, and whether their content has changed."""

import hashlib
import os
import shlex
from collections.abc import Collection, Iterable, Iterator, Sequence
from glob import escape, glob
from itertools import chain
from typing import Final, NamedTuple

from contact_tracker.batch import remote
from contact_tracker.errors import UnreadableRecording, UsageError
from contact_tracker.files import why_not_regular
from contact_tracker.recording import may_be_recording, parts_of

SUFFIXES: Final = (".mcap", ".mcap.zst", ".mcap.zstd", ".db3", ".bag")
"""Suffixes of recordings in folders; tables, which may have no poses, have to be named."""
_OF_TABLES: Final = (".csv", ".tsv", ".tum")
_METADATA: Final = "metadata.yaml"
_BLOCK: Final = 2**20


class Found(NamedTuple):
    """A recording with its absolute ``name`` or URL; ``signature`` is empty if only a worker can determine it
    or there is no file; ``within`` is the URL of the folder that it was found in."""

    name: str
    signature: str
    within: str | None = None


def missing_among(names: Iterable[str]) -> list[str]:
    """The local names at which there is neither a file nor a folder; of URLs the store is asked later."""
    return [name for name in names if not remote.is_remote(name) and not os.path.exists(name)]


def matching(name: str) -> tuple[list[str], list[str]]:
    """The local recordings and folders of recordings that match a pattern (``*``, ``?``, ``[...]``, ``**``),
    by name, and the other files; ``name`` itself if it is none, or no file matches, with the tables beside
    the recordings in a folder.

    A folder with a ``metadata.yaml`` that matches stands for the files in it. Raises UnreadableRecording if
    none of what matches may be a recording.
    """
    if remote.is_remote(name):
        return [name], []
    if os.path.lexists(name):
        inside = _files_in(name)  # none if it is no folder
        tables = _tables_among(inside)
        is_whole = os.path.exists(os.path.join(name, _METADATA))
        return [name], [] if is_whole or not recordings_among(inside) else tables
    found = sorted(glob(name, recursive=True))
    whole = {one.rstrip(os.sep) for one in found if os.path.exists(os.path.join(one, _METADATA))}
    single = [one for one in found if os.path.dirname(one) not in whole]
    folders = [one for one in single if os.path.isdir(one)]
    files = [one for one in single if not os.path.isdir(one)]
    chosen = [one for one in files if _may_be_recording(one)]
    chosen += [one for one in folders if one.rstrip(os.sep) in whole or recordings_among(_files_in(one))]
    if found and not chosen:
        raise UnreadableRecording(
            f"{name}: none of the {len(found)} files and folders that match holds poses"
        )
    return sorted(chosen) or [name], sorted({*files}.difference(chosen))


def _may_be_recording(path: str) -> bool:
    """Whether a file is a recording by its name or its content; what cannot be read counts as one."""
    if path.lower().endswith(SUFFIXES) or not os.path.exists(path):
        return True
    try:
        return os.path.isfile(path) and may_be_recording(path)
    except (OSError, UnreadableRecording):
        return True


def find(names: Iterable[str]) -> Iterator[Found]:
    """Each recording once, with folders replaced by the recordings in them, by name.

    A folder with a ``metadata.yaml`` is one recording. Missing ones are included; their result is that they
    cannot be read. Raises UnreadableRecording for a folder without recordings, UsageError where two URLs
    differ only in their query, and MissingExtra.
    """
    found_before = dict[str, str]()
    for found in chain.from_iterable(map(_found, names)):
        shown = remote.shown(found.name)
        before = found_before.setdefault(shown, found.name)
        if before is found.name:
            yield found
        elif before != found.name:
            raise UsageError(f"two URLs differ only after {shown}, which is not stored: take one")


def _found(name: str) -> Iterator[Found]:
    if remote.is_remote(name):
        files = remote.files_in(name)
        if files is None:
            yield Found(name, "")
            return
        inside = _require_recordings(name, files)
        for one, parts in inside.items():
            yield Found(one, remote.joined(files[part] for part in parts), name)
    else:
        yield from (Found(one, signature_of(one)) for one in recordings_in(os.path.abspath(name)))


def recordings_in(name: str) -> list[str]:
    """The recordings of a local file or folder, by name; raises UnreadableRecording if it has none."""
    if not os.path.isdir(name) or os.path.exists(os.path.join(name, _METADATA)):
        return [name]
    return list(_require_recordings(name, _files_in(name)))


def _require_recordings(folder: str, files: Collection[str]) -> dict[str, Sequence[str]]:
    inside, tables = recordings_among(files), _tables_among(files)
    if not inside:
        remedy = f"; name its tables, as {pattern_beside(tables[0])}" if tables else ""
        raise UnreadableRecording(
            f"{remote.shown(folder)}: this folder holds no recording ({', '.join(SUFFIXES)}){remedy}"
        )
    return inside


def _tables_among(files: Iterable[str]) -> list[str]:
    return sorted(one for one in files if one.lower().endswith(_OF_TABLES))


def pattern_beside(table: str) -> str:
    """The files of the same suffix in the folder of a table, for a shell; of URLs, which are no patterns, the
    table itself."""
    if remote.is_remote(table):
        return shlex.quote(remote.shown(table))
    folder, name = os.path.split(table)
    return shlex.quote(os.path.join(escape(folder), f"*{os.path.splitext(name)[1]}"))


def _files_in(folder: str) -> list[str]:
    return [os.path.join(where, name) for where, _, names in os.walk(folder) for name in names]


def recordings_among(files: Collection[str]) -> dict[str, Sequence[str]]:
    """The recordings among the paths ``files`` with the files that each consists of, sorted.

    A folder with a ``metadata.yaml`` is one of all files in it.
    """
    whole = {os.path.dirname(path) for path in files if os.path.basename(path) == _METADATA}
    found: dict[str, list[str]] = {}
    for path in sorted(files):
        if (folder := os.path.dirname(path)) in whole:
            found.setdefault(folder, []).append(path)
        elif path.lower().endswith(SUFFIXES):
            found[path] = [path]
    return {name: found[name] for name in sorted(found)}


def files_of(name: str) -> list[str]:
    """The files of a local recording; raises UnreadableRecording."""
    beside = os.path.join(name, _METADATA)
    return [*([beside] if os.path.isfile(beside) else []), *parts_of(name)]


def signature_of(name: str) -> str:
    """Size, modification time and inode of its files; equal signatures mean equal content, unless the time
    was set back. Empty if it cannot be read."""
    try:
        states = [os.stat(path) for path in files_of(name)]
    except (OSError, UnreadableRecording, ValueError):
        return ""
    return " ".join(f"{one.st_size:x}.{one.st_mtime_ns:x}.{one.st_ino:x}" for one in states)


def read_content(name: str) -> tuple[str, int]:
    """A hash of a recording's files (BLAKE2b, 32 hexadecimal digits), and their size in bytes. Raises
    OSError, or UnreadableRecording if one of its files is missing or not a regular file."""
    found, size = hashlib.blake2b(digest_size=16), 0
    for path in files_of(name):
        descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
        with open(descriptor, "rb") as file:
            state = os.fstat(descriptor)
            if (reason := why_not_regular(state.st_mode)) is not None:
                raise UnreadableRecording(f"{path}: {reason}")
            found.update(f"{state.st_size} ".encode())
            while block := file.read(_BLOCK):
                found.update(block)
                size += len(block)
    return found.hexdigest(), size
