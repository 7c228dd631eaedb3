"""Comparison of two builds of the project: their outputs and their CPU time.

    python tests/benchmarks/goldens.py build COMMIT FOLDER
    python tests/benchmarks/goldens.py compare FOLDER recordings
    python tests/benchmarks/goldens.py compare FOLDER recordings OTHER --within 1e-3 0.01

``build`` installs a commit of this repository in a folder. ``compare`` runs the commands of that build and of
this one alternately on every recording found: ``segment`` (smoothed posteriors, geometry and segments),
``live`` and ``live --lag`` (filtered and lagged posteriors). Outputs are compared byte by byte, and where
they differ number by number. Exit code 1: a label or segment differs, or a probability by more than allowed.
The outputs and times of the other build are kept in its folder, ``answers``.
"""

import argparse
import csv
import json
import os
import resource
import subprocess
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import zip_longest
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from tqdm import tqdm

ROOT: Final = Path(__file__).resolve().parents[2]
RUNS: Final = {
    "segments": ("segment", "-o", "{out}.csv"),
    "smoothed": ("segment", "-o", "{out}.jsonl"),
    "filtered": ("live", "--json"),
    "lagged": ("live", "--json", "--lag", "0.5"),
}
OFFLINE: Final = ("segments", "smoothed")
ENVIRONMENT: Final = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}


class Output(NamedTuple):
    """The output of a command, and its CPU time (s)."""

    text: bytes
    cpu_s: float


class Difference(NamedTuple):
    """Difference of two outputs of one run: whether they are ``identical``; the number of ``ticks`` (or
    segments), and of those with other ``labels`` (or times); the largest difference of a probability, and the
    largest relative difference of any other number."""

    identical: bool
    ticks: int
    labels: int
    probability: float
    other: float


def run(command: Path, name: str, log: Path, scratch: Path) -> Output:
    """Run one command of one build on one recording."""
    out = scratch / f"{name}-{os.getpid()}-{abs(hash((command, log)))}"
    arguments = [word.format(out=out) for word in RUNS[name]]
    with (scratch / f"{out.name}.stdout").open("w+b") as stdout:
        process = subprocess.Popen(
            [command, arguments[0], log, *arguments[1:]],
            stdout=stdout,
            stderr=subprocess.PIPE,
            env=os.environ | ENVIRONMENT,
        )
        assert process.stderr is not None
        messages = process.stderr.read().decode(errors="replace")
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode not in (0, 3):
            raise SystemExit(f"{command} {' '.join(arguments)} {log}: {messages}")
        stdout.seek(0)
        text = stdout.read()
    Path(stdout.name).unlink()
    for written in scratch.glob(f"{out.name}.*"):
        text = written.read_bytes()
        written.unlink()
    return Output(text, usage.ru_utime + usage.ru_stime)


def kept(folder: Path, name: str, log: Path) -> Output:
    """The output of the build in a folder, which is run only once."""
    path = folder / "answers" / name / f"{log.parent.parent.name}-{log.parent.name}-{log.stem}"
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        output = run(folder / ".venv" / "bin" / "contact-tracker", name, log, path.parent)
        path.with_suffix(".seconds").write_text(str(output.cpu_s))
        path.write_bytes(output.text)
    return Output(path.read_bytes(), float(path.with_suffix(".seconds").read_text()))


def difference(name: str, one: bytes, other: bytes) -> Difference:
    """The difference of two outputs of one run."""
    rows = list(zip_longest(_rows(name, one), _rows(name, other)))
    if one == other:
        return Difference(True, len(rows), 0, 0.0, 0.0)
    labels, probability, numbers = 0, 0.0, 0.0
    for left, right in rows:
        if left is None or right is None or _label(left) != _label(right):
            labels += 1
            continue
        for key in left.keys() & right.keys():
            a, b = left[key], right[key]
            if isinstance(a, str) or isinstance(b, str):
                numbers = numbers if a == b else np.inf
            elif key.startswith("probability"):
                probability = max(probability, abs(a - b))
            elif a != b:
                numbers = max(numbers, abs(a - b) / max(abs(a), abs(b)))
    return Difference(False, len(rows), labels, probability, numbers)


def _rows(name: str, text: bytes) -> list[dict[str, Any]]:
    """Ticks or segments; nested keys joined with dots, numbers as numbers."""
    lines = text.decode().splitlines()
    if name != "segments":
        return [dict(_flat("", json.loads(line))) for line in lines]
    return [dict(_flat("", {key: _read(cell) for key, cell in row.items()})) for row in csv.DictReader(lines)]


def _flat(key: str, value: object) -> Iterator[tuple[str, Any]]:
    if isinstance(value, dict):
        for name, inner in value.items():
            yield from _flat(f"{key}.{name}".lstrip("."), inner)
    elif isinstance(value, list):
        for index, inner in enumerate(value):
            yield from _flat(f"{key}.{index}", inner)
    else:
        yield key, value if isinstance(value, int | float) and not isinstance(value, bool) else str(value)


def _read(cell: str) -> object:
    try:
        return json.loads(cell)
    except ValueError:
        return cell


def _label(row: dict[str, Any]) -> tuple[Any, ...]:
    """The values that must be equal: the contact, and the times of a tick or segment."""
    return tuple(row.get(key) for key in ("contact", "stamp_ns", "start_ns", "end_ns"))


def compare(folder: Path, logs: Sequence[Path], within: tuple[float, float], processes: int) -> int:
    """Print a line per run and recording that differs, and one per run; returns the exit code."""
    here = Path(sys.executable).parent / "contact-tracker"
    jobs = [(name, log) for name in RUNS for log in logs]

    def both(job: tuple[str, Path]) -> tuple[Output, Output]:
        return kept(folder, *job), run(here, *job, folder)

    wrong = 0
    with ThreadPoolExecutor(processes) as pool:
        outputs = dict(zip(jobs, tqdm(pool.map(both, jobs), total=len(jobs), disable=None), strict=True))
    for name in RUNS:
        allowed, same, cpu = within[0 if name in OFFLINE else 1], 0, list[tuple[float, float]]()
        for log in logs:
            old, new = outputs[name, log]
            cpu.append((new.cpu_s, old.cpu_s))
            found = difference(name, old.text, new.text)
            same += found.identical
            bad = found.labels > 0 or found.probability > allowed
            wrong += bad
            if not found.identical:
                print(
                    f"{'NO' if bad else 'ok'} {name} {log.stem}: {found.labels} of {found.ticks} differ, "
                    f"probabilities by {found.probability:.2g}, other numbers by {found.other:.2g}"
                )
        ratio = np.median([new / old for new, old in cpu])
        print(
            f"{name}: {same} of {len(logs)} identical; CPU time of whole commands, median ratio {ratio:.2f}"
        )
    peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024.0
    print(f"largest peak memory of a command {peak:.0f} MB")
    return int(wrong > 0)


def build(commit: str, folder: Path) -> None:
    """Install a commit of this repository in a folder."""
    for command in (
        ["git", "clone", "--quiet", "--no-hardlinks", str(ROOT), str(folder)],
        ["git", "-C", str(folder), "checkout", "--quiet", commit],
        [sys.executable, "-m", "venv", str(folder / ".venv")],
        [str(folder / ".venv" / "bin" / "pip"), "install", "--quiet", str(folder)],
    ):
        subprocess.run(command, check=True)


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    commands = parser.add_subparsers(dest="command", required=True)
    one = commands.add_parser("build", help="install a commit in a folder")
    one.add_argument("commit")
    one.add_argument("folder", type=Path)
    other = commands.add_parser("compare", help="compare that build with this one")
    other.add_argument("folder", type=Path)
    other.add_argument("logs", type=Path, nargs="+", help="recordings, or folders of them")
    other.add_argument(
        "--within", type=float, nargs=2, default=(0.0, 0.0), metavar=("OFFLINE", "ONLINE"),
        help="largest allowed differences of probabilities (default: 0)",
    )  # fmt: skip
    other.add_argument("--processes", type=int, default=1)
    args = parser.parse_args(argv)
    if args.command == "build":
        build(args.commit, args.folder)
        return 0
    logs = [log for path in args.logs for log in ([path] if path.is_file() else sorted(path.rglob("*.mcap")))]
    return compare(args.folder, [log.resolve() for log in logs], tuple(args.within), args.processes)


if __name__ == "__main__":
    sys.exit(main())
