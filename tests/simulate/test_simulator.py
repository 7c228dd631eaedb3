"""The simulator against independent geometry."""

import json
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from itertools import combinations, pairwise

import numpy as np
import pytest
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from contact_tracker.arrays import Array
from contact_tracker.errors import UsageError
from contact_tracker.geometry.elements import Element, Line, Plane, Point
from contact_tracker.ground_truth import TruthInterval
from contact_tracker.motion.poses import Poses
from contact_tracker.states import CONTACTS, STATES, Contact
from contact_tracker_lab.simulate import SCENARIOS, Phase, Scenario, Simulated, named_scenario, simulate
from contact_tracker_lab.simulate.scenarios import FORMATIONS, JOINTS, OBJECTS, SURROUNDINGS

QUIET = dict.fromkeys(
    ("sigma_position_m", "sigma_rotation_rad", "outlier_probability", "drop_probability"), 0.0
)
RANDOM_SEEDS = range(1)


@cache
def quiet(name: str, seed: int) -> Simulated:
    return simulate(replace(named_scenario(name, seed), **QUIET), seed)


@cache
def each_contact(contact: Contact, motion: str, seed: int = 3) -> Simulated:
    """Each contact, for 4 s of one kind of motion after another contact."""
    before = Contact.VF if contact is Contact.FF else Contact.FF
    phases = (Phase(before, 2.0), Phase(contact, 4.0, motion), Phase(before, 2.0))
    return simulate(Scenario(phases, **QUIET), seed)


def stays(simulated: Simulated) -> Iterator[tuple[TruthInterval, Poses]]:
    for interval in simulated.truth.intervals:
        stamps = simulated.poses.stamp_ns
        yield interval, simulated.poses[(stamps >= interval.start_ns) & (stamps <= interval.end_ns)]


def all_quiet() -> list[Simulated]:
    named = [quiet(name, 0) for name in SCENARIOS if name not in {"random", *FORMATIONS, *JOINTS}]
    return named + [quiet("random", seed) for seed in RANDOM_SEEDS]


def to_world(element: Element, poses: Poses) -> list[Array]:
    """The object's element in the world: its directions or normals and its points, (N, 3) each."""
    if isinstance(element, Plane):
        element = Line(element.normal, element.normal * element.offset_m)
    moved = [poses.rotation @ element.point_m + poses.position_m]
    return moved if isinstance(element, Point) else [poses.rotation @ element.direction, *moved]


def incidence(interval: TruthInterval, poses: Poses) -> Array:
    """Residuals (N, k), in m or of unit vectors, of the contact: zero if the elements touch."""
    assert interval.geometry
    thing, world = interval.geometry.object, interval.geometry.environment
    moved = to_world(thing, poses)
    match interval.contact:
        case Contact.VF:
            return moved[0] @ world.normal[:, None] - world.offset_m
        case Contact.EF:
            return np.stack([moved[0] @ world.normal, moved[1] @ world.normal - world.offset_m], axis=1)
        case Contact.FF:
            opposite = np.linalg.norm(moved[0] + world.normal, axis=1)
            return np.stack([opposite, moved[1] @ world.normal - world.offset_m], axis=1)
        case Contact.FV:
            return np.einsum("ni,ni->n", moved[0], world.point_m - moved[1])[:, None]
        case Contact.FE:
            level = np.einsum("ni,ni->n", moved[0], world.point_m - moved[1])
            return np.stack([moved[0] @ world.direction, level], axis=1)
        case Contact.EE:
            across = np.cross(moved[0], world.direction)
            across /= np.linalg.norm(across, axis=1, keepdims=True)
            return np.einsum("ni,ni->n", across, moved[1] - world.point_m)[:, None]
    raise AssertionError(interval.contact)


def directions(vertices: Array) -> tuple[Array, Array]:
    """Face normals and edge directions of the convex hull."""
    hull = ConvexHull(vertices)
    lines = {tuple(sorted(map(int, pair))) for simplex in hull.simplices for pair in combinations(simplex, 2)}
    edges = np.array([vertices[b] - vertices[a] for a, b in lines])
    edges /= np.linalg.norm(edges, axis=1, keepdims=True)
    return np.unique(hull.equations[:, :3].round(12), axis=0), edges


def separation(simulated: Simulated, poses: Poses) -> Array:
    """Widest gap (N,) in m along any axis that can separate two convex bodies: negative if they overlap,
    zero if they touch (the separating axis theorem)."""
    body = np.array(json.loads(simulated.metadata["object_vertices_m"]))
    fixed = np.array(json.loads(simulated.metadata["surroundings_vertices_m"]))
    (body_normals, body_edges), (fixed_normals, fixed_edges) = directions(body), directions(fixed)
    gaps = []
    for rotation, position in zip(poses.rotation, poses.position_m, strict=True):
        crossed = np.cross((body_edges @ rotation.T)[:, None], fixed_edges[None]).reshape(-1, 3)
        length = np.linalg.norm(crossed, axis=1)
        crossed = crossed[length > 1e-3] / length[length > 1e-3, None]
        axes = np.vstack([body_normals @ rotation.T, fixed_normals, crossed])
        a, b = axes @ (body @ rotation.T + position).T, axes @ fixed.T
        gaps.append(np.maximum(a.min(axis=1) - b.max(axis=1), b.min(axis=1) - a.max(axis=1)).max())
    return np.array(gaps)


def twist(poses: Poses, point_m: Array) -> Array:
    """Velocity (N - 1, 6): rotation in rad/s and translation in m/s of a point of the body."""
    seconds = np.diff(poses.stamp_ns)[:, None] / 1e9
    turn = Rotation.from_quat(poses.quat_xyzw)
    spin = (turn[1:] * turn[:-1].inv()).as_rotvec()
    travel = np.diff(poses.position_m + poses.rotation @ point_m, axis=0)
    return np.hstack([spin, travel]) / seconds


def middle(simulated: Simulated) -> Array:
    return np.mean(json.loads(simulated.metadata["object_vertices_m"]), axis=0)


def test_bodies_touch_within_their_extents_and_never_overlap() -> None:
    for simulated in all_quiet():
        for interval, poses in stays(simulated):
            gap = separation(simulated, poses[:: max(1, len(poses) // 12)])
            assert gap.min() > -1e-9
            if interval.contact is not Contact.FREE:
                assert gap.max() < 1e-9
            elif len(poses) > 100:
                assert gap.max() > 0.01


def test_elements_are_the_bodies_own_features() -> None:
    """A face has three vertices of its body or more, an edge two, a vertex one; all others are behind it."""
    for simulated in all_quiet():
        for interval, _ in stays(simulated):
            if interval.geometry is None:
                continue
            assert interval.contact
            for kind, element, key in (
                (interval.contact.value[0], interval.geometry.object, "object_vertices_m"),
                (interval.contact.value[2], interval.geometry.environment, "surroundings_vertices_m"),
            ):
                vertices = np.array(json.loads(simulated.metadata[key]))
                if isinstance(element, Plane):
                    away = element.offset_m - vertices @ element.normal
                    assert away.min() > -1e-9
                elif isinstance(element, Line):
                    away = np.linalg.norm(np.cross(vertices - element.point_m, element.direction), axis=1)
                else:
                    away = np.linalg.norm(vertices - element.point_m, axis=1)
                on = int((np.abs(away) < 1e-9).sum())
                assert on >= 3 if kind == "f" else on == {"e": 2, "v": 1}[kind]


def test_motion_is_continuous_and_possible_for_a_hand() -> None:
    for simulated in all_quiet():
        seconds = np.diff(simulated.poses.stamp_ns)[1:, None] / 1e9
        velocity = twist(simulated.poses, middle(simulated))
        speed = np.linalg.norm(velocity.reshape(-1, 2, 3), axis=2)
        acceleration = np.linalg.norm((np.diff(velocity, axis=0) / seconds).reshape(-1, 2, 3), axis=2)
        assert speed[:, 0].max() < np.radians(500.0)
        assert speed[:, 1].max() < 2.0
        assert acceleration[:, 0].max() < np.radians(4000.0)
        assert acceleration[:, 1].max() < 12.0


@pytest.mark.parametrize("contact", CONTACTS)
def test_motion_excites_every_free_direction(contact: Contact) -> None:
    """The object rotates about all free axes of the contact, and slides in both directions."""
    interval, poses = next(s for s in stays(each_contact(contact, "normal")) if s[0].contact is contact)
    assert interval.geometry
    thing, fixed = interval.geometry.object, interval.geometry.environment
    body = np.swapaxes(poses.rotation, 1, 2)
    turning = twist(poses, np.zeros(3))[:, :3]
    if contact in (Contact.FE, Contact.FV):
        turning = np.einsum("nij,nj->ni", body[1:], turning)
    axes = {Contact.FF: 1, Contact.EF: 2, Contact.FE: 2}.get(contact, 3)
    power = np.linalg.svd(turning, compute_uv=False) / np.sqrt(len(turning))
    assert power[axes - 1] > np.radians(5.0)
    if isinstance(fixed, Plane):
        touch = to_world(thing, poses)[-1] @ np.linalg.svd(fixed.normal[None])[2][1:].T
    elif isinstance(thing, Plane):
        touch = np.einsum("nij,nj->ni", body, fixed.point_m - poses.position_m)
        touch = touch @ np.linalg.svd(thing.normal[None])[2][1:].T
    else:
        lines = zip(*to_world(thing, poses), strict=True)
        touch = np.array([crossing(*line, fixed) for line in lines])
    assert np.sqrt(np.linalg.eigvalsh(np.cov(touch.T))[0]) > 0.005


def crossing(direction: Array, point: Array, fixed: Element) -> Array:
    """Positions (m) along two lines at their crossing."""
    assert isinstance(fixed, Line)
    along = np.stack([-direction, fixed.direction], axis=1)
    return np.linalg.lstsq(along, point - fixed.point_m)[0]


@pytest.mark.parametrize(
    ("motion", "contact"),
    [
        (motion, contact)
        for motion in ("rest", "translation", "one-axis", "tilt")
        for contact in CONTACTS
        if (motion, contact) != ("tilt", Contact.FF)
    ],
)
def test_singular_motion_is_what_its_name_says(contact: Contact, motion: str) -> None:
    if motion == "rest":
        phases = (Phase(contact, 2.0, "rest"), Phase(contact, 2.0))
        simulated = simulate(Scenario(phases, **QUIET), 0)
    else:
        simulated = each_contact(contact, motion)
    interval, poses = next(s for s in stays(simulated) if s[0].motion == motion)
    assert interval.singular
    assert interval.contact is contact
    velocity = twist(poses, middle(simulated))
    turning = np.linalg.svd(velocity[:, :3], compute_uv=False) / np.sqrt(len(velocity))
    travel = np.linalg.norm(velocity[:, 3:], axis=1)
    if motion in ("one-axis", "tilt"):
        assert turning[0] > 0.05
        assert turning[1] < 1e-6
    else:
        assert turning[0] < 1e-6
        assert (travel.max() < 1e-9) == (motion == "rest")
    assert np.abs(incidence(interval, poses)).max() < 1e-9


def test_phases_last_as_specified_and_follow_the_lattice() -> None:
    for simulated in all_quiet():
        intervals = simulated.truth.intervals
        for before, after in pairwise(intervals):
            assert before.contact
            assert after.contact
            assert before.contact.contains(after.contact) or after.contact.contains(before.contact)
            assert before.end_ns < after.start_ns
    played = [i.contact for i in quiet("paper_experiment", 0).truth.intervals]
    assert played == ["f-f", "f-f", "e-f", "v-f", "free", "e-e"]
    assert {i.contact for i in quiet("all_states", 0).truth.intervals} == set(STATES)
    asked = [phase.duration_s for phase in named_scenario("paper_experiment", 0).phases]
    contacts = (i for i in quiet("paper_experiment", 0).truth.intervals if i.contact != "free")
    lasted = [(i.end_ns - i.start_ns) / 1e9 for i in contacts]
    np.testing.assert_allclose(lasted, asked, atol=0.02)


def test_noise_is_as_specified() -> None:
    sigma = {"sigma_position_m": 0.0012, "sigma_rotation_rad": 0.004}
    scenario = replace(named_scenario("random", 2), **sigma, rate_hz=200.0)
    noisy, clean = simulate(scenario, 2).poses, quiet("random", 2).poses
    shift = noisy.position_m - clean.position_m
    turn = Rotation.from_quat(clean.quat_xyzw).inv() * Rotation.from_quat(noisy.quat_xyzw)
    np.testing.assert_allclose(shift.std(axis=0), 0.0012, rtol=0.05)
    np.testing.assert_allclose(turn.as_rotvec().std(axis=0), 0.004, rtol=0.05)
    white = np.einsum("ni,ni->i", shift[1:], shift[:-1]) / np.einsum("ni,ni->i", shift, shift)
    assert np.abs(white).max() < 0.05


def test_outliers_drops_repeated_poses_and_jitter_are_as_specified() -> None:
    asked = {"outlier_probability": 0.02, "drop_probability": 0.1, "hold_probability": 0.05}
    base = replace(named_scenario("all_states", 4), **QUIET)
    poses, clean = simulate(replace(base, **asked, jitter_s=0.0005), 4).poses, simulate(base, 4).poses
    period = 5_000_000
    slot = np.rint((poses.stamp_ns - clean.stamp_ns[0]) / period).astype(int)
    assert np.all(np.diff(poses.stamp_ns) > 0)
    assert abs(1.0 - len(poses) / len(clean) - 0.1) < 0.02
    late = poses.stamp_ns - clean.stamp_ns[0] - slot * period
    assert abs(late.std() - 500_000) < 25_000
    held = np.all(np.diff(poses.position_m, axis=0) == 0.0, axis=1).mean()
    assert abs(held - 0.05 * 0.9) < 0.015
    off = np.linalg.norm(poses.position_m - clean.position_m[slot], axis=1)
    assert abs((off > 0.0099).mean() - 0.02) < 0.015
    assert off.max() < 0.07


@pytest.mark.parametrize(
    ("object_name", "surroundings"), [*zip(OBJECTS, [*SURROUNDINGS, "desk"], strict=True)]
)
def test_every_shape_can_do_every_contact(object_name: str, surroundings: str) -> None:
    order = (Contact.FF, Contact.FE, Contact.FV, Contact.FE, Contact.EE, Contact.EF, Contact.VF, Contact.FF)
    phases = tuple(Phase(contact, 1.5) for contact in order)
    simulated = simulate(Scenario(phases, 100.0, object=object_name, surroundings=surroundings, **QUIET), 1)
    assert [i.contact for i in simulated.truth.intervals] == list(order)
    for interval, poses in stays(simulated):
        assert np.abs(incidence(interval, poses)).max() < 1e-9
        assert np.abs(separation(simulated, poses[::30])).max() < 1e-9


def test_unknown_names_and_negative_seeds_are_refused() -> None:
    with pytest.raises(UsageError, match="choose from paper_experiment"):
        simulate("nothing", 0)
    with pytest.raises(UsageError, match="seed"):
        simulate("all_states", -1)


@pytest.mark.parametrize("name", FORMATIONS)
def test_table_and_wall_are_touched_as_in_the_truth(name: str) -> None:
    simulated = quiet(name, 2)
    (first,) = simulated.truth.intervals
    (second,) = first.further
    poses = simulated.poses
    body = np.array(json.loads(simulated.metadata["object_vertices_m"]))
    corners = np.einsum("nij,vj->nvi", poses.rotation, body) + poses.position_m[:, None]
    inside = (poses.stamp_ns >= second.start_ns) & (poses.stamp_ns <= second.end_ns)
    for contact, geometry, holds in (
        (first.contact, first.geometry, np.full(len(poses), True)),
        (second.contact, second.geometry, inside),
    ):
        assert isinstance(geometry.environment, Plane)
        heights = corners @ geometry.environment.normal - geometry.environment.offset_m
        assert heights.min() > -1e-6
        touching = (np.abs(heights) < 1e-6).sum(axis=1)
        at_least = {Contact.FF: 4, Contact.EF: 2, Contact.VF: 1}[contact]
        assert touching[holds].min() == at_least
        assert (heights[~holds].min(axis=1) > 1e-6).mean() > 0.9 if (~holds).any() else True


@pytest.mark.parametrize("name", JOINTS)
def test_simulated_joints_constrain_the_motion(name: str) -> None:
    """The body's element coincides with that of the world, up to the free motion of the joint."""
    simulated = quiet(name, 0)
    poses, joint = simulated.poses, simulated.joint
    assert json.loads(simulated.metadata["joint"])["kind"] == name
    assert [interval.contact for interval in simulated.truth.intervals] == [None]
    place = poses.rotation @ joint.object.point_m + poses.position_m
    if isinstance(joint.environment, Point):
        np.testing.assert_allclose(place, np.broadcast_to(joint.environment.point_m, place.shape), atol=1e-9)
        return
    axis = joint.environment.direction
    np.testing.assert_allclose(poses.rotation @ joint.object.direction - axis, 0.0, atol=1e-9)
    off = place - joint.environment.point_m
    steps = Rotation.from_matrix(poses.rotation[1:] @ poses.rotation[:-1].swapaxes(1, 2)).as_rotvec() @ axis
    angle = np.append(0.0, steps).cumsum()
    if name == "slider":
        np.testing.assert_allclose(angle, 0.0, atol=1e-9)
        assert np.std(off @ axis) == pytest.approx(0.1, rel=0.2)
    else:
        assert np.std(angle) == pytest.approx(np.radians(25.0), rel=0.2)
        np.testing.assert_allclose(off @ axis - off[0] @ axis, joint.pitch_m_per_rad * angle, atol=1e-9)
    np.testing.assert_allclose(off - np.outer(off @ axis, axis), 0.0, atol=1e-9)
