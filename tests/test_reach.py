"""Required accuracy on the repository's recordings (measured values: docs/benchmarks.md)."""

from pathlib import Path

import pytest

from contact_tracker.config.loading import load_model
from contact_tracker.evaluation.evaluate import evaluate
from contact_tracker.evaluation.scoring import Subset
from contact_tracker.motion.poses import Poses
from contact_tracker.recording import open_log, read_truth
from contact_tracker.tracking.offline_smoother import segment

RECORDINGS = Path(__file__).resolve().parent.parent / "recordings"


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "offline", "online"),
    [("paper_experiment", 0.97, 0.68), ("all_states", 0.95, 0.6), ("robot_1khz", 0.95, 0.6)],
)
def test_the_label_is_right_and_the_geometry_within_its_deviations(name, offline, online):
    path = str(RECORDINGS / f"{name}.mcap")
    poses, truth = Poses.collect(open_log(path)), read_truth(path)
    found = evaluate(poses, truth, segment(poses, load_model()))
    assert found.offline.accuracy(Subset.ALL) >= offline
    assert found.online.accuracy(Subset.ALL) >= online
    assert found.geometry.within_3_sd >= 0.95
