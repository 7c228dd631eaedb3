"""What is known, as parts to draw: bodies whole, elements where they were touched."""

import re
from dataclasses import replace
from itertools import chain
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from contact_tracker.api.offline import Result
from contact_tracker.explanations.joint_evidence import Joint
from contact_tracker.explanations.joint_models import JointKind
from contact_tracker.exports.formats import write_outcome
from contact_tracker.geometry.elements import ContactGeometry, Line, Plane, Point
from contact_tracker.map.association import ElementEstimate, Sighting
from contact_tracker.map.elements import LearnedElements, MapElement
from contact_tracker.map.file import map_from
from contact_tracker.map.world_map import GrowingMap
from contact_tracker.motion.poses import Poses
from contact_tracker.outputs.outcome import Outcome
from contact_tracker.outputs.parts import MOST_KEPT, KnownParts, known_parts
from contact_tracker.outputs.scene import hull
from contact_tracker.outputs.text import table_rows
from contact_tracker.recording import MAP_TOPIC
from contact_tracker.states import CONTACTS, Contact
from contact_tracker.tracking.belief import Belief, Segment
from contact_tracker.tracking.segmentation import Segmentation
from contact_tracker.trajectory import Trajectory
from contact_tracker.viewer import canvas
from contact_tracker.viewer.sinks import to_file
from contact_tracker.viewer.views import LiveViewer
from rerun_files import rows
from smooth_motion import unturned

Z = np.array([0.0, 0.0, 1.0])
KNOWLEDGE = map_from(
    {
        "object": {"box": {"size_m": [0.2, 0.1, 0.1]}},
        "environment": {
            "plane": {"name": "table", "normal": [0, 0, 1], "offset_m": 0.0},
            "box": {"name": "shelf", "size_m": [0.4, 0.4, 0.2], "position_m": [2.0, 0.0, 0.0]},
        },
    }
)
CORNER_M = np.array([0.1, 0.05, -0.05])
ON_TABLE = ContactGeometry(Point(CORNER_M), Plane(Z, 0.0, name="table"))
VERTEX_M = np.array([0.1, 0.0, 0.02])
NAMES = f"{canvas.KNOWN[0]}/names", "Points3D:labels"


@pytest.fixture(scope="module")
def poses() -> Poses:
    """A corner slides 1 m along x on the plane z = 0, and then rises by 1 m."""
    along, up = np.linspace(0.0, 1.0, 200), np.linspace(0.0, 1.0, 100)
    position_m = np.zeros((300, 3))
    position_m[:200, 0], position_m[200:, 0], position_m[200:, 2] = along, 1.0, up
    position_m[:, 2] += 0.05
    return unturned(position_m)


@pytest.fixture(scope="module")
def world() -> GrowingMap:
    """A vertex of the object and a face of the surroundings that an earlier recording has shown."""
    elements = {(0, 1): MapElement("v", np.zeros(3), VERTEX_M), (1, 2): MapElement("f", Z, np.array([0.5]))}
    return GrowingMap(0.3).with_prior(LearnedElements(elements, dict.fromkeys(elements, 3), 1e8 * np.eye(6)))


def test_bodies_are_whole_and_a_listed_face_is_the_patch_that_was_touched(poses, tmp_path) -> None:
    segment = Segment(int(poses.stamp_ns[0]), int(poses.stamp_ns[199]), Contact.VF, 0.9, ON_TABLE)
    outcome = Outcome(Trajectory(poses), Segmentation((segment,)), known_map=KNOWLEDGE)
    parts = {(part.side, part.name): part for part in known_parts(outcome)}
    assert list(parts) == [(0, "object"), (1, "shelf"), (1, "table")]
    for key, middle, size in (
        ((0, "object"), [0.0, 0.0, 0.0], [0.2, 0.1, 0.1]),
        ((1, "shelf"), [2.0, 0.0, 0.0], [0.4, 0.4, 0.2]),
    ):
        vertices = parts[key].mesh.vertices
        assert hull(vertices * [0.0, 1.0, 1.0]) is None, "flat"
        np.testing.assert_allclose(np.ptp(vertices, axis=0), size, atol=1e-6)
        np.testing.assert_allclose(parts[key].label_m, middle, atol=1e-6)
        assert len(parts[key].outline) == 12
    (rim,) = parts[1, "table"].outline
    np.testing.assert_allclose(rim[:, 2], 0.0, atol=1e-12)
    first_m, last_m = rim.min(axis=0), rim.max(axis=0)
    np.testing.assert_allclose(first_m[:2], [0.1, 0.05], atol=0.02)
    np.testing.assert_allclose(last_m[:2], [1.1, 0.05], atol=0.06)  # ten poses per second
    assert len(parts[1, "table"].mesh.triangles) == len(rim) - 3
    write_outcome(outcome, tmp_path / "out.mcap")
    with (tmp_path / "out.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        (*_, scene), *_ = reader.iter_decoded_messages(topics=[MAP_TOPIC])
    sizes = [entity.texts[0].font_size for entity in scene.entities]
    np.testing.assert_allclose(sizes, 0.2 * np.linalg.norm([0.1, 0.05, 0.05]))  # by the box that is known


def test_elements_of_a_map_are_drawn_where_they_are(poses, world) -> None:
    vertex, face = known_parts(Outcome(Trajectory(poses), Segmentation(), touched=world))
    assert [(vertex.side, vertex.name), (face.side, face.name)] == [(0, "vertex 1"), (1, "face 2")]
    np.testing.assert_allclose(vertex.label_m, VERTEX_M)
    np.testing.assert_allclose(face.outline[0][:, 2], 0.5, atol=1e-9)
    corners_m = np.array([[3.0, 0.0, 0.5], [4.0, 0.0, 0.5], [4.0, 2.0, 0.5]])
    touched = replace(world, prior=replace(world.prior, extents={(1, 2): corners_m}))
    _, patch = known_parts(Outcome(Trajectory(poses), Segmentation(), touched=touched))
    np.testing.assert_allclose(patch.outline[0].min(axis=0), [3.0, 0.0, 0.5], atol=0.02)  # with a margin
    np.testing.assert_allclose(patch.outline[0].max(axis=0), [4.0, 2.0, 0.5], atol=0.02)


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_the_side_and_the_patch_of_a_face_are_those_of_the_motion(poses, sense) -> None:
    elements = {
        (0, 1): MapElement("v", np.zeros(3), CORNER_M),
        (1, 2): MapElement("f", sense * Z, np.zeros(1)),
    }
    touched = LearnedElements(elements, dict.fromkeys(elements, 1), 1e8 * np.eye(6))
    estimate = ElementEstimate(
        Contact.VF, np.zeros(7), np.zeros((7, 6)), np.zeros((6, 6)), np.zeros(6), np.eye(3)
    )
    sighting = Sighting(0, 20, estimate, int(poses.stamp_ns[0]), int(poses.stamp_ns[199]))
    world = GrowingMap(0.3, (sighting,), {0: ((0, 1), (1, 2))}).with_prior(touched)
    parts = KnownParts()
    parts.add_poses(poses)
    learned = parts.learned(world)
    np.testing.assert_allclose(learned.outward[1, 2], Z)
    ((key, corners_m),) = learned.extents.items()
    assert key == (1, 2)
    np.testing.assert_allclose(np.ptp(corners_m, axis=0), [1.0, 0.0, 0.0], atol=0.06)
    parts = KnownParts()
    parts.add_poses(poses[:200])  # without the motion off the face
    assert not parts.learned(world).outward


def test_joints_are_drawn_in_all_outputs(poses, tmp_path) -> None:
    pytest.importorskip("matplotlib").use("Agg")
    middle_m, far_m = np.array([0.5, 0.2, 0.0]), np.array([0.0, 9.0, 0.0])
    spans = poses.stamp_ns[[0, 99, 100, 149, 150, 199, 200, 299]].reshape(4, 2).tolist()
    elements = (Line(Z, CORNER_M), Line(Z, middle_m)), (Point(CORNER_M), Point(middle_m))
    hinge, ball = (
        Joint(kind, 0.96, *both, None, None)
        for kind, both in zip((JointKind.HINGE, JointKind.BALL), elements, strict=True)
    )
    joints = hinge, hinge, ball, replace(hinge, object=Line(Z, far_m), environment=Line(Z, far_m))
    segments = [
        Segment(*span, Contact.FF, 0.3, None, CONTACTS, joint=joint)
        for span, joint in zip(spans, joints, strict=True)
    ]
    result = Result(Trajectory(poses), Segmentation(tuple(segments)))
    parts, names = known_parts(result), ["= hinge 0.96", "= ball 0.96"]
    *near, away, _ = parts
    assert [(one.side, one.name) for one in near] == [(side, name) for name in names for side in (0, 1)]
    assert near[0].touched_ns == ((spans[0][0], spans[1][1]),)
    assert (away.name, away.outline) == ("= hinge 0.96 (9 m away)", ())
    for part, element in zip(near, chain(*elements), strict=True):
        np.testing.assert_allclose(part.label_m[:2], element.point_m[:2], atol=1e-9)
    *_, axes = result.plot().axes
    written = [text.get_text() for text in axes.texts]
    assert "f-f = hinge 0.96" in written
    assert len(written) == 3  # both segments of one hinge have one name
    rows = [kind for _, (_, _, kind, *_) in table_rows(segments, 0)]
    assert rows == ["f-f", "= hinge", "= ball", "= hinge"]  # the rows of f-f differ in times only
    write_outcome(result, tmp_path / "out.html")
    write_outcome(result, tmp_path / "out.mcap")
    page = (tmp_path / "out.html").read_text()
    numbered = re.findall('<tr data-segments="([0-9 ]*)">', page)
    assert numbered == ["0 1 2 3", "0 1", "2", "3"]  # a row of a joint is of the segments with it
    with (tmp_path / "out.mcap").open("rb") as file:
        ((_, _, scene),) = make_reader(file).iter_messages(topics=[MAP_TOPIC])
    assert all(f'"label":"{name}"' in page and f"object {name}".encode() in scene.data for name in names)
    write_outcome(result, tmp_path / "out.rrd")
    assert counts(tmp_path / "out.rrd", *NAMES, static=True)[-1] == (0, 3)


def counts(path: Path, entity: str, component: str, static: bool = False) -> list[tuple[int, int]]:
    """Number of values of a component by the time since the first pose in ns."""
    return [(since, len(values)) for since, values in rows(path, entity, component, static)]


def test_a_file_has_everything_at_all_times(tmp_path, poses, world) -> None:
    path = tmp_path / "known.rrd"
    write_outcome(Outcome(Trajectory(poses), Segmentation(), known_map=KNOWLEDGE, touched=world), path)
    outline = f"{canvas.KNOWN[1]}/outline", "LineStrips3D:strips"
    for what, count in ((NAMES, 2), (outline, 12 + 2)):  # of the object the box, and the vertex of the map
        assert counts(path, *what, static=True)[-1] == (0, count)
        assert counts(path, *what) == []


def test_live_elements_appear_as_they_become_known(tmp_path, poses, world) -> None:
    path, probability = tmp_path / "live.rrd", np.full(7, 1.0 / 7.0)
    with LiveViewer(None, to_file(path)) as view:
        for number, pose in enumerate(poses):
            view.pose(pose)
            if number % 10 == 9:
                belief = Belief(pose.stamp_ns, Contact.FREE, probability, 0, None, np.full(6, np.nan))
                view.belief(belief, world if number > 150 else None)
    assert counts(path, *NAMES, static=True) == []
    assert counts(path, *NAMES) == [(0, 0), (1_590_000_000, 1)]


def test_long_streams_keep_few_poses_of_all_their_time() -> None:
    count = 40_000
    poses = unturned(np.zeros((count, 3)), 100_000_000)
    at_once, one_by_one = KnownParts(), KnownParts()
    at_once.add_poses(poses)
    for first in range(0, count, 97):
        one_by_one.add_poses(poses[first : first + 97])
    for known in (at_once, one_by_one):
        kept = Poses.join(known._poses)
        assert MOST_KEPT // 2 <= len(kept) <= MOST_KEPT
        assert np.diff(kept.stamp_ns).max() <= 4 * poses.stamp_ns[-1] // MOST_KEPT
        assert kept.stamp_ns[0] == 0
