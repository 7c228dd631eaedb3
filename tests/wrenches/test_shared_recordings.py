"""On recordings of a physics engine in which motion alone is singular."""

from pathlib import Path

import pytest

from contact_tracker.config.loading import load_model
from contact_tracker.motion.poses import Poses
from contact_tracker.recording import need_truth, open_log, read_wrenches
from contact_tracker.segmenting import OfflineTracker
from contact_tracker.tracking.segmentation import Segmentation
from contact_tracker.with_wrenches import wrench_evidence
from contact_tracker_lab.evaluation.evaluate import evaluate


@pytest.mark.long
def test_wrenches_decide_what_motion_leaves_open(shared_recordings: Path) -> None:
    path, model = str(shared_recordings / "physics" / "singular" / "singular_00.mcap"), load_model()
    log = open_log(path)
    poses = Poses.join(list(log.batches()))
    found = read_wrenches(path, "/object/wrench", log.source, poses)
    evidence, _ = wrench_evidence(poses, found.wrenches, model)
    pieces = OfflineTracker(model, wrenches=evidence).pieces(poses)
    offline = evaluate(poses, need_truth(path), Segmentation.join(list(pieces))).offline
    assert offline.accuracy() > 0.9
    assert offline.sure_wrong < 0.03
