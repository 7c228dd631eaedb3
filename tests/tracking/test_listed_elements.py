"""Use of the map: contacts are found at once, elements are named, and errors are reported."""

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from contact_tracker.cli.main import run
from contact_tracker.config.loading import load_model
from contact_tracker.geometry.elements import Line, Plane
from contact_tracker.geometry.polyhedron import convex
from contact_tracker.map.file import map_from
from contact_tracker.map.map import Accuracy, Map, NamedElement, Up, elements_of, known_to, number_name
from contact_tracker.motion.poses import Poses
from contact_tracker.recording import open_log, read_truth, write_recording
from contact_tracker.segmenting import OfflineTracker
from contact_tracker.states import Contact
from contact_tracker.tracking.offline_smoother import segment
from contact_tracker.tracking.segmentation import Segmentation
from contact_tracker_lab.simulate import Scenario, simulate
from contact_tracker_lab.simulate.scenarios import Phase
from short_recordings import true_contacts
from smooth_motion import with_noise

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
    all_of_it = Map(
        listed_environment=(NamedElement("table", table or plane),),
        listed_object=elements,
        environment_complete=True,
        object_complete=True,
    )
    return replace(all_of_it, **changes)


def test_a_known_object_on_a_known_table_is_labelled_and_named_at_once():
    found, intervals = segment(recorded().poses, MODEL, known_map=known()), recorded().truth.intervals
    for beliefs, least in ((found.beliefs, 0.95), (found.filtered, 0.85)):  # a change is known a tick later
        truth = true_contacts(recorded(), beliefs.stamp_ns)
        assert np.mean([b.contact is t for b, t in zip(beliefs, truth, strict=True)]) > least
    assert [s.contact for s in found.segments] == [phase.contact for phase in PHASES]
    elements = {one.name: one.element for one in surfaces()[0]}
    for found_, interval in zip(found.segments[:2], intervals, strict=False):
        ours, environment = found_.touching
        true = interval.geometry.object
        assert environment == "table"
        assert type(elements[ours]) is type(true)
        off = elements[ours].point_m - true.point_m  # across an edge, and in all directions of a vertex
        across = np.cross(true.direction, off) if isinstance(true, Line) else off
        assert np.linalg.norm(across) < 1e-6
    assert found.segments[2].touching == (None, None)
    named = [b.touching for b in found.filtered if b.contact is Contact.VF][-1]
    assert named == found.segments[1].touching
    written = json.loads(json.dumps(found.filtered[5].to_json(), allow_nan=False))
    assert written["geometry"]["environment"]["name"] == "table"
    never = [Contact.FE.column, Contact.FV.column, Contact.EE.column]
    assert not found.filtered.probability[:, never].any()
    # the motion determines the table more accurately than the map
    table, truth = found.segments[0].geometry.environment, intervals[0].geometry.environment
    place = recorded().poses.position_m[:150].mean(axis=0)
    assert abs(table.normal @ place - table.offset_m - (truth.normal @ place - truth.offset_m)) < 1e-3
    assert np.trace(table.covariance[:3, :3]) < np.trace(surfaces()[1].covariance[:3, :3])


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    "table",
    [{"object": {"box": {"size_m": [0.1, 0.2, 0.3]}}}, {"up": {"direction": [0.0, 0.0, 1.0]}}],
    ids=["box", "up"],
)
def test_incomplete_and_wrong_knowledge_does_no_harm(table):
    """For absent elements with directions along axes, posteriors are still distributions."""
    found = segment(recorded().poses[:40], MODEL, known_map=map_from(table)).filtered.probability
    assert found.sum(axis=1) == pytest.approx(1.0)


@pytest.mark.parametrize("complete", [True, False])
def test_a_known_table_in_the_wrong_place_is_not_used(complete):
    plane = surfaces()[1]
    tilted = plane.normal + 0.14 * np.linalg.svd(plane.normal[None])[2][1]
    normal = tilted / np.linalg.norm(tilted)
    place = recorded().poses.position_m.mean(axis=0)
    wrong = known_to(
        Plane(normal, float(normal @ place) + plane.offset_m - plane.normal @ place - 0.03), ACCURACY
    )
    known_map = known(wrong, listed_object=(), object_complete=False, environment_complete=complete)
    segmentation = segment(recorded().poses[:150], MODEL, known_map=known_map)
    assert segmentation.filtered.probability.sum(axis=1) == pytest.approx(1.0)
    assert complete or segmentation.filtered[-1].touching[1] is None


@pytest.mark.parametrize(("accuracy", "is_sure"), [(ACCURACY, True), (Accuracy(0.3, 0.5), False)])
def test_a_known_face_on_a_known_plane_is_certain_at_once(accuracy, is_sure):
    """Within 0.4 s, before the motion has used all directions; not if the places are hardly known."""
    recording = simulate(Scenario((Phase(Contact.FREE, 1.0), Phase(Contact.FF, 0.6)), rate_hz=100.0), 3)
    touching = recording.truth.intervals[-1].geometry
    place = recording.poses.position_m.mean(axis=0)
    known_map = Map(
        listed_object=(NamedElement("bottom", known_to(touching.object, accuracy, np.zeros(3))),),
        listed_environment=(NamedElement("table", known_to(touching.environment, accuracy, place)),),
    )
    beliefs = segment(recording.poses, MODEL, known_map=known_map).filtered
    certain = beliefs.stamp_ns[beliefs.probability[:, Contact.FF.column] > 0.9]
    begin_ns = recording.truth.intervals[-1].start_ns
    assert (beliefs.stamp_ns[-1] in certain) == is_sure
    assert not is_sure or certain[certain > begin_ns][0] < begin_ns + 0.4e9


def test_a_known_face_that_slides_along_a_line_on_a_known_plane_is_face_on_face():
    """Also in the whole recording, of which the motion is that of a slider, which may be just above it."""
    rng, time_s = np.random.default_rng(0), np.arange(0.0, 3.0, 0.01)
    position_m = np.zeros((len(time_s), 3))
    position_m[:, 0], position_m[:, 2] = 0.1 * np.sin(time_s), 0.05
    poses = with_noise(rng, time_s, position_m, Rotation.identity(len(time_s)), 1e-4, 1e-3)
    accuracy = {"sigma_position_m": 1e-3, "sigma_rotation_deg": 0.5}
    table = {"name": "table", "normal": [0.0, 0.0, 1.0], "offset_m": 0.0, **accuracy}
    bottom = {"name": "bottom", "normal": [0.0, 0.0, -1.0], "offset_m": 0.05, **accuracy}
    known_map = map_from({"environment": {"plane": [table]}, "object": {"plane": [bottom]}})
    (found,) = segment(poses, MODEL, known_map=known_map).segments
    assert found.contact is Contact.FF
    assert found.inseparable == (Contact.FREE,)
    assert found.probability == pytest.approx(0.9, abs=1e-3)  # at most, as the motion keeps more constraints
    assert found.touching == ("bottom", "table")


def test_up_helps_where_little_has_moved():
    """The normal of the face is known from the start, otherwise only after some motion."""
    up = Up(surfaces()[1].normal, 0.02)
    poses = recorded().poses[:60]
    beliefs = segment(poses, MODEL, known_map=Map(up=up)).filtered
    faces = [b.geometry.environment for b in beliefs if b.contact.value.endswith("f")]
    assert faces
    assert all(abs(face.normal @ up.direction) > np.cos(0.1) for face in faces)


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


# --- passes with the recording's own map: rests on a face that it has ---
@pytest.mark.long
def test_rests_on_the_table_are_found_by_the_map(shared_recordings: Path) -> None:
    """A mug is set down again and again: each rest is f-f with a face and a table that the others show."""
    path = shared_recordings / "everyday" / "mug_20.mcap"
    if not path.exists():
        pytest.skip("everyday recordings are not here")
    poses = Poses.collect(open_log(str(path)))
    poses = poses[poses.stamp_ns < poses.stamp_ns[0] + 28.5e9]  # up to the third rest
    segmentation = Segmentation.join(list(OfflineTracker(load_model()).pieces(poses)))
    truth = read_truth(str(path))
    of_tick = truth.at(segmentation.stamp_ns)
    is_rest = np.array(
        [
            i >= 0 and truth.intervals[i].motion == "rest" and truth.intervals[i].contact is Contact.FF
            for i in of_tick
        ]
    )
    is_ff = segmentation.beliefs.rows["contact"] == Contact.FF.column
    assert is_rest.sum() > 50
    assert is_ff[is_rest].mean() > 0.6  # 0.1 by each contact's own motion
    assert len(segmentation.filtered) == len(segmentation.beliefs)
    np.testing.assert_array_equal(segmentation.filtered.stamp_ns, segmentation.stamp_ns)
