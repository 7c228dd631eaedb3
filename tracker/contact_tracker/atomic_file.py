"""Atomic writing of files."""

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
"""Bytes of the target's name in that of a temporary file; names have at most 255, on some systems 143."""
_NO_LINK: Final = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0)


def why_not_replaceable(path: Path) -> str | None:
    """Why ``path`` (or the target of a link there) cannot be replaced by a file, or None."""
    try:
        mode = os.lstat(os.path.realpath(path)).st_mode
    except FileNotFoundError:
        return None
    except OSError as error:
        return error.strerror or str(error)
    return why_not_regular(mode)


def accept_any() -> None:
    """The check of ``whole_file`` that accepts any file."""


@contextmanager
def whole_file(path: Path, check: Callable[[], None] = accept_any) -> Iterator[Path]:
    """Give a temporary file that replaces ``path`` on success and is removed on any failure.

    It is in the same folder, so that the last step is a rename, and has another suffix, so that it is not
    taken for a result. Its name is unpredictable. A replaced file passes on its mode, and where permitted
    its owner and group. Temporary files of ``path`` left by killed processes of this host are removed.

    Parameters
    ----------
    check : called right before the rename; if it raises, the file at ``path`` is unchanged.

    Raises
    ------
    OSError
        ``path`` is not a regular file (a rename would replace even a device), or writing failed; errors of
        the temporary file name ``path``.
    """
    refusal = why_not_replaceable(path)
    if refusal is not None:
        raise OSError(errno.EINVAL, f"cannot be written: {refusal}", str(path))
    target = Path(os.path.realpath(path))
    replaced = _status(target)
    _sweep(target)
    temporary = target.with_name(f"{_begin(target)}{os.getpid()}.{os.urandom(8).hex()}.part")
    made = True
    try:
        try:
            # private, as others may not be allowed to read the replaced file
            descriptor = os.open(
                str(temporary),
                os.O_CREAT | os.O_EXCL | os.O_RDWR | _NO_LINK,
                0o666 if replaced is None else 0o600,
            )
        except OSError:  # not after an interrupt: the file may be there
            made = False
            raise
        try:
            _lock(descriptor)
            yield temporary
            _finish(temporary, descriptor, replaced)
        finally:
            os.close(descriptor)  # Windows cannot rename or remove open files
        check()
        os.replace(temporary, target)
    except OSError as error:
        if error.filename == str(temporary):
            error.filename = str(path)
        raise
    finally:
        if made:
            temporary.unlink(missing_ok=True)


def _status(target: Path) -> os.stat_result | None:
    """Owner and mode of ``target``; None if it does not exist."""
    try:
        return os.lstat(target)
    except FileNotFoundError:
        return None


def _finish(temporary: Path, descriptor: int, replaced: os.stat_result | None) -> None:
    """Check that ``temporary`` is still the file that was made; give it the owner and mode of
    ``replaced``."""
    if not os.path.samestat(os.fstat(descriptor), os.lstat(str(temporary))):
        raise OSError(errno.EBUSY, "another file was put in its place", str(temporary))
    if replaced is None or os.name != "posix":
        return
    for owner, group in ((replaced.st_uid, -1), (-1, replaced.st_gid)):
        with suppress(OSError):  # only root may change owners, others only to their groups
            os.fchown(descriptor, owner, group)
    mode = stat.S_IMODE(replaced.st_mode) & 0o777
    if os.fstat(descriptor).st_gid != replaced.st_gid:  # another group gets no more rights than others
        mode &= ~0o070 | mode << 3
    os.fchmod(descriptor, mode)


def _begin(target: Path) -> str:
    """Prefix of the names of this host's temporary files of ``target``."""
    shown = os.fsencode(target.name)[:_MOST_SHOWN].decode("utf-8", "ignore")
    return f".{shown}.{_of_host(target)}."


def _of_host(target: Path) -> str:
    """A part of this host's name, and a hash of it and of the name of ``target``."""
    import hashlib

    host = platform.node()
    names = os.fsencode(target.name) + b"\0" + os.fsencode(host)
    number = hashlib.blake2b(names, digest_size=8).hexdigest()
    return f"{re.sub(r'[^A-Za-z0-9-]', '-', host)[:20]}.{number}"


def _sweep(target: Path) -> None:
    """Remove temporary files of ``target`` left by ended processes of this host."""
    if os.name != "posix":  # process ids cannot be checked elsewhere
        return
    pattern = re.compile(rf"\..*\.{_of_host(target)}\.([0-9]{{1,10}})\.[0-9a-f]{{16}}\.part", re.DOTALL)
    with suppress(OSError):  # a folder that is writable but not readable
        for name in os.listdir(target.parent):
            found = pattern.fullmatch(name)
            if found and not _is_running(int(found[1])):
                _remove_unlocked(str(target.with_name(name)))


def _is_running(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except OSError:  # a process of another user
        return True
    try:
        state = Path(f"/proc/{pid}/stat").read_bytes().rpartition(b")")[2].split()[0]
    except (OSError, IndexError):  # a system without /proc
        return True
    return state not in (b"Z", b"X")  # zombie or dead


def _remove_unlocked(path: str) -> None:
    """Remove a regular file unless a process has locked it, for example in another container."""
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
    """Lock the file while it is written; on file systems without locks the process id has to do."""
    if os.name == "posix":
        import fcntl

        with suppress(OSError):
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
