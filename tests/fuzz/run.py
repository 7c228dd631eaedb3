"""Fuzz the package with invalid inputs for a given time.

    python tests/fuzz/run.py --seconds 60
    python tests/fuzz/run.py --seconds 36000 --seed 7 --processes 2 --keep found/
    python tests/fuzz/run.py --target mesh --case 1234567

Each case has a number that determines its input; one that violates a property is reported and kept, and the
exit code is 1. Properties: errors of the package in one line, the documented exit codes, no other output on
the terminal, valid probabilities, and at most 5 s of CPU time and 300 MB a case.
"""

import argparse
import random
import resource
import signal
import sys
import time
import traceback
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory
from types import FrameType

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "tests" / "support"), str(Path(__file__).parent)]

from targets import TARGETS, Violation  # noqa: E402  the path comes first

CASE_S = 5.0
CASE_BYTES = 300 * 2**20
STEP = 1_000_003


def attack(name: str, case: int, folder: Path) -> str | None:
    """Run one case; returns the violation, if any."""
    target, rng = TARGETS[name], random.Random(f"{name} {case}")
    path = folder / f"{name}{target.suffix}"
    path.write_bytes(target.make(rng))
    signal.setitimer(signal.ITIMER_PROF, CASE_S)
    try:
        target.attack(path, rng)
    except Violation as error:
        return str(error)
    except KeyboardInterrupt:
        raise
    except BaseException:  # panics of Rust are no Exception
        return traceback.format_exc()
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        for left in folder.iterdir():
            left.unlink()
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    return f"{most / 2**20:.0f} MB" if most > CASE_BYTES else None


def attack_for(
    seconds: float, seed: int, names: list[str], keep: str | None
) -> tuple[Counter[str], list[str]]:
    """Cases one after the other, target by target, from that of the number ``seed`` on."""
    signal.signal(signal.SIGPROF, _too_long)
    done, broken, end_s, case = Counter[str](), list[str](), time.monotonic() + seconds, seed
    with TemporaryDirectory() as folder:
        while time.monotonic() < end_s:
            for name in names:
                found = attack(name, case, Path(folder))
                done[name] += 1
                if found is not None:
                    broken.append(f"--target {name} --case {case}: {found}")
                    _keep(keep, name, case)
            case += STEP
    return done, broken


def _too_long(_: int, frame: FrameType | None) -> None:
    raise TimeoutError(f"more than {CASE_S:g} s of CPU time")


def _keep(folder: str | None, name: str, case: int) -> None:
    if folder is not None:
        Path(folder).mkdir(parents=True, exist_ok=True)
        rng = random.Random(f"{name} {case}")
        target = TARGETS[name]
        (Path(folder) / f"{name}_{case}{target.suffix}").write_bytes(target.make(rng))


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--seed", type=int, default=1, help="number of the first case")
    parser.add_argument("--target", choices=TARGETS, help="only this one")
    parser.add_argument("--case", type=int, help="only this one")
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--keep", metavar="FOLDER", help="where inputs that break something go")
    args = parser.parse_args(argv)
    names = [args.target] if args.target else list(TARGETS)
    if args.case is not None:
        done, broken = attack_for(0.001, args.case, names, args.keep)
    else:
        with ProcessPoolExecutor(args.processes, get_context("spawn")) as pool:
            jobs = [
                pool.submit(attack_for, args.seconds, args.seed + i, names, args.keep)
                for i in range(args.processes)
            ]
            results = [job.result() for job in jobs]
        done = sum((one for one, _ in results), Counter())
        broken = [line for _, lines in results for line in lines]
    print(", ".join(f"{name} {count}" for name, count in done.items()), f"cases; {len(broken)} broken")
    for line in broken[:20]:
        print(line)
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
