"""Simulated wrenches against mechanics, and what the tracker makes of them."""

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from contact_tracker.arrays import Array
from contact_tracker.config.loading import load_model
from contact_tracker.geometry.elements import Line
from contact_tracker.recording import open_log, read_wrenches, write_recording
from contact_tracker.segmenting import segmented, wrench_evidence
from contact_tracker.states import CONTACTS, Contact
from contact_tracker.trajectory import Trajectory
from contact_tracker_lab.evaluation.evaluate import evaluate
from contact_tracker_lab.simulate import Phase, Scenario, Simulated, named_scenario, simulate
from contact_tracker_lab.simulate import wrench as simulated_wrench
from contact_tracker_lab.simulate.wrench import MASS_KG, PRESS_N

QUIET = {"sigma_position_m": 0.0, "sigma_rotation_rad": 0.0}
GRAVITY = 9.80665
TWO_TICKS_NS = 200_000_000


@cache
def exact(contact: Contact) -> Simulated:
    """Free motion, then a contact, without noise of either sensor."""
    phases = (Phase(Contact.FREE, 4.0), Phase(contact, 4.0), Phase(Contact.FREE, 2.0))
    scenario = Scenario(phases, has_wrench=True, object="box", surroundings="block", **QUIET)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(simulated_wrench, "NOISE", (0.0, 0.0))
        patch.setattr(simulated_wrench, "BIAS", (0.0, 0.0))
        return simulate(scenario, 3)


def inertial_force(made: Simulated) -> Array:
    """(N, 3) mass times acceleration of the middle of the object, in the world; not at the ends."""
    vertices = np.array(json.loads(made.metadata["object_vertices_m"]))
    middle = made.poses.rotation @ vertices.mean(axis=0) + made.poses.position_m
    return MASS_KG * np.gradient(np.gradient(middle, axis=0), axis=0) * 200.0**2


def in_world(made: Simulated, vectors: Array) -> Array:
    return np.einsum("nij,nj->ni", made.poses.rotation, vectors)


def weight_of(made: Simulated) -> Array:
    """The weight in the world, by the free motion at the start."""
    free = slice(10, 600)
    carried = in_world(made, made.wrenches.force_n) - inertial_force(made)
    assert carried[free].std(axis=0).max() < 1e-6
    return -carried[free].mean(axis=0)


@pytest.mark.parametrize("contact", CONTACTS)
def test_the_hand_carries_the_object_and_presses_it_where_it_touches(contact: Contact) -> None:
    made = exact(contact)
    weight = weight_of(made)
    assert np.linalg.norm(weight) == pytest.approx(MASS_KG * GRAVITY, rel=1e-6)
    touching = made.truth.intervals[[i.contact for i in made.truth.intervals].index(contact)]
    stamps = made.poses.stamp_ns
    held = (stamps > touching.start_ns + 500_000_000) & (stamps < touching.end_ns - 500_000_000)
    force = inertial_force(made) - weight - in_world(made, made.wrenches.force_n)
    strength = np.linalg.norm(force[held], axis=1)
    assert strength.mean() == pytest.approx(PRESS_N, rel=0.1)
    # It pushes the object away from what it touches, with some friction.
    object, world = touching.geometry.object, touching.geometry.environment
    if contact in (Contact.FF, Contact.EF, Contact.VF):
        normals = np.tile(world.normal, (int(held.sum()), 1))
    elif contact is not Contact.EE:
        normals = -in_world(made, np.tile(object.normal, (len(stamps), 1)))[held]
    else:
        normals = np.cross(in_world(made, np.tile(object.direction, (len(stamps), 1)))[held], world.direction)
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        normals *= np.sign(np.einsum("ni,ni->n", normals, force[held]))[:, None]
    assert np.degrees(np.arccos(np.einsum("ni,ni->n", normals, force[held]) / strength)).max() < 8.0


@pytest.mark.parametrize("contact", [Contact.EF, Contact.VF, Contact.EE])
def test_the_line_of_action_meets_the_touching_element_of_the_object(contact: Contact) -> None:
    """About its vertex, or its edge, the contact has no moment: what is left is that of the masses."""
    made = exact(contact)
    vertices = np.array(json.loads(made.metadata["object_vertices_m"]))
    masses = np.einsum("nij,vj->nvi", made.poses.rotation, vertices) + made.poses.position_m[:, None]
    acceleration = np.gradient(np.gradient(masses, axis=0), axis=0) * 200.0**2
    push = MASS_KG / len(vertices) * acceleration - weight_of(made) / len(vertices)
    touching = made.truth.intervals[[i.contact for i in made.truth.intervals].index(contact)]
    element = touching.geometry.object
    point = made.poses.rotation @ element.point_m + made.poses.position_m
    hand = in_world(made, made.wrenches.moment_nm) + np.cross(
        made.poses.position_m - point, in_world(made, made.wrenches.force_n)
    )
    moment = np.cross(masses - point[:, None], push).sum(axis=1) - hand
    if isinstance(element, Line):
        along = in_world(made, np.tile(element.direction, (len(moment), 1)))
        moment = np.einsum("ni,ni->n", moment, along)[:, None]
    stamps = made.poses.stamp_ns
    held = (stamps > touching.start_ns) & (stamps < touching.end_ns - TWO_TICKS_NS)
    assert np.abs(moment[held]).max() < 1e-6


def test_wrenches_leave_the_poses_as_they_are() -> None:
    scenario = named_scenario("pressed", 1)
    with_wrenches, without = simulate(scenario, 1), simulate(replace(scenario, has_wrench=False), 1)
    assert without.wrenches is None
    for name in ("stamp_ns", "position_m", "quat_xyzw"):
        assert np.array_equal(getattr(with_wrenches.poses, name), getattr(without.poses, name))


@pytest.mark.long
def test_they_decide_what_motion_leaves_open(tmp_path: Path) -> None:
    made, model = simulate("pressed", 0), load_model()
    path = str(tmp_path / "pressed.mcap")
    write_recording(path, made.poses, made.truth, made.metadata, wrenches=made.wrenches)
    log = open_log(path)
    wrenches = read_wrenches(path, "/object/wrench", log.source, made.poses)
    assert wrenches.noted == ""
    assert np.array_equal(wrenches.wrenches.force_n, made.wrenches.force_n)
    assert np.array_equal(wrenches.wrenches.moment_nm, made.wrenches.moment_nm)
    evidence, load = wrench_evidence(made.poses, wrenches.wrenches, model)
    assert load.mass_kg == pytest.approx(MASS_KG, rel=0.05)
    found = segmented(Trajectory(made.poses), model, wrenches=evidence)
    by_wrenches = evaluate(made.poses, made.truth, found.segmentation)
    assert by_wrenches.offline.accuracy() > 0.95  # by motion alone it is below 0.6
    geometry = by_wrenches.geometry  # a face whose normal is the axis of the hinge would move alike
    assert geometry.found_segments == geometry.true_segments == 2
    assert geometry.within_3_sd == 1.0
    assert geometry.angle_deg.max() < 30.0  # friction turns the force, by 10 deg (one sd)
    assert geometry.distance_mm.max() < 5.0


@pytest.mark.long
@pytest.mark.parametrize(("contact", "is_free"), [(Contact.FREE, True), (Contact.EF, False)])
def test_free_motion_at_the_start_is_known_by_its_missing_force(contact: Contact, is_free: bool) -> None:
    phases = tuple(Phase(one, 4.5) for one in (contact, Contact.VF, Contact.FREE, Contact.EF))
    scenario = Scenario(phases, rate_hz=100.0, has_wrench=True, object="box", surroundings="block")
    made, model = simulate(scenario, 1), load_model()
    evidence, _ = wrench_evidence(made.poses, made.wrenches, model)
    assert evidence.shows_contact_at_start() is not is_free
    found = segmented(Trajectory(made.poses), model, wrenches=evidence)
    assert found.segments[0].contact is contact
    assert evaluate(made.poses, made.truth, found.segmentation).offline.accuracy() > 0.95
