"""What an object stood on in several places, by its rests alone."""

from collections.abc import Sequence

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from contact_tracker.config.loading import load_model
from contact_tracker.geometry.elements import Plane
from contact_tracker.motion.poses import Poses, batches
from contact_tracker.segmenting import segment
from contact_tracker.states import Contact
from contact_tracker.tracking.contact_filter import ticks_of
from contact_tracker.tracking.rest_sightings import RestSighting, sightings_at_rest
from smooth_motion import least_jerk, with_noise

MODEL = load_model()
RATE_HZ, REST_S, CARRY_S = 100.0, 1.8, 1.5
SIGMA_M, SIGMA_RAD = 2e-4, 1e-3
WORLD = Rotation.from_rotvec([0.3, 0.5, 0.2])
"""Of the table's frame, with its normal along z, in the world's."""
FACES = Rotation.from_rotvec([1.0, -0.4, 0.3]) * Rotation.from_rotvec(
    [[0.0, 0.0, 0.0], [np.pi / 2, 0.0, 0.0]]
)
"""The orientation of the body on each of two of its faces, the one beside the other."""


def set_down(
    rng: np.random.Generator, faces: Sequence[int], turned: bool = True, height_m: float = 0.0
) -> tuple[Poses, np.ndarray]:
    """An object that rests on these of its faces, one after the other, in places of the table, turned about
    its normal if ``turned``, with smooth carries between; and the numbers of frames at which rests begin.
    With ``height_m``, the rests differ by up to this height."""
    places = [np.append(rng.uniform(-0.3, 0.3, 2), rng.uniform(0.0, height_m)) for _ in faces]
    turns = [
        Rotation.from_rotvec([0.0, 0.0, rng.uniform(-3.0, 3.0) * turned]) * FACES[face].inv()
        for face in faces
    ]
    rest, carry = int(RATE_HZ * REST_S), int(RATE_HZ * CARRY_S)
    share = least_jerk(np.arange(carry) / carry)
    position_m, rotation = list[np.ndarray](), list[np.ndarray]()
    for i, (place, turn) in enumerate(zip(places, turns, strict=True)):
        position_m.append(np.tile(place, (rest, 1)))
        rotation.append(np.tile(turn.as_quat(), (rest, 1)))
        if i + 1 < len(places):
            lift = np.outer(np.sin(np.pi * share), [0.05, -0.03, 0.2])
            position_m.append(place + np.outer(share, places[i + 1] - place) + lift)
            way = (turns[i + 1] * turn.inv()).as_rotvec()
            tilt = Rotation.from_rotvec(np.outer(np.sin(np.pi * share) ** 2, rng.uniform(-0.5, 0.5, 3)))
            rotation.append((tilt * Rotation.from_rotvec(np.outer(share, way)) * turn).as_quat())
    turn = WORLD * Rotation.from_quat(np.concatenate(rotation))
    time_s, place_m = np.arange(len(turn)) / RATE_HZ, WORLD.apply(np.concatenate(position_m))
    poses = with_noise(rng, time_s, place_m, turn, SIGMA_M, SIGMA_RAD)
    return poses, (rest + carry) * np.arange(len(faces))


def is_along(normal: np.ndarray, true: np.ndarray) -> bool:
    return bool(abs(normal @ true) > np.cos(np.radians(0.4)))


def sightings(poses: Poses) -> list[RestSighting]:
    return sightings_at_rest([*ticks_of(batches(poses), MODEL)], MODEL, MODEL.geometry.reach_m)


@pytest.mark.parametrize("seed", range(3))
def test_rests_on_two_faces_show_both_and_the_table(seed: int) -> None:
    faces = [0, 1, 0, 1, 0, 1]
    poses, begins = set_down(np.random.default_rng(seed), faces)
    found = sightings(poses)
    of_face = {0: list[np.ndarray](), 1: list[np.ndarray]()}
    for sighting, evidence in found:
        rest = int(np.abs(begins / RATE_HZ * 1e9 - sighting.onset_ns).argmin())
        model = sighting.estimate.model
        body, table = model.family.elements(sighting.estimate.x, np.zeros((7, 7)), 1.0)
        assert evidence > 5.0
        assert is_along(table.normal, WORLD.apply([0.0, 0.0, 1.0]))
        assert is_along(body.normal, FACES[faces[rest]].apply([0.0, 0.0, 1.0]))
        of_face[faces[rest]].append(body.normal)
    assert len(of_face[0]) == len(of_face[1]) == 3


def on_a_hinge(count: int) -> Poses:
    """A lid, or a knob, that is turned about an axis and rests here and there."""
    rng, rest = np.random.default_rng(0), int(RATE_HZ * REST_S)
    angle = np.cumsum(np.tile(np.repeat([0.0, 0.4 / 60], [rest, 60]), count))
    turn = WORLD * Rotation.from_rotvec(angle[:, None] * [0.0, 0.0, 1.0])
    place_m = turn.apply([0.2, 0.1, 0.05])
    return with_noise(rng, np.arange(len(angle)) / RATE_HZ, place_m, turn, SIGMA_M, SIGMA_RAD)


@pytest.mark.parametrize("how", ["not turned", "at other heights", "in one place", "on a hinge"])
def test_rests_that_show_no_face(how: str) -> None:
    """Three places fit a plane if the object keeps its orientation, and turns about an axis any face across
    it; rests in the air, at any height, do not fit; and a pose that returns shows nothing."""
    rng = np.random.default_rng(0)
    if how == "on a hinge":
        poses = on_a_hinge(5)
    elif how == "in one place":
        poses = set_down(rng, [0])[0]
        turns = Rotation.from_quat(poses.quat_xyzw)
        away = np.linspace(0.0, 1.0, len(poses))[:, None] * [0.1, 0.2, 0.3]
        carried = poses.position_m + away, (Rotation.from_rotvec(away) * turns).as_quat()
        parts = [(poses.position_m, poses.quat_xyzw), carried, tuple(part[::-1] for part in carried)]
        position_m, quat_xyzw = (
            np.concatenate(part) for part in zip(*parts, parts[0], *parts[1:], parts[0], strict=False)
        )
        stamp_ns = (np.arange(len(position_m)) * 1e9 / RATE_HZ).astype(np.int64)
        poses = Poses(stamp_ns, position_m, quat_xyzw)
    else:
        is_turned = how != "not turned"
        poses = set_down(rng, [0] * 3, is_turned, height_m=0.2 * is_turned)[0]
    assert not sightings(poses)


def test_an_object_that_is_only_set_down_and_carried_stands_on_a_face() -> None:
    """No contact moves; still all rests are f-f, or a robot holds the object there, and carries are free."""
    poses, begins = set_down(np.random.default_rng(1), [0] * 4)
    found = segment(poses, MODEL)
    middle_ns = ((begins / RATE_HZ + 0.5 * REST_S) * 1e9).astype(np.int64)
    for at_ns in middle_ns:
        (rest,) = (s for s in found.segments if s.start_ns <= at_ns <= s.end_ns)
        assert rest.contact is Contact.FF
        assert rest.inseparable == (Contact.FREE,)
        assert rest.probability > 0.8
        assert isinstance(rest.geometry.environment, Plane)
        assert is_along(rest.geometry.environment.normal, WORLD.apply([0.0, 0.0, 1.0]))
