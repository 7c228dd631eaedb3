"""Recordings in remote stores, listed and copied by fsspec (extra ``remote``).

A folder has the files below its URL: links and redirects that lead out of it are not followed.
"""

import os
import posixpath
import re
import shutil
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, Final
from urllib.parse import unquote, urljoin, urlsplit

from contact_tracker.errors import MissingExtra, UnreadableRecording, extra

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
"""Keys of a file's version in stores' metadata; if all are missing, only the content can be compared."""

MOST_BYTES: Final = 64 * 2**30
"""Largest recording that is copied, all files together (bytes)."""
_LEFT_BYTES: Final = 2**30
"""Space that is left free on the disk with the copies (bytes)."""
_FILE_BYTES: Final = 4096
"""Space that even an empty file takes (bytes)."""
_SECRET: Final = re.compile(
    r"""(?i)(\bhttps?://)(?:[^\s/?#'"<>]*@)?([^\s?#'"<>]*)(?:[?#][^\s'"<>]*)?"""
    r"""|(\b[a-z][a-z0-9+.-]*://)(?:[^\s/?'"<>]*@)?([^\s?'"<>]*)(?:\?[^\s'"<>]*)?"""
)
"""URLs in a text; the parts outside of the groups may be names, passwords and tokens."""
_PORTS: Final = {"http": 80, "https": 443}


class _LeadsOut(OSError):
    """A link or a redirect leads out of the folder."""


def is_remote(name: str) -> bool:
    """Whether a name is a URL."""
    return "://" in name


def without_secrets(text: str) -> str:
    """A text with its URLs cut to scheme, host and path: the rest may be tokens."""
    return _SECRET.sub(r"\1\2\3\4", text)


def display_name(name: str) -> str:
    """The name of a recording in messages and datasets, without secrets."""
    return without_secrets(name) if is_remote(name) else name


def files_in(url: str) -> Mapping[str, str] | None:
    """The URLs of all files in a folder with their signatures; None if ``url`` is a file.

    A URL that ends in ``/`` is a folder, one with a suffix is a file; otherwise the store is asked. Raises
    MissingExtra, or UnreadableRecording if the folder cannot be listed.
    """
    with _store(url, None) as (filesystem, path, is_folder):
        return _files_in(filesystem, path) if is_folder else None


def signature_of(url: str, within: str | None = None) -> str:
    """Size and version of a file, or of all files in a folder, by the store; empty if the store has none.

    ``within`` is the folder in which the URL was found; None if the user named it: then redirects are
    followed. Raises UnreadableRecording if the file does not exist or cannot be reached.
    """
    with _store(url, within) as (filesystem, path, is_folder):
        if not is_folder:
            return _signature(filesystem.info(path))
        depth = url.rstrip("/").count("/") + 1
        files = sorted(_files_in(filesystem, path).items())
        return combined_signature(signature for name, signature in files if name.count("/") == depth)


def combined_signature(signatures: Iterable[str]) -> str:
    """The signature of several files; empty if one of theirs is empty."""
    parts = list(signatures)
    return " ".join(parts) if all(parts) else ""


@contextmanager
def local_copy(url: str, within: str | None = None) -> Iterator[str]:
    """The path of a local copy, removed at the end of the context; ``within`` as in ``signature_of``. Raises
    UnreadableRecording if the copy fails, is larger than ``MOST_BYTES``, or the disk is full."""
    with tempfile.TemporaryDirectory(prefix="contact-tracker-") as folder:
        target = os.path.join(folder, posixpath.basename(without_secrets(url).rstrip("/")) or "recording")
        with _store(url, within) as (filesystem, path, is_folder):
            if is_folder:
                copy_folder(filesystem, path, target)
            else:
                _copy(filesystem, [(path, target, filesystem.info(path))], folder)
        yield target


def copy_folder(filesystem: Any, path: str, target: str) -> None:
    """Copy all files below ``path``; names that lead outside are rejected."""
    begin = path.rstrip("/") + "/"
    os.makedirs(target, exist_ok=True)

    def files() -> Iterator[tuple[str, str, Mapping[str, Any]]]:
        for name, info in sorted(filesystem.find(path, detail=True).items()):
            inside = str(name).removeprefix(begin)
            if not _is_below(str(name), begin) or os.sep in inside.replace("/", ""):
                raise _LeadsOut(f"the name {name} leads out of the folder")
            local_path = os.path.join(target, *inside.split("/"))
            os.makedirs(os.path.dirname(local_path), exist_ok=True)
            yield name, local_path, info

    _copy(filesystem, files(), target)


def _copy(filesystem: Any, files: Iterable[tuple[str, str, Mapping[str, Any]]], folder: str) -> None:
    """Copy files, each by its name, target and metadata of the store, into ``folder``; raises OSError if they
    are too large in all, whatever sizes the store declares."""
    from fsspec.callbacks import Callback

    copied = 0

    def check(size: int, done: int) -> None:
        """Check the space for a file of at least ``size`` bytes, of which ``done`` are copied."""
        if copied + size > MOST_BYTES:
            raise OSError(f"it is longer than {MOST_BYTES >> 30} GiB: copy it to a disk, and read it there")
        if shutil.disk_usage(folder).free < size - done + _LEFT_BYTES:
            raise OSError(f"no room for a copy in {tempfile.gettempdir()}: TMPDIR says where copies go")

    for name, target, info in files:
        check(info.get("size") or 0, 0)
        coming = Callback(hooks={"length": lambda size, done, **_: check(max(size or 0, done), done)})
        filesystem.get_file(name, target, callback=coming)
        size = os.path.getsize(target)
        check(size, size)
        copied += max(size, _FILE_BYTES)


def _is_below(name: str, begin: str) -> bool:
    """Whether a name is below the folder ``begin``, which ends in a slash."""
    parts = unquote(name.removeprefix(begin)).replace("\\", "/").split("/")
    return name.startswith(begin) and not any(part in ("", ".", "..") for part in parts)


def _files_in(filesystem: Any, path: str) -> dict[str, str]:
    """The URLs of the files below a folder with their signatures, without names that lead out of it."""
    entries = filesystem.find(path, detail=True)
    return {
        str(filesystem.unstrip_protocol(name)): _signature(info)
        for name, info in entries.items()
        if _is_below(name, path.rstrip("/") + "/")
    }


def _require_inside(url: str, folder: str) -> None:
    """Raise ``_LeadsOut`` for a URL that is neither ``folder`` nor below it; https may stand for http."""
    address, base = urlsplit(url), urlsplit(folder)
    origins = [(u.scheme, u.hostname, u.port or _PORTS.get(u.scheme)) for u in (base, address)]
    if origins[0][::2] == ("http", 80):
        origins.append(("https", base.hostname, 443))
    begin = base.path.rstrip("/") + "/"
    is_below = address.path in (begin, begin[:-1]) or _is_below(address.path.rstrip("/"), begin)
    if origins[1] not in (origins[0], *origins[2:]) or not is_below:
        raise _LeadsOut(f"{without_secrets(url)} is not in the folder {without_secrets(folder)}")


def _guard(folder: str) -> Any:
    """A configuration of aiohttp that stops requests outside of ``folder``."""
    import aiohttp

    async def check_start(_: Any, __: Any, request: Any) -> None:
        _require_inside(str(request.url), folder)

    async def check_redirect(_: Any, __: Any, request: Any) -> None:
        headers = request.response.headers
        _require_inside(urljoin(str(request.url), headers.get("Location", headers.get("URI", ""))), folder)

    config = aiohttp.TraceConfig()
    config.on_request_start.append(check_start)
    config.on_request_redirect.append(check_redirect)
    return config


@contextmanager
def _store(url: str, within: str | None) -> Iterator[tuple[Any, str, bool]]:
    """The store of a URL, the path in it, and whether it is a folder; errors in the context become
    UnreadableRecording. Stores are not asked about a URL with a suffix, as some would send the whole file."""
    plain = without_secrets(url)
    try:
        filesystem, path = _open_store(url, within)
        has_suffix = bool(posixpath.splitext(plain)[1])
        is_folder = plain.endswith("/") or (not has_suffix and bool(filesystem.isdir(path)))
        if is_folder and within is None:
            filesystem, path = _open_store(url, url)
        yield filesystem, path, is_folder
    except MissingExtra:
        raise
    except Exception as error:  # stores have no common error
        raise UnreadableRecording(f"{plain}: {_one_line(error)}") from error


def _open_store(url: str, within: str | None) -> tuple[Any, str]:
    plain, options = without_secrets(url), dict[str, Any]()
    with extra("remote", plain):
        import fsspec
    try:
        if within is not None and urlsplit(url).scheme in _PORTS:
            options = {"client_kwargs": {"trace_configs": [_guard(within)]}, "skip_instance_cache": True}
        return fsspec.core.url_to_fs(url, **options)  # type: ignore[no-any-return]
    except ImportError as error:  # the library for this store
        raise MissingExtra(f"{plain}: {' '.join(str(error).split())}") from error


def _signature(info: Mapping[str, Any]) -> str:
    version = [f"{key}={info[key]}" for key in _VALIDATORS if info.get(key)]
    return " ".join([f"{info.get('size')}", *version]) if version else ""


def _one_line(error: BaseException) -> str:
    """An error in one line: ``_LeadsOut``, if the store raised another error because of it."""
    cause: BaseException | None = error
    while cause is not None and not isinstance(cause, _LeadsOut):
        cause = cause.__cause__ or cause.__context__
    if cause is not None:
        return str(cause)
    return without_secrets(f"{type(error).__name__}: {' '.join(str(error).split())}")
