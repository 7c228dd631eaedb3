"""Ambiguity: indistinguishable contacts and unobserved directions of geometry."""

import csv
import io
import json
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from contact_motions import touching
from contact_tracker.config.parameters import SystematicErrors
from contact_tracker.contacts import CONTACT_MODELS
from contact_tracker.exports.formats import json_line, open_text
from contact_tracker.geometry import lifted_pose
from contact_tracker.geometry.elements import ContactGeometry, Line, Origins, Plane, Point, Unobserved
from contact_tracker.hypotheses import observability
from contact_tracker.hypotheses.bank import blank
from contact_tracker.hypotheses.bank_update import fit_window
from contact_tracker.hypotheses.observability import fitted_contact
from contact_tracker.motion.poses import Poses
from contact_tracker.motion.window import Window, used_directions
from contact_tracker.outputs.text import describe, table
from contact_tracker.states import CONTACTS, STATES, Contact
from contact_tracker.tracking import ambiguity
from contact_tracker.tracking.belief import Segment
from contact_tracker.tracking.contact_filter import ContactFilter, ticks_of
from contact_tracker.tracking.offline_smoother import segment
from contact_tracker.tracking.state import scales_of
from contact_tracker_lab.simulate import Scenario, simulate
from contact_tracker_lab.simulate.scenarios import Phase
from short_recordings import MODEL
from smooth_motion import least_jerk, with_noise

SCALES = scales_of(MODEL)
SIGMA_M, SIGMA_RAD = 1e-4, 1e-3
TICKS = 60
each_contact = pytest.mark.parametrize("contact", CONTACTS)
seeds = st.integers(0, 2**32 - 1)


def indistinguishable(label, competing, window, older):
    freedom = ambiguity.freedom_of(label, window, int(window.index[0]) - older)
    return ambiguity.indistinguishable(label, competing, freedom)


def ticks(rotation, position, seed=0, variance=(SIGMA_M**2, SIGMA_RAD**2)):
    """Ticks of exact poses with the noise variance of a good sensor, all in motion."""
    rng = np.random.default_rng(seed)
    count = len(position)
    jitter = Rotation.from_rotvec(rng.normal(size=(count, 3)) * np.sqrt(variance[1])).as_matrix()
    shaken = position - position[0] + rng.normal(size=(count, 3)) * np.sqrt(variance[0])
    rows = np.tile(variance, (count, 1))
    zeta = lifted_pose.lift(rotation @ jitter, shaken)
    return Window(np.arange(count), zeta, rows, 1e4 * rows, frames=np.ones(count))


def waves(number, seed=1):
    """Smooth independent signals (TICKS, number)."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(TICKS)[:, None, None] * 0.1
    phase = rng.uniform(0.0, 6.0, (5, number))
    return np.sin(2.0 * np.pi * rng.uniform(0.2, 0.8, (5, number)) * time_s + phase).mean(axis=1)


def turning(axis, angle):
    return Rotation.from_rotvec(np.outer(angle, axis)).as_matrix()


def found(contact, window):
    """Geometry of one contact fitted to all ticks."""
    model = CONTACT_MODELS[contact.column]
    bank = fit_window(model, window, SCALES)
    return fitted_contact(bank, 0, model, SCALES, window, Origins.zero(), SystematicErrors()).geometry


def ways(element, how):
    return np.array([way.direction for way in element.unobserved if way.how == how])


@each_contact
def test_with_motion_in_all_directions_everything_is_observed_and_at_rest_nothing(contact):
    true = touching(contact, np.random.default_rng(1))
    geometry = found(contact, ticks(true.rotation, true.position_m))
    assert geometry.object.unobserved == geometry.environment.unobserved == ()
    if contact is Contact.VF:
        geometry = found(contact, ticks(np.tile(np.eye(3), (TICKS, 1, 1)), np.zeros((TICKS, 3))))
        assert len(geometry.object.unobserved) == len(geometry.environment.unobserved) == 3


def test_translation_determines_the_normal_of_the_plane_but_not_the_edge():
    turn = Rotation.random(random_state=np.random.default_rng(3))
    normal = np.array([0.0, 0.0, 1.0])
    position = np.column_stack([0.1 * waves(2), np.zeros(TICKS)])
    geometry = found(Contact.EF, ticks(np.tile(turn.as_matrix(), (TICKS, 1, 1)), position))
    edge, face = geometry.object, geometry.environment
    assert abs(face.normal @ normal) > 0.999
    assert not len(ways(face, "turns_about"))
    np.testing.assert_allclose(np.abs(ways(face, "shifts_along") @ normal), 1.0, atol=1e-3)
    # direction and place of the edge in the plane are unobserved
    np.testing.assert_allclose(np.abs(ways(edge, "turns_about") @ turn.inv().apply(normal)), 1.0, atol=0.01)
    assert len(ways(edge, "shifts_along")) == 2
    np.testing.assert_allclose(ways(edge, "shifts_along") @ edge.direction, 0.0, atol=1e-5)
    assert edge.covariance[3:, 3:].max() > 0.1**2


def test_faces_that_slide_along_one_line_may_be_tilted_about_it():
    turn = Rotation.random(random_state=np.random.default_rng(4))
    along = np.array([0.6, 0.8, 0.0])
    window = ticks(np.tile(turn.as_matrix(), (TICKS, 1, 1)), 0.1 * waves(1) * along)
    geometry = found(Contact.FF, window)
    for element, axis in ((geometry.environment, along), (geometry.object, turn.inv().apply(along))):
        assert [way.how for way in element.unobserved] == ["turns_about"]
        assert abs(element.unobserved[0].direction @ axis) > 0.999
    both = ticks(np.tile(turn.as_matrix(), (TICKS, 1, 1)), np.column_stack([0.1 * waves(2), np.zeros(TICKS)]))
    geometry = found(Contact.FF, both)
    assert geometry.object.unobserved == geometry.environment.unobserved == ()


@pytest.mark.parametrize("seed", range(2))
def test_a_hinge_determines_the_vertex_except_along_the_axis(seed):
    """The vertex is correct up to its unobserved directions; the tilt of the plane is unobserved."""
    rng = np.random.default_rng(seed)
    axis, vertex = Rotation.random(random_state=rng).apply([1.0, 0.0, 0.0]), rng.normal(size=3) * 0.1
    rotation = turning(axis, 0.6 * waves(1, seed)[:, 0])
    geometry = found(Contact.VF, ticks(rotation, -rotation @ vertex))
    shifts = ways(geometry.object, "shifts_along")
    off = geometry.object.point_m - vertex
    np.testing.assert_allclose(off - shifts.T @ (shifts @ off), 0.0, atol=0.01)
    assert np.linalg.norm(shifts @ axis) > 0.99
    assert len(ways(geometry.environment, "turns_about")) >= 1


def kinds_of_motion():
    eye, axis = np.tile(np.eye(3), (TICKS, 1, 1)), np.array([0.0, 0.6, 0.8])
    four = waves(6, 5)
    hinge = turning(axis, 0.7 * four[:, 0])
    arm = np.array([0.1, 0.05, -0.2])
    plane = 0.1 * four[:, 1:3] @ np.linalg.svd(axis[None])[2][1:]
    return {
        "rest": (0, eye, np.zeros((TICKS, 3))),
        "line": (1, eye, 0.1 * four[:, :1] * axis),
        "hinge": (1, hinge, -hinge @ arm),
        "screw": (1, hinge, -hinge @ arm + 0.05 * four[:, :1] * axis),
        # with small errors of about 0.3 deg about other axes
        "loose hinge": (
            1,
            hinge @ Rotation.from_rotvec(0.005 * four[:, 2:5]).as_matrix(),
            -hinge @ arm + 0.002 * four[:, 2:5],
        ),
        "plane": (2, eye, plane),
        "cylinder": (2, hinge, -hinge @ arm + 0.1 * four[:, 1:2] * axis),
        "faces": (3, hinge, plane),
        "all": (6, Rotation.from_rotvec(0.4 * four[:, :3]).as_matrix(), 0.1 * four[:, 3:]),
    }


@pytest.mark.parametrize("kind", kinds_of_motion())
@given(seed=seeds)
@settings(max_examples=3, deadline=None)
def test_the_directions_that_a_motion_uses_are_counted_in_any_frame(kind, seed):
    used, rotation, position = kinds_of_motion()[kind]
    rng = np.random.default_rng(seed)
    world, body = Rotation.random(2, random_state=rng).as_matrix()
    position = (position + rotation @ rng.normal(size=3) * 0.2) @ world.T
    assert used_directions(ticks(world @ rotation @ body, position, seed)) == used


def test_a_carry_in_a_plane_with_a_turn_uses_three_directions():
    """An axis that moves gives further twists, but the object has no further freedom: as e-f it has four."""
    upright, four = np.array([0.0, 0.0, 1.0]), waves(6, 5)
    position = 0.2 * np.column_stack([four[:, 1], np.zeros(TICKS), four[:, 2]])
    window = ticks(turning(upright, 0.7 * four[:, 0]), position)
    assert used_directions(window) == 3
    assert ambiguity.freedom_of(Contact.EF, window, 0).underused


@pytest.mark.parametrize("move", ["tilts", "slides"])
def test_tilts_on_several_edges_are_no_motion_of_one_contact(move):
    """Three parallel hinges move an object like a face on a wall beside it; slides with stops between do not
    turn it."""
    rises = np.concatenate([np.zeros(12), np.sin(np.linspace(0.0, np.pi, 20))])
    feet_m = 0.1 * np.repeat([[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 0.0, 2.0]], len(rises), axis=0)
    angle = np.tile(0.5 * rises, 3)
    rotation = turning(np.array([0.0, 1.0, 0.0]), angle)
    shifts_m = feet_m - np.einsum("nij,nj->ni", rotation, feet_m)
    if move == "slides":
        rotation = np.tile(np.eye(3), (len(angle), 1, 1))
        shifts_m = angle[:, None] * np.repeat(np.eye(3), len(rises), axis=0)
    window = ticks(rotation, shifts_m)
    assert used_directions(window) == 3
    freedom = ambiguity.freedom_of(Contact.FF, window, 0)
    assert not freedom.one_direction
    assert ambiguity.freedom_by_moves(freedom, window, 0.1).one_direction == (move == "tilts")


def rivals(**nats):
    """Evidence by state; states not given fit badly, except free motion."""
    names = [state.value.replace("-", "") for state in STATES]
    evidence = np.array([nats.get(name, -100.0) for name in names])
    return ambiguity.CompetingEvidence(
        evidence, np.array([1.0 if n in nats or n == "free" else 9.0 for n in names])
    )


def test_the_evidence_of_a_label_is_that_of_its_best_hypotheses():
    """For each onset the best one, without negligible ones, also at the onset of the rival."""
    onsets = np.array([0, 0, 1, 2, 2])
    banks = [blank(model, 0) for model in CONTACT_MODELS]
    edge, vertex = CONTACT_MODELS[Contact.EF.column], CONTACT_MODELS[Contact.VF.column]
    evidence = [5.0, 2.0, -300.0, -1.0, 4.0]
    banks[Contact.EF.column] = blank(edge, 5).replace_columns(onset=onsets, log_likelihood=evidence)
    banks[Contact.VF.column] = blank(vertex, 1).replace_columns(onset=1, log_likelihood=3.0)
    competing = ambiguity.competing_evidence(banks, Contact.EF, 0, 20)
    assert competing.evidence[Contact.VF.column] == pytest.approx(3.0 - 0.5 * (5.0 + 4.0))
    assert competing.evidence[-1] == pytest.approx(-5.0)
    assert competing.evidence[Contact.FF.column] == -np.inf


@pytest.mark.parametrize(
    ("label", "nats", "kind", "expected"),
    [
        # evidence of twenty to one separates
        (Contact.FF, {"ff": 50.0, "ef": 50.0 - 2.9, "vf": 50.0 - 3.1, "ee": 51.0}, "all", "e-f e-e"),
        # with unused freedom contained contacts are indistinguishable
        (Contact.EF, {"ef": 50.0, "fe": 49.0}, "all", "f-e"),
        (Contact.EF, {"ef": 50.0, "fe": 49.0}, "faces", "f-e v-f f-v e-e free"),
        (Contact.EF, {"ef": 50.0, "fe": 49.0}, "hinge", "f-f f-e v-f f-v e-e free"),
        (Contact.FF, {"ff": 50.0}, "faces", ""),
        # even with high evidence of f-v: an object that only slides may also have an edge on a face
        (Contact.FV, {"fv": 50.0, "ef": 20.0}, "plane", "e-f v-f e-e free"),
        (Contact.FV, {"fv": 50.0, "ef": 20.0}, "all", ""),
    ],
)
def test_what_evidence_and_freedom_do_not_separate_is_indistinguishable(label, nats, kind, expected):
    window = ticks(*kinds_of_motion()[kind][1:])
    others = indistinguishable(label, rivals(**nats), window, older=False)
    assert " ".join(other.value for other in others) == expected


@pytest.mark.parametrize(("sigma_m", "is_open"), [(3e-5, True), (SIGMA_M, False)])
def test_a_machine_may_be_programmed_to_keep_few_constraints_or_not_to_tilt_in_the_air(sigma_m, is_open):
    """Poses without noise (but for the models' least) are those of a machine."""
    rotation, position = kinds_of_motion()["all"][1:]
    window = ticks(rotation, position, variance=(sigma_m**2, SIGMA_RAD**2))
    evidence = {"ff": 50.0, "vf": 50.0, "ee": 50.0, "ef": 50.0}
    for label in Contact.FF, Contact.VF, Contact.EE:
        assert (Contact.FREE in indistinguishable(label, rivals(**evidence), window, older=False)) == is_open
    assert Contact.FREE not in indistinguishable(Contact.EF, rivals(**evidence), window, older=False)


@pytest.mark.parametrize(
    ("turn_rad", "onset", "in_world", "is_flush"),
    [
        *((0.0, 0, True, True), (0.0, 0, False, True), (0.0, TICKS - 8, True, False)),
        *((0.1, 0, True, False), (0.1, 0, False, False)),
    ],
)
def test_a_face_that_has_not_turned_for_a_second_may_be_flush_now(turn_rad, onset, in_world, is_flush):
    """Whether it lies on an edge or on a face; of a contact since then, and not of what was before."""
    upright, angle = np.array([0.0, 0.0, 1.0]), np.linspace(0.0, 6.0, TICKS)
    tilt = Rotation.from_rotvec(turn_rad * np.sin(angle)[:, None] * np.array([1.0, 0.0, 0.0]))
    yaw = Rotation.from_rotvec(angle[:, None] * upright)
    turn = (yaw * tilt if in_world else tilt * yaw).as_matrix()
    window = ticks(turn, np.zeros((TICKS, 3)))
    assert ambiguity.is_flush_now(upright, in_world, window, onset, 0.1) == is_flush


@pytest.mark.parametrize(
    ("shift_m", "sigma_m", "name", "is_open"),
    [
        *((0.0, SIGMA_M, None, True), (0.0, SIGMA_M, "corner", False)),
        *((0.01, SIGMA_M, None, False), (0.01, 1e-6, None, True)),
    ],
)
def test_an_edge_on_the_axis_of_an_arms_base_may_be_none(shift_m, sigma_m, name, is_open):
    """The arm moves its tool in planes through this axis: the z axis of the world, or one parallel to it if
    the poses are those of a machine; not if the edge is listed."""
    edge = Line(np.array([0.0, 0.0, 1.0]), np.array([shift_m, 0.0, 0.4]), 1e-6 * np.eye(6), name=name)
    face = Plane(np.array([0.0, 1.0, 0.0]), 0.0, 1e-6 * np.eye(4))
    window = ticks(*kinds_of_motion()["all"][1:], variance=(sigma_m**2, SIGMA_RAD**2))
    assert ambiguity.may_be_free(Contact.FE, ContactGeometry(face, edge), window) == is_open
    assert not ambiguity.may_be_free(Contact.EF, ContactGeometry(edge, face), window)


def test_a_label_is_open_to_what_a_further_contact_beside_it_may_be():
    """An edge that is dragged in a vertical plane keeps a face in that plane, with less complex elements."""
    rms = np.array([1.0, 1.1, 5.0, 1.1, 5.0, 5.0, 1.0])
    rivals = ambiguity.CompetingEvidence(np.array([40.0, 18.0, 0.0, 10.0, 0.0, 0.0, 0.0]), rms)
    open_to = {(): (), (Contact.EF, Contact.EE): (Contact.EF,)}
    for others, alike in open_to.items():
        assert ambiguity.alike_in_formation(Contact.FF, rivals, others) == alike


@pytest.mark.parametrize(("older", "others"), [(True, ()), (False, (Contact.FREE,))])
def test_rest_keeps_the_information_of_earlier_motion(older, others):
    rest = ticks(*kinds_of_motion()["rest"][1:])
    rest = replace(rest, innovation_excess=0.0 * rest.innovation_excess)
    assert indistinguishable(Contact.VF, rivals(vf=50.0), rest, older) == others


@pytest.mark.parametrize(("contact", "motion"), [(Contact.EF, "one-axis"), (Contact.FE, "translation")])
def test_the_true_contact_is_among_the_indistinguishable_ones(contact, motion):
    simulated = simulate(Scenario((Phase(contact, 3.0, motion),)), 1)
    done = segment(simulated.poses, MODEL)
    for one in (*(s for s in done.segments if s.end_ns - s.start_ns > 1.5e9), *done.filtered[-10:]):
        assert contact in (one.contact, *one.inseparable)
        assert len(one.inseparable) >= 4
    assert json.loads(json_line(done.filtered[-1]))["inseparable"] == list(done.filtered[-1].inseparable)


UP = np.array([0.0, 0.0, 1.0])
SHIFTS, TURNS = Unobserved("shifts_along", UP), Unobserved("turns_about", UP)
PARTLY = ContactGeometry(Point(np.zeros(3), None, (SHIFTS,)), Plane(UP, 0.25, None, (TURNS,)))


def test_outputs_name_the_indistinguishable_contacts():
    assert describe(PARTLY, (Contact.FREE,)) == (
        "vertex (0.000 0.000 0.000) m (unobserved: shift along (0.00 0.00 1.00)) on "
        "face normal (0.00 0.00 1.00) at 0.250 m (unobserved: turn about (0.00 0.00 1.00)); or free"
    )
    nothing = ContactGeometry(Line(UP, np.zeros(3), None, (TURNS, TURNS, SHIFTS, SHIFTS)), Plane(UP, 0.0))
    assert describe(nothing).startswith("edge (unobserved) on face normal")
    segments = [Segment(0, 2 * 10**9, Contact.VF, 0.4, PARTLY, (Contact.EF, Contact.FREE))]
    segments += [Segment(2 * 10**9, 6 * 10**9, Contact.FREE, 0.4, None)]
    assert list(table(segments, 0))[-1] == "The motion leaves the contact open for 2.00 of 6.00 s."
    *_, both = table(segments, 0, with_wrenches=True)
    assert both == "Motion and wrenches leave the contact open for 2.00 of 6.00 s."
    assert len(list(table(segments[1:], 0))) == 2
    file = io.StringIO(newline="")
    with open_text(".csv", file, "segments", lambda: 0) as append:
        append(segments)
    row, _ = csv.DictReader(io.StringIO(file.getvalue(), newline=""))
    assert row["inseparable"].split() == ["e-f", "free"]
    assert json.loads(row["geometry"])["object"]["unobserved"] == [{"shifts_along": [0.0, 0.0, 1.0]}]


def exact_inverse(matrix):
    """The inverse of a matrix of fractions, by Gauss-Jordan elimination."""
    size = len(matrix)
    rows = [[*row, *(Fraction(int(i == k)) for i in range(size))] for k, row in enumerate(matrix)]
    for k in range(size):
        pivot = next(i for i in range(k, size) if rows[i][k])
        rows[k], rows[pivot] = rows[pivot], rows[k]
        rows[k] = [value / rows[k][k] for value in rows[k]]
        for i in set(range(size)) - {k}:
            rows[i] = [a - rows[i][k] * b for a, b in zip(rows[i], rows[k], strict=True)]
    return np.array([row[size:] for row in rows])


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 2**32 - 1), st.lists(st.floats(-3.0, 18.0), min_size=5, max_size=5))
def test_precise_knowledge_does_not_hide_other_unobserved_directions(seed, digits):
    rng = np.random.default_rng(seed)
    ways, root = (rng.normal(size=(5, 5)) + 3.0 * np.eye(5) for _ in range(2))
    eigenvalues, prior = 1.0 + 10.0 ** np.array(digits), root @ root.T
    covariance = observability.posterior_covariance(eigenvalues, ways, prior)
    exact = np.vectorize(Fraction, otypes=[object])
    dual = exact_inverse(exact(ways))
    true = exact_inverse(dual.T @ np.diag(exact(eigenvalues - 1.0)) @ dual + exact(prior)).astype(float)
    sd = np.sqrt(true.diagonal())
    np.testing.assert_allclose(covariance / np.outer(sd, sd), true / np.outer(sd, sd), atol=1e-6)


@pytest.mark.parametrize(("seed", "lag_s"), [(10, 0.0), (11, 0.0), (11, 0.5)])
def test_a_smooth_carry_is_no_contact_with_something_new(seed, lag_s):
    """A new vertex and a new plane can be chosen so that they agree with it: that is not their evidence."""
    rng, count, still = np.random.default_rng(seed), 150, 150
    s = least_jerk((np.arange(still + count) - still) / (count - 1))[:, None]
    end_m, axis = np.array([*rng.normal(scale=0.3, size=2), 0.0]), rng.normal(size=3)
    position_m = s * end_m + 0.6 * s * (1.0 - s) * [0.0, 0.0, 1.0]
    position_m[still:] += np.cumsum(rng.normal(scale=1e-4, size=(count, 3)), axis=0)
    turn = Rotation.from_rotvec(s * axis * 0.8 / np.linalg.norm(axis))
    noise = Rotation.from_rotvec(rng.normal(scale=1.5e-3, size=(len(s), 3)))
    position_m += rng.normal(scale=2e-4, size=position_m.shape)
    poses = Poses(np.arange(len(s)) * 10_000_000, position_m, (noise * turn).as_quat())
    online, labels = ContactFilter.start(MODEL, lag_s), set[Contact]()
    for tick in ticks_of([poses], MODEL):
        online.update(tick)
        if online.reported is not None:
            labels.add(online.reported.contact)
    assert Contact.FREE in labels
    assert not {label for label in labels if label.codimension == 1}


def test_a_contact_that_has_shown_itself_stays_when_its_motion_is_older_than_the_window():
    """A vertex turns on a plane in all ways, and then only slides."""
    model = replace(MODEL, search=replace(MODEL.search, window_s=8.0))
    rng, time_s = np.random.default_rng(0), np.arange(0.0, 24.0, 0.02)

    def waves_of(amplitudes, rates_hz):
        phases = np.arange(3)
        return np.array(amplitudes) * np.sin(2 * np.pi * np.array(rates_hz) * time_s[:, None] + phases)

    calming = np.clip((10.0 - time_s) / 2.0, 0.0, 1.0)[:, None]
    turn = Rotation.from_rotvec(waves_of([0.4, 0.4, 0.5], [0.31, 0.23, 0.17]) * calming)
    position_m = waves_of([0.1, 0.1, 0.0], [0.13, 0.19, 0.0]) - turn.apply([0.02, 0.05, -0.1])
    poses = with_noise(rng, time_s, position_m, turn, 3e-4, 1.5e-3)
    online = ContactFilter.start(model)
    beliefs = [online.update(tick) for tick in ticks_of([poses], model)]
    established = next(
        i for i, one in enumerate(beliefs) if one.contact is Contact.VF and one.probability.max() > 0.9
    )
    assert {belief.contact for belief in beliefs[established:]} == {Contact.VF}
