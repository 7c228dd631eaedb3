"""Recordings of the physics engine: what touches is found from poses alone, and they are those published."""

from itertools import groupby
from pathlib import Path

import numpy as np
import pytest

from contact_tracker.geometry.elements import Plane
from contact_tracker.geometry.polyhedron import convex
from contact_tracker.ground_truth import Truth
from contact_tracker.motion.poses import Poses
from contact_tracker.recording import need_truth, open_log
from contact_tracker.states import STATES, Contact
from contact_tracker_lab import physics
from contact_tracker_lab.simulate.motion import move
from contact_tracker_lab.simulate.plan import Rigid, plan
from contact_tracker_lab.simulate.scenarios import OBJECTS, SURROUNDINGS, Phase, Scenario
from contact_tracker_lab.simulate.touching import Touch, intervals, touch_at

BOX, BLOCK = convex(OBJECTS["box"]), convex(SURROUNDINGS["block"])
STAMP_NS = np.arange(5) * 100_000_000


@pytest.mark.parametrize("contact", STATES)
def test_features_that_touch_are_found_in_poses_that_keep_them(contact: Contact) -> None:
    rng = np.random.default_rng(5)
    scenario = Scenario((Phase(contact, 4.0),), object="box", surroundings="block")
    leg = plan(rng, scenario.phases, BOX, BLOCK, 0.0)[0]
    path = move(rng, leg, 10.0 / leg.duration_s, scenario)
    for rotation, translation in zip(path.pose.rotation, path.pose.translation, strict=True):
        touch = touch_at(BOX, [BLOCK], rotation, translation)
        assert touch.contact is contact
        if contact is not Contact.FREE:
            assert (touch.object, touch.environment) == (leg.chart.object, leg.chart.environment)


@pytest.mark.parametrize(("gap_m", "contact"), [(0.0001, Contact.FF), (0.0003, None), (0.001, Contact.FREE)])
def test_between_the_tolerances_nothing_is_given(gap_m: float, contact: Contact | None) -> None:
    assert touch_at(BOX, [BLOCK], np.eye(3), np.array([0.0, 0.0, 0.325 + gap_m])).contact is contact


def test_two_bodies_at_once_are_not_given() -> None:
    wall = convex(BLOCK.vertices + np.array([0.305, 0.0, 0.36]))
    at = np.array([0.0, 0.0, 0.325])
    assert touch_at(BOX, [BLOCK], np.eye(3), at).contact is Contact.FF
    assert touch_at(BOX, [BLOCK, wall], np.eye(3), at).contact is None


def test_intervals_have_elements_and_short_ones_are_not_given() -> None:
    touch = touch_at(BOX, [BLOCK], np.eye(3), np.array([0.0, 0.0, 0.325]))
    free, still = Touch(Contact.FREE), Rigid(np.eye(3), np.zeros(3))
    spans = intervals(STAMP_NS, [touch, touch, free, free, free], ["rest", *4 * ["normal"]], still, still)
    assert [span.contact for span in spans] == ["f-f", "f-f", "free"]
    assert [span.motion for span in spans] == ["rest", "normal", "normal"]
    assert spans[0].geometry is not None
    assert isinstance(spans[0].geometry.environment, Plane)
    assert spans[0].geometry.environment.offset_m == pytest.approx(0.175)
    brief = intervals(STAMP_NS // 5, [free, touch, free, free, free], 5 * ["normal"], still, still)
    assert [one.contact for one in brief] == [None, Contact.FREE]


@pytest.mark.long
def test_a_recording_is_the_published_one(tmp_path: Path) -> None:
    """And the object, which the hand lets go of, does not fall off the desk."""
    made = physics.SETS["everyday"][3]
    row, is_alike = physics.make(made, tmp_path / "made.mcap", overwrite=False)
    assert is_alike, row
    poses = Poses.collect(open_log(str(tmp_path / "made.mcap")))
    assert np.linalg.norm(np.diff(poses.position_m, axis=0), axis=1).max() < 0.03
    truth: Truth = need_truth(str(tmp_path / "made.mcap"))
    phases = [contact for contact, _ in groupby(one.contact for one in truth.intervals if one.contact)]
    assert phases.count(Contact.FREE) >= 6


def test_without_the_engine_one_line_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(__import__("sys").modules, "mujoco", None)
    with pytest.raises(SystemExit):
        physics.main([str(tmp_path / "made")])
    assert "pip install 'contact-tracker[simulate]'" in capsys.readouterr().err
    assert not (tmp_path / "made").exists()
