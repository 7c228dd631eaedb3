"""The steps of documentation pages, and running them in a folder.

A block marked ``console`` has commands after ``$ ``, each followed by its output; ``...`` stands for the rest
of that. Blocks marked ``python`` are run as they are; a ``text`` block after one is its output.
"""

import os
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from itertools import pairwise, takewhile
from pathlib import Path
from typing import NamedTuple

from command_line import Done, run

ROOT = Path(__file__).resolve().parents[2]
FENCED = re.compile(r"^```(console|python|text)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
SETUP = {
    "$ python3 -m venv .venv",
    "$ .venv/bin/pip install -q -e '.[all]'",
    "$ source .venv/bin/activate",
}
"""Installation by the reader, not needed here."""


class Step(NamedTuple):
    """A command or a piece of Python, and the output that the page shows."""

    language: str
    code: str
    shown: str


def steps(text: str) -> Iterator[Step]:
    """The steps of a page in order; a text block shows the output of the Python before it."""
    blocks = FENCED.findall(text)
    for (language, block), (next_language, next_block) in pairwise([*blocks, ("", "")]):
        if language == "python":
            yield Step(language, block, next_block if next_language == "text" else "")
        elif language == "console":
            lines = block.splitlines()
            assert lines[0].startswith("$ "), f"a console block starts with a command: {lines[0]}"
            for i, line in enumerate(lines):
                if line.startswith("$ ") and line not in SETUP:
                    shown = takewhile(lambda following: not following.startswith("$ "), lines[i + 1 :])
                    yield Step(language, line[2:], "\n".join(shown))


def carried_out(step: Step, folder: Path) -> "subprocess.CompletedProcess[str] | Done":
    """Run a step where ``contact-tracker`` and ``python`` are this checkout's; a command alone in this
    process."""
    if step.code.startswith("contact-tracker ") and not set("|<>&;*") & set(step.code.replace("->", "")):
        return run(*shlex.split(step.code)[1:], cwd=folder)
    environment = os.environ | {"PYTHONPATH": str(ROOT / "tracker"), "PYTHON": sys.executable}
    programs = 'contact-tracker() { "$PYTHON" -m contact_tracker "$@"; }\npython() { "$PYTHON" "$@"; }\n'
    shell = ["bash", "-c", programs + step.code]
    command = shell if step.language == "console" else [sys.executable, "-c", step.code]
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
