"""Recordings in remote stores, by fsspec (the extra ``remote``): listed, and copied while they are read."""

import os
import posixpath
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
    """A copy on this machine, as long as it is needed; raises UnreadableRecording."""
    filesystem, path = _opened(url)
    with tempfile.TemporaryDirectory(prefix="contact-tracker-") as folder:
        target = os.path.join(folder, posixpath.basename(path.rstrip("/")) or "recording")
        with _told_of(url):
            if _is_folder(filesystem, url, path):
                copy_folder(filesystem, path, target)
            else:
                filesystem.get_file(path, target)
        yield target


def copy_folder(filesystem: Any, path: str, target: str) -> None:
    """Copy all files below ``path``; a name that leads elsewhere is none of them."""
    begin = path.rstrip("/") + "/"
    for name in sorted(filesystem.find(path)):
        parts = str(name).removeprefix(begin).split("/")
        if not str(name).startswith(begin) or any(
            part in ("", ".", "..") or os.sep in part for part in parts
        ):
            raise OSError(f"the name {name} leads out of the folder")
        own = os.path.join(target, *parts)
        os.makedirs(os.path.dirname(own), exist_ok=True)
        filesystem.get_file(name, own)


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
