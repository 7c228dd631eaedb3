"""``contact-tracker batch``: killed, interrupted, on a cluster, over the network."""

import os
import shlex
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import fsspec
import pytest
from pyarrow import parquet

from batches import BROKEN, contents, run, write_broken, write_recordings
from command_line import ENVIRONMENT, PIPE, Done, started
from command_line import run as command
from contact_tracker.batch.finding import matching

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


@pytest.mark.parametrize(
    ("library", "extra", "arguments"),
    [
        ("distributed", "cluster", ["--scheduler", "tcp://127.0.0.1:9"]),
        ("fsspec", "remote", ["memory://x.mcap"]),
    ],
)
def test_a_missing_extra_is_one_line(
    library: str, extra: str, arguments: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (log,) = write_recordings(tmp_path / "logs", 1)
    monkeypatch.delitem(sys.modules, "contact_tracker.batch.cluster", raising=False)
    monkeypatch.setitem(sys.modules, library, None)
    done = command("batch", log, *arguments, "-o", tmp_path / "dataset")
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert f"needs {library}: pip install 'contact-tracker[{extra}]'" in line


@contextmanager
def served(folder: Path) -> Iterator[tuple[str, list[str]]]:
    """The address of a web server for a folder, and the paths that were asked of it."""
    asked: list[str] = []

    class Handler(SimpleHTTPRequestHandler):
        def log_message(self, *_: object) -> None:
            asked.append(f"{self.command} {self.path}")

    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(Handler, directory=str(folder)))
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_port}", asked
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


@pytest.mark.long
def test_recordings_are_read_from_the_web(tmp_path: Path) -> None:
    """A server without versions of files: each run reads them, and finds them unchanged."""
    write_recordings(tmp_path / "logs", 2)
    with served(tmp_path / "logs") as (address, asked):
        for expected in ("2 new or changed, 0 unchanged", "0 new or changed, 2 unchanged"):
            asked.clear()
            done = batch(f"{address}/", "--output", tmp_path / "dataset", "--processes", 1)
            assert done.returncode == 0, done.stderr
            assert expected in done.stderr
            assert sum(line.startswith("GET /0.mcap") for line in asked) == 1
        secret = [f"{address}/{name}.mcap?token=SECRET" for name in ("gone", 0)]
        done = batch(*secret, "--output", tmp_path / "dataset", "--processes", 1)
        assert done.returncode == 3
        assert "1 new or changed, 1 unchanged" in done.stderr
        assert "SECRET" not in done.stderr
    table = parquet.read_table(tmp_path / "dataset" / "summary.parquet")
    assert table["recording"].to_pylist() == [f"{address}/{name}.mcap" for name in ("0", "1", "gone")]
    assert table["exit_code"].to_pylist() == [0, 0, 1]
    assert "FileNotFoundError" in table["error"][2].as_py()
    assert not any(
        b"SECRET" in path.read_bytes() for path in (tmp_path / "dataset").rglob("*") if path.is_file()
    )
    assert "SECRET" not in str(table.to_pylist())


def test_recordings_are_read_from_a_store_with_versions(tmp_path: Path) -> None:
    """Those that are as they were are not read again; a folder with its metadata is one recording."""
    store = fsspec.filesystem("memory")
    for path in write_recordings(tmp_path / "logs", 2):
        store.pipe(f"/bucket/logs/{path.name}", path.read_bytes())
        store.pipe(f"/bucket/logs/bag/bag_{path.name}", path.read_bytes())
    store.pipe("/bucket/logs/bag/metadata.yaml", b"rosbag2_bagfile_information: {}\n")
    try:
        outcome = run(["memory://bucket/logs"], tmp_path / "dataset")
        assert (outcome.done, outcome.bad) == (3, 0)
        table = parquet.read_table(tmp_path / "dataset" / "summary.parquet")
        assert table["recording"].to_pylist() == [
            f"memory:///bucket/logs/{name}" for name in ("0.mcap", "1.mcap", "bag")
        ]
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("contact_tracker.batch.remote.local_copy", pytest.fail)
            assert run(["memory://bucket/logs"], tmp_path / "dataset").unchanged == 2 + 1
        store.pipe("/bucket/logs/0.mcap", (tmp_path / "logs" / "1.mcap").read_bytes())
        assert run(["memory://bucket/logs"], tmp_path / "dataset").done == 1
    finally:
        store.rm("/bucket", recursive=True)


@pytest.mark.parametrize("beside", ["a.mcap", "a.txt"])
def test_the_pattern_that_is_proposed_matches_the_tables(tmp_path: Path, beside: str) -> None:
    table = tmp_path / "my logs" / "take [1]" / "x.TUM"
    table.parent.mkdir(parents=True)
    table.write_text("0 1 2 3 0 0 0 1\n0.1 1 2 3 0 0 0 1\n")
    (tmp_path / "my logs" / beside).touch()
    done = command("batch", "my logs", "-o", "out", "--processes", 1, cwd=tmp_path)
    (told,) = (line for line in done.stderr.splitlines() if ", as " in line)
    (pattern,) = shlex.split(told.rpartition(", as ")[2])
    assert matching(str(tmp_path / pattern)) == ([str(table)], [])
