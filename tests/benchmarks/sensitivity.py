"""How sensitive accuracy is to each tuned constant: every one halved and doubled, on recordings with truth.

    python tests/benchmarks/sensitivity.py everyday/*.mcap physics/*/*.mcap --jobs 2

Constants are the module-level ``NAME: Final = number`` of the estimation core, also those that others are
derived from at import: each variant runs in a process of its own, in which the assigned expression is
multiplied before the module is compiled. The compiled kernels have no tuned constants of their own; what they
share with Python is passed to them.
"""

import argparse
import ast
import hashlib
import json
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from importlib.machinery import PathFinder, SourceFileLoader
from importlib.util import find_spec
from multiprocessing import get_context
from pathlib import Path
from types import CodeType
from typing import Any, Final, NamedTuple

PACKAGE: Final = Path(str(find_spec("contact_tracker").origin)).parent  # type: ignore[union-attr]
CORE: Final = ("explanations", "hmm", "hypotheses", "map", "motion", "tracking")
"""Packages that decide labels, and what is reported beside them; checks warn."""
FACTORS: Final = (0.5, 2.0)
SHOWN: Final = 0.0005
"""Least change of accuracy that is shown."""
FAILS: Final = 9.0
"""Stands for the change where the tracker does not run."""
GUARD: Final = 1e-5
"""Smaller constants keep divisions and comparisons safe from rounding: they are not tuned."""


class Constant(NamedTuple):
    """A module-level number: its ``module``, ``name``, the expression in the source and its value."""

    module: str
    name: str
    source: str
    value: float

    @property
    def label(self) -> str:
        return f"{self.module.removeprefix('contact_tracker.').replace('.', '/')}.py: {self.name}"


class Outcome(NamedTuple):
    """``accuracy`` by set of recordings, offline and online, and a ``digest`` of all labels and
    probabilities; an ``error`` where the tracker does not run with the constant."""

    accuracy: dict[str, tuple[float, float]]
    digest: str
    error: str = ""


def tuned_constants(package: Path) -> Iterator[Constant]:
    """The tuned constants of the core, by module."""
    for folder in CORE:
        for path in sorted((package / folder).rglob("*.py")):
            module = ".".join((package.name, *path.relative_to(package).with_suffix("").parts))
            for node in ast.parse(path.read_text(encoding="utf-8")).body:
                yield from _constant(module, node)


def _constant(module: str, node: ast.stmt) -> Iterator[Constant]:
    match node:
        case ast.AnnAssign(target=ast.Name(id=name), value=ast.expr() as value) if name.isupper():
            if any(isinstance(part, ast.Name | ast.Call | ast.Attribute) for part in ast.walk(value)):
                return  # it is derived from others
            number = eval(compile(ast.Expression(value), "<constant>", "eval"), {"__builtins__": {}})
            if type(number) in (int, float) and abs(number) > GUARD:
                yield Constant(module, name, ast.unparse(value), float(number))


class ScalingFinder(PathFinder):
    """Finds modules as usual, ``module`` with the constant ``name`` multiplied by ``factor``."""

    module, name, factor = "", "", 1.0

    @classmethod
    def find_spec(cls, fullname: str, path: Sequence[str] | None = None, target: Any = None) -> Any:
        spec = PathFinder.find_spec(fullname, path, target) if fullname == cls.module else None
        if spec is not None and spec.origin is not None:
            spec.loader = ScalingLoader(fullname, spec.origin)
        return spec


class ScalingLoader(SourceFileLoader):
    """Compiles a module with one constant multiplied; integers stay integers."""

    def get_code(self, fullname: str) -> CodeType:
        tree = ast.parse(self.get_data(self.path))
        for node in tree.body:
            match node:
                case ast.AnnAssign(target=ast.Name(id=name), value=ast.expr() as value):
                    if name == ScalingFinder.name:
                        source = ast.unparse(value)
                        text = f"type({source})(({source}) * {ScalingFinder.factor})"
                        node.value = ast.parse(text, mode="eval").body
        return compile(ast.fix_missing_locations(tree), self.path, "exec")


def run_variant(constant: tuple[str, str, float] | None, logs: Sequence[Path], seconds: float) -> Outcome:
    """Segment the first ``seconds`` of recordings with a constant scaled; to be called in a process that has
    not imported the tracker."""
    if constant is not None:
        ScalingFinder.module, ScalingFinder.name, ScalingFinder.factor = constant
        sys.meta_path.insert(0, ScalingFinder())
    import numpy as np

    from contact_tracker.config.loading import load_model
    from contact_tracker.motion.poses import Poses
    from contact_tracker.recording import need_truth, open_log
    from contact_tracker.segmenting import segmented
    from contact_tracker.trajectory import Trajectory
    from contact_tracker_lab.evaluation.evaluate import evaluate

    totals, digest = dict[str, Any](), hashlib.sha256()
    for log in logs:
        poses = Poses.collect(open_log(str(log)))
        poses = poses[: int(np.searchsorted(poses.stamp_ns, poses.stamp_ns[0] + round(seconds * 1e9)))]
        segmentation = segmented(Trajectory(poses), load_model()).segmentation
        for beliefs in (segmentation.beliefs, segmentation.filtered):
            digest.update(np.ascontiguousarray(beliefs.rows["contact"]).tobytes())
            digest.update(np.ascontiguousarray(beliefs.probability).tobytes())
        score, name = evaluate(poses, need_truth(str(log)), segmentation), log.parent.name
        totals[name] = totals[name] + score if name in totals else score
    both = {name: (total.offline, total.online) for name, total in totals.items()}
    accuracy = {name: (float(a.accuracy()), float(b.accuracy())) for name, (a, b) in both.items()}
    return Outcome(accuracy, digest.hexdigest())


def run_apart(constant: Constant | None, factor: float, logs: Sequence[Path], seconds: float) -> Outcome:
    """``run_variant`` in a process of its own."""
    scaled = None if constant is None else (constant.module, constant.name, factor)
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        try:
            return pool.submit(run_variant, scaled, logs, seconds).result()
        except Exception as error:  # anything that the constant breaks
            return Outcome({}, "", f"{type(error).__name__}: {error}")


def run_all(
    constants: Sequence[Constant], logs: Sequence[Path], seconds: float, journal: Path, jobs: int
) -> dict[tuple[str, str, float], Outcome]:
    """The outcome of each constant and factor, and of none (``("", "", 1.0)``). Those that the ``journal``
    (JSON lines) has of the same recordings and code are not run again, unless they failed."""
    found: dict[tuple[str, str, float], Outcome] = {}
    basis = basis_of(logs, seconds)
    for line in journal.read_text(encoding="utf-8").splitlines() if journal.exists() else ():
        of, module, name, factor, accuracy, digest, error = json.loads(line)
        if of == basis and not error:
            found[module, name, factor] = Outcome({k: tuple(v) for k, v in accuracy.items()}, digest, error)
    variants = [(None, 1.0), *((one, factor) for one in constants for factor in FACTORS)]
    keys = {(one.module, one.name, f) if one else ("", "", f): (one, f) for one, f in variants}
    left = [key for key in keys if key not in found]
    with ThreadPoolExecutor(jobs) as pool, journal.open("a", encoding="utf-8") as file:
        outcomes = pool.map(lambda key: run_apart(*keys[key], logs, seconds), left)
        for key, outcome in zip(left, outcomes, strict=True):
            found[key] = outcome
            file.write(json.dumps([basis, *key, *outcome]) + "\n")
            file.flush()
    return {key: found[key] for key in keys}


def basis_of(logs: Sequence[Path], seconds: float) -> str:
    """What outcomes depend on beside the constants: the recordings, their length, and the code."""
    digest = hashlib.sha256(json.dumps([[str(log.resolve()) for log in logs], seconds]).encode())
    for path in sorted(PACKAGE.parent.rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def table(constants: Sequence[Constant], found: dict[tuple[str, str, float], Outcome]) -> list[str]:
    """Lines of Markdown: constants by the greatest change of accuracy, then those that change only
    probabilities, and those without any effect."""
    base = found["", "", 1.0]
    lines = ["| constant | value | " + " | ".join(f"{name} x 1/2 | x 2" for name in base.accuracy) + " |"]
    lines.append("|---|---|" + "---|" * (2 * len(base.accuracy)))
    rows, slight, idle = list[tuple[float, str]](), list[Constant](), list[Constant]()
    for one in constants:
        outcomes = [found[one.module, one.name, factor] for factor in FACTORS]
        changes = [[_change(outcome, base, name) for outcome in outcomes] for name in base.accuracy]
        greatest = max(max(map(abs, pair)) for pairs in changes for pair in pairs)
        if greatest >= SHOWN:
            cells = [_shown(*pair) for pairs in changes for pair in pairs]
            rows.append((greatest, f"| `{one.label}` | {one.source} | " + " | ".join(cells) + " |"))
        else:
            (idle if all(outcome.digest == base.digest for outcome in outcomes) else slight).append(one)
    lines += [row for _, row in sorted(rows, key=lambda row: -row[0])]
    return [
        *lines,
        *("", f"Probabilities change, accuracy by less than {SHOWN}:", "", *_listed(slight)),
        *("", "Labels and probabilities are the same to the last bit with half and with double:", ""),
        *_listed(idle),
    ]


def _change(outcome: Outcome, base: Outcome, name: str) -> tuple[float, float]:
    """Changes of accuracy, offline and online; ``FAILS`` where the tracker does not run."""
    if outcome.error:
        return FAILS, FAILS
    now, before = outcome.accuracy[name], base.accuracy[name]
    return now[0] - before[0], now[1] - before[1]


def _shown(offline: float, online: float) -> str:
    if offline == FAILS:
        return "fails"
    return " / ".join("0" if abs(one) < SHOWN else f"{one:+.3f}" for one in (offline, online))


def _listed(constants: Sequence[Constant]) -> list[str]:
    """Lines of constants by file."""
    by_file: dict[str, list[str]] = {}
    for one in constants:
        by_file.setdefault(one.label.partition(":")[0], []).append(f"`{one.name}`")
    return [f"- `{file}`: {', '.join(names)}" for file, names in by_file.items()]


def main() -> int:
    described = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=described)
    add = parser.add_argument
    add("logs", nargs="+", type=Path, help="recordings with truth; their folders are the sets")
    add("--seconds", type=float, default=20.0, help="of each recording (default: %(default)s)")
    add("--jobs", type=int, default=1, help="processes at a time (default: %(default)s)")
    add("--only", nargs="+", metavar="NAME", help="only these constants")
    add("--journal", type=Path, default=Path("sensitivity.jsonl"), help="outcomes, to go on with later")
    arguments = parser.parse_args()
    from contact_tracker.cli.terminal import show

    every = list(tuned_constants(PACKAGE))
    constants = [one for one in every if arguments.only is None or one.name in arguments.only]
    if not constants:
        parser.error(f"none of the {len(every)} constants is {' or '.join(arguments.only)}")
    how = arguments.logs, arguments.seconds, arguments.journal, arguments.jobs
    ((_, base),) = run_all((), *how).items()  # with no constant changed
    if base.error:
        parser.error(base.error)
    found = run_all(constants, *how)
    show("\n".join(table(constants, found)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
