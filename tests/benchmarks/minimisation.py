"""How long minimising the paper's objectives takes: SLSQP per start, and the batched fixed-window curves.

python tests/benchmarks/minimisation.py recordings/paper_experiment.mcap
"""

import argparse
import time

import numpy as np

from contact_tracker.contacts import CONTACT_MODELS
from contact_tracker.evaluation.tables import table
from contact_tracker.paper import matrix, minimise_slsqp, motion
from contact_tracker.poses import Poses
from contact_tracker.recording import open_log
from contact_tracker.windows import curves, minimise_windows

FRAMES, STEP, STARTS = 500, 10, 3


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("log")
    parser.add_argument("--windows", type=int, default=12, help="windows on which SLSQP is timed")
    args = parser.parse_args()
    poses = Poses.collect(open_log(args.log))
    position = poses.position_m - poses.position_m.mean(axis=0)
    rotation, p = motion(poses.rotation, position)
    first = np.arange(0, len(poses) - FRAMES + 1, STEP)
    sample = first[np.linspace(0, len(first) - 1, args.windows).astype(int)]
    rng = np.random.default_rng(0)
    rows = []
    for model in CONTACT_MODELS:
        contact = model.contact
        matrices = [matrix(contact, rotation[a : a + FRAMES], p[a : a + FRAMES]) for a in sample]
        begin = time.process_time()
        for k in matrices:
            minimise_slsqp(contact, k, rng, STARTS)
        per_start = (time.process_time() - begin) / (STARTS * len(matrices))
        begin = time.process_time()
        end = first[-1] + FRAMES
        minimise_windows(model, poses.rotation[:end], position[:end], FRAMES, STEP)
        batched = time.process_time() - begin
        slsqp = per_start * STARTS * len(first)
        rows.append((contact.value, f"{1e3 * per_start:.1f}", f"{slsqp:.0f}", f"{batched:.2f}"))
    header = ("contact", "SLSQP, a start (ms)", f"SLSQP, {len(first)} windows (s)", "batched (s)")
    print(table(header, rows))
    begin = time.process_time()
    curves(poses, FRAMES, STEP)
    print(f"all six curves of {len(poses)} poses: {time.process_time() - begin:.2f} s")


if __name__ == "__main__":
    main()
