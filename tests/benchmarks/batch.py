"""Reliability and speed of ``contact-tracker batch`` with many recordings: one row for each, also for broken
ones and after a killed run, and the time that it takes.

    python tests/benchmarks/batch.py                    # 200 simulated recordings and 5 broken ones
    python tests/benchmarks/batch.py --pairs 5 --some 24

Wall times mean little on a machine with other load: runs that are compared alternate, and the CPU time of all
processes of a run is given beside the wall time (for a cluster, the CPU time of the command alone).
"""

import argparse
import os
import resource
import shutil
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from contact_tracker.recording import write_recording
from contact_tracker.states import CONTACTS
from contact_tracker_lab.simulate import Scenario, simulate
from contact_tracker_lab.simulate.scenarios import Phase

ROOT = Path(__file__).resolve().parents[2]
PROGRAM = [sys.executable, "-m", "contact_tracker", "batch"]
ENVIRONMENT = os.environ | {"PYTHONPATH": str(ROOT / "tracker")}
PHASE_S = 1.5
BROKEN = 5


class Run(NamedTuple):
    """Wall time, CPU time of all processes, exit code and text on stderr."""

    wall_s: float
    cpu_s: float
    code: int
    messages: str


def make_recordings(folder: Path, count: int) -> None:
    """``count`` simulated recordings of one or two contacts, and ``BROKEN`` files without any."""
    folder.mkdir()
    for i in range(count):
        phases = tuple(Phase(CONTACTS[(i * step + i // 6) % 6], PHASE_S) for step in (1, 5))
        made = simulate(Scenario(phases[:1] if phases[0] == phases[1] else phases), i)
        write_recording(str(folder / f"{i:04d}.mcap"), made.poses, made.truth, made.metadata)
    whole = (folder / "0000.mcap").read_bytes()
    (folder / "broken_empty.mcap").write_bytes(b"")
    (folder / "broken_short.mcap").write_bytes(whole[:200])
    (folder / "broken_zeros.mcap").write_bytes(bytes(5000))
    (folder / "broken_text.mcap").write_text("no recording\n")
    (folder / "broken_link.mcap").symlink_to("nowhere.mcap")


def batch(*arguments: object) -> Run:
    """Run the command to its end."""
    before, begin_s = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
    done = subprocess.run([*PROGRAM, *map(str, arguments)], env=ENVIRONMENT, capture_output=True, text=True)
    wall_s, after = time.monotonic() - begin_s, resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return Run(wall_s, cpu_s, done.returncode, done.stderr)


def kill_in_the_middle(recordings: Path, dataset: Path, count: int) -> int:
    """Kill a run once half of the segments are written; returns their number."""
    command = [*PROGRAM, str(recordings), "--output", str(dataset), "--processes", "2"]
    with subprocess.Popen(command, env=ENVIRONMENT, stderr=subprocess.DEVNULL) as process:
        while (written := len(list(dataset.glob("segments/*/*.parquet")))) < count // 2:
            assert process.poll() is None, "it ended before it was killed"
            time.sleep(0.02)
        process.send_signal(signal.SIGKILL)
        process.wait()
    return written


def contents(dataset: Path) -> dict[str, bytes]:
    """The content of all files below a folder, by name."""
    return {
        str(path.relative_to(dataset)): path.read_bytes() for path in dataset.rglob("*") if path.is_file()
    }


@contextmanager
def local_cluster(workers: int) -> Iterator[str]:
    """The address of a Dask scheduler with ``workers`` workers of one thread each."""
    from distributed import LocalCluster

    with LocalCluster(  # type: ignore[no-untyped-call]
        n_workers=workers, threads_per_worker=1, processes=True, dashboard_address=":0"
    ) as cluster:
        yield cluster.scheduler_address


def check_runs(folder: Path, count: int) -> None:
    """A first run, a second one, and the continuation of a killed one."""
    recordings, dataset, killed = folder / "recordings", folder / "dataset", folder / "killed"
    first = batch(recordings, "--output", dataset, "--processes", 2)
    print(f"first run:  {first.wall_s:7.1f} s, {first.cpu_s:7.1f} s of CPU, exit code {first.code}")
    print(first.messages.splitlines()[-1].rpartition("; ")[0])
    rows = list(read_summary(dataset))
    bad = sum(code not in (0, 3) for code in rows)
    print(f"rows {len(rows)} of {count + BROKEN}, {bad} of them of {BROKEN} broken recordings")
    assert (len(rows), bad) == (count + BROKEN, BROKEN)
    again = batch(recordings, "--output", dataset, "--processes", 2)
    print(f"second run: {again.wall_s:7.1f} s, {again.cpu_s:7.1f} s of CPU, exit code {again.code}")
    print(again.messages.splitlines()[-1].rpartition("; ")[0])
    written = kill_in_the_middle(recordings, killed, count)
    rest = batch(recordings, "--output", killed, "--processes", 2)
    print(f"killed with {written} of {count} segmented; the rest took {rest.wall_s:.1f} s")
    print(rest.messages.splitlines()[-1].rpartition("; ")[0])
    same = contents(dataset) == contents(killed)
    print(f"the same dataset, to the byte: {same}")
    assert same
    files = contents(dataset)
    segments = [len(data) for name, data in files.items() if name.startswith("segments")]
    per_row = len(files["summary.parquet"]) / len(rows), len(files["signatures.parquet"]) / len(rows)
    print(
        f"bytes a recording: {statistics.mean(segments):.0f} of segments, {per_row[0]:.0f} of summary, ",
        end="",
    )
    print(f"{per_row[1]:.0f} of signatures")


def read_summary(dataset: Path) -> list[int]:
    """The exit codes in the summary of a dataset."""
    import duckdb

    found = duckdb.execute(f"SELECT exit_code FROM '{dataset}/summary.parquet'").fetchall()
    return [int(code) for (code,) in found]


def compare(folder: Path, some: int, pairs: int) -> None:
    """One process, two, and a cluster of two, alternately on the same recordings."""
    recordings = sorted((folder / "recordings").glob("[0-9]*.mcap"))[:some]
    some = len(recordings)
    names = [str(path) for path in recordings]
    ways: dict[str, list[Run]] = {"one process": [], "two processes": [], "LocalCluster of two": []}
    with local_cluster(2) as address:
        options: dict[str, tuple[object, ...]] = {
            "one process": ("--processes", 1),
            "two processes": ("--processes", 2),
            "LocalCluster of two": ("--scheduler", address),
        }
        results = set[tuple[tuple[str, bytes], ...]]()
        for turn in range(pairs):
            for way in list(ways)[turn % 3 :] + list(ways)[: turn % 3]:
                dataset = folder / "compared"
                ways[way].append(batch(*names, "--output", dataset, *options[way]))
                assert ways[way][-1].code == 0, ways[way][-1].messages
                results.add(tuple(sorted(contents(dataset).items())))
                shutil.rmtree(dataset)
    print(f"{some} recordings, {pairs} turns; the datasets of all runs are the same: {len(results) == 1}")
    assert len(results) == 1
    for way, runs in ways.items():
        ratios = [one.wall_s / other.wall_s for one, other in zip(ways["one process"], runs, strict=True)]
        wall_s, cpu_s = (statistics.median(values) for values in zip(*(run[:2] for run in runs), strict=True))
        figures = f"{wall_s:6.1f} s, {cpu_s:6.1f} s of CPU, {some / wall_s:5.2f} recordings/s"
        speed = f"{statistics.median(ratios):.2f} times as fast as one process"
        print(f"{way:<20} {figures}; {speed} ({spread(ratios)} in {pairs} pairs)")


def spread(values: list[float]) -> str:
    return f"{min(values):.2f} to {max(values):.2f}"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--recordings", type=int, default=200)
    parser.add_argument("--some", type=int, default=40, help="number of recordings in runs that are compared")
    parser.add_argument("--pairs", type=int, default=3)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        make_recordings(folder / "recordings", args.recordings)
        print(f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")
        check_runs(folder, args.recordings)
        compare(folder, args.some, args.pairs)
        print(f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")


if __name__ == "__main__":
    main()
