"""Errors of geometry against exact values, the text and JSON reports, and contacts beside the first."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from contact_tracker.arrays import Array
from contact_tracker.errors import NoTruth
from contact_tracker.geometry.elements import ContactGeometry, Element, Line, Plane, Point, nearest
from contact_tracker.ground_truth import Truth, TruthInterval
from contact_tracker.motion.poses import Poses
from contact_tracker.states import CONTACTS, STATES, Contact
from contact_tracker.tracking.belief import Belief, Segment
from contact_tracker.tracking.segmentation import Beliefs, Segmentation
from contact_tracker_lab.evaluation.evaluate import Answers, Evaluation, evaluate
from contact_tracker_lab.evaluation.geometry_errors import deviation, geometry_errors
from contact_tracker_lab.evaluation.report import Report

SEEDS = st.integers(0, 2**32 - 1)
STEP_NS = 10_000_000


def unit(rng: np.random.Generator) -> Array:
    v = rng.normal(size=3)
    return v / np.linalg.norm(v)


def element(kind: str, rng: np.random.Generator, far_m: float = 1.0) -> Element:
    point = rng.normal(size=3) * far_m
    if kind == "v":
        return Point(point)
    direction = unit(rng)
    return Plane(direction, float(direction @ point)) if kind == "f" else Line(direction, point)


def geometry(contact: Contact, rng: np.random.Generator) -> ContactGeometry:
    return ContactGeometry(element(contact.value[0], rng, 0.2), element(contact.value[2], rng))


def flipped(found: Element) -> Element:
    """The same element written with the other sign."""
    match found:
        case Plane(normal, offset_m, covariance):
            return Plane(-normal, -offset_m, covariance)
        case Line(direction, point_m, covariance):
            turn = np.diag([-1.0, -1, -1, 1, 1, 1])
            return Line(-direction, point_m, None if covariance is None else turn @ covariance @ turn)
    return found


def random_poses(rng: np.random.Generator, count: int) -> Poses:
    quat = Rotation.from_rotvec(0.3 * rng.normal(size=(count, 3))).as_quat()
    return Poses(np.arange(count, dtype=np.int64) * STEP_NS, rng.normal(size=(count, 3)), quat)


def interval(contact: Contact, first: int, last: int, true: ContactGeometry | None) -> TruthInterval:
    return TruthInterval(first * STEP_NS, last * STEP_NS, contact, geometry=true)


def segment(contact: Contact, first: int, last: int, found: ContactGeometry | None) -> Segment:
    return Segment(first * STEP_NS, last * STEP_NS, contact, 0.9, found)


def scattered(kind: str, true: Element, place: Array, rng: np.random.Generator) -> Element:
    """``true`` displaced by a draw from its covariance: some 0.5 degrees and millimetres about ``place``."""
    if isinstance(true, Point):
        spread = 1e-3 * rng.normal(size=(3, 3))
        return Point(true.point_m + spread @ rng.normal(size=3), spread @ spread.T)
    direction = true.normal if isinstance(true, Plane) else true.direction
    tangent = np.linalg.svd(direction[None])[2][1:].T
    spread = 0.01 * rng.normal(size=(3 if kind == "f" else 4,) * 2)
    spread[2:] *= 0.1
    draw = spread @ rng.normal(size=len(spread))
    turned = direction + tangent @ draw[:2]
    turned /= np.linalg.norm(turned)
    if isinstance(true, Plane):
        # (n, h) from (two angles, height at place): h = height + n . place
        jacobian = np.zeros((4, 3))
        jacobian[:3, :2], jacobian[3, :2], jacobian[3, 2] = tangent, place @ tangent, 1
        height = true.offset_m - direction @ place + draw[2]
        return Plane(turned, float(height + turned @ place), jacobian @ spread @ spread.T @ jacobian.T)
    jacobian = np.zeros((6, 4))
    jacobian[:3, :2], jacobian[3:, 2:] = tangent, tangent
    moved = nearest(true, place) + tangent @ draw[2:]
    return Line(turned, moved, jacobian @ spread @ spread.T @ jacobian.T)


@pytest.mark.parametrize("kind", "fev")
def test_deviations_under_a_consistent_covariance_are_normal(kind: str) -> None:
    rng = np.random.default_rng(3)
    deviations = []
    for number in range(1500):
        true = element(kind, rng, far_m=3.0)
        place = nearest(true, rng.normal(size=3))
        found = scattered(kind, true, place, rng)
        deviations.append(deviation(found, true, place).sd)
        if number < 100:
            assert deviation(flipped(found), true, place).sd == pytest.approx(deviations[-1], rel=1e-4)
    for sd, share in ((1, 0.6827), (2, 0.9545), (3, 0.9973)):
        tolerance = 3.5 * np.sqrt(share * (1 - share) / 1500)
        assert np.mean(np.array(deviations) <= sd) == pytest.approx(share, abs=tolerance)


def test_deviations_are_known_only_with_a_covariance_and_far_ones_stay_finite() -> None:
    origin = Point(np.zeros(3))
    assert np.isnan(deviation(origin, origin, np.zeros(3)).sd)
    assert np.isnan(deviation(replace(origin, covariance=np.full((3, 3), np.nan)), origin, np.zeros(3)).sd)
    assert np.isnan(deviation(replace(origin, covariance=np.zeros((3, 3))), origin, np.zeros(3)).sd)
    sure = replace(origin, covariance=1e-6 * np.eye(3))
    assert deviation(sure, Point(np.array([0, 0, 1.0])), np.zeros(3)).sd == pytest.approx(1000)
    on_line = Point(np.zeros(3), np.diag([0.01, 0, 0]))  # by its one free direction
    assert deviation(on_line, Point(np.array([0.25, 0, 0])), np.zeros(3)).sd == pytest.approx(2.5)


@settings(max_examples=30, deadline=None)
@given(SEEDS, st.sampled_from(CONTACTS))
def test_the_true_geometry_has_no_error_however_it_is_signed(seed: int, contact: Contact) -> None:
    rng = np.random.default_rng(seed)
    true, poses = geometry(contact, rng), random_poses(rng, 50)
    result = ContactGeometry(flipped(true.object), true.environment)
    truth = Truth((interval(contact, 0, 49, true),))
    for answer in (true, result, ContactGeometry(true.object, flipped(true.environment))):
        errors = geometry_errors(poses, truth, [segment(contact, 0, 49, answer)])
        assert (errors.true_segments, errors.found_segments, len(errors.rows)) == (1, 1, 2)
        assert np.all(errors.angle_deg < 1e-6)
        assert np.all(errors.distance_mm < 1e-9)
        assert np.isnan(errors.within_3_sd)


@settings(max_examples=30, deadline=None)
@given(SEEDS, st.sampled_from([c for c in CONTACTS if c is not Contact.FF]))
def test_a_shifted_environment_is_off_by_its_shift(seed: int, contact: Contact) -> None:
    rng = np.random.default_rng(seed)
    true, poses = geometry(contact, rng), random_poses(rng, 50)
    match true.environment:
        case Plane(normal, offset_m):
            shifted: Element = Plane(normal, offset_m + 0.005)
        case Line(direction, point_m):
            aside = np.cross(direction, unit(rng))
            shifted = Line(direction, point_m + 0.7 * direction + 0.005 * aside / np.linalg.norm(aside))
        case Point(point_m):
            shifted = Point(point_m + 0.005 * unit(rng))
    apart = segment(contact, 0, 49, ContactGeometry(true.object, shifted))
    errors = geometry_errors(poses, Truth((interval(contact, 0, 49, true),)), [apart])
    on_object, on_environment = errors.rows
    assert on_object.distance_mm == pytest.approx(0, abs=1e-9)
    assert on_environment.distance_mm == pytest.approx(5.0)


@settings(max_examples=30, deadline=None)
@given(SEEDS, st.booleans())
def test_errors_of_two_faces_depend_on_their_relative_offset_unless_both_are_known(
    seed: int, flip: bool
) -> None:
    rng = np.random.default_rng(seed)
    normal = unit(rng)
    position = rng.normal(size=(50, 3))
    yaw = Rotation.from_rotvec(np.linspace(0, 1, 50)[:, None] * normal)  # the normals stay aligned
    poses = Poses(np.arange(50, dtype=np.int64) * STEP_NS, position, yaw.as_quat())
    true = ContactGeometry(Plane(normal, 0.1), Plane(normal, 0.7))
    truth = Truth((interval(Contact.FF, 0, 49, true),))
    covariance = np.diag([1e-6, 1e-6, 1e-6, 0.09])
    for on_object_m, on_world_m, expected_mm in (
        (0.0, 0.6, [0.0]),  # an offset of 0 is open
        (0.0, 0.602, [2.0]),
        (0.4, 1.002, [300.0, 302.0]),
    ):
        body, world = Plane(normal, on_object_m, covariance), Plane(normal, on_world_m, covariance)
        found = ContactGeometry(flipped(body) if flip else body, world)
        errors = geometry_errors(poses, truth, [segment(Contact.FF, 0, 49, found)])
        assert errors.distance_mm == pytest.approx(expected_mm, abs=1e-6)


def test_a_true_segment_is_compared_with_the_one_that_overlaps_it_most() -> None:
    rng = np.random.default_rng(0)
    poses, true, other = random_poses(rng, 100), geometry(Contact.VF, rng), geometry(Contact.VF, rng)
    truth = Truth(
        (
            interval(Contact.VF, 0, 19, true),  # at rest, then moving: one segment
            interval(Contact.VF, 20, 59, true),
            interval(Contact.FREE, 60, 69, None),
            interval(Contact.EE, 70, 99, geometry(Contact.EE, rng)),
            interval(Contact.VF, 120, 140, true),  # after the last pose
        )
    )
    found = [
        segment(Contact.VF, 0, 25, other),
        segment(Contact.VF, 26, 69, true),
        segment(Contact.EF, 70, 99, None),
    ]
    errors = geometry_errors(poses, truth, found)
    assert (errors.true_segments, errors.found_segments) == (2, 1)
    assert np.all(errors.distance_mm < 1e-9)


def evaluation(seed: int = 0, right: float = 0.8) -> Evaluation:
    return evaluate(*recorded(seed, right))


def recorded(seed: int, right: float) -> tuple[Poses, Truth, Segmentation]:
    """A recording of all states, with a share ``right`` of right labels, its geometry off by about 1 mm."""
    rng = np.random.default_rng(seed)
    poses, ticks = random_poses(rng, 700), range(9, 700, 10)
    true = {c: geometry(c, rng) for c in CONTACTS}
    truth = Truth(tuple(interval(c, 100 * i, 100 * i + 99, true.get(c)) for i, c in enumerate(STATES)))
    beliefs = []
    for last in ticks:
        label = STATES[last // 100] if rng.random() < right else Contact.FREE
        p = np.where(np.array(STATES) == label, 0.82, 0.03)
        beliefs.append(Belief(int(poses.stamp_ns[last]), label, p, 0, None, np.zeros(6)))
    segments = []
    for i, c in enumerate(CONTACTS):
        place = nearest(true[c].environment, poses.position_m[100 * i : 100 * i + 100].mean(axis=0))
        near = scattered(c.value[2], true[c].environment, place, rng)
        segments.append(segment(c, 100 * i, 100 * i + 99, ContactGeometry(true[c].object, near)))
    return poses, truth, Segmentation(tuple(segments), Beliefs.of(beliefs), Beliefs.of(beliefs))


@pytest.mark.parametrize("late_ns", [0, 200_000_000])
def test_by_arrival_a_label_counts_from_when_it_is_given_out(late_ns: int) -> None:
    poses, truth, whole = recorded(3, 0.9)
    result = evaluate(poses, truth, whole, Answers(whole.filtered, whole.filtered.stamp_ns + late_ns))
    shifted = Beliefs.of(replace(belief, stamp_ns=belief.stamp_ns + late_ns) for belief in whole.filtered)
    later = evaluate(poses, truth, replace(whole, filtered=shifted))
    assert result.arrival.accuracy() == later.online.accuracy()
    assert (result + result).arrival is not None
    assert (result + later).arrival is None
    assert (result.arrival.accuracy() == result.online.accuracy()) is (late_ns == 0)


def test_wrong_elements_in_the_truth_are_refused_before_scoring() -> None:
    truth = Truth((interval(Contact.EE, 0, 9, geometry(Contact.VF, np.random.default_rng(0))),))
    with pytest.raises(NoTruth, match="not those of e-e"):
        evaluate(random_poses(np.random.default_rng(0), 5), truth, Segmentation())


def test_the_open_share_is_that_of_segments_offline_and_of_beliefs_online() -> None:
    poses, truth, segmentation = recorded(0, 1.0)
    first, *others = segmentation.segments
    others = [replace(others[0], inseparable=(Contact.FREE,)), *others[1:]]
    rows = segmentation.filtered.rows.copy()
    rows["inseparable"][:10, 0] = True
    filtered = replace(segmentation.filtered, rows=rows)
    result = evaluate(poses, truth, replace(segmentation, segments=(first, *others), filtered=filtered))
    assert (result.offline.open, result.online.open) == pytest.approx((1 / 7, 1 / 7), abs=0.002)
    assert evaluate(poses, truth, segmentation).online.open == 0.0
    assert result.offline.accuracy() == pytest.approx(1.0), "an open label may be right"


def test_the_report_is_aligned_and_fits_in_80_columns() -> None:
    """Also where shortened names coincide."""
    long = f"{{}}/{40 * 'far/'}away/a_recording_with_a_long_name.mcap"
    text = Report({long.format(i): evaluation(i) for i in range(3)}).to_text()
    assert max(map(len, text.splitlines())) <= 80
    assert text.count("long_name.mcap") == 3 * 4
    assert sum(line.startswith("total") for line in text.splitlines()) == 4
    assert "nan" not in text
    for block in (b.splitlines() for b in text.split("\n\n") if b.startswith("recording ")):
        assert len({len(line) for line in block if line[-1].isdigit() or line[-1] == "-"}) == 1


def test_the_json_report_has_the_same_values_without_nan() -> None:
    a, b = evaluation(1), evaluation(2)
    nothing = evaluate(random_poses(np.random.default_rng(0), 5), Truth(()), Segmentation())
    data = json.loads(Report({"a": a, "b": b, "nothing": nothing}).to_json(), parse_constant=pytest.fail)
    assert list(data["recordings"]) == ["a", "b", "nothing"]
    assert data["recordings"]["nothing"]["offline"]["accuracy"]["all"] is None
    assert data["total"]["offline"]["accuracy"]["all"] == pytest.approx((a + b).offline.accuracy())
    assert data["total"]["offline"]["scored_s"] == pytest.approx(14.0)
    assert np.sum(data["total"]["online"]["confusion_s"]) == pytest.approx(14.0 - 2 * 0.09)
    assert data["total"]["geometry"]["true_segments"] == 12
    assert data["total"]["geometry"]["point"]["distance_mm"]["count"] == 2 * 2 * 2 - 4
