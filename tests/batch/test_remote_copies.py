"""Copies from a remote store stay in their folder and are limited in size."""

import shutil
import tempfile
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any, ClassVar, Self
from unittest.mock import Mock

import pytest
from fsspec import AbstractFileSystem

from contact_tracker.batch import remote
from contact_tracker.batch.remote import copy_folder
from contact_tracker.errors import UnreadableRecording


def test_names_of_a_store_stay_in_the_folder(tmp_path) -> None:
    store = Mock(get_file=lambda name, target, callback: Path(target).write_text(name))
    store.find.return_value = {"bucket/bag/part.mcap": {}, "bucket/bag/../../out.mcap": {}}
    with pytest.raises(OSError, match="leads out of the folder"):
        copy_folder(store, "bucket/bag", str(tmp_path / "a" / "b"))
    assert not list(tmp_path.glob("*.mcap"))


class EndlessFile:
    """Counts the bytes read; gives the requested bytes, or ``at_once`` of them."""

    def __init__(self, at_once: int | None = None) -> None:
        self.read_bytes, self.at_once = 0, at_once

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def read(self, count: int) -> bytes:
        count = count if self.at_once is None else self.at_once
        self.read_bytes += count
        return bytes(count)


class Store(AbstractFileSystem):
    """A remote store with arbitrary metadata of its files."""

    cachable = False

    def __init__(self, said_bytes: int | None = None, file: Any = None) -> None:
        super().__init__()
        self.said_bytes, self.file = said_bytes, EndlessFile() if file is None else file

    def isdir(self, path: str) -> bool:
        return path.endswith("bag/")

    def info(self, path: str, **_: object) -> dict[str, object]:
        return {"name": path, "size": self.said_bytes, "type": "file"}

    def find(self, path: str, *_: object, **__: object) -> dict[str, dict[str, object]]:
        names = (f"{path}{number}.mcap" for number in range(10_000))
        return {name: self.info(name) for name in names}

    def open(self, *_: object, **__: object) -> Any:
        return self.file


@pytest.mark.parametrize(
    ("store", "name", "limit", "words"),
    [
        (Store(), "log.mcap", "MOST_BYTES", "longer than"),
        (Store(10), "log.mcap", "MOST_BYTES", "longer than"),
        (Store(10), "bag/", "MOST_BYTES", "longer than"),
        (Store(10**15), "log.mcap", "MOST_BYTES", "longer than"),
        (Store(0, EndlessFile(0)), "bag/", "MOST_BYTES", "longer than"),
        (Store(10), "log.mcap", "_LEFT_BYTES", "no room"),
    ],
    ids=["size not said", "size wrong", "folder", "too long", "empty files", "full disk"],
)
def test_copies_have_a_size_limit_and_leave_free_space(
    store, name, limit, words, tmp_path, monkeypatch
) -> None:
    free = shutil.disk_usage(tmp_path).free
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(remote, "_open_store", lambda *_: (store, name))
    monkeypatch.setattr(remote, limit, {"MOST_BYTES": 20 * 2**20, "_LEFT_BYTES": free - 8 * 2**20}[limit])
    with pytest.raises(UnreadableRecording, match=words), remote.local_copy(f"endless://{name}"):
        pass
    assert store.file.read_bytes <= 40 * 2**20
    assert not list(tmp_path.iterdir())


class HostileServer(BaseHTTPRequestHandler):
    """A folder with links and redirects that lead out of it; each answer contains what was asked for."""

    links = (
        "a.mcap",
        "../secret/b.mcap",
        "%2e%2e/secret/c.mcap",
        "d.mcap",
        "e.mcap",
        "sub/../../secret/f.mcap",
        "up/",
    )
    redirects: ClassVar[dict[str, str]] = {
        "/logs/d.mcap": "/secret/d.mcap",
        "/logs/e.mcap": "../logs/moved.mcap",
        "/logs/up/": "/secret/",
    }
    asked: ClassVar[list[str]] = []

    def do_GET(self) -> None:
        path = self.path.partition("?")[0]
        self.asked.append(path)
        where = self.redirects.get(path)
        is_folder = path.endswith(("logs", "/"))
        links = "".join(f'<a href="{link}">x</a>' for link in self.links) if is_folder else path
        self.send_response(200 if where is None else 302)
        if where is not None:
            self.send_header("Location", where)
        self.send_header("Content-Type", "text/html" if is_folder else "application/octet-stream")
        self.send_header("Content-Length", str(len(links)))
        self.end_headers()
        if self.command == "GET":
            self.wfile.write(links.encode())

    do_HEAD = do_GET

    def log_message(self, *_: object) -> None:
        pass


@pytest.fixture
def address() -> Iterator[str]:
    server = ThreadingHTTPServer(("127.0.0.1", 0), HostileServer)
    thread = threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True)
    thread.start()
    HostileServer.asked.clear()
    yield f"http://127.0.0.1:{server.server_port}"
    server.shutdown()
    server.server_close()


@pytest.mark.parametrize("folder", ["logs", "logs/"])
def test_nothing_outside_of_a_folder_on_the_web_is_read(address, folder) -> None:
    files = remote.files_in(f"{address}/{folder}")
    assert {name.removeprefix(address) for name in files} == {f"/logs/{name}.mcap" for name in "ade"}
    for name in ("a", "e"):
        with remote.local_copy(f"{address}/logs/{name}.mcap", f"{address}/{folder}") as copy:
            assert Path(copy).read_text() == ("/logs/a.mcap" if name == "a" else "/logs/moved.mcap")
    leads_out = pytest.raises(UnreadableRecording, match=f"{address}/secret/d.mcap is not in the folder")
    with leads_out, remote.local_copy(f"{address}/logs/d.mcap", f"{address}/{folder}"):
        pass
    assert not [path for path in HostileServer.asked if path.startswith("/secret")]
    with remote.local_copy(f"{address}/logs/d.mcap?token=secret") as copy:  # which was named itself
        assert Path(copy).name == "d.mcap"


def test_tokens_of_urls_are_left_out() -> None:
    secret = "https://me:pw@host:8/a/b.mcap?token=T&x=a/b#f"
    assert remote.display_name(secret) == "https://host:8/a/b.mcap"
    assert remote.display_name("s3://key:secret@bucket/a#1.mcap") == "s3://bucket/a#1.mcap"
    text = f"403, url='{secret}' and (abfs://x?sig=S)"
    assert remote.without_secrets(text) == "403, url='https://host:8/a/b.mcap' and (abfs://x"
    assert remote.display_name("/a/b?c.mcap") == "/a/b?c.mcap"
