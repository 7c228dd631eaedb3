"""Recordings in remote stores, by fsspec (the extra ``remote``): listed, and copied while they are read."""

import os
import posixpath
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any, Final

from contact_tracker.errors import MissingExtra, UnreadableRecording
from contact_tracker.extras import extra

_VALIDATORS: Final = (
    "ETag",
    "etag",
    "mtime",
    "LastModified",
    "last_modified",
    "updated",
    "generation",
    "created",
    "Content-MD5",
)
"""What stores say of a version of a file. Of those that say none, nothing but the content tells."""


def is_remote(name: str) -> bool:
    """Whether a name is a URL."""
    return "://" in name


def files_in(url: str) -> Mapping[str, str] | None:
    """The URLs of all files in a folder with their signatures; None if ``url`` is a file.

    What ends in ``/`` is a folder, what has a suffix is none, and of the rest the store knows.

    Raises
    ------
    MissingExtra
        A library is not installed.
    UnreadableRecording
        The folder cannot be listed.
    """
    filesystem, path = _opened(url)
    try:
        if not url.endswith("/") and (posixpath.splitext(path)[1] or not filesystem.isdir(path)):
            return None
        found = filesystem.find(path, detail=True)
    except Exception as error:  # each store raises its own
        raise UnreadableRecording(f"{url}: {_line(error)}") from error
    return {str(filesystem.unstrip_protocol(name)): _signature(info) for name, info in found.items()}


def signature_of(url: str) -> str:
    """Size and version of a file as its store tells them; empty where it tells no version."""
    filesystem, path = _opened(url)
    try:
        if filesystem.isdir(path):
            return ""
        return _signature(filesystem.info(path))
    except Exception as error:
        raise UnreadableRecording(f"{url}: {_line(error)}") from error


@contextmanager
def local_copy(url: str) -> Iterator[str]:
    """A copy on this machine, as long as it is needed; raises UnreadableRecording."""
    filesystem, path = _opened(url)
    with tempfile.TemporaryDirectory(prefix="contact-tracker-") as folder:
        base = os.path.basename(path.rstrip("/")) or "recording"
        target = os.path.join(folder, base)
        try:
            filesystem.get(path, target, recursive=filesystem.isdir(path))
        except Exception as error:
            raise UnreadableRecording(f"{url}: {_line(error)}") from error
        yield target


def _opened(url: str) -> tuple[Any, str]:
    with extra("remote", url):
        import fsspec
    try:
        return fsspec.core.url_to_fs(url)  # type: ignore[no-any-return]
    except ImportError as error:  # the library for this store
        raise MissingExtra(f"{url}: {' '.join(str(error).split())}") from error
    except Exception as error:
        raise UnreadableRecording(f"{url}: {_line(error)}") from error


def _signature(info: Mapping[str, Any]) -> str:
    version = [f"{key}={info[key]}" for key in _VALIDATORS if info.get(key)]
    return " ".join([f"{info.get('size')}", *version]) if version else ""


def _line(error: BaseException) -> str:
    return f"{type(error).__name__}: {' '.join(str(error).split())}"
