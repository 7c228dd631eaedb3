"""Parts of a segment in which its face does not turn: the contact may be that of two faces."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from test_formation_reports import finished_with

from contact_tracker.config.loading import load_model
from contact_tracker.geometry.elements import ContactGeometry, Line, Origins, Plane
from contact_tracker.geometry.lifted_pose import lift
from contact_tracker.map.map import EMPTY_MAP, Map
from contact_tracker.motion.window import Window
from contact_tracker.states import Contact
from contact_tracker.tracking.ambiguity import FLUSH_RAD
from contact_tracker.tracking.belief import Segment
from contact_tracker.tracking.segment_fit import SegmentFit, SegmentTicks

MODEL = load_model()
NOISE_RAD = 5e-4
FLAT, COUNT = 40, 80
TABLE = Plane(np.array([0.0, 0.0, 1.0]), 0.0, 1e-8 * np.eye(4))
EDGE = Line(np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.05, -0.04]), 1e-8 * np.eye(6))


def slid_then_tilted(tilt_rad: float, rng: np.random.Generator) -> Window:
    """A box that slides and yaws on the table, for ``FLAT`` ticks on a face and then on an edge that is
    tilted to and fro."""
    tick = np.arange(COUNT)
    yaw, tilt = 0.3 * np.sin(0.1 * tick), tilt_rad * np.sin(0.4 * np.clip(tick - FLAT, 0, None))
    turn = Rotation.from_euler("ZX", np.column_stack([yaw, tilt]))
    place_m = np.column_stack([0.1 * np.sin(0.07 * tick), 0.1 * np.cos(0.09 * tick), 0.0 * tick])
    error = Rotation.from_rotvec(NOISE_RAD * rng.normal(size=(COUNT, 3)))
    zeta = lift((turn * error).as_matrix(), place_m - turn.apply(EDGE.point_m))
    variance = np.tile([1e-8, NOISE_RAD**2], (COUNT, 1))
    return Window(tick, zeta, variance, 1e-6 * np.ones((COUNT, 2)), frames=np.full(COUNT, 20.0))


def reported(tilt_rad: float, fit: SegmentFit, known_map: Map = EMPTY_MAP) -> tuple[Segment, ...]:
    """The parts of one segment of the motion above, which is sure of its contact."""
    window = slid_then_tilted(tilt_rad, np.random.default_rng(0))
    ticks = SegmentTicks(window, fit.contact, MODEL, known_map, Origins.zero())
    segments, beliefs = finished_with(ticks, 0.994, 100_000_000).with_fit(fit)
    for belief in beliefs:
        (part,) = (segment for segment in segments if segment.start_ns <= belief.stamp_ns <= segment.end_ns)
        assert belief.inseparable == part.inseparable
    return segments


def fit_of(contact: Contact, geometry: ContactGeometry) -> SegmentFit:
    return SegmentFit(contact, geometry, (), np.zeros(1))


@pytest.mark.parametrize("is_mirrored", [False, True])
def test_a_part_on_the_face_may_be_flush_in_a_segment_on_an_edge(is_mirrored: bool) -> None:
    if is_mirrored:  # the body's face on an edge of the world: here the world's axes are the body's
        window_normal = Plane(np.array([0.0, 0.0, 1.0]), 0.0, 1e-8 * np.eye(4))
        fit = fit_of(Contact.FE, ContactGeometry(window_normal, EDGE))
    else:
        fit = fit_of(Contact.EF, ContactGeometry(EDGE, TABLE))
    flat, tilted = reported(0.2, fit)
    assert flat.inseparable == (Contact.FF,)
    assert flat.probability < 0.9 + 1e-9
    assert tilted.inseparable == ()
    assert tilted.probability > 0.99
    assert abs(tilted.start_ns - FLAT * 1e8) <= 5e8


def test_all_of_a_segment_that_rocks_less_than_faces_do_may_be_flush() -> None:
    (whole,) = reported(FLUSH_RAD, fit_of(Contact.EF, ContactGeometry(EDGE, TABLE)))
    assert whole.inseparable == (Contact.FF,)


def test_where_f_f_cannot_occur_the_edge_stays_sure() -> None:
    possible = Map(states=(Contact.EF, Contact.VF, Contact.FREE))
    (whole,) = reported(0.2, fit_of(Contact.EF, ContactGeometry(EDGE, TABLE)), possible)
    assert whole.inseparable == ()
