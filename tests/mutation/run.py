"""Mutation tests: put small faults into the core, one at a time, and list those that no test finds.

    python tests/mutation/run.py
    python tests/mutation/run.py --only hypotheses/evidence.py --every 5

Tests run once, and are watched: a fault is tried with those that run its line, the quick ones first, until
one fails, or those of ``--budget`` seconds have passed. Survivors are printed: a test is missing, or the
fault changes nothing that matters.
"""

import argparse
import importlib
import os
import resource
import sys
import time
from collections import defaultdict
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import hypothesis
import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "tracker" / "contact_tracker"
sys.path.insert(0, str(Path(__file__).parent))

from mutants import Mutant, apply, mutants_of  # noqa: E402  the path comes first

TESTS: dict[str, list[str]] = {
    "contacts": [
        "contacts",
        "map/test_element_prior.py",
        *(f"hypotheses/test_{name}.py" for name in ("evidence", "gauss_newton", "parity")),
    ],
    "hypotheses/evidence.py": ["hypotheses", "tracking/test_ambiguity.py"],
    "hmm": ["hmm"],
    "motion/losses.py": ["motion/test_losses.py", "motion/test_tick_averaging.py"],
    "motion/pose_validation.py": [
        f"motion/test_{name}.py" for name in ("pose_validation", "gate_limits", "excursions", "default_poses")
    ],
    "motion/tick_averaging.py": ["motion"],
    "motion/window.py": ["motion", "hypotheses"],
    "sequences/pair_hmm.py": ["sequences/test_pair_hmm.py"],
    "tracking/ambiguity.py": ["tracking/test_ambiguity.py"],
}
"""Folders or files of the package, and where under tests/ their tests are."""
EXAMPLES = 10
SLOW = {"test_compiled_build.py"}
"""It compiles."""
LIMIT_S = 10.0
LIMIT_BYTES = 4 * 2**30


class Coverage(NamedTuple):
    """What the tests ran: by test its seconds, and by (file, line) the tests."""

    seconds: dict[str, float]
    lines: dict[tuple[str, int], set[str]]


class Plugin:
    """Runs inside pytest once the tests are collected, in place of its own loop."""

    def __init__(self, files: list[str], budget_s: float, every: int) -> None:
        self.files, self.budget_s, self.every = files, budget_s, every
        self.failed = False
        self.survivors = list[str]()
        self.tried = self.unreached = 0

    def pytest_internalerror(self, excrepr: Any) -> None:
        print(excrepr, file=sys.stderr)

    def pytest_runtest_logreport(self, report: Any) -> None:
        self.failed |= report.failed

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        self.items = {item.nodeid: item for item in session.items if not (SLOW & set(item.path.parts))}
        for item in self.items.values():
            _try_few_examples(item)
        coverage = self._watch()
        names = [f"contact_tracker.{file.removesuffix('.py').replace('/', '.')}" for file in self.files]
        modules = [importlib.import_module(name.removesuffix(".__init__")) for name in names]
        ours = [m for n, m in sys.modules.items() if n.startswith("contact_tracker")]
        for file, module in zip(self.files, modules, strict=True):
            for mutant in islice(mutants_of(PACKAGE, file), 0, None, self.every):
                self.tried += 1
                tests = self._tests(mutant, coverage)
                self.unreached += not tests
                usual_s = sum(coverage.seconds[test] for test in tests)
                if not tests or self._survives(mutant, module, ours, tests, usual_s):
                    self.survivors.append(mutant.name)
        return True

    def _watch(self) -> Coverage:
        """Run the tests once, each line of the files traced."""
        watched = {str(PACKAGE / file): file for file in self.files}
        seconds, lines = dict[str, float](), defaultdict[tuple[str, int], set[str]](set)
        now = ""

        def trace(frame: Any, event: str, _: Any) -> Any:
            file = watched.get(frame.f_code.co_filename)
            if file is None:
                return None
            lines[file, frame.f_lineno].add(now)
            return trace

        for name, item in self.items.items():
            now, begin_s = name, time.process_time()
            sys.settrace(trace)
            try:
                self._run(item)
            finally:
                sys.settrace(None)
            seconds[name] = time.process_time() - begin_s
            if self.failed:
                raise pytest.UsageError(f"{name} fails as it is")
        return Coverage(seconds, lines)

    def _tests(self, mutant: Mutant, coverage: Coverage) -> list[str]:
        found = set[str]()
        if mutant.place.endswith("()"):
            found = set(coverage.lines.get((mutant.file, mutant.line), ()))
        else:  # a constant: whatever runs a line with its name, or any line of the file
            text = (PACKAGE / mutant.file).read_text(encoding="utf-8").splitlines()
            named = [n for n, line in enumerate(text, 1) if mutant.place.split(".")[0] in line]
            found = set().union(*(coverage.lines.get((mutant.file, n), set()) for n in named))
            if not found:
                found = set().union(
                    *(tests for (file, _), tests in coverage.lines.items() if file == mutant.file)
                )
        chosen, left_s = list[str](), self.budget_s
        for name in sorted(found, key=lambda test: (coverage.seconds[test], test)):
            left_s -= coverage.seconds[name]
            if chosen and left_s < 0.0:
                break
            chosen.append(name)
        return chosen

    def _run(self, item: Any) -> None:
        item.config.hook.pytest_runtest_protocol(item=item, nextitem=None)

    def _survives(
        self, mutant: Mutant, module: Any, ours: list[Any], tests: list[str], usual_s: float
    ) -> bool:
        """In a process of its own: a fault that takes time or memory without end ends it, as a test would."""
        pid = os.fork()
        if pid:
            return os.waitpid(pid, 0)[1] == 0
        limit_s = int(LIMIT_S + 5.0 * usual_s)
        resource.setrlimit(resource.RLIMIT_CPU, (limit_s, limit_s))
        resource.setrlimit(resource.RLIMIT_AS, (LIMIT_BYTES, LIMIT_BYTES))
        code = 1
        try:
            apply(mutant, module, ours)
            for name in tests:
                self._run(self.items[name])
                if self.failed:
                    break
            code = 1 if self.failed else 0
        finally:
            os._exit(code)


def _try_few_examples(item: Any) -> None:
    """Faults show in the first examples, or hardly ever."""
    name = "_hypothesis_internal_use_settings"
    if (given := getattr(getattr(item, "obj", None), name, None)) is not None:
        setattr(item.obj, name, hypothesis.settings(given, max_examples=min(given.max_examples, EXAMPLES)))


def files_of(only: str | None) -> tuple[list[str], list[str]]:
    """The files to put faults into, and the tests."""
    files, tests = list[str](), list[str]()
    for name, where in TESTS.items():
        path = PACKAGE / name
        some = (
            [p.relative_to(PACKAGE).as_posix() for p in sorted(path.glob("*.py"))]
            if path.is_dir()
            else [name]
        )
        some = [file for file in some if only is None or file.startswith(only)]
        if some:
            files += some
            tests += [str(ROOT / "tests" / place) for place in where]
    return files, sorted(set(tests))


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", help="files of the package whose path begins so")
    parser.add_argument("--budget", type=float, default=2.0, help="seconds of tests a fault (default: 2)")
    parser.add_argument("--every", type=int, default=1, metavar="N", help="try one of N faults only")
    args = parser.parse_args()
    files, tests = files_of(args.only)
    if not files:
        parser.error(f"no file of {PACKAGE.name} begins with {args.only!r}")
    quick = {"derandomize": True, "database": None, "deadline": None}
    phases = (hypothesis.Phase.explicit, hypothesis.Phase.generate)
    hypothesis.settings.register_profile("mutation", phases=phases, **quick)
    hypothesis.settings.load_profile("mutation")
    plugin = Plugin(files, args.budget, args.every)
    options = ["-p", "no:cacheprovider", "-p", "no:terminal", "-p", "no:xdist", f"--rootdir={ROOT}"]
    code = pytest.main([*options, "-c", str(ROOT / "pyproject.toml"), *tests], plugins=[plugin])
    if code:
        print(f"pytest ended with {code!r} after {plugin.tried} faults", file=sys.stderr)
        return int(code)
    unreached = f"{plugin.unreached} of these in lines that no test runs"
    print(f"{plugin.tried} faults, {len(plugin.survivors)} not found, {unreached}")
    print(*(f"survives: {name}" for name in plugin.survivors), sep="\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
