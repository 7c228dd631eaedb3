"""The viewer's recordings read back: their entities, and when these appear and end."""

import json
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rerun as rr
from hypothesis import given, settings
from hypothesis import strategies as st
from rerun.chunk import RrdReader

from contact_tracker.cli.main import run
from contact_tracker.contacts.contact_motion import ContactMotion
from contact_tracker.errors import NoPoses
from contact_tracker.exports.formats import write_outcome
from contact_tracker.geometry.elements import ContactGeometry, Line, Plane, Point
from contact_tracker.ground_truth import Truth
from contact_tracker.motion.poses import Poses
from contact_tracker.outputs import scene
from contact_tracker.outputs.outcome import Outcome
from contact_tracker.outputs.scene import OBJECT, UNKNOWN_EXTENT, draw
from contact_tracker.outputs.text import COLOUR
from contact_tracker.recording import write_recording
from contact_tracker.states import CONTACTS, STATES, Contact
from contact_tracker.tracking.belief import Belief, FurtherContact, Segment
from contact_tracker.tracking.informative_motion import InformativeMotion
from contact_tracker.tracking.segmentation import Beliefs, Segmentation
from contact_tracker.trajectory import Trajectory, vertices_from_metadata
from contact_tracker.viewer import canvas, sinks
from contact_tracker.viewer.sinks import to_file
from contact_tracker.viewer.views import LiveViewer, begin
from mcap_logs import smooth_poses
from rerun_files import chunks, column, rows
from smooth_motion import unturned

ORIGIN_NS = 1_700_000_000_000_000_000
TICK_NS = 100_000_000
POSES = 2400
TICKS = 120
CUBE_M = np.array([[x, y, z] for x in (-0.1, 0.1) for y in (-0.1, 0.1) for z in (0.0, 0.2)])
Z = np.array([0.0, 0.0, 1.0])
X = np.array([1.0, 0.0, 0.0])
FLOOR = Plane(Z, 0.0, np.diag([1e-4, 1e-4, 0.0, 1e-6]))
GEOMETRY = {
    Contact.FF: ContactGeometry(Plane(-Z, 0.0), FLOOR),
    Contact.EF: ContactGeometry(Line(X, np.array([0.0, -0.1, 0.0]), 1e-6 * np.eye(6)), FLOOR),
    Contact.VF: ContactGeometry(Point(np.array([-0.1, -0.1, 0.0]), 1e-6 * np.eye(3)), FLOOR),
    Contact.FREE: None,
}
MESHES = canvas.touching()[:4]
PHASES = ((Contact.FF, 0, 30), (Contact.FREE, 30, 60), (Contact.EF, 60, 90), (Contact.VF, 90, 120))
STARTS_NS = [ORIGIN_NS + first * TICK_NS for _, first, _ in PHASES]
TRUTH = Truth.from_changes(STARTS_NS, ["f-f", "?", "e-f", "e-f"], ORIGIN_NS + TICKS * TICK_NS)


@pytest.fixture(autouse=True)
def strict_rerun() -> Iterator[None]:
    """Fail the test for data that rerun drops with a warning."""
    rr.set_strict_mode(True)
    yield
    rr.set_strict_mode(False)


@pytest.fixture(scope="module")
def poses() -> Poses:
    """A body that slides along x, upright, at 200 Hz."""
    position = np.zeros((POSES, 3))
    position[:, 0] = np.linspace(0.0, 0.3, POSES)
    return unturned(position, 5_000_000, ORIGIN_NS)


@pytest.fixture(scope="module")
def segmentation() -> Segmentation:
    segments, beliefs = [], []
    for contact, first, last in PHASES:
        start_ns, end_ns = ORIGIN_NS + first * TICK_NS, ORIGIN_NS + last * TICK_NS - 5_000_000
        segments.append(Segment(start_ns, end_ns, contact, 0.9, GEOMETRY[contact]))
        for tick in range(first, last):
            probability = np.full(7, 0.2 / 6.0)
            probability[contact.column] = 0.8
            residual = np.where([contact is c for c in CONTACTS], 1.0, np.nan)
            stamp_ns = ORIGIN_NS + (tick + 1) * TICK_NS - 5_000_000
            beliefs.append(Belief(stamp_ns, contact, probability, start_ns, GEOMETRY[contact], residual))
    return Segmentation(tuple(segments), Beliefs.of(beliefs), Beliefs.of(beliefs))


@pytest.fixture(scope="module")
def sparse(poses) -> Poses:
    """Every fifth pose, for speed."""
    return poses[::5]


def outcome(poses: Poses, segmentation: Segmentation, truth: Truth | None = None, **more: Any) -> Outcome:
    return Outcome(Trajectory(poses, **more), segmentation, labels=truth)


@pytest.fixture(scope="module")
def written(tmp_path_factory, poses, segmentation) -> Path:
    path = tmp_path_factory.mktemp("viewer") / "all.rrd"
    write_outcome(outcome(poses, segmentation, TRUTH, vertices_m=CUBE_M), path)
    return path


@pytest.fixture(scope="module")
def streamed(tmp_path_factory, poses, segmentation) -> Path:
    path = tmp_path_factory.mktemp("viewer") / "live.rrd"
    play(path, poses, segmentation.filtered)
    return path


def total(path: Path, entity: str) -> int:
    return sum(chunk.num_rows for chunk in chunks(path, entity))


def test_every_view_has_its_rows(written) -> None:
    expected = {
        canvas.BODY: POSES,
        canvas.TRAIL: TICKS,
        canvas.P_SMOOTHED: TICKS,
        canvas.P_FILTERED: TICKS,
        canvas.RESIDUAL: TICKS,
        canvas.SMOOTHED: len(PHASES),
        canvas.FILTERED: len(PHASES),
        canvas.TRUTH: 3,  # f-f, unknown, e-f: the second e-f is no change
        canvas.EVENTS: len(PHASES),
    }
    assert {entity: total(written, entity) for entity in expected} == expected


def test_poses_are_columns_on_both_timelines(written, poses) -> None:
    parts = chunks(written, canvas.BODY)
    assert max(c.num_rows for c in parts) == 1000
    batch = parts[0].to_record_batch()
    since, stamp = (batch.column(name).to_numpy(zero_copy_only=False) for name in ("t", "stamp"))
    assert since.dtype == "timedelta64[ns]"
    assert np.array_equal(since.astype(np.int64) + ORIGIN_NS, stamp.astype(np.int64))
    translation = rows(written, canvas.BODY, "Transform3D:translation")
    assert [t + ORIGIN_NS for t, _ in translation] == poses.stamp_ns.tolist()
    assert np.allclose([value[0] for _, value in translation], poses.position_m, atol=1e-6)


def test_geometry_appears_with_its_segment_and_is_cleared_after_it(written) -> None:
    for entity in MESHES:
        counts = [(t, len(v)) for t, v in rows(written, entity, "Mesh3D:vertex_positions")]
        assert [t + ORIGIN_NS for t, _ in counts] == STARTS_NS
        assert counts[1][1] == 0, "free motion shows no geometry"
        triangles = rows(written, entity, "Mesh3D:triangle_indices")
        for (_, vertices), (_, corners) in zip(counts, triangles, strict=True):
            assert (vertices == 0) == (corners == [])
            assert all(max(corner) < vertices for corner in corners)
    assert len(rows(written, MESHES[2], "Mesh3D:vertex_positions")[0][1]) > 0
    unknown = rows(written, MESHES[1], "Mesh3D:vertex_positions")[0][1]
    assert unknown == [], "a plane without covariance has no uncertainty to draw"


def test_drawings_fade_with_probability_and_only_surroundings_have_the_contacts_colour(written) -> None:
    for number, (entity, opacity) in enumerate(zip(MESHES, canvas.OPACITY, strict=True)):
        factors = rows(written, entity, "Mesh3D:albedo_factor")
        assert len(factors) == TICKS + len(PHASES)
        rgba = [tuple(value[0].to_bytes(4)) for _, value in factors]
        is_sheet = [number == 2 and one[:3] != COLOUR[Contact.FREE] for one in rgba]
        assert [one[3] for one in rgba] == [
            round(255 * opacity * 0.8 * (canvas.SHEET if sheet else 1.0)) for sheet in is_sheet
        ]
        of_contacts = {COLOUR[contact] for contact, _, _ in PHASES}
        assert {one[:3] for one in rgba} == ({OBJECT} if number < 2 else of_contacts)


def test_states_change_where_they_should(written) -> None:
    smoothed = rows(written, canvas.SMOOTHED, "StateChange:state")
    assert [(t + ORIGIN_NS, v) for t, v in smoothed] == [
        (start, [contact.value]) for start, (contact, _, _) in zip(STARTS_NS, PHASES, strict=True)
    ]
    assert [v for _, v in rows(written, canvas.TRUTH, "StateChange:state")] == [["f-f"], [""], ["e-f"]]
    configured = chunks(written, canvas.TRUTH, static=True)[0].to_record_batch()
    assert configured.column("StateConfiguration:values").to_pylist() == [[s.value for s in STATES]]


def test_posteriors_and_minima_are_whole_and_nan_stays_nan(written, segmentation) -> None:
    probability = np.array([v for _, v in rows(written, canvas.P_SMOOTHED, "Scalars:scalars")])
    assert np.array_equal(probability, [b.probability for b in segmentation.beliefs])
    residual = np.array([v for _, v in rows(written, canvas.RESIDUAL, "Scalars:scalars")])
    expected = np.array([b.residual for b in segmentation.filtered])
    assert np.isnan(expected).any()
    assert np.array_equal(residual, expected, equal_nan=True)


def test_events_have_time_probability_and_geometry(written) -> None:
    texts = [value[0] for _, value in rows(written, canvas.EVENTS, "TextLog:text")]
    assert "3.00 s" in texts[1]
    assert "edge along" in texts[2]
    assert "vertex" in texts[3]
    assert all("p 0.90" in text for text in texts)


def test_the_slip_at_the_contact_is_drawn_with_noise_and_gaps(tmp_path, sparse, segmentation) -> None:
    stamps = segmentation.beliefs.stamp_ns[:9]
    ones, slip = np.ones(len(stamps)), np.outer(np.arange(len(stamps)), [0.6, 0.8, 0.0])
    both, three = np.ones((len(stamps), 2)), np.ones((len(stamps), 3))
    motion = ContactMotion(stamps, slip, 0.1 * ones, both, ones, ones, ones, three)
    first, *others = segmentation.segments
    moving = replace(segmentation, segments=(replace(first, motion=motion), *others))
    path = tmp_path / "slip.rrd"
    write_outcome(outcome(sparse, moving), path)
    drawn = np.array([value for _, value in rows(path, canvas.MOTION, "Scalars:scalars")])
    np.testing.assert_allclose(drawn[:-1, 0], np.arange(len(stamps)), atol=1e-12)
    np.testing.assert_allclose(drawn[:-1, 1], 0.3)
    assert np.isnan(drawn[-1]).all()


def test_the_blueprint_is_in_the_file(written) -> None:
    reader = RrdReader(written)
    (recording,), (_, blueprint) = reader.recordings(), reader.blueprints()
    assert blueprint.application_id == recording.application_id == canvas.APPLICATION
    classes = [value for (value,) in column(reader, reader.blueprints()[0], "ViewBlueprint:class_identifier")]
    assert sorted(classes) == ["3D", "StateTimeline", "TextDocument", "TextLog", *["TimeSeries"] * 4]


def test_without_truth_and_hull_the_rest_is_there(tmp_path, poses, segmentation) -> None:
    path = tmp_path / "less.rrd"
    write_outcome(outcome(poses[:499], segmentation), path)
    assert total(path, canvas.TRUTH) == 0
    assert total(path, canvas.BODY) == 499
    assert not any(chunks(path, entity, static=True) for entity in canvas.KNOWN)
    one = Segmentation(segmentation.segments[:1], segmentation.beliefs[:1], segmentation.filtered[:1])
    write_outcome(outcome(poses[:1], one), tmp_path / "one.rrd")
    assert total(tmp_path / "one.rrd", canvas.BODY) == 1
    with pytest.raises(NoPoses):
        write_outcome(outcome(poses[:0], segmentation, origin_ns=ORIGIN_NS), tmp_path / "none.rrd")
    assert not (tmp_path / "none.rrd").exists()


def play(path: Path, poses: Poses, beliefs: tuple[Belief, ...]) -> None:
    """Stream poses, and each belief once its tick is complete."""
    due = list(beliefs)
    with LiveViewer(CUBE_M, to_file(path)) as view:
        for pose in poses:
            view.pose(pose)
            while due and due[0].stamp_ns <= pose.stamp_ns:
                view.belief(due.pop(0))


def test_what_to_move_next_is_drawn_live(tmp_path, poses) -> None:
    """A turn as its axis and the arc about it, until there is nothing to suggest."""
    pair, turn = (Contact.EF, Contact.VF), np.array([0.0, 0.25, 0.0])
    motion = InformativeMotion(*pair, turn, turn, *np.array([[0.1, 0.2, 0.3]] * 2), *np.zeros((2, 3)), 9.0)
    path = tmp_path / "live.rrd"
    with LiveViewer(CUBE_M, to_file(path)) as view:
        view.pose(next(iter(poses)))
        view.suggest(int(poses.stamp_ns[0]), motion)
        view.suggest(int(poses.stamp_ns[1]), None)
    (_, (vector,)), (_, gone) = rows(path, canvas.SUGGESTED, "Arrows3D:vectors")
    assert vector[1] > 0.0
    assert not len(gone)
    (_, (strip,)), _ = rows(path, f"{canvas.SUGGESTED}/arc", "LineStrips3D:strips")
    arms = np.array(strip) - [0.1, 0.2, 0.3]
    np.testing.assert_allclose(arms[:, 1], 0.0, atol=1e-6)
    cosine = arms[0] @ arms[-1] / np.linalg.norm(arms[0]) ** 2
    assert np.arccos(cosine) == pytest.approx(0.25, abs=1e-3)


def test_indistinguishable_contacts_are_named_and_pale(tmp_path, sparse, segmentation) -> None:
    first, *rest = segmentation.segments
    unsure = replace(segmentation, segments=(replace(first, inseparable=(Contact.VF, Contact.FREE)), *rest))
    write_outcome(outcome(sparse, unsure), tmp_path / "some.rrd")
    beliefs = [replace(b, inseparable=(Contact.VF,)) if i < 10 else b for i, b in enumerate(unsure.filtered)]
    play(tmp_path / "live.rrd", sparse, tuple(beliefs))
    lane = [v for _, v in rows(tmp_path / "some.rrd", canvas.INSEPARABLE, "StateChange:state")]
    assert lane == [["or v-f, free"], [""]]
    lane = [v for _, v in rows(tmp_path / "live.rrd", canvas.INSEPARABLE, "StateChange:state")]
    assert lane == [["or v-f"], [""]]
    label = canvas.touching()[-1]
    captions = [v[0] for _, v in rows(tmp_path / "some.rrd", label, "Points3D:labels")]
    assert captions[0] == "f-f  0.80 or v-f, free"
    assert captions[-1] == "v-f  0.80"
    captions = [v[0] for _, v in rows(tmp_path / "live.rrd", label, "Points3D:labels")]
    assert captions[9:11] == ["f-f  0.80 or v-f", "f-f  0.80"]
    factors = 1.0, 1.0, canvas.SHEET, 1.0
    for path in (tmp_path / "some.rrd", tmp_path / "live.rrd"):
        for entity, opacity, factor in zip(MESHES, canvas.OPACITY, factors, strict=True):
            _, value = rows(path, entity, "Mesh3D:albedo_factor")[0]
            assert value[0].to_bytes(4)[3] == round(255 * opacity * 0.8 * factor * canvas.OPEN)


def test_a_live_part_of_a_recording_keeps_its_time(tmp_path, sparse) -> None:
    path = tmp_path / "live.rrd"
    with LiveViewer(CUBE_M, to_file(path), lambda: ORIGIN_NS) as view:
        for pose in sparse[160:]:
            view.pose(pose)
    assert rows(path, canvas.BODY, "Transform3D:translation")[0][0] == 4_000_000_000


def test_a_recording_beside_others_has_its_name_and_the_list_open(tmp_path, sparse, segmentation) -> None:
    panels = []
    for several in (False, True):
        path = tmp_path / f"{several}.rrd"
        begin(to_file(path), "shelf.mcap", several)(outcome(sparse, segmentation))
        reader = RrdReader(path)
        properties = column(reader, reader.recordings()[0], "RecordingInfo:name")
        assert properties == [["shelf.mcap"]]
        panels.append(column(reader, reader.blueprints()[0], "PanelBlueprint:state", "/blueprint_panel"))
    assert panels[0] != panels[1]


def with_a_wall(segmentation: Segmentation) -> Segmentation:
    """With a vertex on a wall in the second half of the first segment and in half of the third."""
    wall = ContactGeometry(Point(np.array([0.1, 0.0, 0.0])), Plane(X, 0.4))
    segments, beliefs = list(segmentation.segments), list(segmentation.beliefs)
    for number, tick in ((0, 15), (2, 75)):
        start_ns = ORIGIN_NS + tick * TICK_NS
        end_ns = segments[number].end_ns if number == 0 else start_ns + 9 * TICK_NS
        further = (FurtherContact(Contact.VF, 0.8, start_ns, end_ns, wall, (Contact.EF,), 4),)
        segments[number] = replace(segments[number], further=further)
        beliefs = [replace(b, further=further) if start_ns <= b.stamp_ns <= end_ns else b for b in beliefs]
    return Segmentation(tuple(segments), Beliefs.of(beliefs), Beliefs.of(beliefs))


@pytest.mark.parametrize("live", [False, True])
def test_a_further_contact_has_its_lane_label_and_meshes(tmp_path, sparse, segmentation, live) -> None:
    path = tmp_path / "two.rrd"
    if live:
        play(path, sparse, with_a_wall(segmentation).filtered)
    else:
        write_outcome(outcome(sparse, with_a_wall(segmentation), vertices_m=CUBE_M), path)
    lane = [value for _, value in rows(path, canvas.further_lane(1), "StateChange:state")]
    assert [value[0] for value in lane if value] == [*([] if live else [""]), "v-f", "", "v-f", ""]
    second = canvas.touching(1)
    labels = [value for _, value in rows(path, second[-1], "Points3D:labels")]
    together = "0.64" if live else "0.72"  # 0.8 beside a label with 0.8 and 0.9
    assert set(map(tuple, labels)) == {(f"+ v-f  {together} or e-f",)}
    drawn = [len(value) > 0 for _, value in rows(path, second[2], "Mesh3D:vertex_positions")]
    changes = [a for a, b in zip(drawn, [None, *drawn], strict=False) if a is not b]
    assert changes == [*([] if live else [False]), True, False, True, False]
    first = [len(value) for _, value in rows(path, MESHES[2], "Mesh3D:vertex_positions")]
    assert len({n for n in first if n}) <= 2, "no wall beside what the label is about"


def test_live_and_offline_views_agree(streamed) -> None:
    assert total(streamed, canvas.BODY) == POSES // 2, "200 Hz are shown at 100 Hz"
    for entity in (canvas.TRAIL, canvas.P_FILTERED, canvas.RESIDUAL):
        assert total(streamed, entity) == TICKS
    assert total(streamed, canvas.FILTERED) == total(streamed, canvas.EVENTS) == len(PHASES)
    assert len(RrdReader(streamed).blueprints()) == 1
    strips = [value[0] for _, value in rows(streamed, canvas.TRAIL, "LineStrips3D:strips")]
    assert all(before[-1] == after[0] for before, after in pairwise(strips)), "the trail is unbroken"


def test_live_geometry_follows_twice_a_second_and_ends_with_its_contact(streamed) -> None:
    drawn = rows(streamed, MESHES[2], "Mesh3D:vertex_positions")
    for contact, first, last in PHASES:
        first_ns, last_ns = ((tick + 1) * TICK_NS - 5_000_000 for tick in (first, last))
        within = [(t, len(v) > 0) for t, v in drawn if first_ns <= t < last_ns]
        assert within == [(first_ns + 5 * i * TICK_NS, contact is not Contact.FREE) for i in range(6)]


@settings(max_examples=24, deadline=None)
@given(
    kind=st.sampled_from((Plane, Line, Point)),
    vector=st.lists(st.floats(-1.0, 1.0), min_size=3, max_size=3).filter(lambda v: np.linalg.norm(v) > 0.1),
    seed=st.integers(0, 2**32 - 1),
)
def test_uncertainty_is_drawn_at_two_standard_deviations(kind: type, vector: list[float], seed: int) -> None:
    """As bowls about a plane, a tube about a line, and an ellipsoid about a point."""
    axis, place_m = np.array(vector) / np.linalg.norm(vector), np.array([0.1, -0.2, 0.3])
    size = {Plane: 4, Line: 6, Point: 3}[kind]
    root = 1e-3 * np.random.default_rng(seed).normal(size=(size, size))
    covariance, basis = root @ root.T + 1e-8 * np.eye(size), np.linalg.svd(axis[None])[2][1:]
    known = {Plane: (axis, axis @ place_m), Line: (axis, place_m), Point: (place_m,)}[kind]
    mesh = scene.uncertainty(kind(*known, covariance), place_m, 1.0)
    assert len(mesh.vertices)
    for offset_m in mesh.vertices.astype(float) - place_m:
        if kind is Plane:
            off_m, foot_m = np.array([offset_m @ axis]), place_m + offset_m - (offset_m @ axis) * axis
            jacobian = np.append(foot_m, -1.0)[None]
        elif kind is Line:
            off_m, jacobian = basis @ offset_m, basis @ np.hstack([offset_m @ axis * np.eye(3), np.eye(3)])
        else:
            off_m, jacobian = offset_m, np.eye(3)
        inverse = np.linalg.inv(jacobian @ covariance @ jacobian.T)
        assert off_m @ inverse @ off_m == pytest.approx(4.0, rel=0.05)


def test_unbounded_uncertainty_is_drawn_no_larger_than_the_element() -> None:
    centre = np.zeros(3)
    wide = [1e6 * np.eye(size) for size in (4, 6, 3)]
    for element in (Plane(Z, 0.0, wide[0]), Line(X, centre, wide[1]), Point(centre, wide[2])):
        mesh = scene.uncertainty(element, centre, 0.1)
        assert 0.09 < np.abs(mesh.vertices).max() < 0.11


def test_what_is_unknown_or_not_finite_draws_nothing() -> None:
    zeros, nans = np.zeros(3), np.full((6, 6), np.nan)
    for element in (Plane(Z, 0.0), Point(zeros, nans[:3, :3]), Line(X, zeros, np.full((6, 6), np.inf))):
        assert scene.uncertainty(element, np.zeros(3), 0.1) is scene.EMPTY
    nowhere = np.full(3, np.nan)
    for element in (Point(nowhere), Line(X, nowhere), Plane(Z, np.nan)):
        for is_round in (True, False):
            assert len(scene.solid(is_round, element, nowhere, 0.1).vertices) == 0


def test_the_object_is_round_and_the_surroundings_square() -> None:
    """In the view along the rod, or from above."""
    for element in (Line(Z, np.zeros(3)), Point(np.zeros(3)), Plane(Z, 0.0)):
        counts = []
        for is_round in (True, False):
            flat = scene.solid(is_round, element, np.zeros(3), 1.0).vertices.astype(float)[:, :2]
            distance = np.linalg.norm(flat, axis=1)
            rim = flat[distance > 0.99 * distance.max()]
            counts.append(len({round(float(np.degrees(np.arctan2(y, x)))) for x, y in rim}))
        assert counts[0] >= 36
        assert counts[1] == 4


def test_planes_are_drawn_where_the_contact_took_place(poses) -> None:
    vertex = Point(np.array([0.5, 0.0, 0.2]))
    far_floor = Plane(Z, 0.2)
    drawing = draw(ContactGeometry(vertex, far_floor), poses, UNKNOWN_EXTENT)
    disc = drawing.meshes[2].vertices
    assert np.allclose(disc[:, 2], 0.2)
    assert np.linalg.norm(drawing.label_m - [0.65, 0.0, 0.2]) > 0.1, "its name does not hide what touches"
    assert disc[:, 0].min() < 0.5 < 0.8 < disc[:, 0].max(), "it covers the way from 0.5 to 0.8 m"


def test_vertices_come_from_any_metadata_record_and_invalid_ones_are_ignored() -> None:
    for text in ("", "not json", "[1, 2]", '[["a", 0, 0]]', "[[0, 0, NaN]]", "null"):
        assert vertices_from_metadata({"recording": {"object_vertices_m": text}}) is None
    assert vertices_from_metadata({"other": {}}) is None
    metadata = {"other": {}, "recording": {"object_vertices_m": json.dumps(CUBE_M.tolist())}}
    assert np.array_equal(vertices_from_metadata(metadata), CUBE_M)


@pytest.fixture(scope="module")
def log(tmp_path_factory) -> Path:
    """A log of 4 s; the true contact changes after 2 s."""
    poses = smooth_poses(400, 100.0)
    first, last = int(poses.stamp_ns[0]), int(poses.stamp_ns[-1])
    path = tmp_path_factory.mktemp("view") / "log.mcap"
    truth = Truth.from_changes([first, first + 2_000_000_000], ["free", "v-f"], last)
    write_recording(str(path), poses, truth, {})
    return path


def test_a_part_has_the_times_of_the_whole(log, tmp_path) -> None:
    part, begin = tmp_path / "part.rrd", tmp_path / "begin.rrd"
    assert run(["view", str(log), "--start", "1", "--duration", "2", "--save", str(part), "-q"]) == 0
    states = "StateChange:state"
    assert rows(part, canvas.TRUTH, states) == [(1_000_000_000, ["free"]), (2_000_000_000, ["v-f"])]
    assert rows(part, canvas.SMOOTHED, states)[0][0] == pytest.approx(1e9, abs=1e7)
    assert run(["view", str(log), "--duration", "1.5", "--save", str(begin), "-q"]) == 0
    assert rows(begin, canvas.TRUTH, states) == [(0, ["free"])], "what comes later is not shown"


def test_several_are_shown_and_an_unusable_one_is_named(tmp_path, monkeypatch, capsys) -> None:
    shown, log = list[Path](), tmp_path / "log.mcap"
    write_recording(str(log), smooth_poses(60), None, {})

    def show(recording: rr.RecordingStream, blueprint: Any) -> None:
        shown.append(tmp_path / f"{len(shown)}.rrd")
        to_file(shown[-1])(recording, blueprint)

    monkeypatch.setattr(sinks, "to_viewer", lambda: show)
    other, broken = tmp_path / "other.mcap", tmp_path / "broken.mcap"
    other.write_bytes(log.read_bytes())
    broken.write_text("no recording")
    assert run(["view", str(log), str(broken), str(other), str(log), "-q"]) == 1
    assert capsys.readouterr().err.count("broken.mcap") == 1
    assert sum(path.is_file() for path in shown) == 2, "one that is named twice is shown once"
    path = tmp_path / "both.rrd"
    assert run(["view", str(log), str(other), "--save", str(path)]) == 2
    assert "save each LOG alone" in capsys.readouterr().err
    assert not path.exists()
    for command, window in (("view", ["--save", "x.rrd"]), ("live", ["--rerun"])):
        assert run([command, str(log), "--web", *window]) == 2
        assert "--web" in capsys.readouterr().err
