"""Use of the map: contacts are found at once, elements are named, and errors are reported."""

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from contact_tracker.cli.main import run
from contact_tracker.config.loading import load_model
from contact_tracker.geometry.elements import Line, Plane, Point
from contact_tracker.geometry.polyhedron import convex
from contact_tracker.hypotheses import compiled
from contact_tracker.map.file import map_from
from contact_tracker.map.map import (
    EMPTY_MAP,
    Accuracy,
    Map,
    NamedElement,
    Up,
    elements_of,
    known_to,
    number_name,
)
from contact_tracker.recording import write_recording
from contact_tracker.states import CONTACTS, Contact
from contact_tracker.tracking.offline_smoother import segment
from contact_tracker_lab.simulate import Scenario, simulate
from contact_tracker_lab.simulate.scenarios import Phase
from pose_filter import PoseFilter
from short_recordings import true_contacts

MODEL = load_model()
ACCURACY = Accuracy(1e-3, float(np.radians(0.3)))
PHASES = (Phase(Contact.EF, 1.5), Phase(Contact.VF, 1.5), Phase(Contact.FREE, 1.0))


@cache
def recorded():
    return simulate(Scenario(PHASES, rate_hz=100.0), 4)


@cache
def surfaces():
    """Object and table of the simulation: all elements of the object, the touched face of the table."""
    simulated = recorded()
    body = convex(np.array(json.loads(simulated.metadata["object_vertices_m"])), 1e-6)
    elements = elements_of(body, number_name, ACCURACY, np.eye(3), np.zeros(3))
    plane = simulated.truth.intervals[0].geometry.environment
    return elements, known_to(plane, ACCURACY, simulated.poses.position_m.mean(axis=0))


def known(table=None, **changes):
    elements, plane = surfaces()
    all_of_it = Map((NamedElement("table", table or plane),), elements, None, True, True)
    return replace(all_of_it, **changes)


@cache
def with_everything():
    return segment(recorded().poses, MODEL, known_map=known())


def accuracy(beliefs):
    truth = true_contacts(recorded(), np.array([b.stamp_ns for b in beliefs]))
    return np.mean([b.contact is t for b, t in zip(beliefs, truth, strict=True)])


def true_name(interval):
    """The name of the true touching element of the object in the map."""
    element = interval.geometry.object
    same = [
        k.name for k in surfaces()[0] if k.kind == interval.contact.value[0] and alike(k.element, element)
    ]
    (name,) = same
    return name


def alike(a, b):
    match a, b:
        case Point(), Point():
            return np.linalg.norm(a.point_m - b.point_m) < 1e-6
        case Line(), Line():
            apart = np.cross(a.direction, b.point_m - a.point_m)
            return abs(a.direction @ b.direction) > 1 - 1e-9 and np.linalg.norm(apart) < 1e-6
        case Plane(), Plane():
            return a.normal @ b.normal > 1 - 1e-9
    return False


def test_labels_are_right_at_once():
    found = with_everything()
    assert accuracy(found.beliefs) > 0.95
    assert accuracy(found.filtered) > 0.85  # a change is known one or two ticks later
    assert [s.contact for s in found.segments] == [phase.contact for phase in PHASES]


def test_the_touching_elements_are_named():
    found, intervals = with_everything(), recorded().truth.intervals
    for segment_found, interval in zip(found.segments, intervals, strict=True):
        wanted = (true_name(interval), "table") if interval.geometry else (None, None)
        assert segment_found.touching == wanted
    named = [b.touching for b in found.filtered if b.contact is Contact.VF][-1]
    assert named == (true_name(intervals[1]), "table")
    written = json.loads(json.dumps(found.filtered[5].to_json(), allow_nan=False))
    assert written["geometry"]["environment"]["name"] == "table"


def test_known_elements_are_refined():
    """The motion determines the table more accurately than the map."""
    table = with_everything().segments[0].geometry.environment
    truth = recorded().truth.intervals[0].geometry.environment
    place = recorded().poses.position_m[:150].mean(axis=0)
    assert abs(table.normal @ place - table.offset_m - (truth.normal @ place - truth.offset_m)) < 1e-3
    assert np.trace(table.covariance[:3, :3]) < np.trace(surfaces()[1].covariance[:3, :3])


def test_elements_missing_from_a_complete_map_cannot_touch():
    for belief in with_everything().filtered:
        assert not belief.probability[[Contact.FE.column, Contact.FV.column, Contact.EE.column]].any()


@pytest.mark.parametrize("in_use", [True, False])
def test_contacts_without_known_elements_have_no_hypotheses(in_use, monkeypatch):
    """For an object with one face, compiled or not."""
    in_use = in_use and compiled.in_use()
    monkeypatch.setattr(compiled, "in_use", lambda: in_use)
    face = next(k for k in surfaces()[0] if k.kind == "f")
    known_map = Map(object=(face,), object_complete=True)
    for belief in segment(recorded().poses[:60], MODEL, known_map=known_map).filtered:
        assert belief.probability.sum() == pytest.approx(1.0)
        assert not belief.probability[[Contact.EF.column, Contact.VF.column, Contact.EE.column]].any()


@pytest.mark.parametrize("complete", [True, False])
def test_a_known_table_in_the_wrong_place_is_not_used(complete):
    """Off by 3 cm and 8 deg with a small covariance: no touching element is named "table"."""
    plane = surfaces()[1]
    tilted = plane.normal + 0.14 * np.linalg.svd(plane.normal[None])[2][1]
    normal = tilted / np.linalg.norm(tilted)
    place = recorded().poses.position_m.mean(axis=0)
    wrong = known_to(
        Plane(normal, float(normal @ place) + plane.offset_m - plane.normal @ place - 0.03), ACCURACY
    )
    known_map = known(wrong, object=(), object_complete=False, environment_complete=complete)
    found = segment(recorded().poses[:150], MODEL, known_map=known_map)
    for belief in found.filtered:
        assert np.isfinite(belief.probability).all()
        assert belief.probability.sum() == pytest.approx(1.0)
    if not complete:
        last = found.filtered[-1]
        assert last.touching[1] is None


def test_up_helps_where_little_has_moved():
    """The normal of the face is known from the start, otherwise only after some motion."""
    up = Up(surfaces()[1].normal, 0.02)
    poses = recorded().poses[:60]
    beliefs = segment(poses, MODEL, known_map=Map(up=up)).filtered
    faces = [b.geometry.environment for b in beliefs if b.contact.value.endswith("f")]
    assert faces
    assert all(abs(face.normal @ up.direction) > np.cos(0.1) for face in faces)


def test_an_empty_map_changes_nothing():
    poses = recorded().poses[:120]
    ours, theirs = segment(poses, MODEL, known_map=EMPTY_MAP), segment(poses, MODEL)
    for a, b in zip(ours.filtered, theirs.filtered, strict=True):
        assert a.to_json() == b.to_json()
        assert a.touching == (None, None)


def test_the_online_tracker_uses_the_map():
    one, beliefs = PoseFilter(MODEL, known_map=known()), []
    for pose in recorded().poses[:60]:
        beliefs += one.update(pose)
    offline = with_everything().filtered
    assert [b.to_json() for b in beliefs] == [b.to_json() for b in offline[: len(beliefs)]]
    assert len(one.state.banks) == len(CONTACTS)


def test_arguments_define_the_map(tmp_path, capsys):
    path = str(tmp_path / "short.mcap")
    write_recording(path, recorded().poses[:60], None, {})
    normal, offset_m = surfaces()[1].normal, surfaces()[1].offset_m
    (tmp_path / "only.toml").write_text("[environment]\ncomplete = true\n")
    plane = "--plane=" + ",".join(map(str, [*normal, offset_m]))
    assert run(["segment", path, "--known", str(tmp_path / "only.toml"), plane]) == 0
    assert "face plane 1 normal" in capsys.readouterr().out
    (tmp_path / "known.toml").write_text('[[environment.plane]]\nname = "desk"\nnormal = [0, 0, 1]\n')
    for arguments, wanted in (
        (["--known", str(tmp_path / "known.toml")], "environment.plane[1].offset_m"),
        (["--known", str(tmp_path / "gone.toml")], "gone.toml"),
        (["--up", "0,0"], "--up"),
        (["--up", "0,0,3"], "up.direction"),
        (["--box", "1,1,-1"], "object.box.size_m"),
        (["--plane", "0,0,1,nan"], "--plane"),
    ):
        assert run(["live", path, *arguments]) == 2
        error = capsys.readouterr().err
        assert wanted in error
        assert error.count("\n") == 1


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    "table",
    [{"object": {"box": {"size_m": [0.1, 0.2, 0.3]}}}, {"up": {"direction": [0.0, 0.0, 1.0]}}],
    ids=["box", "up"],
)
def test_incomplete_and_wrong_knowledge_does_no_harm(table):
    """For absent elements with directions along axes, posteriors are still distributions."""
    for belief in segment(recorded().poses[:60], MODEL, known_map=map_from(table)).filtered:
        assert np.isfinite(belief.probability).all()
        assert belief.probability.sum() == pytest.approx(1.0)
