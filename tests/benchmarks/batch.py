"""Time and memory of ``contact-tracker batch``: of short recordings, and for a dataset of very many.

    python tests/benchmarks/batch.py                           # 200 recordings; a million rows, 20,000 files
    python tests/benchmarks/batch.py --recordings 20 --rows 100000 --files 2000

Short recordings are simulated and segmented by the command, twice. Then one recording is segmented; its row
is repeated under other names, and its file is copied: so everything but the segmentation is measured.
"""

import argparse
import hashlib
import os
import resource
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Final, NamedTuple, TypeVar

import duckdb

from contact_tracker.batch import rows
from contact_tracker.batch.dataset import open_dataset
from contact_tracker.batch.finding import find
from contact_tracker.batch.rows import Settings
from contact_tracker.batch.segmenting import Answer, segment_recording
from contact_tracker.config.loading import load_model
from contact_tracker.map.map import EMPTY_MAP
from contact_tracker.processes import local_processes
from contact_tracker.recording import write_recording
from contact_tracker.states import CONTACTS
from contact_tracker_lab.simulate import Scenario, simulate
from contact_tracker_lab.simulate.scenarios import Phase
from speed import run

T = TypeVar("T")
RECORDING = Path(__file__).resolve().parents[2] / "recordings" / "robot_1khz.mcap"
QUERY = "SELECT sum(time_ef_s), count(*) FILTER (exit_code <> 0) FROM '{}/summary.parquet'"
ALL_SEGMENTS = "SELECT contact, count(*) FROM read_parquet('{}/segments/*/*.parquet') GROUP BY contact"
COMPACTED = "COPY (FROM read_parquet('{0}/segments/*/*.parquet')) TO '{0}/all.parquet' (COMPRESSION zstd)"
SETTINGS = Settings(load_model(), EMPTY_MAP)
SAVE_AFTER: Final = 50_000


def timed(text: str, many: int, function: Callable[[], T]) -> T:
    """The result of ``function``, after printing its CPU time, in total and per item."""
    begin_s, begin_cpu_s = time.monotonic(), time.process_time()
    found = function()
    cpu_s, took_s = time.process_time() - begin_cpu_s, time.monotonic() - begin_s
    print(f"{text:<42} {cpu_s:8.2f} s of CPU, {1e6 * cpu_s / many:8.1f} us each ({took_s:.1f} s)", flush=True)
    return found


class Made(NamedTuple):
    """One answer, and the Parquet file of its segments."""

    answer: Answer
    segments: bytes

    def under(self, name: str, number: int) -> Answer:
        """The same answer for another recording."""
        digits = hashlib.blake2b(name.encode(), digest_size=16).hexdigest()
        signature = f"{len(digits) + number:x}.{1_700_000_000_000_000_000 + 977 * number:x}.{number:x}"
        assert self.answer.row is not None
        row = self.answer.row | {"recording": name, "file": rows.file_of(name), "content_hash": digits}
        return Answer(name, signature, row)


def made() -> Made:
    with tempfile.TemporaryDirectory() as folder:
        answer = segment_recording(str(RECORDING), None, SETTINGS, folder)
        assert answer.row is not None
        return Made(answer, (Path(folder) / "segments" / answer.row["file"]).read_bytes())


def record(folder: Path, names: list[str], one: Made, with_files: bool) -> float:
    """Record an answer for each name; returns the CPU time (s) of the last save."""
    with open_dataset(folder) as dataset:
        took_s = 0.0
        for number, name in enumerate(names):
            answer = one.under(name, number)
            if with_files:
                target = folder / "segments" / rows.file_of(name)
                target.parent.mkdir(parents=True, exist_ok=True)
                target.write_bytes(one.segments)
            dataset.record(answer)
            if number % SAVE_AFTER == SAVE_AFTER - 1:
                begin_s = time.process_time()
                dataset.save()
                took_s = time.process_time() - begin_s
        return took_s


def count_known(folder: Path, names: list[str]) -> int:
    """Number of recordings that the dataset has already."""
    with open_dataset(folder) as dataset:
        return sum(dataset.known(name, SETTINGS) is not None for name in names)


def grow(folder: Path, count: int, one: Made) -> None:
    """Growth of the summary and of memory."""
    names = [f"/archive/robot_{i % 100:02d}/2024-01-01/recording_{i:07d}.mcap" for i in range(count)]
    took_s = timed(f"{count} answers recorded", count, lambda: record(folder, names, one, False))
    print(f"the last of the saves, each after {SAVE_AFTER} answers, took {took_s:.2f} s of CPU")
    print(f"memory at most {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MB")
    timed("opened, and one answer saved", count, lambda: record(folder, names[:1], one, False))
    for name in ("summary.parquet", "signatures.parquet"):
        size = (folder / name).stat().st_size
        print(f"{name}: {size / 1e6:.1f} MB, {size / count:.0f} bytes a recording")
    timed("a query of the summary", count, lambda: duckdb.execute(QUERY.format(folder)).fetchall())


def many_files(folder: Path, count: int, one: Made) -> None:
    """Many files of segments, and empty files as recordings."""
    archive = folder.parent / "archive"
    names = [str(archive / f"{i:07d}.mcap") for i in range(count)]
    archive.mkdir()
    for name in names:
        Path(name).touch()
    timed(f"{count} answers recorded with files", count, lambda: record(folder, names, one, True))
    timed("recordings found, with their signatures", count, lambda: list(find([str(archive)])))
    found = timed("opened, and all found unchanged", count, lambda: count_known(folder, names))
    assert found == count
    timed(
        "a query over all files of segments",
        count,
        lambda: duckdb.execute(ALL_SEGMENTS.format(folder)).fetchall(),
    )
    timed("all segments copied into one file", count, lambda: duckdb.execute(COMPACTED.format(folder)))
    size = (folder / "all.parquet").stat().st_size
    print(f"all.parquet: {size / 1e6:.1f} MB, {size / count:.0f} bytes a recording")
    disk = 512 * sum(path.stat().st_blocks for path in (folder / "segments").glob("*/*"))
    print(f"segments on the disk: {disk / count:.0f} bytes a recording")


def segment_short(folder: Path, count: int) -> None:
    """``count`` simulated recordings of one or two contacts, segmented, and found unchanged by a second
    run."""
    recordings, dataset = folder / "recordings", folder / "dataset"
    recordings.mkdir()
    for i in range(count):
        phases = tuple(Phase(CONTACTS[(i * step + i // 6) % 6], 1.5) for step in (1, 5))
        made = simulate(Scenario(phases[:1] if phases[0] == phases[1] else phases), i)
        write_recording(str(recordings / f"{i:04d}.mcap"), made.poses, made.truth, made.metadata)
    for what in ("segmented", "found unchanged"):
        ran = run("batch", str(recordings), "--output", str(dataset), "--processes", "2")
        print(f"{count} short recordings {what}: {ran.cpu_s:.1f} s of CPU, {ran.cpu_s / count:.2f} s each")


def nothing() -> None:
    """No preparation of worker processes."""


def distribute(count: int) -> None:
    """CPU time of this process, including the scheduler, for the distribution of empty jobs."""
    from distributed import LocalCluster

    from contact_tracker.batch.cluster import dask_cluster

    jobs = [(number,) for number in range(count)]
    with local_processes(2, nothing) as call:
        timed(f"{count} jobs to processes", count, lambda: list(call(abs, jobs)))
    with (
        LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=":0") as cluster,  # type: ignore[no-untyped-call]
        dask_cluster(cluster.scheduler_address) as call,
    ):
        timed(f"{count} jobs to a Dask cluster", count, lambda: list(call(abs, jobs)))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--recordings", type=int, default=200)
    parser.add_argument("--rows", type=int, default=1_000_000)
    parser.add_argument("--files", type=int, default=20_000)
    args = parser.parse_args()
    print(f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")
    with tempfile.TemporaryDirectory() as name:
        segment_short(Path(name), args.recordings)
        distribute(2000)
        one = made()
        many_files(Path(name) / "files", args.files, one)
        grow(Path(name) / "rows", args.rows, one)
    print(f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")


if __name__ == "__main__":
    main()
