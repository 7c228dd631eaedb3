"""Labels of motion that none of the six contacts explains: curved surfaces, hinges, drawers, screws.

    python tests/benchmarks/restricted.py
    python tests/benchmarks/restricted.py --seeds 3 --tables docs/benchmarks/restricted.json

24 s of each motion with the noise of the shipped recordings. Shares of the time after the first 2 s in which
free motion, or a contact, has a probability above 0.9, and in which all other states are reported as
possible.
"""

import sys
from typing import Final

import numpy as np

from contact_tracker import segmenting
from contact_tracker.config.loading import load_model
from contact_tracker.motion.pose_validation import gate
from contact_tracker.states import STATES, Contact
from contact_tracker.tracking.segmentation import Beliefs
from contact_tracker_lab.benchmark.runner import Table, measured, parser_of, report
from contact_tracker_lab.evaluation.tables import number
from restricted_motions import MOTIONS, poses_of

HEADER: Final = (
    *("motion", "most frequent label", "free above 0.9 offline", "free above 0.9 online"),
    *("contact above 0.9 offline", "contact above 0.9 online", "any other offline", "any other online"),
)
SURE_PROBABILITY: Final = 0.9
SETTLING_TICKS: Final = 20


def shares(beliefs: Beliefs) -> list[float]:
    """Shares of one recording: free above 0.9, a contact above 0.9, any other possible."""
    rows = beliefs.rows[SETTLING_TICKS:]
    free, contact = rows["probability"][:, Contact.FREE.column], rows["probability"][:, :-1].max(axis=1)
    others = rows["inseparable"].sum(axis=1) == len(STATES) - 1
    return [float(np.mean(part)) for part in (free > SURE_PROBABILITY, contact > SURE_PROBABILITY, others)]


def measure(name: str, seed: int) -> tuple[list[list[float]], np.ndarray]:
    """Shares (2 x 3), offline and online, of one recording, and its ticks by label (7,)."""
    poses = gate(poses_of(MOTIONS[name], np.random.default_rng(seed)))
    segmentation = segmenting.segment(poses, load_model())
    labels = np.bincount(segmentation.beliefs.rows["contact"], minlength=len(STATES))
    return [shares(segmentation.beliefs), shares(segmentation.filtered)], labels


def main() -> int:
    parser = parser_of(__doc__)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--only", nargs="+", default=[*MOTIONS], choices=MOTIONS, metavar="NAME")
    args = parser.parse_args()
    jobs = {name: [(name, seed) for seed in range(args.seeds)] for name in args.only}
    rows = list[list[str]]()
    for name, found in measured(measure, jobs, args.processes):
        label = STATES[int(np.sum([ticks for _, ticks in found], axis=0).argmax())]
        mean = np.mean([both for both, _ in found], axis=0).T.ravel()
        rows.append([name, label.value, *(number(float(share)) for share in mean)])
    return report(args, motions=Table(HEADER, rows))


if __name__ == "__main__":
    sys.exit(main())
