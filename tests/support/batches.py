"""Recordings for batches, and a batch in this process."""

from collections.abc import Callable, Iterable, Iterator
from contextlib import nullcontext
from pathlib import Path
from typing import Any

from contact_tracker.batch.dataset import Batch, open_dataset
from contact_tracker.batch.finding import find
from contact_tracker.batch.segmenting import Row, Settings
from contact_tracker.config.loading import load_model
from contact_tracker.map.map import EMPTY_MAP
from contact_tracker.recording import write_recording
from mcap_logs import poses_topic, smooth_poses, write_log

MODEL = load_model()
BROKEN = 6


def write_recordings(folder: Path, count: int = 2, poses: int = 60) -> list[Path]:
    """Some short ones that can be segmented."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / f"{i}.mcap" for i in range(count)]
    for i, path in enumerate(paths):
        write_recording(str(path), smooth_poses(poses, seed=i), None, {})
    return paths


def write_broken(folder: Path) -> list[Path]:
    """The ``BROKEN`` recordings, each unusable for another reason."""
    folder.mkdir(parents=True, exist_ok=True)
    whole = write_recordings(folder / "whole", 1)[0].read_bytes()
    contents = {"empty": b"", "short": whole[:200], "zeros": bytes(5000), "text": b"no recording\n"}
    paths = [folder / f"{name}.mcap" for name in contents]
    for path, content in zip(paths, contents.values(), strict=True):
        path.write_bytes(content)
    (folder / "link.mcap").symlink_to("nowhere.mcap")
    poses = smooth_poses()
    topics = [poses_topic(poses, "/a"), poses_topic(poses, "/b")]
    return [*paths, folder / "link.mcap", write_log(folder / "ambiguous.mcap", topics)]


def settings(**options: Any) -> Settings:
    return Settings(options.pop("model", MODEL), EMPTY_MAP, **options)


def run(names: Iterable[object], dataset: Path, new: list[Row] | None = None, **options: Any) -> Batch:
    """A batch in this process; ``new`` collects the new rows."""

    def one_by_one(
        function: Callable[..., Any], jobs: Iterable[tuple[Any, ...]]
    ) -> Iterator[tuple[tuple[Any, ...], Any]]:
        for job in jobs:
            answer = function(*job)
            if new is not None and answer.row is not None:
                new.append(answer.row)
            yield job, answer

    with open_dataset(dataset) as opened:
        batch = Batch(settings(**options), opened, lambda _: None, lambda _: None)
        return batch.run(find(map(str, names)), lambda: nullcontext(one_by_one))


def contents(dataset: Path) -> dict[str, bytes]:
    """All files below a folder."""
    return {
        str(path.relative_to(dataset)): path.read_bytes() for path in dataset.rglob("*") if path.is_file()
    }
