"""Passes with the recording's own map: rests on a face that it has, and what keeps the first pass."""

from pathlib import Path

import numpy as np
import pytest

from contact_tracker.config.loading import load_model
from contact_tracker.motion.poses import Poses
from contact_tracker.recording import open_log, read_truth
from contact_tracker.segmenting import OfflineTracker
from contact_tracker.states import Contact
from contact_tracker.tracking import pass_record
from contact_tracker.tracking.segmentation import Segmentation

ROBOT = Path(__file__).parents[2] / "recordings" / "robot_1khz.mcap"


def pieces(path: Path) -> list[Segmentation]:
    return list(OfflineTracker(load_model("default")).pieces(open_log(str(path))))


def test_rests_on_the_table_are_found_by_the_map(shared_recordings: Path) -> None:
    """A mug is set down again and again: each rest is f-f with a face and a table that the others show."""
    path = shared_recordings / "everyday" / "mug_20.mcap"
    if not path.exists():
        pytest.skip("everyday recordings are not here")
    found, truth = Segmentation.join(pieces(path)), read_truth(str(path))
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


def test_a_map_that_does_not_win_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """The result is then that of the first pass, as for a recording that is too long for a second one."""
    poses = Poses.collect(open_log(str(ROBOT)))
    tracked = Segmentation.join(list(OfflineTracker(load_model("default")).pieces(poses)))
    monkeypatch.setattr(pass_record, "MOST_TICKS", 10)
    alone = Segmentation.join(list(OfflineTracker(load_model("default")).pieces(poses)))
    np.testing.assert_array_equal(tracked.beliefs.probability, alone.beliefs.probability)
    assert [(one.contact, one.start_ns) for one in tracked.segments] == [
        (one.contact, one.start_ns) for one in alone.segments
    ]
