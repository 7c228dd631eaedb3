"""The main loop can be read: short functions, shown in the README, and few calls for one tick."""

import ast
import re
import textwrap
from pathlib import Path
from statistics import median

import pytest

from contact_tracker.hypotheses import compiled
from trace_tick import by_file, traced_ticks

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = ROOT / "tracker" / "contact_tracker"
MOST_CALLS, MOST_FILES = 131, 26
"""Calls in the tick of twenty that takes fewest, 126."""


def source(path: str, function: str) -> str:
    """The lines of a method, without its indentation."""
    text = (PACKAGE / path).read_text(encoding="utf-8")
    functions = (one for one in ast.walk(ast.parse(text)) if isinstance(one, ast.FunctionDef))
    (node,) = (one for one in functions if one.name == function)
    return textwrap.dedent("\n".join(text.splitlines()[node.lineno - 1 : node.end_lineno]))


def statements(code: str) -> int:
    """Lines of a function without its docstring."""
    (function,) = ast.parse(code).body
    assert isinstance(function, ast.FunctionDef)
    doc = function.body[0]
    return len(code.splitlines()) - ((doc.end_lineno or 0) - doc.lineno + 1)


@pytest.mark.parametrize(
    ("path", "function", "most"),
    [
        ("tracking/contact_filter.py", "update", 15),
        ("tracker.py", "update", 15),
        ("segmenting.py", "pieces", 20),
    ],
)
def test_the_main_loop_is_short(path: str, function: str, most: int) -> None:
    assert statements(source(path, function)) <= most


def test_the_readme_shows_the_loop_and_where_its_parts_are() -> None:
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    section = readme.split("## How it works")[1].split("\n## ")[0]
    (shown,) = re.findall(r"```py\n(.*?)\n```", section, re.DOTALL)
    assert shown == source("tracking/contact_filter.py", "update")
    named = set()
    for names, places in re.findall(r"^\| (`.*?) \| .*?: (.*) \|$", section, re.MULTILINE):
        targets = re.findall(r"\]\((.*?)\)", places)
        files = [(ROOT / target).read_text(encoding="utf-8") for target in targets]
        for name in re.findall(r"`(\w+)`", names):
            assert any(f"def {name}(" in text for text in files), name
            named.add(name)
    called = [one.func for one in ast.walk(ast.parse(shown)) if isinstance(one, ast.Call)]
    calls = {one.id for one in called if isinstance(one, ast.Name)}
    assert calls - {"replace"} == named


@pytest.mark.long
@pytest.mark.skipif(not compiled.in_use(), reason="counts the calls around the kernels")
def test_one_tick_takes_few_calls() -> None:
    traces = traced_ticks(ROOT / "recordings" / "paper_experiment.mcap")
    assert len(traces) == 20
    assert median(one.total() for one in traces) <= MOST_CALLS
    assert median(len(by_file(one)) for one in traces) <= MOST_FILES
