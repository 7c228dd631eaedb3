"""A killed worker process of a command, as when memory runs out: one line, exit code 1."""

import os
import signal
import subprocess
import time
from pathlib import Path

import pytest

from command_line import ENVIRONMENT, PROGRAM, ROOT

LOG = str(ROOT / "recordings" / "paper_experiment.mcap")
SEGMENT = ["segment", LOG, "--processes", "3", "-o", "out.csv"]
CALIBRATE = [
    "calibrate",
    *(str(ROOT / "recordings" / f"{name}.mcap") for name in ("robot_1khz", "vision_30hz")),
    "--only",
    "transitions",
    "--processes",
    "2",
    "-o",
    "out.toml",
]
PROC = Path("/proc")

pytestmark = pytest.mark.skipif(not PROC.is_dir(), reason="needs a system that lists processes in files")


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


def assert_same_as_undisturbed(arguments: list[str], folder: Path, output: str) -> None:
    other = folder / "undisturbed"
    other.mkdir()
    command = [*PROGRAM, *arguments]
    done = subprocess.run(command, env=ENVIRONMENT, cwd=other, capture_output=True, text=True, check=True)
    assert output == done.stdout
    assert (folder / arguments[-1]).read_bytes() == (other / arguments[-1]).read_bytes()


@pytest.mark.parametrize(
    ("arguments", "delay_s"),
    [(SEGMENT, 0.02), (SEGMENT, 0.4), (CALIBRATE, 0.4)],
    ids=["segment at once", "segment", "calibrate"],
)
def test_a_helper_that_is_killed_is_one_line_and_1(
    arguments: list[str], delay_s: float, tmp_path: Path
) -> None:
    with subprocess.Popen(
        [*PROGRAM, *arguments],
        env=ENVIRONMENT,
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        while not (helpers := helpers_of(process.pid)):
            assert process.poll() is None
            time.sleep(0.002)
        time.sleep(delay_s)
        os.kill(helpers[0], signal.SIGKILL)
        output, messages = process.communicate(timeout=60)
    if not process.returncode:  # it had no work yet, and was replaced: nothing is lost
        assert_same_as_undisturbed(arguments, tmp_path, output)
        return
    assert (process.returncode, output) == (1, ""), messages
    (line,) = messages.splitlines()
    assert line.startswith("contact-tracker: error: a process has ended before its work was done")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("arguments", [SEGMENT, CALIBRATE], ids=["segment", "calibrate"])
def test_helpers_end_with_the_process_that_started_them(arguments: list[str], tmp_path: Path) -> None:
    with (
        open(tmp_path / "stderr", "w") as stderr,
        subprocess.Popen(
            [*PROGRAM, *arguments],
            env=ENVIRONMENT,
            cwd=tmp_path,
            stdout=subprocess.DEVNULL,
            stderr=stderr,
        ) as process,
    ):
        while len(helpers := helpers_of(process.pid)) < 2:
            assert process.poll() is None
            time.sleep(0.01)
        time.sleep(0.3)  # until then it is multiprocessing that starts them
        process.kill()
        process.wait()
    give_up = time.monotonic() + 60
    while any((PROC / str(helper)).exists() and is_running(helper) for helper in helpers):
        assert time.monotonic() < give_up
        time.sleep(0.05)
    assert "Traceback" not in (tmp_path / "stderr").read_text()


def is_running(pid: int) -> bool:
    """Whether a process is running, and not a zombie."""
    try:
        return (PROC / str(pid) / "stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False
