"""Everyday handling: first takes alone, and later takes of the same scene with the map of the first.

    python tests/benchmarks/takes.py

Shares of the scored time: right offline, sure (0.9 or more) and wrong offline, and right online. Recordings
are named SCENE_TAKE, as in ``everyday`` of the shared ones.
"""

import sys
from collections import defaultdict
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from contact_tracker.config.loading import load_model
from contact_tracker.map.learned import NOTHING_LEARNED, LearnedElements
from contact_tracker.map.map import EMPTY_MAP, Map
from contact_tracker.motion.poses import Poses
from contact_tracker.recording import need_truth, open_log
from contact_tracker.segmenting import OfflineTracker
from contact_tracker.tracking.belief import Detail
from contact_tracker.tracking.segmentation import Segmentation
from contact_tracker_lab.evaluation.evaluate import evaluate
from contact_tracker_lab.evaluation.tables import number
from runner import Table, measured, parser_of, show
from shared_recordings import SHARED_RECORDINGS

COLUMNS: Final = ("take", "recordings", "offline", "sure and wrong", "online")
FIRST, ALONE, WITH_MAP = "first", "later, alone", "later, with the map of the first"


class Score(NamedTuple):
    """Shares of the scored time."""

    offline: float
    sure_wrong: float
    online: float


def score(path: Path, known: Map = EMPTY_MAP) -> tuple[Score, LearnedElements]:
    """The score of a recording, and the map that was learned from it."""
    poses = Poses.collect(open_log(str(path)))
    tracker = OfflineTracker(load_model("default"), known)
    found = Segmentation.join(list(tracker.pieces(poses, None, Detail.SHARED)))
    done = evaluate(poses, need_truth(str(path)), found)
    wrong = float(done.offline.sure_wrong_by_state_s.sum() / done.offline.seconds())
    world = tracker.map
    learned = NOTHING_LEARNED if world is None else world.learned
    return Score(done.offline.accuracy(), wrong, done.online.accuracy()), learned


def score_scene(first: Path, *later: Path) -> list[tuple[str, Score]]:
    """Kind and score of each take of one scene."""
    found, learned = score(first)
    alone = [(ALONE, score(path)[0]) for path in later]
    return [(FIRST, found), *alone, *((WITH_MAP, score(path, Map(learned=learned))[0]) for path in later)]


def main() -> int:
    parser = parser_of(__doc__)
    parser.add_argument("folder", nargs="?", type=Path, default=SHARED_RECORDINGS / "everyday")
    args = parser.parse_args()
    scenes = defaultdict[str, list[Path]](list)
    for path in sorted(args.folder.glob("*_*.mcap")):
        scenes[path.stem.rsplit("_", 1)[0]].append(path)
    scores = defaultdict[str, list[Score]](list)
    jobs = {name: [tuple(paths)] for name, paths in scenes.items()}
    for _, (scene,) in measured(score_scene, jobs, args.processes):
        for kind, one in scene:
            scores[kind].append(one)
    rows = [[kind, str(len(some)), *map(number, np.mean(some, axis=0))] for kind, some in scores.items()]
    return show(args, takes=Table(COLUMNS, rows))


if __name__ == "__main__":
    sys.exit(main())
