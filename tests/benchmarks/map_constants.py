"""What the constants of the map are worth: each changed, on everyday handling and on single contacts.

    python tests/benchmarks/map_constants.py

Shares of the scored time, means of the recordings: right offline, sure (0.9 or more) and wrong offline, and
right online. First takes of everyday handling are without a map, later ones with that of the first.
"""

import argparse
import sys
from collections import defaultdict
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from types import ModuleType
from typing import Any, Final

import numpy as np

from contact_tracker.map import prices, world_map
from contact_tracker.map.learned import NOTHING_LEARNED
from contact_tracker.map.map import Map
from contact_tracker.tracking import map_passes
from contact_tracker_lab.evaluation.tables import number, table
from shared_recordings import SHARED_RECORDINGS
from takes import Score, score

A: Final = prices.CONCENTRATIONS
VARIANTS: Final[dict[str, tuple[ModuleType, str, Any]]] = {
    "as shipped": (prices, "CONCENTRATIONS", A),
    "a while the map grows: halved": (prices, "CONCENTRATIONS", 0.5 * A),
    "doubled": (prices, "CONCENTRATIONS", 2.0 * A),
    "0.3 always": (prices, "CONCENTRATIONS", np.array([0.3])),
    "a offline: halved": (prices, "CONCENTRATION", (0.1, 0.01)),
    "doubled ": (prices, "CONCENTRATION", (0.4, 0.04)),
    "0.02 for the object, too": (prices, "CONCENTRATION", (0.02, 0.02)),
    "lead of a pass with a map: 15 nats": (map_passes, "DECISIVE_NATS", 15.0),
    "60 nats": (map_passes, "DECISIVE_NATS", 60.0),
    "lead that drops a map: 7.5 nats": (world_map, "DROPPED_NATS", 7.5),
    "30 nats": (world_map, "DROPPED_NATS", 30.0),
}
COLUMNS: Final = ("variant", "recordings", "offline", "sure and wrong", "online")


def score_scene(variant: str, paths: list[Path]) -> list[tuple[str, str, Score]]:
    """Variant, kind and score of the takes of one scene, the later ones with the map of the first."""
    module, name, value = VARIANTS[variant]
    shipped = getattr(module, name)
    setattr(module, name, value)
    learned, scores = NOTHING_LEARNED, list[tuple[str, str, Score]]()
    try:
        for path in paths:
            found, own = score(path, Map(learned=learned))
            is_first = path is paths[0]
            scores.append((variant, path.parent.name + ("" if is_first else ", later takes"), found))
            learned = own if is_first else learned
    finally:
        setattr(module, name, shipped)
    return scores


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--processes", type=int, default=2)
    everyday = defaultdict[str, list[Path]](list)
    for path in sorted((SHARED_RECORDINGS / "everyday").glob("*_*.mcap")):
        everyday[path.stem.rsplit("_", 1)[0]].append(path)
    single = [[path] for path in sorted((SHARED_RECORDINGS / "physics" / "hard").glob("*.mcap"))]
    jobs = [(variant, paths) for variant in VARIANTS for paths in [*everyday.values(), *single]]
    scores = defaultdict[tuple[str, str], list[Score]](list)
    with ProcessPoolExecutor(parser.parse_args().processes) as executor:
        for some in executor.map(score_scene, *zip(*jobs, strict=True)):
            for variant, kind, found in some:
                scores[kind, variant].append(found)
    for kind in dict.fromkeys(kind for kind, _ in scores):
        rows = [
            (variant, str(len(some)), *map(number, np.mean(some, axis=0)))
            for (of_kind, variant), some in scores.items()
            if of_kind == kind
        ]
        print(f"{kind}\n{table(COLUMNS, rows)}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
