"""The steps of documentation pages, and running them in a folder.

Blocks marked ``bash`` have a command a line; blocks marked ``python`` are run as they are. A ``text`` block
after one is its output, of the last command; ``...`` stands for the rest.
"""

import os
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

from command_line import Done, run

ROOT = Path(__file__).resolve().parents[2]
FENCED = re.compile(r"^```(bash|python|text)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
SETUP = {"python3 -m venv .venv", ".venv/bin/pip install -q -e '.[all]'", "source .venv/bin/activate"}
"""Installation by the reader, not needed here."""


class Step(NamedTuple):
    """A command or a piece of Python, and the output that the page shows."""

    language: str
    code: str
    shown: str


def steps(text: str) -> Iterator[Step]:
    """The steps of a page in order."""
    blocks = FENCED.findall(text)
    for (language, block), (next_language, next_block) in pairwise([*blocks, ("", "")]):
        shown = next_block if next_language == "text" else ""
        if language == "python":
            yield Step(language, block, shown)
        elif language == "bash":
            commands = [line for line in block.splitlines() if line not in SETUP]
            for command in commands:
                yield Step(language, command, shown if command is commands[-1] else "")


def carried_out(step: Step, folder: Path) -> "subprocess.CompletedProcess[str] | Done":
    """Run a step where ``contact-tracker`` and ``python`` are this checkout's; a command alone in this
    process."""
    if step.code.startswith("contact-tracker ") and not set("|<>&;*") & set(step.code.replace("->", "")):
        return run(*shlex.split(step.code)[1:], cwd=folder)
    environment = os.environ | {"PYTHONPATH": str(ROOT / "tracker"), "PYTHON": sys.executable}
    programs = 'contact-tracker() { "$PYTHON" -m contact_tracker "$@"; }\npython() { "$PYTHON" "$@"; }\n'
    shell = ["bash", "-c", programs + step.code]
    command = shell if step.language == "bash" else [sys.executable, "-c", step.code]
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)


def loosely(output: str) -> list[str]:
    """Lines with numbers masked and spaces joined: figures may differ from machine to machine."""
    return [" ".join(NUMBER.sub("N", line).split()) for line in output.splitlines() if line.strip()]


def assert_shown(step: Step, output: str) -> None:
    """Check that lines agree; a last line ``...`` on the page stands for the rest."""
    expected, got = loosely(step.shown), loosely(output)
    if expected[-1] == "...":
        expected.pop()
        got = got[: len(expected)]
    assert got == expected, f"$ {step.code}"
