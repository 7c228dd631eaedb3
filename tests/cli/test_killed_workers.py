"""A killed worker process of a command, as when memory runs out."""

import time
from pathlib import Path

import pytest

from command_line import DEVNULL, ROOT, started

LOG = str(ROOT / "recordings" / "robot_1khz.mcap")
SEGMENT = ["segment", LOG, "--processes", "3", "-o", "out.csv"]
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


@pytest.mark.long
def test_helpers_end_with_the_process_that_started_them(tmp_path: Path) -> None:
    with (
        open(tmp_path / "stderr", "w") as stderr,
        started(*SEGMENT, cwd=tmp_path, stdout=DEVNULL, stderr=stderr) as process,
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
