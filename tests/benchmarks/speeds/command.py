"""CPU and wall time and peak memory of the command line, run in a process of its own."""

import os
import resource
import subprocess
import sys
import time
from typing import NamedTuple

from speeds.figures import peak_mb


class Ran(NamedTuple):
    cpu_s: float
    peak_mb: float
    exit_code: int


def run(*arguments: str, may_fail: bool = False) -> Ran:
    """Run ``contact-tracker`` to its end; raises CalledProcessError if it fails, unless it may."""
    process = _start(arguments, subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode and not may_fail:
        raise subprocess.CalledProcessError(process.returncode, arguments)
    return Ran(_cpu_s(usage), peak_mb(usage), process.returncode)


def first_lines_s(lines: int, *arguments: str) -> float:
    """Wall time from the start until ``lines`` are on stdout; then the process is ended."""
    begin_s = time.perf_counter()
    process = _start(arguments, subprocess.PIPE)
    assert process.stdout is not None
    with process.stdout as stdout:
        for _ in range(lines):
            if not stdout.readline():
                raise RuntimeError(f"contact-tracker {' '.join(arguments)} printed fewer than {lines} lines")
        taken_s = time.perf_counter() - begin_s
    process.kill()
    process.wait()
    return taken_s


def _start(arguments: tuple[str, ...], stdout: int) -> "subprocess.Popen[bytes]":
    command = [sys.executable, "-m", "contact_tracker", *arguments]
    return subprocess.Popen(command, stdout=stdout, stderr=subprocess.DEVNULL)


def _cpu_s(usage: resource.struct_rusage) -> float:
    return usage.ru_utime + usage.ru_stime
