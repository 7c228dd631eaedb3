"""Maps that are learned from one recording and used with another."""

import json
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from test_map import BOTTOM, CORNER, EDGE, REACH_M, TABLE, seen, unshared

import contact_tracker as ct
from contact_tracker.cli.main import run
from contact_tracker.errors import KnowledgeError
from contact_tracker.geometry.elements import Array, ContactGeometry, Origins, Plane, Point, Unobserved
from contact_tracker.map.elements import ANYWHERE_M, LearnedElements, MapElement
from contact_tracker.map.file import learned_text, map_from
from contact_tracker.map.map import EMPTY_MAP, Map
from contact_tracker.map.world_map import MOST_LEARNED, GrowingMap
from contact_tracker.recording import write_recording
from contact_tracker.states import Contact
from contact_tracker.tracking.belief import Segment
from contact_tracker.tracking.filter_bank import map_findings, map_use
from contact_tracker.tracking.located_faces import with_offsets
from contact_tracker.tracking.segmentation import Segmentation
from contact_tracker_lab.simulate import Simulated
from mcap_logs import smooth_poses
from short_recordings import FACE_TO_EDGE, recorded, true_contacts

FACE = {"side": "object", "kind": "face", "touched": 1, "direction": [0, 0, 1], "offset_m": 0.1}
ORIGIN_M = np.array([100.0, -20.0, 3.0])


def grown(body_m: NDArray[np.float64] | None = None) -> GrowingMap:
    rng = np.random.default_rng(3)
    body_m = np.zeros(3) if body_m is None else body_m
    world = GrowingMap(REACH_M).at_origins(Origins(ORIGIN_M, body_m))
    for number, (contact, pair) in enumerate(
        [(Contact.FF, (BOTTOM, TABLE)), (Contact.VF, (CORNER, TABLE)), (Contact.EE, (EDGE, EDGE))]
    ):
        world = world.insert(seen(contact, pair, 100 * number, rng=rng))
    return world


def again(learned: LearnedElements | None = None) -> GrowingMap:
    """An empty map with what was learned in the same frames."""
    world = GrowingMap(REACH_M).with_prior(grown().learned if learned is None else learned)
    return world.at_origins(Origins(ORIGIN_M, np.zeros(3)))


def with_sides(learned: LearnedElements) -> LearnedElements:
    """What is learned, with a touched region of each element, and normals out of the bodies."""
    ways = {key: element.direction for key, element in learned.elements.items() if element.kind == "f"}
    corners_m = np.array([[0.1, 0.2, 0.3], [-0.1, 0.2, 0.3], [0.0, -0.3, 0.4]])
    extents = {key: key[1] * corners_m for key, element in learned.elements.items() if element.kind != "v"}
    return replace(
        learned, extents=extents, outward={key: (-1.0) ** key[0] * way for key, way in ways.items()}
    )


def assert_same_sides(learned: LearnedElements, expected: LearnedElements) -> None:
    for values, true in ((learned.extents, expected.extents), (learned.outward, expected.outward)):
        assert len(values) == len(true) > 1
        for key, value in zip(values, sorted(true), strict=True):
            np.testing.assert_allclose(values[key], true[value], atol=1e-9)


def test_a_file_has_all_that_is_known(tmp_path: Path) -> None:
    learned = with_sides(grown().learned)
    path = tmp_path / "scene.toml"
    ct.Map(learned=learned).save(path)
    again = ct.Map.load(path).learned
    assert dict(again.counts) == dict(zip(again.elements, learned.counts.values(), strict=True))
    np.testing.assert_allclose(again.information, learned.information, rtol=1e-9, atol=1e-4)
    for one, other in zip(again.elements.values(), learned.elements.values(), strict=True):
        assert one.kind == other.kind
        np.testing.assert_allclose(one.direction, other.direction, atol=1e-6)
        np.testing.assert_allclose(one.place_m, other.place_m, atol=1e-12)
    assert_same_sides(again, learned)


@pytest.mark.parametrize("body_m", [np.zeros(3), np.array([0.3, -2.0, 1.0])])
def test_the_origins_of_a_recording_do_not_matter(body_m: NDArray[np.float64]) -> None:
    """What is learned is in the frames of the world and the body, and a map that begins with it says the
    same."""
    world, learned = grown(body_m), with_sides(grown(body_m).learned)
    again = GrowingMap(REACH_M).with_prior(learned).at_origins(Origins(ORIGIN_M, body_m))
    assert_same_sides(again.learned, learned)
    np.testing.assert_allclose(again.whole.covariance, world.whole.covariance, rtol=1e-4, atol=1e-9)
    elsewhere = GrowingMap(REACH_M).with_prior(world.learned).at_origins(Origins.zero())
    table = next(one for key, one in elsewhere.elements.items() if key[0] == 1 and one.kind == "f")
    assert table.place_m[0] - table.direction @ ORIGIN_M == pytest.approx(0.2, abs=5e-3)
    np.testing.assert_allclose(
        elsewhere.learned.information, world.learned.information, rtol=1e-3, atol=1e-3 * 1e6
    )


def test_what_is_known_is_touched_again() -> None:
    same = again().insert(seen(Contact.VF, (CORNER, TABLE), 0, rng=np.random.default_rng(4)))
    assert set(same.pairs[0]) <= set(same.prior.elements)
    assert not same.untested_sides
    known_map = Map(learned=same.prior)
    assert not map_findings(same, known_map)
    assert not map_use(same, Map())  # listed elements are reported by names
    used = "the learned map is used: of 1 sure contacts 1 touch its elements of the object, 1 those of the"
    assert map_use(same, known_map) == f"{used} surroundings"


WIDE = np.diag([1e-6, 1e-6, 0.0, 0.09])
FLUSH = ContactGeometry(
    Plane(-BOTTOM.direction, 0.0, WIDE), Plane(TABLE.direction, BOTTOM.place_m[0] - TABLE.place_m[0], WIDE)
)
"""The bottom on the table, by the motion of f-f."""
OBSERVED = ContactGeometry(Point(CORNER.place_m, 1e-6 * np.eye(3)), Plane(TABLE.direction, 0.0, WIDE))
"""A contact in which the motion shows the places of both elements."""


def with_place(
    world: GrowingMap, *others: Segment, pair: ContactGeometry = FLUSH, known_map: Map = EMPTY_MAP
) -> ContactGeometry:
    """The faces of a segment of f-f, 10 to 90 ns, after the passes with a map."""
    flat = Segment(10, 90, Contact.FF, 0.9, pair)
    return with_offsets(Segmentation((flat, *others)), world, known_map).segments[0].geometry


def test_face_on_face_has_the_offsets_of_an_earlier_map() -> None:
    """Where it has the side of both faces."""
    prior = with_sides(grown().learned)
    sighting = replace(seen(Contact.FF, (BOTTOM, TABLE), 0), stamp_ns=100)
    pair = with_place(again(prior).insert(sighting))
    assert pair.object.offset_m == pytest.approx(BOTTOM.place_m[0], abs=5e-3)
    assert pair.environment.offset_m - ORIGIN_M[2] == pytest.approx(TABLE.place_m[0], abs=5e-3)
    assert pair.has_open_offset == (False, False)
    assert 1e-4 < np.sqrt(pair.object.covariance[3, 3]) < 5e-3
    assert with_place(again(replace(prior, outward={})).insert(sighting)).has_open_offset == (True, True)


def test_a_rest_on_known_faces_has_their_offsets() -> None:
    """It shows nothing more of them, and is at the pair whose height it has."""
    rng, world = np.random.default_rng(6), GrowingMap(REACH_M).at_origins(Origins.zero())
    shelf = MapElement("f", TABLE.direction, TABLE.place_m + 0.1)
    world = world.insert(replace(seen(Contact.VF, (CORNER, TABLE), 100, rng=rng), onset_ns=200, stamp_ns=290))
    world = world.insert(replace(seen(Contact.VF, (CORNER, shelf), 200, rng=rng), onset_ns=300, stamp_ns=390))
    others = [Segment(ns, ns + 90, Contact.VF, 0.9, OBSERVED) for ns in (-100, 200, 300)]
    world = world.insert(replace(seen(Contact.FV, (BOTTOM, CORNER), 0, rng=rng), onset_ns=-100, stamp_ns=-10))
    rest = replace(seen(Contact.FF, (BOTTOM, shelf), 300), onset_ns=10, stamp_ns=90)
    recognised = world.with_recognised([rest])
    assert recognised.pairs == world.pairs
    pair = with_place(recognised, *others)
    assert pair.environment.offset_m == pytest.approx(shelf.place_m[0], abs=5e-3)
    assert with_place(world, *others).has_open_offset == (True, True)


@pytest.mark.parametrize("sigma_position_m", [1e-3, 1e-2])
def test_places_are_as_uncertain_as_what_was_known_is_wrong(sigma_position_m: float) -> None:
    """A table that is listed 4 mm too high, which is as it may be if it is given to 1 cm."""
    rng, sigma = np.random.default_rng(7), {"sigma_position_m": sigma_position_m, "sigma_rotation_deg": 0.1}
    plane = {"normal": TABLE.direction.tolist(), "offset_m": float(TABLE.place_m[0]) + 0.004, **sigma}
    table = map_from({"environment": {"plane": [plane]}})
    world = GrowingMap(REACH_M).with_prior(table.prior).at_origins(Origins.zero())
    world = world.insert(replace(seen(Contact.FF, (BOTTOM, TABLE), 0, rng=rng), stamp_ns=100))
    for number in range(1, 5):
        at = seen(Contact.VF, (CORNER, TABLE), 20 * number, 1e-4, rng=rng)
        world = world.insert(replace(at, onset_ns=200 * number, stamp_ns=200 * number + 100))
    pair = with_place(world, Segment(200, 300, Contact.VF, 0.9, OBSERVED), known_map=table)
    sd_m = np.sqrt(pair.environment.covariance[3, 3])
    assert sd_m == pytest.approx(0.004, abs=5e-4) if sigma_position_m < 0.004 else sd_m < 2e-4


@pytest.mark.parametrize(("first", "face"), [(320, "shelf"), (420, "table")])
def test_a_contact_keeps_its_face_when_it_changes(first: int, face: str) -> None:
    """f-f fits the table, which is touched more often, as well as a shelf: it is on the shelf if that was
    touched just before."""
    faces = {"table": TABLE, "shelf": MapElement("f", TABLE.direction, TABLE.place_m + 0.2)}
    sightings = [seen(Contact.VF, (CORNER, TABLE), 100 * number) for number in range(3)]
    sightings.append(seen(Contact.VF, (CORNER, faces["shelf"]), 300))
    sightings.append(seen(Contact.FF, (BOTTOM, faces["shelf"]), first))
    pairs = GrowingMap.learn(sightings, REACH_M, share=0.5).pairs
    assert pairs[first][1] == pairs[0 if face == "table" else 300][1]


@pytest.mark.parametrize(
    ("is_free_between", "unobserved", "others", "is_known"),
    [
        (False, (), [TABLE], True),
        (False, (TABLE.direction,), [TABLE], False),
        (True, (), [TABLE], False),
        (False, (), [], False),
        (True, (), [TABLE, BOTTOM], True),
    ],
)
def test_face_on_face_has_the_offsets_that_other_contacts_show(
    is_free_between: bool, unobserved: tuple[Array, ...], others: list[MapElement], is_known: bool
) -> None:
    """A vertex that touches the table afterwards shows the height of the bottom if there is no free motion
    between: otherwise the bottom may have been on a shelf above it. A vertex on each face shows both, unless
    the motion leaves its place open."""
    rng, world = np.random.default_rng(5), GrowingMap(REACH_M).at_origins(Origins.zero())
    world = world.insert(replace(seen(Contact.FF, (BOTTOM, TABLE), 0, rng=rng), stamp_ns=100))
    for number, face in enumerate(others, start=1):
        contact, pair = (Contact.VF, (CORNER, face)) if face is TABLE else (Contact.FV, (face, CORNER))
        first = 100 * number if is_free_between else 20 * number  # a sighting has 20 ticks
        at = seen(contact, pair, first, rng=rng)
        world = world.insert(replace(at, onset_ns=200 * number, stamp_ns=200 * number + 100))
    point, shifts = OBSERVED.object, tuple(Unobserved("shifts_along", way) for way in unobserved)
    touching = ContactGeometry(replace(point, unobserved=shifts), OBSERVED.environment)
    after = [Segment(200 * n, 200 * n + 100, Contact.VF, 0.9, touching) for n in range(1, 1 + len(others))]
    plane = {"normal": TABLE.direction.tolist(), "offset_m": float(TABLE.place_m[0]), "name": "table"}
    shelf = plane | {"offset_m": 0.5, "name": "shelf"}
    pair = with_place(world, *after, known_map=map_from({"environment": {"plane": [plane, shelf]}}))
    assert pair.has_open_offset == (not is_known, not is_known)
    assert pair.names == (None, "table" if is_known else None)
    on_shelf = replace(FLUSH.environment, offset_m=0.5, covariance=1e-6 * np.eye(4), name="shelf")
    by_direction = ContactGeometry(FLUSH.object, on_shelf)
    only_shelf = map_from({"environment": {"plane": [shelf]}})
    named = with_place(world, *after, pair=by_direction, known_map=only_shelf)
    assert named.names == (None, None if is_known else "shelf")
    if is_known:
        assert abs(pair.object.offset_m - BOTTOM.place_m[0]) < 4 * np.sqrt(pair.object.covariance[3, 3])


@pytest.mark.parametrize(
    ("turn_rad", "moved_m", "count", "unused", "text"),
    [
        (0.7, 0.05, 3, (0, 1), "the learned map explains no contact"),
        (0.0, 0.05, 3, (0,), "what the learned map has of the object explains no contact"),
        # of a known object elsewhere only the place is dropped, however many new faces there are
        *(
            (0.7, 0.0, count, (1,), "what the learned map has of the surroundings explains no contact")
            for count in (3, 10)
        ),
    ],
)
def test_another_object_or_place_is_noticed(
    turn_rad: float, moved_m: float, count: int, unused: tuple[int, ...], text: str
) -> None:
    world, rng = again(), np.random.default_rng(4)
    known_map = Map(learned=world.prior)
    turn = Rotation.from_rotvec([turn_rad, 0.3 * turn_rad, 0.0])
    for number in range(count):
        face = MapElement("f", turn.apply(TABLE.direction), TABLE.place_m + turn_rad * number)
        apart_m = moved_m * np.array([1.0, 1.0 + number, -2.0])
        corner = MapElement("v", np.zeros(3), CORNER.place_m + apart_m)
        world = world.insert(seen(Contact.VF, (corner, face), 100 * number, rng=rng))
    assert world.unused_sides == unused
    assert [finding.text.partition(":")[0] for finding in map_findings(world, known_map)] == [text]
    assert bool(map_use(world, known_map)) == (len(unused) < 2)
    sides = {side for side, _ in world.prior.elements}
    assert sides >= {0, 1} - {*unused}
    if count > 3:
        assert world.prior_is_dropped == (False, True)
        assert sides == {0}


def test_what_is_known_of_one_side_is_what_both_say_of_it() -> None:
    learned = grown().learned
    for side in (0, 1):
        of_side = learned.of([key for key in learned.elements if key[0] == side], ANYWHERE_M)
        rows = np.concatenate([np.r_[learned.slots[key]] for key in of_side.elements])
        np.testing.assert_allclose(
            of_side.covariance(), learned.covariance()[np.ix_(rows, rows)], rtol=1e-4, atol=1e-15
        )


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("information", [[1.0]]),
        ("information", "none"),
        ("information", [[10**400] * 17] * 17),
        ("information", [[1.7e308] * 17] * 17),
        ("element", [{"side": "left", "kind": "face"}]),
        ("element", [{"side": "object", "kind": "plane"}]),
        ("element", [FACE | {"touched_m": []}]),
        ("element", [FACE | {"touched_m": [[1, 2]]}]),
        ("element", [FACE | {"touched_m": [[0, 0, 1e9]]}]),
        ("element", [FACE | {"touched_m": [[0, 0, 0]] * 25}]),
        ("element", [FACE | {"outward": [1, 0, 0]}]),
        ("element", [FACE | {"kind": "vertex", "touched_m": [[0, 0, 0]]}]),
        ("information", (-1e6 * np.eye(17)).tolist()),  # of no Gaussian
    ],
)
def test_a_file_with_a_mistake_is_refused(key: str, value: object) -> None:
    table = tomllib.loads(learned_text(grown().learned))
    table["learned"][key] = value
    with pytest.raises(KnowledgeError, match=r"learned"):
        map_from(table)


def test_a_map_of_many_elements_can_be_read_again(tmp_path: Path) -> None:
    """With what was touched most; also where most directions are hardly known."""
    learned = GrowingMap.learn(unshared(22, unknown=(0, 1)), REACH_M).learned
    ct.Map(learned=learned).save(tmp_path / "scene.toml")
    again = ct.Map.load(tmp_path / "scene.toml")
    assert len(again) == MOST_LEARNED
    assert (np.linalg.eigvalsh(again.learned.covariance()) > 0.0).all()


def test_what_stands_as_a_recording_begins_may_stand_on_a_new_face() -> None:
    tracker = ct.Tracker(known=ct.Map(learned=grown().learned))
    quat_xyzw = Rotation.from_rotvec([0.7, 0.3, 0.0]).as_quat()
    position_m = np.random.default_rng(5).normal([0.3, 0.1, 0.9], 2e-4, (40, 3))
    found = [tracker.update(20_000_000 * i, at_m, quat_xyzw) for i, at_m in enumerate(position_m)]
    labels = {one.contact for one in found if one is not None}
    assert labels == {Contact.FF}


def test_free_motion_is_open_until_a_contact_agrees_with_the_map() -> None:
    """It may be of another scene, whose contacts its price of new elements hides."""
    tracker = ct.Tracker(known=ct.Map(learned=grown().learned))
    *_, belief = (one for one in (tracker.update(*pose) for pose in smooth_poses(600)) if one is not None)
    assert belief.contact is Contact.FREE
    assert len(belief.inseparable) == 6
    assert belief.probability.max() < 0.9


def assert_true_sides(learned: LearnedElements, recording: Simulated) -> None:
    """Normals out of the bodies, and regions on the touched faces within the object's size."""
    size_m = np.ptp(json.loads(recording.metadata["object_vertices_m"]), axis=0).max()
    truth = recording.truth.intervals[0].geometry
    assert truth is not None
    faces = {key: element for key, element in learned.elements.items() if element.kind == "f"}
    assert len(learned.outward) == len(faces) >= 2
    for key, outward in learned.outward.items():
        face = (truth.object, truth.environment)[key[0]]
        assert isinstance(face, Plane)
        np.testing.assert_allclose(outward, face.normal, atol=0.02)
        corners_m = learned.extents[key]
        np.testing.assert_allclose(corners_m @ face.normal, face.offset_m, atol=5e-3)
        if key[0] == 0:
            assert np.ptp(corners_m, axis=0).max() < 1.5 * size_m


@pytest.mark.long
def test_commands_pass_a_map_on(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """``segment`` writes it, whatever else it writes, and ``live`` goes on learning."""
    log, scene = str(tmp_path / "log.mcap"), str(tmp_path / "scene.toml")
    recording = recorded(FACE_TO_EDGE)
    write_recording(log, recording.poses, None, {})
    output = ["-o", str(tmp_path / "ticks.csv"), "--rows", "ticks"]
    assert run(["segment", log, "--map-out", scene, *output]) == 0
    first = ct.Map.load(scene).learned
    assert_true_sides(first, recording)
    assert run(["live", log, "--known", scene, "--map-out", scene]) == 0
    assert "sure contacts" in capsys.readouterr().err
    both = ct.Map.load(scene).learned
    assert sum(both.counts.values()) > sum(first.counts.values())
    assert_true_sides(both, recording)


def test_learn_once_use_at_once() -> None:
    """The same contacts again, with the map of the first time: labels come sooner."""
    recording = recorded(FACE_TO_EDGE)
    poses = recording.poses[:1100]
    assert not LearnedElements()
    assert not map_from({}).learned
    first = ct.segment(
        ct.Trajectory.from_arrays(poses.stamp_ns, poses.position_m, poses.quat_xyzw, unit="ns")
    )
    assert len(first.map.object) >= 2
    assert_true_sides(first.map.learned, recording)
    rights = []
    for tracker in (ct.Tracker(), ct.Tracker(known=first.map)):
        found = [tracker.update(pose.stamp_ns, pose.position_m, pose.quat_xyzw) for pose in poses]
        beliefs = [one for one in found if one is not None]
        true = true_contacts(recording, np.array([one.stamp_ns for one in beliefs]))
        rights.append(np.mean([one.contact is is_true for one, is_true in zip(beliefs, true, strict=True)]))
        assert tracker.map is not None
    assert rights[1] > rights[0] + 0.03
