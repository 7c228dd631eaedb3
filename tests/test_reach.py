"""Required accuracy on the repository's recordings (measured values: docs/benchmarks.md)."""

from pathlib import Path

import pytest

from contact_tracker.config.loading import load_model
from contact_tracker.motion.poses import Poses
from contact_tracker.recording import open_log, read_truth
from contact_tracker.segmenting import OfflineTracker
from contact_tracker.tracking.segmentation import Segmentation
from contact_tracker_lab.evaluation.evaluate import evaluate
from contact_tracker_lab.evaluation.scoring import Subset

RECORDINGS = Path(__file__).resolve().parent.parent / "recordings"


@pytest.mark.parametrize(
    ("name", "offline", "online"),
    [
        ("robot_1khz", 0.95, 0.6),
        pytest.param("paper_experiment", 0.97, 0.68, marks=pytest.mark.long),
        pytest.param("all_states", 0.95, 0.6, marks=pytest.mark.long),
        pytest.param("vision_30hz", 0.8, 0.5, marks=pytest.mark.long),
    ],
)
def test_labels_are_right_geometry_within_its_deviations_and_nothing_is_reported(name, offline, online):
    path = str(RECORDINGS / f"{name}.mcap")
    poses, truth, tracker = Poses.collect(open_log(path)), read_truth(path), OfflineTracker(load_model())
    found = evaluate(poses, truth, Segmentation.join(list(tracker.pieces(poses))))
    assert found.offline.accuracy(Subset.ALL) >= offline
    assert found.online.accuracy(Subset.ALL) >= online
    assert found.geometry.within_3_sd >= 0.95
    assert tracker.report.findings == ()
