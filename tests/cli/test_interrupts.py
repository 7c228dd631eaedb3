"""Ctrl-C at any moment: exit code 130 and no traceback."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from command_line import ENVIRONMENT, ROOT

LOG = str(ROOT / "recordings" / "paper_experiment.mcap")
AS_A_MODULE = "import runpy; runpy.run_module('contact_tracker', run_name='__main__')"
AS_A_PROGRAM = "import sys; from contact_tracker.__main__ import main; sys.exit(main())"  # what pip writes
# An interrupt as the N-th module is looked for.
AT_AN_IMPORT = """
import os, signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)
left = int(os.environ["IMPORTS"])
def count(event, _):
    global left
    left -= event == "import"
    if left == 0 and event == "import":
        os.kill(os.getpid(), signal.SIGINT)
import runpy
import contact_tracker  # nothing in it; from here on it is ours
sys.addaudithook(count)
"""
# Interrupts come through as soon as the first line of ours runs; until then it is Python that starts.
ONCE_STARTED = """
import signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
def let_through(event, arguments):
    if event == "import" and arguments[0] == "contact_tracker.interrupts":
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
sys.addaudithook(let_through)
print(flush=True)
"""


def assert_ended_in_order(code: int, messages: str) -> None:
    assert "Traceback" not in messages
    assert "KeyboardInterrupt" not in messages
    assert "Error" not in messages
    assert code == 130, messages


@pytest.mark.long
@pytest.mark.parametrize("start", [AS_A_MODULE, AS_A_PROGRAM], ids=["module", "program"])
def test_an_interrupt_during_imports_ends_in_order(start: str) -> None:
    """Also during imports of numpy and scipy, which raise other errors."""
    for number in (4, 632, 946) if start is AS_A_MODULE else (318,):
        command = [sys.executable, "-c", AT_AN_IMPORT + start, "live", LOG, "--rate", "1"]
        environment = ENVIRONMENT | {"IMPORTS": str(number)}
        done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60)
        assert_ended_in_order(done.returncode, done.stderr)


@pytest.mark.parametrize(
    ("start", "arguments"),
    [
        (AS_A_MODULE, ["live", LOG, "--rate", "1"]),
        (AS_A_PROGRAM, ["segment", LOG, "--processes", "2", "-o", "out.csv"]),
    ],
    ids=["live", "segment"],
)
def test_an_interrupt_at_any_time_ends_in_order(start: str, arguments: list[str], tmp_path: Path) -> None:
    for delay_s in [i / 30 for i in range(start is AS_A_PROGRAM, 30, 15)]:
        with subprocess.Popen(
            [sys.executable, "-c", ONCE_STARTED + start, *arguments],
            env=ENVIRONMENT,
            cwd=tmp_path,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        ) as process:
            process.stdout.readline()
            time.sleep(delay_s)
            os.killpg(process.pid, signal.SIGINT)
            _, messages = process.communicate(timeout=60)
        assert_ended_in_order(process.returncode, messages)
        assert list(tmp_path.iterdir()) == []


def test_background_jobs_that_ignore_interrupts_go_on_ignoring_them() -> None:
    program = "import signal; from contact_tracker.interrupts import end_in_order; end_in_order('SIGINT'); "
    program += "signal.raise_signal(signal.SIGINT)"
    done = subprocess.run(
        [sys.executable, "-c", program],
        env=ENVIRONMENT,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_IGN),
    )
    assert done.returncode == 0


HELD = """
class Held:
    def __del__(self):
        signal.raise_signal(signal.{})
"""
PROGRAMS = {
    "an interrupt that Python cannot raise is repeated": (
        "SIGINT",
        HELD.format("SIGINT"),
        "Held()\n    time.sleep(10)",
        "except KeyboardInterrupt:\n    print('interrupted')",
    ),
    "so is a request to end": (
        "SIGTERM",
        HELD.format("SIGTERM"),
        "Held()\n    time.sleep(8)",
        "finally:\n    print('released')",
    ),
    "incomplete objects after an interrupt end silently": (
        "SIGINT",
        """
class Half:
    def __init__(self):
        signal.raise_signal(signal.SIGINT)
        self.whole = True
    def __del__(self):
        self.whole
""",
        "Half()",
        "except KeyboardInterrupt:\n    print('interrupted')",
    ),
    "an interrupt, also in another thread, waits until children have ended": (
        "SIGINT",
        """
def interrupt():
    time.sleep(0.1)
    signal.pthread_kill(threading.get_ident(), signal.SIGINT)
threading.Thread(target=interrupt).start()
""",
        "with deferred('SIGINT'):\n        time.sleep(0.3)\n        ended = 'interrupted'",
        "except KeyboardInterrupt:\n    print(ended)",
    ),
}


def run_interruptible(program: str) -> "subprocess.CompletedProcess[str]":
    imports = (
        "import signal, sys, threading, time\nfrom contact_tracker.interrupts import deferred, end_in_order\n"
    )
    return subprocess.run(
        [sys.executable, "-c", imports + program],
        env=ENVIRONMENT,
        capture_output=True,
        text=True,
        timeout=9,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )


@pytest.mark.parametrize("name", PROGRAMS)
def test_signals_in_the_midst_of_things(name: str) -> None:
    number, definitions, body, end = PROGRAMS[name]
    done = run_interruptible(f"end_in_order('{number}')\n{definitions}\ntry:\n    {body}\n{end}\n")
    expected = ("interrupted\n", 0) if number == "SIGINT" else ("released\n", 128 + signal.SIGTERM)
    assert (done.stdout, done.returncode, done.stderr) == (*expected, "")


def test_errors_after_an_interrupt_that_python_cannot_raise_are_silent() -> None:
    program = (
        HELD.format("SIGINT")
        + """
from contact_tracker.__main__ import main
from contact_tracker.cli import main as command
def run():
    Held()
    raise ValueError("half a result")
command.run = run
sys.exit(main())
"""
    )
    done = run_interruptible(program)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "")
    unharmed = run_interruptible(program.replace("    Held()\n", ""))
    assert (unharmed.returncode, "half a result" in unharmed.stderr) == (1, True)
