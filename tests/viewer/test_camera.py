"""The view is upright with respect to the touched plane."""

import numpy as np
import pytest

from contact_tracker.geometry.elements import ContactGeometry, Plane, Point
from contact_tracker.motion.poses import Poses
from contact_tracker.outputs.scene import UNKNOWN_EXTENT, Extent, Upward, draw
from smooth_motion import unturned

X, Y, Z = np.eye(3)
CUBE_M = np.array([[x, y, z] for x in (-0.1, 0.1) for y in (-0.1, 0.1) for z in (-0.1, 0.1)])
CUBE = Extent(np.zeros(3), float(np.sqrt(0.03)), CUBE_M)


def touch(upward: Upward, plane: Plane, poses: Poses, lasted_ns: int) -> bool:
    return upward.add(ContactGeometry(Point(np.zeros(3)), plane), poses, lasted_ns)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_up_is_away_from_the_plane_whichever_way_its_normal_points(sign) -> None:
    upward = Upward(UNKNOWN_EXTENT)
    assert touch(upward, Plane(sign * X, 0.0), unturned([[-0.5, 0.0, 0.0]]), 1_000), "the direction changes"
    assert upward.direction == pytest.approx(-X)
    assert upward.eye(1.0)[0] @ -X == pytest.approx(2.2)


def test_up_is_mostly_that_of_the_plane_that_was_touched_longest() -> None:
    upward, aside = Upward(UNKNOWN_EXTENT), unturned([[0.5, 0.0, 0.5]])
    touch(upward, Plane(Z, 0.0), aside, 100)
    touch(upward, Plane(X, 0.0), aside, 900)
    assert upward.direction @ X > 0.9


def test_faces_of_unknown_height_do_not_determine_the_side() -> None:
    """They count towards what is known, here that the object hangs below the plane."""
    faces = Plane(Z, 0.3, np.diag([1e-6, 1e-6, 1e-6, 0.09]))
    upward, poses = Upward(CUBE), unturned([[0.0, 0.0, 0.0]])
    touch(upward, Plane(Z, 0.1), poses, 10)
    touch(upward, faces, poses, 1_000)
    assert upward.direction == pytest.approx(-Z)


def test_faces_of_unknown_height_lie_below_the_hull() -> None:
    covariance = np.diag([1e-6, 1e-6, 1e-6, 0.09])
    faces = ContactGeometry(Plane(-Z, 0.0, covariance), Plane(Z, 1.0, covariance))
    large = Extent(np.zeros(3), 2.0)  # as its size exceeds the prior's deviation, too
    assert draw(faces, unturned([[0.0, 0.0, 1.0]]), large).is_open
    for up, height in ((Z, 0.9), (-Z, 1.1)):
        drawing = draw(faces, unturned([[0.0, 0.0, 1.0]]), CUBE, up)
        assert drawing.is_open
        wheel, nothing, sheet, needle = drawing.meshes
        assert np.allclose(sheet.vertices[:, 2], height)
        assert np.allclose(wheel.vertices[:, 2].mean() + 1.0, height, atol=1e-3)
        assert len(nothing.vertices) == 0, "no surfaces at two standard deviations: they would be far off"
        assert np.ptp(needle.vertices[:, 2]) > 2.0 * np.ptp(needle.vertices[:, 0])


def test_faces_of_known_height_lie_there() -> None:
    known = np.diag([1e-8, 1e-8, 1e-8, 1e-8])
    faces = ContactGeometry(Plane(-Z, 0.1, known), Plane(Z, 0.9, known))
    drawing = draw(faces, unturned([[0.0, 0.0, 1.0]]), CUBE)
    assert not drawing.is_open
    assert np.allclose(drawing.meshes[2].vertices[:, 2], 0.9)
