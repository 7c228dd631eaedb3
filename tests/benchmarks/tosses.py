"""Real tosses of a cube on a table: accuracy with and without known table and cube.

    python tests/benchmarks/tosses.py --model impacts

Share of the frames with certain truth and the cube in motion that are labelled right: offline, online, and
online by arrival, where the label counts that had been given out when a frame came,
with nothing known, with the table's plane, and with plane and cube, both from the metadata of each recording.
Figures are of every second recording (``--half checked``); the model was tuned on the others.
"""

import sys
from itertools import product
from pathlib import Path
from typing import Any, Final

import numpy as np

from contact_tracker.arrays import Bools, Ints
from contact_tracker.config.loading import load_model
from contact_tracker.map.file import map_from
from contact_tracker.map.map import EMPTY_MAP, Map
from contact_tracker.motion.poses import Poses
from contact_tracker.recording import need_truth, open_log, read_metadata
from contact_tracker.segmenting import segment
from contact_tracker.states import STATES, Contact
from contact_tracker_lab.benchmark.runner import Table, measured, parser_of, report
from contact_tracker_lab.evaluation.evaluate import answers_to, gated
from contact_tracker_lab.evaluation.scoring import UNSCORED, scoring, tick_containing, tick_in_force
from contact_tracker_lab.evaluation.tables import number, table
from shared_recordings import SHARED_RECORDINGS

MOVING_M_S: Final = 0.05
"""The cube is in motion while its fastest corner is faster than this."""
SIGMA: Final = {"sigma_position_m": 0.5e-3, "sigma_rotation_deg": 0.2}
"""Assumed accuracy of plane and cube in the metadata."""
COLUMNS: Final = ("model", "known", "frames", "accuracy offline", "accuracy online", "by arrival")
LEVELS: Final = ("nothing", "plane", "plane and cube")


def known(level: str, metadata: dict[str, str]) -> Map:
    """The map of ``level`` for a recording with this metadata."""
    if level == "nothing":
        return EMPTY_MAP
    *normal, offset_m = map(float, metadata["table_plane_n_h"].split())
    plane = {"name": "table", "normal": normal, "offset_m": offset_m, **SIGMA}
    tables: dict[str, Any] = {"environment": {"plane": [plane]}}
    if level == "plane and cube":
        tables["environment"]["complete"] = True
        tables["object"] = {"box": {"size_m": [float(metadata["cube_side_m"])] * 3, **SIGMA}}
    return map_from(tables)


def measure(path: Path, model_name: str) -> dict[str, Ints]:
    """Of one recording at each level of knowledge the confusion (3, 7, 7), truth by label, of the frames in
    motion: offline; online, where each frame has the latest label up to its stamp, and where it has the
    latest that had been given out when it came."""
    poses, truth = Poses.collect(open_log(str(path))), need_truth(str(path))
    metadata = read_metadata(str(path))["recording"]
    scored = scoring(poses.stamp_ns, truth)
    counted = (scored.truth != UNSCORED) & in_motion(poses, float(metadata["cube_side_m"]))
    results = {}
    for level in LEVELS:
        model, known_map = load_model(model_name), known(level, dict(metadata))
        found = segment(poses, model, known_map=known_map)
        answers = answers_to(gated(poses), model, known_map)
        rows = []
        for beliefs, time_ns, tick_of in (
            (found.beliefs, found.beliefs.stamp_ns, tick_containing),
            (answers.beliefs, answers.beliefs.stamp_ns, tick_in_force),
            (answers.beliefs, answers.arrival_ns, tick_in_force),
        ):
            tick = tick_of(poses.stamp_ns, time_ns)
            label = beliefs.rows["contact"][tick]
            confusion = np.zeros((len(STATES), len(STATES)), np.int64)
            has_label = counted & (tick >= 0)
            np.add.at(confusion, (scored.truth[has_label], label[has_label]), 1)
            np.add.at(confusion, (scored.truth[counted & (tick < 0)], Contact.FREE.column), 1)
            rows.append(confusion)
        results[level] = np.array(rows)
    return results


def in_motion(poses: Poses, side_m: float) -> Bools:
    """(N,) frames in which the fastest corner of the cube is faster than ``MOVING_M_S``."""
    corners = 0.5 * side_m * np.array(list(product((-1.0, 1.0), repeat=3)))
    places = poses.position_m[:, None] + np.einsum("nij,kj->nki", poses.rotation, corners)
    velocity = np.gradient(places, poses.stamp_ns * 1e-9, axis=0)
    return np.asarray(np.linalg.norm(velocity, axis=2).max(axis=1) > MOVING_M_S)


def main() -> int:
    parser = parser_of(__doc__)
    parser.add_argument("folder", nargs="?", type=Path, default=SHARED_RECORDINGS / "cube_tosses")
    parser.add_argument("--model", nargs="+", default=["impacts"], metavar="NAME|FILE")
    parser.add_argument("--half", choices=("checked", "chosen"), default="checked")
    args = parser.parse_args()
    paths = sorted(args.folder.glob("*.mcap"))[1 if args.half == "checked" else 0 :: 2]
    if not paths:
        raise SystemExit(f"{args.folder}: no recordings")
    rows = list[list[str]]()
    jobs = {model: [(path, model) for path in paths] for model in args.model}
    for model, results in measured(measure, jobs, args.processes):
        for level in LEVELS:
            total = np.sum([result[level] for result in results], axis=0)
            accuracies = (number(confusion.trace() / confusion.sum()) for confusion in total)
            rows.append([model, level, str(total[0].sum()), *accuracies])
        print(f"{model}, offline with {level} known: truth by row, label by column")
        confused = zip(STATES, total[0], strict=True)
        print(table(("", *STATES), [[state, *map(str, row)] for state, row in confused if row.any()]))
    return report(args, tosses=Table(COLUMNS, rows))


if __name__ == "__main__":
    sys.exit(main())
