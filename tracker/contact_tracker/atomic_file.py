"""Atomic writing of files."""

import errno
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from contact_tracker.regular_file import why_not_regular

TEMPORARY: Final = ".contact-tracker-"
"""What the names of temporary files begin with."""


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
    taken for a result. Its name is unpredictable. A replaced file passes on its mode.

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
    temporary = target.with_name(f"{TEMPORARY}{os.urandom(16).hex()}.part")
    # private while others may not be allowed to read the replaced file
    mode = 0o600 if target.exists() else 0o666
    try:
        os.close(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, mode))
        yield temporary
        if target.exists():
            temporary.chmod(target.stat().st_mode & 0o777)
        check()
        os.replace(temporary, target)
    except OSError as error:
        if error.filename in (temporary, str(temporary)):
            error.filename = str(path)
        raise
    finally:
        temporary.unlink(missing_ok=True)
