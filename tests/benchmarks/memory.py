"""Resident memory online after each step, in MB.

    python tests/benchmarks/memory.py

It reads /proc (Linux), and uses one thread, since each thread has buffers of its own.
"""

import os
import sys
from collections.abc import Callable, Iterator
from functools import partial
from importlib import import_module
from itertools import islice
from pathlib import Path
from typing import Final

RECORDING: Final = Path(__file__).parents[2] / "recordings" / "paper_experiment.mcap"
POSES: Final = 1200
LIBRARIES: Final = ("numpy", "scipy.linalg", "scipy.spatial")


def steps() -> Iterator[tuple[str, Callable[[], object]]]:
    """The steps, in order."""
    yield "Python", lambda: None
    for name in LIBRARIES:
        yield name, partial(import_module, name)
    yield "contact_tracker", partial(import_module, "contact_tracker.tracking.forward_pass")
    yield "kernels", partial(import_module, "contact_tracker.hypotheses.compiled.kernels")
    yield f"{POSES} poses", track


def track() -> int:
    """Track the first poses of a recording online."""
    from contact_tracker.config.loading import load_model
    from contact_tracker.recording import open_log
    from contact_tracker.tracking.forward_pass import forward

    return len(list(forward(islice(open_log(str(RECORDING)), POSES), load_model())))


def resident_mb() -> float:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def main() -> int:
    before = 0.0
    for name, step in steps():
        step()
        after = resident_mb()
        print(f"{name:24}{after - before:6.0f}{after:7.0f}")
        before = after
    return 0


if __name__ == "__main__":
    for threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(threads, "1")
    sys.exit(main())
