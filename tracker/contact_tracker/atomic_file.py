"""Files that appear whole or not at all."""

import errno
import os
import platform
import re
import stat
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

from contact_tracker.regular_file import why_not_regular

_MOST_SHOWN: Final = 60
"""Bytes of the target's name in that of a temporary file, which has 255 at most, on some disks 143."""
_NO_LINK: Final = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0)


def why_not_replaceable(path: Path) -> str | None:
    """Why no file can take the place of what is at ``path`` (or where a link there leads), or None."""
    try:
        mode = os.lstat(os.path.realpath(path)).st_mode
    except FileNotFoundError:
        return None
    except OSError as error:
        return error.strerror or str(error)
    return why_not_regular(mode)


def whatever_is_there() -> None:
    """The check of ``whole_file`` where any file may be replaced."""


@contextmanager
def whole_file(path: Path, check: Callable[[], None] = whatever_is_there) -> Iterator[Path]:
    """Give a temporary file beside ``path``; it becomes ``path`` on success and vanishes on any failure.

    It lies in the same folder, so that the last step is one rename, and does not end in the suffix of
    ``path``, so that nobody takes it for a result. Its name cannot be known beforehand. A file that is
    replaced leaves its mode, and where that is permitted its owner and group. What processes of this host
    that were killed have left of ``path`` is removed.

    Parameters
    ----------
    check : called right before the rename: what it raises leaves the file at ``path`` as it is.

    Raises
    ------
    OSError
        If ``path`` is something else than a file: a rename would replace even a device. Of what fails with
        the temporary file it is told as of ``path``.
    """
    refusal = why_not_replaceable(path)
    if refusal is not None:
        raise OSError(errno.EINVAL, f"cannot be written: {refusal}", str(path))
    target = Path(os.path.realpath(path))
    replaced = _status(target)
    _sweep(target)
    temporary = target.with_name(f"{_begin(target)}{os.getpid()}.{os.urandom(8).hex()}.part")
    try:
        # only its user reads what replaces a file that perhaps others may not read
        descriptor = os.open(
            str(temporary),
            os.O_CREAT | os.O_EXCL | os.O_RDWR | _NO_LINK,
            0o666 if replaced is None else 0o600,
        )
    except OSError as error:
        error.filename = str(path)
        raise
    try:
        try:
            _lock(descriptor)
            yield temporary
            _finish(temporary, descriptor, replaced)
        finally:
            os.close(descriptor)  # Windows renames and removes no open file
        check()
        os.replace(temporary, target)
    except OSError as error:
        if error.filename == str(temporary):
            error.filename = str(path)
        raise
    finally:
        temporary.unlink(missing_ok=True)


def _status(target: Path) -> os.stat_result | None:
    """Whose ``target`` is, and who may read and write it; None where there is none."""
    try:
        return os.lstat(target)
    except FileNotFoundError:
        return None


def _finish(temporary: Path, descriptor: int, replaced: os.stat_result | None) -> None:
    """See that ``temporary`` is still the file that was made, and give it the owner and mode of the other."""
    if not os.path.samestat(os.fstat(descriptor), os.lstat(str(temporary))):
        raise OSError(errno.EBUSY, "another file was put in its place", str(temporary))
    if replaced is None or os.name != "posix":
        return
    for owner, group in ((replaced.st_uid, -1), (-1, replaced.st_gid)):
        with suppress(OSError):  # only root gives files away, and others only to groups of theirs
            os.fchown(descriptor, owner, group)
    mode = stat.S_IMODE(replaced.st_mode) & 0o777
    if os.fstat(descriptor).st_gid != replaced.st_gid:  # another group reads no more than everybody does
        mode &= ~0o070 | mode << 3
    os.fchmod(descriptor, mode)


def _begin(target: Path) -> str:
    """How the names of temporary files of ``target`` begin that this host makes."""
    shown = os.fsencode(target.name)[:_MOST_SHOWN].decode("utf-8", "ignore")
    return f".{shown}.{_of_host(target)}."


def _of_host(target: Path) -> str:
    """This host's name, and a number for it and the name of ``target``, however long they are."""
    import hashlib

    host = platform.node()
    names = os.fsencode(target.name) + b"\0" + os.fsencode(host)
    number = hashlib.blake2b(names, digest_size=8).hexdigest()
    return f"{re.sub(r'[^A-Za-z0-9-]', '-', host)[:20]}.{number}"


def _sweep(target: Path) -> None:
    """Remove what processes of this host that have ended left of ``target``."""
    if os.name != "posix":  # elsewhere nothing tells which processes live
        return
    pattern = re.compile(rf"\..*\.{_of_host(target)}\.([0-9]{{1,10}})\.[0-9a-f]{{16}}\.part", re.DOTALL)
    with suppress(OSError):  # a folder that can be written to but not read
        for name in os.listdir(target.parent):
            found = pattern.fullmatch(name)
            if found and not _lives(int(found[1])):
                _remove_unlocked(str(target.with_name(name)))


def _lives(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except OSError:  # it belongs to somebody else
        return True
    try:
        state = Path(f"/proc/{pid}/stat").read_bytes().rpartition(b")")[2].split()[0]
    except (OSError, IndexError):  # a system that does not tell
        return True
    return state not in (b"Z", b"X")  # ended, but nobody has asked how


def _remove_unlocked(path: str) -> None:
    """Remove a regular file that no process has locked, one of another container for example."""
    import fcntl

    with suppress(OSError):
        if not stat.S_ISREG(os.lstat(path).st_mode):
            return
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | _NO_LINK)
        try:
            if stat.S_ISREG(os.fstat(descriptor).st_mode):
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                os.unlink(path)
        finally:
            os.close(descriptor)


def _lock(descriptor: int) -> None:
    """Show others that this process still writes; on disks without locks its number has to do."""
    if os.name == "posix":
        import fcntl

        with suppress(OSError):
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
