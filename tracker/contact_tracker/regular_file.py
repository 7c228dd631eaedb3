"""Reading of whole files: only regular ones of limited size."""

import errno
import os
import stat
from pathlib import Path


def read_regular(path: Path, most_bytes: int) -> bytes:
    """The content of a regular file; devices may be endless, and pipes may block.

    Raises
    ------
    OSError
        It cannot be read, is not a regular file, or has more than ``most_bytes``.
    """
    _check(os.stat(path), most_bytes)
    with open(path, "rb", opener=_open_at_once) as file:
        _check(os.fstat(file.fileno()), most_bytes)  # it may have been replaced
        content = file.read(most_bytes + 1)
    _check_size(len(content), most_bytes)  # some files have content but size 0
    return content


def why_not_regular(mode: int) -> str | None:
    """Why a path with this ``st_mode`` is not a regular file, or None."""
    if stat.S_ISREG(mode):
        return None
    return "it is a folder" if stat.S_ISDIR(mode) else "it is not a regular file"


def _check(status: os.stat_result, most_bytes: int) -> None:
    reason = why_not_regular(status.st_mode)
    if reason is not None:
        raise OSError(errno.EINVAL, reason)
    _check_size(status.st_size, most_bytes)


def _check_size(size: int, most_bytes: int) -> None:
    if size > most_bytes:
        raise OSError(errno.EFBIG, f"it is larger than {most_bytes / 1e6:g} MB")


def _open_at_once(path: str, flags: int) -> int:
    return os.open(path, flags | getattr(os, "O_NONBLOCK", 0))
