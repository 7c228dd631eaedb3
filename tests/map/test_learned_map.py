"""Maps that are learned from one recording and used with another."""

import tomllib
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from test_map import BOTTOM, CORNER, EDGE, OTHER_CORNER, REACH_M, SHELF, TABLE, seen, unshared

import contact_tracker as ct
from contact_tracker.errors import KnowledgeError
from contact_tracker.geometry.elements import Origins
from contact_tracker.map.elements import LearnedElements, MapElement
from contact_tracker.map.file import learned_text, map_from
from contact_tracker.map.world_map import MOST_LEARNED, GrowingMap
from contact_tracker.states import Contact
from contact_tracker.tracking.filter_bank import map_use
from mcap_logs import smooth_poses
from short_recordings import FACE_TO_EDGE, recorded, true_contacts

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


def test_a_file_has_all_that_is_known(tmp_path: Path) -> None:
    learned = grown().learned
    path = tmp_path / "scene.toml"
    ct.Map(learned=learned).save(path)
    again = ct.Map.load(path).learned
    assert dict(again.counts) == dict(zip(again.elements, learned.counts.values(), strict=True))
    np.testing.assert_allclose(again.information, learned.information, rtol=1e-9, atol=1e-4)
    for one, other in zip(again.elements.values(), learned.elements.values(), strict=True):
        assert one.kind == other.kind
        np.testing.assert_allclose(one.direction, other.direction, atol=1e-6)
        np.testing.assert_allclose(one.place_m, other.place_m, atol=1e-12)


@pytest.mark.parametrize("body_m", [np.zeros(3), np.array([0.3, -2.0, 1.0])])
def test_the_origins_of_a_recording_do_not_matter(body_m: NDArray[np.float64]) -> None:
    """What is learned is in the frames of the world and the body, and a map that begins with it says the
    same."""
    world = grown(body_m)
    again = GrowingMap(REACH_M).with_prior(world.learned).at_origins(Origins(ORIGIN_M, body_m))
    np.testing.assert_allclose(again.whole.covariance, world.whole.covariance, rtol=1e-4, atol=1e-9)
    elsewhere = GrowingMap(REACH_M).with_prior(world.learned).at_origins(Origins.zero())
    table = next(one for key, one in elsewhere.elements.items() if key[0] == 1 and one.kind == "f")
    assert table.place_m[0] - table.direction @ ORIGIN_M == pytest.approx(0.2, abs=5e-3)
    np.testing.assert_allclose(
        elsewhere.learned.information, world.learned.information, rtol=1e-3, atol=1e-3 * 1e6
    )


def test_what_is_known_is_touched_again_and_another_world_is_noticed() -> None:
    learned = grown().learned
    rng = np.random.default_rng(4)
    same = GrowingMap(REACH_M).with_prior(learned).at_origins(Origins(ORIGIN_M, np.zeros(3)))
    same = same.insert(seen(Contact.VF, (CORNER, TABLE), 0, rng=rng))
    assert set(same.pairs[0]) <= set(learned.elements)
    assert not same.prior_is_dropped
    assert map_use(same) == "the learned map is used: 1 of 1 sure contacts touch its elements"
    other = GrowingMap(REACH_M).with_prior(learned).at_origins(Origins(ORIGIN_M, np.zeros(3)))
    turn = Rotation.from_rotvec([0.7, 0.3, 0.0])
    for number, corner in enumerate((CORNER, OTHER_CORNER, CORNER)):
        wall = MapElement("f", turn.apply(SHELF.direction), SHELF.place_m + 0.1 * number)
        moved = MapElement("v", np.zeros(3), corner.place_m + np.array([0.02, 0.01 * number, 0.05]))
        other = other.insert(seen(Contact.VF, (moved, wall), 100 * number, rng=rng))
    assert other.prior_is_dropped
    assert not other.prior
    assert not map_use(other)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("information", [[1.0]]),
        ("information", "none"),
        ("information", [[10**400] * 17] * 17),
        ("information", [[1.7e308] * 17] * 17),
        ("element", [{"side": "left", "kind": "face"}]),
        ("element", [{"side": "object", "kind": "plane"}]),
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
    rights = []
    for tracker in (ct.Tracker(), ct.Tracker(known=first.map)):
        found = [tracker.update(pose.stamp_ns, pose.position_m, pose.quat_xyzw) for pose in poses]
        beliefs = [one for one in found if one is not None]
        true = true_contacts(recording, np.array([one.stamp_ns for one in beliefs]))
        rights.append(np.mean([one.contact is is_true for one, is_true in zip(beliefs, true, strict=True)]))
        assert tracker.map is not None
    assert rights[1] > rights[0] + 0.03
