"""The camera is upright with respect to the touched plane, and keeps object and contact in view."""

from collections.abc import Sequence

import numpy as np
import pytest

from contact_tracker.geometry.elements import ContactGeometry, Plane, Point
from contact_tracker.motion.poses import Poses
from contact_tracker.viewer.camera import SLACK, Camera
from contact_tracker.viewer.scene import UNKNOWN_EXTENT, UP, Extent, draw

X, Y, Z = np.eye(3)
CUBE_M = np.array([[x, y, z] for x in (-0.1, 0.1) for y in (-0.1, 0.1) for z in (-0.1, 0.1)])
CUBE = Extent(np.zeros(3), float(np.sqrt(0.03)), CUBE_M)


def at(places: Sequence[Sequence[float]] | np.ndarray) -> Poses:
    """Poses without rotation, at 100 Hz."""
    position = np.asarray(places, float)
    stamps = 10_000_000 * np.arange(len(position), dtype=np.int64)
    return Poses(stamps, position, np.tile([0.0, 0.0, 0.0, 1.0], (len(position), 1)))


def touch(
    camera: Camera, plane: Plane, poses: Poses, lasted_ns: int, extent: Extent = UNKNOWN_EXTENT
) -> bool:
    geometry = ContactGeometry(Point(np.zeros(3)), plane)
    return camera.add_contact(geometry, draw(geometry, poses, extent, camera.up), poses, lasted_ns)


def test_without_contact_z_is_up() -> None:
    camera = Camera(UNKNOWN_EXTENT)
    axes = camera.frame()
    assert axes[:, 2] == pytest.approx(0.1 * UP)
    assert np.linalg.det(axes) == pytest.approx(0.1**3), "a rotation, as large as the object"


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_up_is_away_from_the_plane_whichever_way_its_normal_points(sign: float) -> None:
    camera = Camera(UNKNOWN_EXTENT)
    assert touch(camera, Plane(sign * X, 0.0), at([[-0.5, 0.0, 0.0]]), 1_000), "the frame turns"
    assert camera.up == pytest.approx(-X)


def test_up_is_of_the_plane_that_was_touched_longest_in_all() -> None:
    camera = Camera(UNKNOWN_EXTENT)
    aside = at([[0.5, 0.0, 0.5]])
    touch(camera, Plane(Z, 0.0), aside, 400)
    touch(camera, Plane(X, 0.0), aside, 500)
    assert camera.up == pytest.approx(X)
    touch(camera, Plane(-Z, 0.0), aside, 200)
    assert camera.up == pytest.approx(Z)


def test_faces_of_unknown_height_do_not_determine_up() -> None:
    """They last longer than v-f, which does, and are parallel to its face."""
    open_plane = Plane(Z, 0.3, np.diag([1e-6, 1e-6, 1e-6, 0.09]))
    faces = ContactGeometry(Plane(Z, 0.3, open_plane.covariance), open_plane)
    camera, poses = Camera(CUBE), at([[0.0, 0.0, 0.0]])
    camera.add_contact(faces, draw(faces, poses, CUBE), poses, 1_000)
    assert camera.up == pytest.approx(Z)
    touch(camera, Plane(Z, 0.1), poses, 10, CUBE)
    assert camera.up == pytest.approx(-Z), "the object hangs below the plane"


def test_faces_of_unknown_height_lie_below_the_hull() -> None:
    covariance = np.diag([1e-6, 1e-6, 1e-6, 0.09])
    faces = ContactGeometry(Plane(-Z, 0.0, covariance), Plane(Z, 1.0, covariance))
    large = Extent(np.zeros(3), 2.0)  # as its size exceeds the prior's deviation, too
    assert draw(faces, at([[0.0, 0.0, 1.0]]), large).is_open
    for up, height in ((Z, 0.9), (-Z, 1.1)):
        drawing = draw(faces, at([[0.0, 0.0, 1.0]]), CUBE, up)
        assert drawing.is_open
        wheel, nothing, sheet, needle = drawing.meshes
        assert np.allclose(sheet.vertices[:, 2], height)
        assert np.allclose(wheel.vertices[:, 2].mean() + 1.0, height, atol=1e-3)
        assert len(nothing.vertices) == 0, "no surfaces at two standard deviations: they would be far off"
        assert np.ptp(needle.vertices[:, 2]) > 2.0 * np.ptp(needle.vertices[:, 0])


def test_faces_of_known_height_lie_there() -> None:
    known = np.diag([1e-8, 1e-8, 1e-8, 1e-8])
    faces = ContactGeometry(Plane(-Z, 0.1, known), Plane(Z, 0.9, known))
    drawing = draw(faces, at([[0.0, 0.0, 1.0]]), CUBE)
    assert not drawing.is_open
    assert np.allclose(drawing.meshes[2].vertices[:, 2], 0.9)


def test_the_frame_rests_while_the_object_stays_near_and_follows_it() -> None:
    way = np.zeros((600, 3))
    way[:300, 0] = 0.3 * SLACK * UNKNOWN_EXTENT.radius_m * np.sin(np.arange(300) / 20.0)
    way[300:, 1] = np.linspace(0.0, 5.0, 300)
    camera, poses = Camera(UNKNOWN_EXTENT), at(way)
    stamps, origins = camera.follow(poses[:300])
    assert len(stamps) == 1, "it does not tremble with the object"
    more = camera.follow(poses[300:])
    stamps, origins = np.concatenate([stamps, more[0]]), np.concatenate([origins, more[1]])
    held = origins[np.searchsorted(stamps, poses.stamp_ns, side="right") - 1]
    step_m = 5.0 / 300 * 5
    assert np.linalg.norm(way - held, axis=1).max() <= SLACK * UNKNOWN_EXTENT.radius_m + step_m


def test_poses_in_pieces_are_followed_as_one() -> None:
    poses = at(np.cumsum(np.random.default_rng(1).normal(scale=0.01, size=(500, 3)), axis=0))
    whole, parts = Camera(CUBE), Camera(CUBE)
    expected = whole.follow(poses)
    found = [parts.follow(poses[first : first + 7]) for first in range(0, 500, 7)]
    assert np.array_equal(np.concatenate([stamps for stamps, _ in found]), expected[0])
    assert np.array_equal(np.concatenate([origins for _, origins in found]), expected[1])


def test_contacts_far_from_the_bodys_origin_are_in_view() -> None:
    camera, poses = Camera(UNKNOWN_EXTENT), at([[0.0, 0.0, 0.8]])
    geometry = ContactGeometry(Point(np.array([0.0, 0.0, -0.8])), Plane(Z, 0.0))
    drawing = draw(geometry, poses, UNKNOWN_EXTENT)
    assert camera.add_contact(geometry, drawing, poses, 1)
    assert np.linalg.norm(camera.frame()[:, 0]) == pytest.approx(0.8)
    assert np.ptp(drawing.meshes[2].vertices[:, 0]) > 0.8, "and drawn as large as the object seems"
    far = replace_place(geometry, 50.0)
    assert not camera.add_contact(far, draw(far, poses, UNKNOWN_EXTENT), poses, 1), (
        "but not for a contact 50 m away"
    )


def replace_place(geometry: ContactGeometry, distance_m: float) -> ContactGeometry:
    return ContactGeometry(Point(np.array([0.0, 0.0, -distance_m])), geometry.environment)


def test_motion_is_viewed_from_the_side() -> None:
    camera = Camera(UNKNOWN_EXTENT)
    camera.follow(at(np.outer(np.linspace(0.0, 1.0, 200), X)))
    forward = camera.frame()[:, 1]
    assert abs(forward @ Y) == pytest.approx(0.1)
