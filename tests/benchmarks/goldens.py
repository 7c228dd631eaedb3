"""Comparison of two builds of the project: their outputs and their CPU time.

    git worktree add OTHER COMMIT && python -m venv OTHER/.venv && OTHER/.venv/bin/pip install OTHER
    python tests/benchmarks/goldens.py OTHER recordings
    python tests/benchmarks/goldens.py OTHER recordings FOLDER --within 1e-3 0.01

Runs the commands of the build in a folder and of this one on every recording found: ``segment`` (smoothed
posteriors, geometry and segments), ``live`` and ``live --lag`` (filtered and lagged posteriors), and compares
outputs number by number. Exit code 1: a label or segment differs, or a probability by more than allowed. The
outputs and times of the other build are kept in its folder, ``answers``.
"""

import argparse
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from itertools import zip_longest
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

RUNS: Final = {
    "segments": ("segment", "--rows", "segments", "-o", "{out}.jsonl"),
    "smoothed": ("segment", "-o", "{out}.jsonl"),
    "filtered": ("live", "--json"),
    "lagged": ("live", "--json", "--lag", "0.5"),
}
OFFLINE: Final = ("segments", "smoothed")
ENVIRONMENT: Final = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}


class Difference(NamedTuple):
    """Number of ticks or segments, and of those with other ``labels`` (or times); the largest difference of a
    probability, and the largest relative difference of any other number."""

    ticks: int
    labels: int
    probability: float
    other: float


def run(build: Path, name: str, log: Path, folder: Path) -> tuple[str, float]:
    """The output of one command of one build on one recording, and its CPU time (s)."""
    folder.mkdir(parents=True, exist_ok=True)
    out = folder / f"{log.parent.parent.name}-{log.parent.name}-{log.stem}.{name}"
    command, *options = (word.format(out=out) for word in RUNS[name])
    with out.open("wb") as stdout:
        words = [str(build), command, str(log), *options]
        process = subprocess.Popen(words, stdout=stdout, env=os.environ | ENVIRONMENT)
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode not in (0, 3):
        raise SystemExit(f"{' '.join(words)}: exit code {process.returncode}")
    for written in folder.glob(f"{out.name}.*"):
        written.replace(out)
    return out.read_text(), usage.ru_utime + usage.ru_stime


def kept(folder: Path, name: str, log: Path) -> tuple[str, float]:
    """The output of the build in a folder, which is run only once."""
    path = folder / "answers" / f"{log.parent.parent.name}-{log.parent.name}-{log.stem}.{name}.json"
    if not path.exists():
        path.parent.mkdir(exist_ok=True)
        answer = run(folder / ".venv" / "bin" / "contact-tracker", name, log, folder / "answers" / "run")
        path.write_text(json.dumps(answer))
    text, cpu_s = json.loads(path.read_text())
    return text, cpu_s


def difference(one: str, other: str) -> Difference:
    """The difference of two outputs of one run: lines of JSON, of ticks or segments."""
    rows = ([dict(_flat("", json.loads(line))) for line in text.splitlines()] for text in (one, other))
    pairs = list(zip_longest(*rows, fillvalue=dict[str, Any]()))
    labels, probability, numbers = 0, 0.0, 0.0
    for left, right in pairs:
        same = all(left.get(key) == right.get(key) for key in ("contact", "stamp_ns", "start_ns", "end_ns"))
        labels += not same
        for key in left.keys() & right.keys() if same else ():
            a, b = left[key], right[key]
            if isinstance(a, str) or isinstance(b, str):
                numbers = numbers if a == b else np.inf
            elif key.startswith("probability"):
                probability = max(probability, abs(a - b))
            elif a != b:
                numbers = max(numbers, abs(a - b) / max(abs(a), abs(b)))
    return Difference(len(pairs), labels, probability, numbers)


def _flat(key: str, value: object) -> Iterator[tuple[str, Any]]:
    """Nested keys joined with dots, numbers as numbers."""
    if isinstance(value, dict | list):
        for name, inner in value.items() if isinstance(value, dict) else enumerate(value):
            yield from _flat(f"{key}.{name}".lstrip("."), inner)
    else:
        yield key, value if isinstance(value, int | float) and not isinstance(value, bool) else str(value)


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path, help="of the other build")
    parser.add_argument("logs", type=Path, nargs="+", help="recordings, or folders of them")
    allowed = "largest allowed differences of probabilities (default: 0)"
    parser.add_argument(
        "--within", type=float, nargs=2, default=(0.0, 0.0), metavar=("OFFLINE", "ONLINE"), help=allowed
    )
    args = parser.parse_args()
    logs = [log for path in args.logs for log in ([path] if path.is_file() else sorted(path.rglob("*.mcap")))]
    here, failed = Path(sys.executable).parent / "contact-tracker", False
    for name in RUNS:
        ratios, within = list[float](), args.within[name not in OFFLINE]
        for log in map(Path.resolve, logs):
            old, old_s = kept(args.folder, name, log)
            new, new_s = run(here, name, log, args.folder / "answers" / "run")
            ratios.append(new_s / old_s)
            found = difference(old, new)
            wrong = found.labels > 0 or found.probability > within
            failed |= wrong
            if old != new:
                print(
                    f"{'NO' if wrong else 'ok'} {name} {log.stem}: {found.labels} of {found.ticks} differ, "
                    f"probabilities by {found.probability:.2g}, other numbers by {found.other:.2g}"
                )
        print(f"{name}: {len(logs)} recordings; CPU time, median ratio {np.median(ratios):.2f}")
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
