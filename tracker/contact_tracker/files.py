"""Files as a whole: reading of regular files of limited size, and atomic writing.

Libraries that take time to load are imported on first use, so that help texts are fast.
"""

import errno
import os
import re
import stat
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Final

TEMPORARY: Final = ".contact-tracker-"
"""Beginning of the names of temporary files."""
_NO_LINK: Final = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0)
MOST_PARTS: Final = 64
"""Largest number of parts of a key in TOML."""
_KEY_PART: Final = r"""(?:[A-Za-z0-9_-]+|"[^"\n]*"|'[^'\n]*')"""
_BLANK: Final = r"[ \t]*+"  # possessive: no backtracking, so that the search takes linear time
_LONG_KEY: Final = re.compile(
    rf"(?:^|[{{,]){_BLANK}\[{{0,2}}+{_BLANK}{_KEY_PART}(?:{_BLANK}\.{_BLANK}{_KEY_PART}){{{MOST_PARTS},}}",
    re.MULTILINE,
)


def read_regular(path: Path, most_bytes: int) -> bytes:
    """The content of a regular file; devices may be endless, and pipes may block.

    Raises
    ------
    OSError
        The file cannot be read, is not regular, or has more than ``most_bytes``.
    """
    status, content = os.stat(path), b""
    if (reason := why_not_regular(status.st_mode)) is not None:
        raise OSError(errno.EINVAL, reason)
    if status.st_size <= most_bytes:
        no_wait = getattr(os, "O_NONBLOCK", 0)  # for the other end of a pipe, by which it may be replaced
        with open(path, "rb", opener=lambda name, flags: os.open(name, flags | no_wait)) as file:
            content = file.read(most_bytes + 1) or b""
    if max(status.st_size, len(content)) > most_bytes:  # some files have content but size 0
        raise OSError(errno.EFBIG, f"it is larger than {most_bytes / 1e6:g} MB")
    return content


def why_not_regular(mode: int) -> str | None:
    """Why a path with this ``st_mode`` is not a regular file, or None."""
    if stat.S_ISREG(mode):
        return None
    return "it is a folder" if stat.S_ISDIR(mode) else "it is not a regular file"


def parse_toml(text: str) -> dict[str, Any]:
    """The table of a text in TOML, in bounded time: the standard library's time grows with the square of the
    number of a key's parts.

    Raises
    ------
    ValueError, RecursionError
        The text is not TOML, or nested too deeply.
    """
    if text.count(".") > MOST_PARTS and _LONG_KEY.search(text):
        raise ValueError(f"a key has more than {MOST_PARTS} parts")
    import tomllib

    return tomllib.loads(text)


def why_not_replaceable(path: Path) -> str | None:
    """Why ``path`` (or the target of a link there) cannot be replaced by a file, or None."""
    try:
        mode = os.lstat(os.path.realpath(path)).st_mode
    except FileNotFoundError:
        return None
    except OSError as error:
        return error.strerror or str(error)
    return why_not_regular(mode)


def why_not_writable(path: Path) -> str | None:
    """Why no file can be made or replaced at ``path`` (or the target of a link there), or None."""
    folder = (Path(os.path.realpath(path)) if path.is_symlink() else path).parent
    if not os.path.isdir(folder):
        return f"there is no folder {folder}"
    if (refusal := why_not_replaceable(path)) is not None:
        return refusal
    import tempfile

    try:  # rights do not show all reasons, as in /proc
        with tempfile.TemporaryFile(dir=folder, prefix=TEMPORARY, suffix=".part"):
            return None
    except OSError as error:
        return f"the folder {folder} is not writable ({error.strerror or error})"


def accept_any() -> None:
    """The check of ``whole_file`` that accepts any file."""


@contextmanager
def whole_file(path: Path, check: Callable[[], None] = accept_any) -> Iterator[Path]:
    """A context with a temporary file that replaces ``path`` on success and is removed on any failure.

    It is in the same folder, so that the last step is a rename, and has another suffix, so that nobody
    mistakes it for a result. Its name is unpredictable. It gets the mode of a replaced file, and where
    permitted its owner and group.

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
    try:
        replaced = os.lstat(target)
    except FileNotFoundError:
        replaced = None
    temporary = target.with_name(f"{TEMPORARY}{os.urandom(8).hex()}.part")
    made = True
    try:
        try:
            # readable by the owner only, as the replaced file may be
            flags, mode = os.O_CREAT | os.O_EXCL | os.O_RDWR, 0o666 if replaced is None else 0o600
            descriptor = os.open(str(temporary), flags | _NO_LINK, mode)
        except OSError:  # not after an interrupt: the file may be there
            made = False
            raise
        try:
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


def _finish(temporary: Path, descriptor: int, replaced: os.stat_result | None) -> None:
    """Check that ``temporary`` is still the file that was made; give it owner and mode of ``replaced``."""
    if not os.path.samestat(os.fstat(descriptor), os.lstat(str(temporary))):
        raise OSError(errno.EBUSY, "another file was put in its place", str(temporary))
    if replaced is None or os.name != "posix":
        return
    for owner, group in ((replaced.st_uid, -1), (-1, replaced.st_gid)):
        with suppress(OSError):  # only root may change owners; users change groups to theirs
            os.fchown(descriptor, owner, group)
    mode = stat.S_IMODE(replaced.st_mode) & 0o777
    if os.fstat(descriptor).st_gid != replaced.st_gid:  # a different group gets the rights of everybody
        mode &= ~0o070 | mode << 3
    os.fchmod(descriptor, mode)
