"""Contacts beside the first in simulated recordings: found offline and online, with elements and times."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import as_values
from contact_tracker import segmenting
from contact_tracker.config.loading import load_model
from contact_tracker.explanations.further_contacts import named_by
from contact_tracker.exports.formats import json_line
from contact_tracker.geometry.elements import ContactGeometry, Element, Plane, Point
from contact_tracker.ground_truth import Truth, TruthInterval
from contact_tracker.map.map import Accuracy, Map, NamedElement, known_to
from contact_tracker.motion.poses import Poses
from contact_tracker.outputs.text import Changes, describe, table
from contact_tracker.saved_state import load, save
from contact_tracker.states import Contact
from contact_tracker.tracker import Tracker
from contact_tracker.tracking import offline_smoother
from contact_tracker.tracking.belief import Belief, FurtherContact, Segment
from contact_tracker.tracking.segmentation import Segmentation
from contact_tracker_lab.evaluation.geometry_errors import geometry_errors
from contact_tracker_lab.simulate import Phase, Scenario, Simulated, named_scenario, simulate
from short_recordings import needs_kernels, shipped

SECOND = 10**9


@cache
def made(name: str) -> Simulated:
    scenario = named_scenario(name, 1)
    if scenario.further and scenario.further.start_s is None:  # it lasts all the time: 14 s of 24 will do
        scenario = replace(scenario, phases=tuple(one._replace(duration_s=14.0) for one in scenario.phases))
    return simulate(scenario, 1)


@cache
def found(name: str) -> Segmentation:
    return segmenting.segment(made(name).poses, load_model())


@cache
def online(name: str) -> tuple[Tracker, tuple[Belief, ...]]:
    state, beliefs = as_values.advance(as_values.start(load_model()), made(name).poses)
    return state, tuple(beliefs)


def only_further(name: str) -> FurtherContact:
    *_, segment = found(name).segments  # the first half second may be another contact
    (further,) = segment.further
    return further


@pytest.mark.long
@needs_kernels
def test_no_further_contact_repeats_another() -> None:
    """Wrong orders of quaternions give motion that keeps constraints, but no contacts beside the first."""
    poses = shipped("paper_experiment")[1000:4000]
    poses = replace(poses, quat_xyzw=np.ascontiguousarray(poses.quat_xyzw[:, [1, 2, 3, 0]]))
    _, beliefs = as_values.advance(as_values.start(load_model()), poses)
    for one in (*segmenting.segment(poses, load_model()).segments, *beliefs):
        contacts = [describe(other.geometry) for other in (one, *one.further) if other.geometry is not None]
        assert len(set(contacts)) == len(contacts)


@needs_kernels
@pytest.mark.parametrize(
    ("name", "label", "constraints"),
    [
        ("vertex_and_vertex", Contact.VF, 2),
        pytest.param("edge_and_vertex", Contact.EF, 3, marks=pytest.mark.long),
    ],
)
def test_a_vertex_on_the_wall_is_found_with_its_elements(name: str, label: Contact, constraints: int) -> None:
    further, segment = only_further(name), found(name).segments[-1]
    assert segment.contact is label
    assert (further.contact, further.constraints) == (Contact.VF, constraints)
    assert further.probability > 0.9
    assert not further.inseparable
    true = made(name).truth.intervals[0]
    geometries = [true.geometry, *(one.geometry for one in true.further)]
    fitted = [
        Segment(true.start_ns, true.end_ns, Contact.VF, 1.0, one)
        for one in (segment.geometry, further.geometry)
        if one is not None and isinstance(one.object, Point)
    ]
    for one in fitted:  # of two vertices either may be the label
        deviations = [
            max(error.deviation.sd for error in geometry_errors(made(name).poses, truth, [one]).rows)
            for geometry in geometries
            if geometry is not None and isinstance(geometry.object, Point)
            for truth in [Truth((TruthInterval(true.start_ns, true.end_ns, Contact.VF, geometry=geometry),))]
        ]
        assert min(deviations) < 4.0


@pytest.mark.long
@needs_kernels
def test_with_a_table_an_edge_and_a_vertex_on_the_wall_are_indistinguishable() -> None:
    further = only_further("face_and_edge")
    assert Contact.EF in (further.contact, *further.inseparable)
    assert Contact.VF in (further.contact, *further.inseparable)
    assert Contact.FF not in (further.contact, *further.inseparable)
    assert further.constraints == 4


@needs_kernels
def test_a_further_contact_begins_and_ends() -> None:
    name = "wall_in_between"
    further, result = only_further(name), found(name)
    (true,) = made(name).truth.intervals[0].further
    assert further.end_ns is not None
    assert abs(further.start_ns - true.start_ns) < 0.3 * SECOND
    assert abs(further.end_ns - true.end_ns) < 0.3 * SECOND
    holds = np.array([bool(belief.further) for belief in result.beliefs])
    inside = (result.stamp_ns >= further.start_ns) & (result.stamp_ns <= further.end_ns)
    np.testing.assert_array_equal(holds, inside)
    lines = [line.split() for line in table(result.segments, result.segments[0].start_ns)]
    assert [line[2:4] for line in lines if "+" in line] == [["+", "v-f"]]


@needs_kernels
@pytest.mark.parametrize("contact", [Contact.FF, pytest.param(Contact.VF, marks=pytest.mark.long)])
def test_a_single_contact_has_no_further_ones_and_is_no_joint(contact: Contact) -> None:
    """Two vertices on the table would be an edge, three a face."""
    poses = simulate(Scenario((Phase(contact, 10.0),)), 1).poses
    result = segmenting.segment(poses, load_model())
    assert not any(segment.further or segment.joint for segment in result.segments)
    _, beliefs = as_values.advance(as_values.start(load_model()), poses)
    assert not any(belief.further for belief in beliefs)


@needs_kernels
def test_a_further_contact_is_reported_online_while_it_holds() -> None:
    _, beliefs = online("wall_in_between")
    (true,) = made("wall_in_between").truth.intervals[0].further
    reporting = [belief for belief in beliefs if belief.further]
    assert len(reporting) > 10
    assert all(true.start_ns <= one.stamp_ns <= true.end_ns + 0.3 * SECOND for one in reporting)
    assert abs(reporting[0].further[0].start_ns - true.start_ns) < 0.5 * SECOND
    changes = Changes()
    events = [tuple(map(len, changes.update(belief)[1:])) for belief in beliefs]
    assert [event for event in events if any(event)] == [(1, 0), (0, 1)]


@needs_kernels
def test_a_saved_stream_resumes_with_its_formation(tmp_path) -> None:
    poses = made("vertex_and_vertex").poses
    state, beliefs = as_values.advance(as_values.start(load_model()), poses[:1600])
    assert beliefs[-1].further
    save(tmp_path / "state", state)
    restored = load(tmp_path / "state")
    _, rest = as_values.advance(state, poses[1600:1800])
    _, again = as_values.advance(restored, poses[1600:1800])
    assert list(map(json_line, again)) == list(map(json_line, rest))
    assert any(belief.further for belief in rest)


@needs_kernels
def test_a_ball_in_a_corner_may_have_edges_on_the_line_of_the_corner() -> None:
    """Its centre keeps to a line: as a vertex on two planes, or as two edges on that line."""
    rng = np.random.default_rng(1)
    time_s = np.arange(0.0, 5.0, 0.02)
    rates, phases = rng.uniform(1.0, 4.0, (4, 6)), rng.uniform(0.0, 6.0, (4, 6))
    waves = np.sin(time_s[:, None, None] * rates + phases).mean(axis=2)
    turn = Rotation.from_rotvec(2.5 * waves[:, :3] + rng.normal(size=waves[:, :3].shape) * 1e-3)
    centre_m, in_body_m = np.pad(0.3 * waves[:, 3:], ((0, 0), (0, 2))), np.array([0.02, 0.03, -0.01])
    position_m = centre_m - turn.apply(in_body_m) + rng.normal(size=centre_m.shape) * 1e-4
    poses = Poses((time_s * SECOND).astype(np.int64), position_m, turn.as_quat())
    *_, segment = offline_smoother.segment(poses, load_model()).segments
    assert {segment.contact, *segment.inseparable} == {Contact.VF, Contact.EE}
    (further,) = segment.further
    assert further.probability <= segment.probability < 0.8


@pytest.mark.long
@needs_kernels
def test_further_contacts_are_searched_among_known_elements() -> None:
    true = made("vertex_and_vertex").truth.intervals[0]
    first, second = true.geometry, true.further[0].geometry

    def listed(name: str, *elements: Element) -> tuple[NamedElement, ...]:
        given = enumerate(known_to(element, Accuracy()) for element in elements)
        return tuple(NamedElement(f"{name}{number}", element) for number, element in given)

    vertices = listed("vertex", first.object, second.object)
    both = first.environment, second.environment
    for walls, names in ((both, {"face0", "face1"}), (both[:1], {"face0"})):
        known_map = Map(
            listed_object=vertices,
            listed_environment=listed("face", *walls),
            object_complete=True,
            environment_complete=True,
        )
        poses = made("vertex_and_vertex").poses[:2400]
        (segment,) = segmenting.segment(poses, load_model(), known_map=known_map).segments
        assert segment.contact is Contact.VF
        assert {segment.touching[1], *(one.geometry.names[1] for one in segment.further)} == names
        if len(walls) == 1:
            assert segment.probability < 0.9 + 1e-9  # an element touches that is not listed


def test_known_elements_give_their_names() -> None:
    wall = NamedElement("wall", known_to(Plane(np.array([1.0, 0.0, 0.0]), 0.5), Accuracy()))
    near = Plane(np.array([1.0, 0.0, 0.0]), 0.5005, 1e-6 * np.eye(4))
    far = Plane(np.array([0.0, 1.0, 0.0]), 0.5, 1e-6 * np.eye(4))
    corner = Point(np.zeros(3), 1e-6 * np.eye(3))
    known_map = Map(listed_environment=(wall,))
    assert named_by(known_map, ContactGeometry(corner, near)).names == (None, "wall")
    assert named_by(known_map, ContactGeometry(corner, far)).names == (None, None)
