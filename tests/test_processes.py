"""Processes of batch and calibrate: killed, interrupted, or left alone."""

import os
import signal
import sys
import time
from collections.abc import Callable, Collection, Iterator
from concurrent import futures
from concurrent.futures import Future
from contextlib import contextmanager
from functools import partial
from multiprocessing import active_children
from pathlib import Path
from typing import Any

import pytest

from contact_tracker import processes
from contact_tracker.errors import ContactTrackerError
from contact_tracker.processes import Workers, local_processes

pytestmark = pytest.mark.skipif(os.name != "posix", reason="needs signals")


def prepare() -> None:
    """Nothing has to be done first."""


def square(number: int, fatal: tuple[int, ...], once: str) -> int:
    """The square; the process is killed for a ``fatal`` number, for 100 the first time only."""
    time.sleep(0.01)
    if number in fatal:
        os.kill(os.getpid(), signal.SIGKILL)
    if number == 100 and not Path(once).exists():
        Path(once).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    if number == 404:
        raise OSError(28, "No space left on device", "there")
    return number**2


def test_a_job_that_kills_its_own_process_is_given_up_and_no_other_is_lost(tmp_path: Path) -> None:
    fatal, numbers = (3, 17), [100, *range(20)]
    jobs = ((number, fatal, str(tmp_path / "once")) for number in numbers)
    (tmp_path / "started").mkdir()
    with local_processes(2, partial(note_start, tmp_path / "started")) as call:
        answers = [(job[0], answer) for job, answer in call(square, jobs)]
    assert len(answers) == len(numbers)
    assert dict(answers) == {number: None if number in fatal else number**2 for number in numbers}
    assert len(list((tmp_path / "started").iterdir())) <= 2 + (1 + 2) + len(fatal) * (1 + 1 + 2)


def note_start(folder: Path) -> None:
    (folder / str(os.getpid())).touch()


def test_no_job_is_lost_where_all_at_work_have_ended_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    def wait(at_work: Collection[Future[int]], **options: Any) -> Any:
        time.sleep(0.1)
        return futures.wait(at_work, **options)

    monkeypatch.setattr(processes, "wait", wait)
    with local_processes(1, prepare) as call:
        assert sorted(answer for _, answer in call(abs, ((-n,) for n in range(5)))) == [*range(5)]


def slowly(jobs: list[tuple[int, tuple[int, ...], str]]) -> Iterator[tuple[int, tuple[int, ...], str]]:
    """Jobs between which idle processes are killed."""
    for job in jobs:
        for process in active_children():
            process.kill()
            process.join()
        time.sleep(0.2)
        yield job


def test_a_process_that_ends_while_idle_is_replaced() -> None:
    with local_processes(1, prepare) as call:
        answers = call(square, slowly([(number, (), "") for number in range(3)]))
        assert sorted(answer for _, answer in answers) == [0, 1, 4]


def test_what_a_function_raises_ends_the_run() -> None:
    jobs = [(404, (), ""), *((number, (), "") for number in range(50))]
    with (
        pytest.raises(OSError, match="No space left on device: 'there'"),
        local_processes(2, prepare) as call,
    ):
        list(call(square, jobs))


def die() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def test_processes_that_cannot_start_are_reported() -> None:
    with pytest.raises(ContactTrackerError, match="a process has ended"), local_processes(2, die) as call:
        list(call(square, [(1, (), "")]))


def wait_for_ever(folder: str) -> None:
    """A job that removes its file when it is interrupted."""
    try:
        (Path(folder) / f"{os.getpid()}").touch()
        time.sleep(600)
    finally:
        (Path(folder) / f"{os.getpid()}").unlink()


@contextmanager
def interrupted_once(is_due: Callable[[], bool]) -> Iterator[None]:
    def look(*_: object) -> None:
        if is_due():
            signal.setitimer(signal.ITIMER_REAL, 0)
            signal.raise_signal(signal.SIGINT)

    before = signal.signal(signal.SIGALRM, look)
    interrupt = signal.signal(signal.SIGINT, signal.default_int_handler)  # jobs in the background ignore it
    signal.setitimer(signal.ITIMER_REAL, 0.2, 0.2)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
        signal.signal(signal.SIGINT, interrupt)


def test_running_jobs_are_ended_at_once_and_clean_up(tmp_path: Path) -> None:
    begin_s = time.monotonic()
    with (
        pytest.raises(KeyboardInterrupt),
        local_processes(2, prepare) as call,
        interrupted_once(lambda: len(list(tmp_path.iterdir())) == 2),  # both jobs run
    ):
        next(call(wait_for_ever, [(str(tmp_path),)] * 5))
    assert time.monotonic() - begin_s < 100
    assert list(tmp_path.iterdir()) == []


def meet(number: int, folder: str) -> bool:
    """Whether two jobs run at the same time."""
    (Path(folder) / str(number)).touch()
    give_up = time.monotonic() + 20
    while not (Path(folder) / str(1 - number)).exists() and time.monotonic() < give_up:
        time.sleep(0.01)
    return (Path(folder) / str(1 - number)).exists()


def test_few_jobs_are_shared_by_all_processes(tmp_path: Path) -> None:
    with local_processes(2, prepare) as call:
        assert all(answer for _, answer in call(meet, [(number, str(tmp_path)) for number in range(2)]))


def note(folder: str, number: int) -> None:
    time.sleep(0.2)
    (Path(folder) / str(number)).touch()


def test_an_error_of_the_caller_ends_workers_without_the_work_that_waits(tmp_path: Path) -> None:
    def fail_in_the_middle() -> None:
        with Workers(2, prepare) as executor:
            executor.submit(abs, 1).result()
            for number in range(20):
                executor.submit(note, str(tmp_path), number)
            raise OSError("full")

    with pytest.raises(OSError, match="full"):
        fail_in_the_middle()
    assert len(list(tmp_path.iterdir())) <= 6
    assert not active_children()


class Killing:
    """An argument that kills the process to which it is given."""

    name = "killing"

    def __reduce__(self) -> tuple[Callable[[int], object], tuple[int]]:
        return os._exit, (9,)


def test_commands_of_the_lab_say_in_one_line_that_a_process_was_killed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from contact_tracker_lab import physics  # not in the processes of other tests: it takes time to load
    from contact_tracker_lab.benchmark.runner import measured

    monkeypatch.setattr(physics, "_engine", prepare)
    monkeypatch.setattr(physics, "make", print)
    monkeypatch.setattr(physics, "SETS", {"set": (Killing(),)})
    with pytest.raises(SystemExit):
        physics.main([str(tmp_path), "--processes", "1"])
    assert "error: a process has ended before its work was done" in capsys.readouterr().err
    with pytest.raises(ContactTrackerError, match="a process has ended"):
        dict(measured(print, {"set": [(Killing(),)]}, 1))


def test_a_text_that_ends_a_function_is_given_to_the_caller() -> None:
    with pytest.raises(SystemExit, match="no such"), Workers(1) as pool:
        pool.submit(sys.exit, "no such").result()
