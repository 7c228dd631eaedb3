"""Hash of the content of a recording's files, and signature of their metadata."""

import hashlib
import os
from typing import Final, NamedTuple

from contact_tracker.errors import UnreadableRecording
from contact_tracker.recording import parts_of
from contact_tracker.regular_file import why_not_regular

_METADATA: Final = "metadata.yaml"
_BLOCK: Final = 2**20


class Content(NamedTuple):
    """A hash of the content (BLAKE2b, 32 hexadecimal digits), and its size in bytes."""

    digits: str
    size_bytes: int


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


def read_content(name: str) -> Content:
    """Hash and size of a recording's files.

    Raises
    ------
    UnreadableRecording
        It does not exist, or one of its files is not a regular file.
    OSError
        A file cannot be read.
    """
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
    return Content(found.hexdigest(), size)
