"""Recordings in remote stores, listed and copied by fsspec (extra ``remote``)."""

import os
import posixpath
import shutil
import tempfile
from collections.abc import Iterable, Iterator, Mapping
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
"""Keys of a file's version in stores' metadata; without one only the content can be compared."""

MOST_BYTES: Final = 64 * 2**30
"""Largest recording that is copied, all files together (bytes)."""
_LEFT_BYTES: Final = 2**30
"""Space that is left free on the disk with the copies (bytes)."""
_FILE_BYTES: Final = 4096
"""Space that even an empty file takes (bytes)."""


def is_remote(name: str) -> bool:
    """Whether a name is a URL."""
    return "://" in name


def files_in(url: str) -> Mapping[str, str] | None:
    """The URLs of all files in a folder with their signatures; None if ``url`` is a file.

    A URL that ends in ``/`` is a folder, one with a suffix is a file; otherwise the store is asked.

    Raises
    ------
    MissingExtra
        A library is not installed.
    UnreadableRecording
        The folder cannot be listed.
    """
    filesystem, path = _opened(url)
    with _store_errors(url):
        return _files_in(filesystem, path) if _is_folder(filesystem, url, path) else None


def signature_of(url: str) -> str:
    """Size and version of a file, or of all in a folder, by the store; empty if it has none.

    Raises
    ------
    UnreadableRecording
        It does not exist or cannot be reached.
    """
    filesystem, path = _opened(url)
    with _store_errors(url):
        if not _is_folder(filesystem, url, path):
            return _signature(filesystem.info(path))
        depth = url.rstrip("/").count("/") + 1
        files = {
            name: signature
            for name, signature in _files_in(filesystem, path).items()
            if name.count("/") == depth
        }
        return joined(files[name] for name in sorted(files))


def joined(signatures: Iterable[str]) -> str:
    """The signature of several files; empty if one of them is."""
    given = list(signatures)
    return " ".join(given) if all(given) else ""


@contextmanager
def local_copy(url: str) -> Iterator[str]:
    """A local copy, removed at the end of the context.

    Raises
    ------
    UnreadableRecording
        It cannot be copied, is larger than ``MOST_BYTES``, or the disk is full.
    """
    filesystem, path = _opened(url)
    with tempfile.TemporaryDirectory(prefix="contact-tracker-") as folder:
        target = os.path.join(folder, posixpath.basename(path.rstrip("/")) or "recording")
        with _store_errors(url):
            if _is_folder(filesystem, url, path):
                copy_folder(filesystem, path, target)
            else:
                _Copier(filesystem, folder).copy(path, target, filesystem.info(path))
        yield target


def copy_folder(filesystem: Any, path: str, target: str) -> None:
    """Copy all files below ``path``; names that lead outside are rejected."""
    begin = path.rstrip("/") + "/"
    os.makedirs(target, exist_ok=True)
    copier = _Copier(filesystem, target)
    for name, info in sorted(filesystem.find(path, detail=True).items()):
        parts = str(name).removeprefix(begin).split("/")
        if not str(name).startswith(begin) or any(
            part in ("", ".", "..") or os.sep in part for part in parts
        ):
            raise OSError(f"the name {name} leads out of the folder")
        own = os.path.join(target, *parts)
        os.makedirs(os.path.dirname(own), exist_ok=True)
        copier.copy(name, own, info)


class _Copier:
    """Copies files into ``folder``, up to the allowed total size."""

    def __init__(self, filesystem: Any, folder: str) -> None:
        self._filesystem, self._folder = filesystem, folder
        self._copied = 0

    def copy(self, name: str, target: str, info: Mapping[str, Any]) -> None:
        """Copy a file; raises OSError if it is too large, whatever size ``info`` declares."""
        from fsspec.callbacks import Callback

        self._check(info.get("size") or 0, 0)
        coming = Callback(hooks={"length": lambda size, done, **_: self._check(max(size or 0, done), done)})
        self._filesystem.get_file(name, target, callback=coming)
        size = os.path.getsize(target)
        self._check(size, size)
        self._copied += max(size, _FILE_BYTES)

    def _check(self, size: int, done: int) -> None:
        """Check the space for a file of at least ``size`` bytes, of which ``done`` are copied."""
        if self._copied + size > MOST_BYTES:
            raise OSError(f"it is longer than {MOST_BYTES >> 30} GiB: copy it to a disk, and read it there")
        if shutil.disk_usage(self._folder).free < size - done + _LEFT_BYTES:
            raise OSError(f"no room for a copy in {tempfile.gettempdir()}: TMPDIR says where copies go")


def _is_folder(filesystem: Any, url: str, path: str) -> bool:
    """Whether a URL is a folder; stores are not asked about a suffix, as some would send the whole file."""
    return url.endswith("/") or (not posixpath.splitext(path)[1] and bool(filesystem.isdir(path)))


def _files_in(filesystem: Any, path: str) -> dict[str, str]:
    found = filesystem.find(path, detail=True)
    return {str(filesystem.unstrip_protocol(name)): _signature(info) for name, info in found.items()}


@contextmanager
def _store_errors(url: str) -> Iterator[None]:
    """Convert the errors of stores to UnreadableRecording."""
    try:
        yield
    except Exception as error:
        raise UnreadableRecording(f"{url}: {_line(error)}") from error


def _opened(url: str) -> tuple[Any, str]:
    with extra("remote", url):
        import fsspec
    try:
        return fsspec.core.url_to_fs(url)  # type: ignore[no-any-return]
    except ImportError as error:  # the library for this store
        raise MissingExtra(f"{url}: {' '.join(str(error).split())}") from error
    except Exception as error:  # stores have no common error
        raise UnreadableRecording(f"{url}: {_line(error)}") from error


def _signature(info: Mapping[str, Any]) -> str:
    version = [f"{key}={info[key]}" for key in _VALIDATORS if info.get(key)]
    return " ".join([f"{info.get('size')}", *version]) if version else ""


def _line(error: BaseException) -> str:
    return f"{type(error).__name__}: {' '.join(str(error).split())}"
