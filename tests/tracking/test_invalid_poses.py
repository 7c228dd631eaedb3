"""Poses from Python that did not pass the gate are refused with the package's own error."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import as_values
from contact_tracker import segmenting
from contact_tracker.errors import ContactTrackerError, InvalidPose
from contact_tracker.hypotheses import compiled
from contact_tracker.tracking.contact_filter import ContactFilter
from mcap_logs import smooth_poses
from short_recordings import FACE_TO_EDGE, MODEL, recorded

SOUND = smooth_poses(40)
FIRST = next(iter(SOUND))
FAULTS = {
    "nan": list(SOUND)[30]._replace(position_m=(float("nan"), 0.0, 0.0)),
    "seconds": FIRST._replace(stamp_ns=12.5),  # type: ignore[arg-type]
    "again": list(SOUND)[29],
}


@pytest.mark.parametrize("name", FAULTS)
def test_a_pose_that_did_not_pass_the_gate_is_refused_online_and_offline(name: str) -> None:
    state, _ = as_values.advance(as_values.start(MODEL), SOUND[:30])
    with pytest.raises(InvalidPose) as caught:
        state.add(FAULTS[name])
    assert isinstance(caught.value, ContactTrackerError)
    assert "gate" in str(caught.value) or "1e9" in str(caught.value)
    state.add(list(SOUND)[30])
    with pytest.raises(InvalidPose):
        segmenting.segment([*list(SOUND)[:30], FAULTS[name], *list(SOUND)[31:]], MODEL)


def test_columns_of_seconds_are_refused() -> None:
    seconds = replace(SOUND, stamp_ns=SOUND.stamp_ns * 1e-9)  # type: ignore[arg-type]
    for refused in (
        segmenting.segment,
        lambda poses, model: as_values.advance(as_values.start(model), poses),
    ):
        with pytest.raises(InvalidPose, match="nanoseconds"):
            refused(seconds, MODEL)


@pytest.mark.skipif(not compiled.in_use(), reason="no kernels")
@pytest.mark.parametrize("at", range(1, 6))
def test_kernels_check_values_as_well_as_shapes(at: int) -> None:
    from contact_tracker.hypotheses.compiled import kernels

    lifts, two = np.ones((1, 25)), np.ones((1, 2))
    arrays = [np.zeros(1, np.int64), lifts, lifts, two, two, two, None, None]
    kernels.Ticks(*arrays)
    arrays[at] = np.full_like(arrays[at], np.nan)
    with pytest.raises(ValueError, match="finite"):
        kernels.Ticks(*arrays)


def test_an_interrupted_update_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of several filters, some are updated by a tick then; the stream goes on as if nothing had happened."""
    poses = recorded(FACE_TO_EDGE).poses[:260]
    state, expected = as_values.start(MODEL, 0.5), as_values.start(MODEL, 0.5)
    state.add(poses[:130])
    update, calls = ContactFilter.update, list[int]()

    def interrupted(one: ContactFilter, *args: Any) -> Any:
        calls.append(1)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return update(one, *args)

    monkeypatch.setattr(ContactFilter, "update", interrupted)
    with pytest.raises(KeyboardInterrupt):
        any(state.add(pose) and False for pose in poses[130:180])
    monkeypatch.undo()
    assert len(state.filters.filters) > 2
    left = poses.stamp_ns > state.last_ns
    found = [*state.add(poses[left]), *state.finish()]
    same = [*expected.add(poses), *expected.finish()]
    assert len(found) > 5
    for one, other in zip(found, same[-len(found) :], strict=True):
        assert (one.stamp_ns, one.contact) == (other.stamp_ns, other.contact)
        assert one.probability == pytest.approx(other.probability, abs=1e-9)
