"""Passes with the recording's own map: rests on a face that it has."""

from pathlib import Path

import numpy as np
import pytest

from contact_tracker.config.loading import load_model
from contact_tracker.motion.poses import Poses
from contact_tracker.recording import open_log, read_truth
from contact_tracker.segmenting import OfflineTracker
from contact_tracker.states import Contact
from contact_tracker.tracking.segmentation import Segmentation


def test_rests_on_the_table_are_found_by_the_map(shared_recordings: Path) -> None:
    """A mug is set down again and again: each rest is f-f with a face and a table that the others show."""
    path = shared_recordings / "everyday" / "mug_20.mcap"
    if not path.exists():
        pytest.skip("everyday recordings are not here")
    poses = Poses.collect(open_log(str(path)))
    poses = poses[poses.stamp_ns < poses.stamp_ns[0] + 28.5e9]  # up to the third rest
    found = Segmentation.join(list(OfflineTracker(load_model()).pieces(poses)))
    truth = read_truth(str(path))
    of_tick = truth.at(found.stamp_ns)
    is_rest = np.array(
        [
            i >= 0 and truth.intervals[i].motion == "rest" and truth.intervals[i].contact is Contact.FF
            for i in of_tick
        ]
    )
    is_ff = found.beliefs.rows["contact"] == Contact.FF.column
    assert is_rest.sum() > 50
    assert is_ff[is_rest].mean() > 0.6  # 0.1 by each contact's own motion
    assert len(found.filtered) == len(found.beliefs)
    np.testing.assert_array_equal(found.filtered.stamp_ns, found.stamp_ns)
