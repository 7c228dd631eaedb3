"""Copies from a remote store stay in their folder and are limited in size."""

import shutil
import tempfile
from pathlib import Path
from typing import Any, Self

import pytest
from fsspec import AbstractFileSystem

from contact_tracker.batch import remote
from contact_tracker.batch.remote import copy_folder
from contact_tracker.errors import UnreadableRecording


class StoreWithOddNames:
    """A remote store, in which a key leads out of its folder."""

    def find(self, path: str, detail: bool) -> dict[str, dict[str, int]]:
        assert detail
        return {f"{path}/part.mcap": {}, f"{path}/../../out.mcap": {}}

    def get_file(self, name: str, target: str, callback: Any) -> None:
        Path(target).write_text(name)


def test_names_of_a_store_stay_in_the_folder(tmp_path: Path) -> None:
    with pytest.raises(OSError, match="leads out of the folder"):
        copy_folder(StoreWithOddNames(), "bucket/bag", str(tmp_path / "a" / "b"))
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
    ("store", "name"),
    [
        (Store(), "log.mcap"),
        (Store(10), "log.mcap"),
        (Store(10), "bag/"),
        (Store(10**15), "log.mcap"),
        (Store(0, EndlessFile(0)), "bag/"),
    ],
    ids=["size not said", "size wrong", "folder", "too long", "empty files"],
)
def test_copies_of_recordings_in_stores_have_a_size_limit(
    store: Store, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(remote, "_opened", lambda _: (store, name))
    monkeypatch.setattr(remote, "MOST_BYTES", 20 * 2**20)
    with pytest.raises(UnreadableRecording, match="longer than"), remote.local_copy(f"endless://{name}"):
        pass
    assert store.file.read_bytes <= 40 * 2**20
    assert not list(tmp_path.iterdir())


def test_copies_of_recordings_in_stores_leave_free_space(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(remote, "_opened", lambda _: (Store(10), "log.mcap"))
    monkeypatch.setattr(remote, "_LEFT_BYTES", shutil.disk_usage(tmp_path).free - 8 * 2**20)
    with pytest.raises(UnreadableRecording, match="no room"), remote.local_copy("endless://log.mcap"):
        pass
    assert not list(tmp_path.iterdir())
