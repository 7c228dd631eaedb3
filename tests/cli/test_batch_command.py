"""``contact-tracker batch``: killed, interrupted, on a cluster."""

import os
import re
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from pyarrow import parquet

from batches import BROKEN, contents, write_broken, write_recordings
from command_line import ENVIRONMENT, PIPE, Done, started
from command_line import run as command
from pose_tables import TURN, P, T

PROC = Path("/proc")


def batch(*arguments: object, stdin: bytes = b"") -> Done:
    processes = () if {"--processes", "--scheduler"} & set(arguments) else ("--processes", 1)
    return command("batch", *arguments, *processes, stdin=stdin)


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Five recordings that take some tenths of a second each."""
    folder = tmp_path_factory.mktemp("batch") / "logs"
    write_recordings(folder, 5, poses=200)
    return folder


@pytest.fixture(scope="module")
def whole(logs: Path) -> dict[str, bytes]:
    """The dataset of an uninterrupted run."""
    dataset = logs.parent / "whole"
    done = batch(logs, "--output", dataset)
    assert (done.returncode, done.stdout) == (0, ""), done.stderr
    (line,) = done.stderr.splitlines()
    counts = "recordings: 5, of which 5 new or changed, 0 unchanged; 0 unusable, 0 damaged"
    assert line == f"contact-tracker: {counts}; {dataset / 'summary.parquet'}"
    return contents(dataset)


def test_kinds_of_warnings_are_named(tmp_path: Path) -> None:
    rows = (f"{n},{n},{n % 7},0,0,0,0,1\n" for n in range(40))
    table = tmp_path / "a.csv"
    table.write_text("t,x,y,z,qx,qy,qz,qw\n" + "".join(rows))
    (tmp_path / "b.csv").write_bytes(table.read_bytes())
    done = batch(table, tmp_path / "b.csv", "-o", tmp_path / "out")
    assert "warnings: 2 of the new ones have some: " in done.stderr
    assert "have no unit and are taken as milliseconds, with steps of ... (2)" in done.stderr


def test_the_command_that_is_proposed_for_a_table_adds_it_to_the_dataset(tmp_path: Path) -> None:
    degrees = np.column_stack([T, 1e3 * P, TURN.as_euler("xyz", degrees=True)])
    for name in "ab":
        np.savetxt(tmp_path / f"{name}.csv", degrees, "%.9f", ",", header="t,x,y,z,rx,ry,rz", comments="")
    words = "a.csv", "b.csv", "--ticks", "-o", "out", "--processes", 1
    done = command("batch", *words, cwd=tmp_path)
    assert done.returncode == 3
    proposed = re.findall(r"contact-tracker (batch .*?), with your unit", done.stderr)
    assert len(proposed) == 2
    for line in proposed:
        assert "--ticks" in line
        assert "--processes" not in line
        done = command(*shlex.split(line), cwd=tmp_path)
        assert done.returncode == 0, done.stderr
    assert parquet.read_table(tmp_path / "out" / "summary.parquet")["exit_code"].to_pylist() == [0, 0]


@contextmanager
def in_the_middle(logs: Path, dataset: Path) -> "Iterator[subprocess.Popen[bytes]]":
    """A run of which some recordings are done and some are not."""
    words = "batch", logs, "--output", dataset, "--processes", "2"
    with started(*words, stderr=PIPE, start_new_session=True) as process:
        journal = dataset / "journal.jsonl"
        while not journal.is_file() or not journal.stat().st_size:  # the first result is recorded
            assert process.poll() is None
            time.sleep(0.01)
        yield process


def helpers_of(pid: int) -> list[int]:
    """The processes of ``multiprocessing`` that any thread of a process has started."""
    found = []
    for thread in (PROC / str(pid) / "task").iterdir():
        try:
            children = (thread / "children").read_text().split()
            found += [int(c) for c in children if b"spawn_main" in (PROC / c / "cmdline").read_bytes()]
        except OSError:  # it has ended meanwhile
            continue
    return found


def is_running(pid: int) -> bool:
    """Whether a process is running, and not a zombie."""
    try:
        return (PROC / str(pid) / "stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


@pytest.mark.long
def test_a_killed_run_goes_on_to_the_same_dataset(
    logs: Path, whole: dict[str, bytes], tmp_path: Path
) -> None:
    dataset = tmp_path / "dataset"
    with in_the_middle(logs, dataset) as process:
        helpers = helpers_of(process.pid) if PROC.is_dir() else []
        process.kill()
        _, said = process.communicate()
    assert b"Traceback" not in said
    give_up = time.monotonic() + 60
    while any(is_running(helper) for helper in helpers):  # they write no more
        assert time.monotonic() < give_up
        time.sleep(0.02)
    done = batch(logs, "--output", dataset)
    assert done.returncode == 0, done.stderr
    assert " 0 unchanged" not in done.stderr
    assert contents(dataset) == whole


def test_an_interrupt_ends_it_in_order(logs: Path, whole: dict[str, bytes], tmp_path: Path) -> None:
    dataset = tmp_path / "dataset"
    with in_the_middle(logs, dataset) as process:
        os.killpg(process.pid, signal.SIGINT)
        _, said = process.communicate(timeout=60)
    assert (process.returncode, said) == (130, b"")
    files = contents(dataset)
    assert not [name for name in files if name.endswith(".part")]
    rows = parquet.read_table(dataset / "summary.parquet")
    assert 1 <= len(rows) < 5
    assert set(rows["file"].to_pylist()) <= {name.removeprefix("segments/") for name in files}
    assert batch(logs, "--output", dataset).returncode == 0
    assert contents(dataset) == whole


@pytest.mark.long
def test_a_cluster_makes_the_same_dataset(logs: Path, whole: dict[str, bytes], tmp_path: Path) -> None:
    import distributed  # takes time to load

    with (
        pytest.MonkeyPatch.context() as patch,
        distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=":0") as cluster,
    ):
        patch.setenv("PYTHONPATH", ENVIRONMENT["PYTHONPATH"])
        done = batch(logs, "--output", tmp_path / "dataset", "--scheduler", cluster.scheduler_address)
    assert done.returncode == 0, done.stderr
    assert contents(tmp_path / "dataset") == whole
    done = batch(logs, "--output", tmp_path / "other", "--scheduler", "tcp://127.0.0.1:9")
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert line.startswith("contact-tracker: error: no Dask scheduler answers at tcp://127.0.0.1:9: ")


def test_names_come_on_standard_input_and_bad_ones_are_3(tmp_path: Path) -> None:
    """Also those that are gone: lists of names come from other programs."""
    broken = write_broken(tmp_path / "broken")
    names = [*write_recordings(tmp_path / "logs", 1), *broken, tmp_path / "gone.mcap"]
    again = "as before: see the column error of the summary"
    for end, said in ((b"\n", "gone.mcap: no such file"), (b"\0", again)):
        stdin = b"".join(os.fsencode(name) + end for name in names)
        done = batch("-", "--output", tmp_path / "dataset", stdin=stdin)
        assert (done.returncode, done.stdout) == (3, "")
        *lines, last = done.stderr.splitlines()
        assert len(lines) == BROKEN + 1
        assert all(line.startswith("contact-tracker: warning: ") for line in lines)
        assert all(any(str(name) in line for line in lines) for name in names[1:])
        assert any(said in line for line in lines)
        assert f"{BROKEN + 1} unusable" in last
    assert parquet.read_table(tmp_path / "dataset" / "summary.parquet")["exit_code"].to_pylist().count(0) == 1


@pytest.mark.parametrize(
    ("arguments", "stdin", "said"),
    [
        (["-"], "\n", "there are no names of recordings on standard input"),
        (["nothing/"], "", "this folder holds no recording"),
        (["x.mcap", "--model", "no_such"], "", "no_such"),
        (["x.mcap", "--processes", "0"], "", "'0' is not a whole number from 1 to 1024"),
        (["x.mcap", "--processes", "2", "--scheduler", "tcp://a:1"], "", "not allowed with argument"),
        (["s3://logs/"], "", "s3://logs/: addresses are not read: copy the recordings to a disk"),
        (["gone.mcap"], "", "gone.mcap: no such file or folder"),
        (["-"], "a.mcap\n", "a.mcap: no such file or folder, the only name on standard input"),
        (["0.mcap", *"abcd", "-"], "0.mcap\n", "a, b, c and 1 more: no such file or folder; nothing was"),
        (["0.mcap", "-"], "a.mcap\nb\n", "none of the 2 names on standard input exists, such as a.mcap"),
    ],
)
def test_mistakes_are_one_line_before_anything_is_done(
    arguments: list[str], stdin: str, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_recordings(tmp_path, 1)
    (tmp_path / "nothing").mkdir()
    monkeypatch.chdir(tmp_path)
    done = batch(*arguments, "--output", "dataset", stdin=stdin.encode())
    assert done.returncode in (1, 2)
    (line,) = done.stderr.splitlines()
    assert line.startswith("contact-tracker: error: ")
    assert said in line
    assert not (tmp_path / "dataset").exists()


def test_a_missing_extra_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (log,) = write_recordings(tmp_path / "logs", 1)
    monkeypatch.delitem(sys.modules, "contact_tracker.batch.cluster", raising=False)
    monkeypatch.setitem(sys.modules, "distributed", None)
    done = command("batch", log, "--scheduler", "tcp://127.0.0.1:9", "-o", tmp_path / "dataset")
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert "needs distributed: pip install 'contact-tracker[cluster]'" in line


@pytest.mark.parametrize("beside", ["a.mcap", "a.txt"])
def test_the_pattern_that_is_proposed_matches_the_tables(tmp_path: Path, beside: str) -> None:
    table = tmp_path / "my logs" / "take [1]" / "x.TUM"
    table.parent.mkdir(parents=True)
    table.write_text("0 1 2 3 0 0 0 1\n0.1 1 2 3 0 0 0 1\n")
    (tmp_path / "my logs" / beside).touch()
    done = command("batch", "my logs", "-o", "out", "--processes", 1, cwd=tmp_path)
    (told,) = (line for line in done.stderr.splitlines() if ", as " in line)
    shown = subprocess.run(
        ["sh", "-c", f"echo {told.rpartition(', as ')[2]}"], cwd=tmp_path, capture_output=True
    )
    assert (tmp_path / os.fsdecode(shown.stdout.strip())).name == table.name
