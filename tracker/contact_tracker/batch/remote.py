"""Recordings in remote stores, by fsspec (the extra ``remote``): listed, and copied while they are read."""

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
"""What stores say of a version of a file. Of those that say none, nothing but the content tells."""

MOST_BYTES: Final = 64 * 2**30
"""A recording that is copied is at most so long, all its files together."""
_LEFT_BYTES: Final = 2**30
"""So much of the disk with the copies is left free."""
_FILE_BYTES: Final = 4096
"""A file takes as much of a disk, also if it is empty."""


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
    with _told_of(url):
        return _files_in(filesystem, path) if _is_folder(filesystem, url, path) else None


def signature_of(url: str) -> str:
    """Size and version of a file, or of all in a folder, as the store tells them; empty where it does not.

    Raises
    ------
    UnreadableRecording
        It is not there, or cannot be reached.
    """
    filesystem, path = _opened(url)
    with _told_of(url):
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
    """That of several files; empty if one of them is."""
    given = list(signatures)
    return " ".join(given) if all(given) else ""


@contextmanager
def local_copy(url: str) -> Iterator[str]:
    """A copy on this machine, as long as it is needed.

    Raises
    ------
    UnreadableRecording
        It cannot be copied, is longer than ``MOST_BYTES``, or there is no room for it.
    """
    filesystem, path = _opened(url)
    with tempfile.TemporaryDirectory(prefix="contact-tracker-") as folder:
        target = os.path.join(folder, posixpath.basename(path.rstrip("/")) or "recording")
        with _told_of(url):
            if _is_folder(filesystem, url, path):
                copy_folder(filesystem, path, target)
            else:
                _Copier(filesystem, folder).copy(path, target, filesystem.info(path))
        yield target


def copy_folder(filesystem: Any, path: str, target: str) -> None:
    """Copy all files below ``path``; a name that leads elsewhere is none of them."""
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
    """Copies files into ``folder``, all together no longer than they may be."""

    def __init__(self, filesystem: Any, folder: str) -> None:
        self._filesystem, self._folder = filesystem, folder
        self._copied = 0

    def copy(self, name: str, target: str, info: Mapping[str, Any]) -> None:
        """Copy a file; raises OSError if it is too long, whatever ``info`` says of its size."""
        from fsspec.callbacks import Callback

        self._check(info.get("size") or 0, 0)
        coming = Callback(hooks={"length": lambda size, done, **_: self._check(max(size or 0, done), done)})
        self._filesystem.get_file(name, target, callback=coming)
        size = os.path.getsize(target)
        self._check(size, size)
        self._copied += max(size, _FILE_BYTES)

    def _check(self, size: int, done: int) -> None:
        """Of a file of at least ``size`` bytes, ``done`` of them are copied."""
        if self._copied + size > MOST_BYTES:
            raise OSError(f"it is longer than {MOST_BYTES >> 30} GiB: copy it to a disk, and read it there")
        if shutil.disk_usage(self._folder).free < size - done + _LEFT_BYTES:
            raise OSError(f"no room for a copy in {tempfile.gettempdir()}: TMPDIR says where copies go")


def _is_folder(filesystem: Any, url: str, path: str) -> bool:
    """What has a suffix is not asked for: some stores send all of it as the answer."""
    return url.endswith("/") or (not posixpath.splitext(path)[1] and bool(filesystem.isdir(path)))


def _files_in(filesystem: Any, path: str) -> dict[str, str]:
    found = filesystem.find(path, detail=True)
    return {str(filesystem.unstrip_protocol(name)): _signature(info) for name, info in found.items()}


@contextmanager
def _told_of(url: str) -> Iterator[None]:
    """Each store raises errors of its own."""
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
    except Exception as error:  # each store raises its own
        raise UnreadableRecording(f"{url}: {_line(error)}") from error


def _signature(info: Mapping[str, Any]) -> str:
    version = [f"{key}={info[key]}" for key in _VALIDATORS if info.get(key)]
    return " ".join([f"{info.get('size')}", *version]) if version else ""


def _line(error: BaseException) -> str:
    return f"{type(error).__name__}: {' '.join(str(error).split())}"
