"""Findings say that no contact confirms any known element of a side, or that contacts move them far."""

from dataclasses import replace

import numpy as np
import pytest

from checked_stream import stream_of
from contact_tracker.api.learned_map import map_of
from contact_tracker.api.offline import segment
from contact_tracker.checks.map_use import MapUse, without_contradicted_names
from contact_tracker.geometry.elements import ContactGeometry, Line, Plane, Point
from contact_tracker.map.file import map_from
from contact_tracker.states import STATES, Contact
from contact_tracker.tracking.belief import FurtherContact, Segment
from contact_tracker.tracking.segmentation import BELIEF, Beliefs, Segmentation
from contact_tracker.trajectory import Trajectory
from short_recordings import shipped

TABLE = {"environment": {"plane": [{"normal": [0, 0, 1], "offset_m": 0.5}]}}
CORNER = {"object": {"point": [{"point_m": [0.1, 0.0, 0.0], "name": "tip"}]}}


def on(offset_m, name=None, normal=(0.0, 0.0, 1.0), probability=1.0, inseparable=(), tip=None):
    pair = ContactGeometry(
        Point(np.array([0.1, 0.0, 0.0]), np.eye(3) * 1e-6, name=tip),
        Plane(np.array(normal), offset_m, np.eye(4) * 1e-6, name=name),
    )
    return Segment(0, 10**9, Contact.VF, probability, pair, inseparable)


def found(given, *segments):
    known_map = map_of(given, lambda _: None)
    stream = stream_of(known_map)
    return MapUse().update_segments(segments, stream).findings(stream, [])


def test_a_face_that_no_contact_is_on_is_named_with_its_distance():
    (finding,) = found(TABLE, on(0.34))
    assert "surroundings (plane 1)" in finding.text
    assert "parallel to plane 1, 160 mm from it" in finding.text
    assert not finding.doubts_labels
    (turned,) = found(TABLE, on(0.34, normal=(1.0, 0.0, 0.0)))
    assert "parallel" not in turned.text
    (tilted,) = found(TABLE, on(0.5, normal=(0.087, 0.0, 0.996)))  # by 5 deg, at its place
    assert "parallel" not in tilted.text
    (vertex,) = found(CORNER, on(0.5))
    assert "object (tip)" in vertex.text


@pytest.mark.parametrize(
    "segments",
    [
        [],
        [on(0.34), on(0.5, "plane 1")],
        [on(0.34), on(0.498)],
        [on(0.34, probability=0.3)],
        [on(0.34, inseparable=tuple(state for state in STATES if state is not Contact.VF))],
        [Segment(0, 10**9, Contact.FREE, 1.0, None)],
    ],
)
def test_it_is_not_found_where_one_is_touched_or_nothing_is_sure(segments):
    assert not found(TABLE, *segments)
    assert not found({"up": {"direction": [0, 0, 1]}}, *segments)


LEVELS = {"environment": {"plane": [{"normal": [0, 0, 1], "offset_m": offset} for offset in (0.5, 0.8)]}}


@pytest.mark.parametrize(
    ("segments", "differences"),
    [
        ([on(0.84)], ["plane 2 of the surroundings, and a face that is touched differs from it by 40 mm:"]),
        ([on(0.84), on(0.87)], ["by 40 mm:"]),
        ([on(0.8, normal=(-0.14, 0.0, 0.99))], ["by 8 deg:"]),
        ([on(-0.84, normal=(0.0, 0.0, -1.0))], ["by 40 mm:"]),
        ([on(0.802)], []),  # within the deviations of both
        ([on(1.0)], []),  # another level
        ([on(0.84), on(0.8, "plane 2")], []),
    ],
)
def test_a_face_beside_a_listed_one_that_no_contact_confirms_is_named(segments, differences):
    """Where contacts confirm another listed face."""
    findings = found(LEVELS, on(0.5, "plane 1"), *segments)
    for finding, text in zip(findings, differences, strict=True):
        assert text in finding.text
        assert not finding.doubts_labels


def test_a_face_on_a_face_does_not_show_the_place():
    """The object's face is on any parallel one; where its offset is known, other contacts have shown it."""
    covariance = np.eye(4) * 1e-6
    up = np.array([0.0, 0.0, 1.0])
    for offset_m in (0.0, 0.1):
        flat = ContactGeometry(Plane(up, offset_m, covariance), Plane(up, 0.5, covariance, name="plane 1"))
        resting = Segment(0, 10**9, Contact.FF, 1.0, flat)
        assert not found(TABLE, resting)
        (one,) = found(TABLE, resting, on(0.34))
        assert "160 mm" in one.text


def flat_on(name, normal=(0.0, 0.0, 1.0)):
    """A face on a face, whose place along the normal the motion does not show."""
    covariance = np.diag([1e-6, 1e-6, 1e-6, 0.1])
    pair = ContactGeometry(
        Plane(np.array([1.0, 0.0, 0.0]), 0.0, covariance),
        Plane(np.array(normal), 0.5, np.eye(4) * 1e-6, name=name),
    )
    return Segmentation((Segment(0, 10**9, Contact.FF, 1.0, pair),), Beliefs(np.zeros(10, BELIEF)))


def test_names_by_direction_are_withdrawn_where_a_contact_shows_another_place():
    listed = map_of(TABLE, lambda _: None).listed_environment
    other = MapUse((False, True), (False, False), (0.1, "plane 1"))
    for piece, use, name in (
        (flat_on("plane 1"), MapUse(), "plane 1"),
        (flat_on("plane 1"), other, None),
        (flat_on("plane 1"), replace(other, known=(False, True)), "plane 1"),
        (flat_on("wall", (1.0, 0.0, 0.0)), other, "wall"),  # of another direction
    ):
        (segment,) = without_contradicted_names(piece, listed, use).segments
        assert segment.geometry.environment.name == name


@pytest.mark.long
def test_no_row_is_on_a_known_face_that_contacts_contradict(tmp_path):
    """One of the right direction, 10 cm off: a face on a face alone would be on it."""
    paper = Trajectory(shipped("paper_experiment")[:5000])
    normal = [0.566, 0.556, 0.609]
    wrong, right = (
        segment(paper, known={"environment": {"plane": [{"normal": normal, "offset_m": offset_m}]}})
        for offset_m in (0.137, 0.037)
    )
    assert any("parallel to plane 1" in line for line in wrong.warnings)
    assert not right.warnings
    assert wrong.segments[0].contact is right.segments[0].contact is Contact.FF
    assert right.segments[0].geometry.environment.name == "plane 1"
    for one in (*wrong.segments, *wrong.beliefs):
        assert one.geometry is None or one.geometry.environment.name is None
    assert wrong.segments[0].geometry.environment.offset_m == pytest.approx(0.037, abs=0.003)
    assert [line[:8] for line in str(wrong).splitlines() if "plane 1" in line] == ["warning:"]
    wrong.save(tmp_path / "out.csv")
    assert "plane 1" not in (tmp_path / "out.csv").read_text()


SIGMA = {"sigma_position_m": 0.001, "sigma_rotation_deg": 0.5}


KNOWN = map_from(
    {
        "environment": {"plane": [{"name": "table", "normal": [0, 0, 1], "offset_m": 0.0, **SIGMA}]},
        "object": {"line": [{"name": "edge", "direction": [0, 1, 0], "point_m": [0.05, 0, 0], **SIGMA}]},
    }
)


def moved(height_m=0.0, across_m=0.0, tilt_deg=0.0, names=("edge", "table"), probability=1.0):
    """A contact of the edge, moved across by ``across_m``, on the table, moved up and tilted."""
    tilt = np.radians(tilt_deg)
    line = Line(np.array([0.0, -1.0, 0.0]), np.array([0.05, 3.0, across_m]), np.eye(6) * 1e-9, name=names[0])
    face = Plane(np.array([np.sin(tilt), 0.0, np.cos(tilt)]), height_m, np.eye(4) * 1e-9, name=names[1])
    return Segment(0, 10**9, Contact.EF, probability, ContactGeometry(line, face), ())


def movements(*segments):
    use = MapUse().update_segments(segments, stream_of(KNOWN))
    return [one.text for one in use.findings(stream_of(KNOWN), []) if "contacts move" in one.text]


@pytest.mark.parametrize(
    "segments",
    [
        [],
        [moved(0.003)],
        [moved(0.002, 0.002), moved(-0.002, 0.002)],
        [moved(0.02, names=(None, None))],
        [moved(0.02, names=("edge", None))],
        [moved(0.02, probability=0.3)],
        [Segment(0, 10**9, Contact.FREE, 1.0, None)],
    ],
)
def test_small_movements_and_unknown_elements_are_no_matter(segments):
    assert movements(*segments) == []


def test_the_furthest_movement_is_named_with_its_sizes():
    (text,) = movements(moved(0.002), moved(0.005, 0.006), moved(0.001))
    assert "by 8 of its standard deviations" in text
    assert "edge by 6 mm, table by 5 mm" in text
    (turned,) = movements(moved(tilt_deg=4.0))
    assert "table by 4 deg" in turned


def test_movements_of_further_contacts_count_as_well():
    first = moved()
    beside = moved(0.01)
    further = FurtherContact(Contact.EF, 1.0, 0, None, beside.geometry, (), 2)
    segment = Segment(0, 10**9, Contact.EF, 1.0, first.geometry, (), further=(further,))
    assert movements(segment)
