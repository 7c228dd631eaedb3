"""Labels of motion that none of the six contacts explains: curved surfaces, hinges, drawers, screws.

    python tests/benchmarks/restricted.py
    python tests/benchmarks/restricted.py --seeds 3 --tables docs/benchmarks/restricted.json

24 s of each motion with the noise of the shipped recordings. Shares of the time after the first 2 s in which
free motion, or a contact, has a probability above 0.9, and in which all other states are reported as
possible.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

import kept_tables
from contact_tracker import segmenting
from contact_tracker.config.loading import load_model
from contact_tracker.motion.pose_validation import gate
from contact_tracker.states import STATES, Contact
from contact_tracker.tracking.segmentation import Beliefs
from contact_tracker_lab.evaluation.tables import number, table
from kept_tables import Table
from restricted_motions import MOTIONS, Motion, poses_of

HEADER: Final = (
    *("motion", "most frequent label", "free above 0.9 offline", "free above 0.9 online"),
    *("contact above 0.9 offline", "contact above 0.9 online", "any other offline", "any other online"),
)
SURE: Final = 0.9
SETTLING_TICKS: Final = 20


def shares(beliefs: Beliefs) -> list[float]:
    """Shares of one recording: free above 0.9, a contact above 0.9, any other possible."""
    rows = beliefs.rows[SETTLING_TICKS:]
    free, contact = rows["probability"][:, Contact.FREE.column], rows["probability"][:, :-1].max(axis=1)
    others = rows["inseparable"].sum(axis=1) == len(STATES) - 1
    return [float(np.mean(part)) for part in (free > SURE, contact > SURE, others)]


def row(name: str, motion: Motion, seeds: int) -> list[str]:
    """A row of the table."""
    measured, labels = [], np.zeros(len(STATES))
    for seed in range(seeds):
        poses = gate(poses_of(motion, np.random.default_rng(seed)))
        found = segmenting.segment(poses, load_model())
        measured.append([shares(found.beliefs), shares(found.filtered)])
        labels += np.bincount(found.beliefs.rows["contact"], minlength=len(STATES))
    mean = np.mean(measured, axis=0).T.ravel()
    return [name, STATES[int(labels.argmax())].value, *(number(float(share)) for share in mean)]


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--only", nargs="+", default=[*MOTIONS], choices=MOTIONS, metavar="NAME")
    parser.add_argument("--tables", type=Path, metavar="JSON", help="keep the table in this file")
    args = parser.parse_args(argv)
    rows = [row(name, MOTIONS[name], args.seeds) for name in args.only]
    print(table(HEADER, rows))
    if args.tables:
        command = f"python tests/benchmarks/restricted.py --seeds {args.seeds}"
        kept_tables.keep(args.tables, command, {"motions": Table(HEADER, rows)})
    return 0


if __name__ == "__main__":
    sys.exit(main())
