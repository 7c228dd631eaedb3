"""Files that appear whole or not at all."""

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


def why_not_replaceable(path: Path) -> str | None:
    """Why no file can take the place of what is at ``path`` (or where a link there leads), or None."""
    target = os.path.realpath(path)
    if os.path.isfile(target) or not os.path.lexists(target):
        return None
    return "it is a folder" if os.path.isdir(target) else "it is not a regular file"


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Give a temporary path beside ``path``; it becomes ``path`` on success and vanishes on any failure.

    It lies in the same folder, so that the last step is one rename, and does not end in the suffix of
    ``path``, so that nobody takes it for a result.

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
    temporary = target.with_name(f".{target.name}.{os.getpid()}.part")
    try:
        yield temporary
        os.replace(temporary, target)
    except OSError as error:
        if error.filename == str(temporary):
            error.filename = str(path)
        raise
    finally:
        temporary.unlink(missing_ok=True)
