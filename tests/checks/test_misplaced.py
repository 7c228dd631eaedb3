"""Known elements that contacts have to move by many standard deviations are reported."""

import numpy as np
import pytest

from checked_stream import stream_of
from contact_tracker.checks.map_use import MapUse
from contact_tracker.geometry.elements import ContactGeometry, Line, Plane
from contact_tracker.map.file import map_from
from contact_tracker.states import Contact
from contact_tracker.tracking.belief import FurtherContact, Segment

SIGMA = {"sigma_position_m": 0.001, "sigma_rotation_deg": 0.5}
KNOWN = map_from(
    {
        "environment": {"plane": [{"name": "table", "normal": [0, 0, 1], "offset_m": 0.0, **SIGMA}]},
        "object": {"line": [{"name": "edge", "direction": [0, 1, 0], "point_m": [0.05, 0, 0], **SIGMA}]},
    }
)


def on(height_m=0.0, across_m=0.0, tilt_deg=0.0, names=("edge", "table"), probability=1.0):
    """A contact of the edge, moved across by ``across_m``, on the table, moved up and tilted."""
    tilt = np.radians(tilt_deg)
    line = Line(np.array([0.0, -1.0, 0.0]), np.array([0.05, 3.0, across_m]), np.eye(6) * 1e-9, name=names[0])
    face = Plane(np.array([np.sin(tilt), 0.0, np.cos(tilt)]), height_m, np.eye(4) * 1e-9, name=names[1])
    return Segment(0, 10**9, Contact.EF, probability, ContactGeometry(line, face), ())


def texts(*segments):
    found = MapUse().update_segments(segments, stream_of(KNOWN))
    return [one.text for one in found.findings(stream_of(KNOWN), []) if "contacts move" in one.text]


@pytest.mark.parametrize(
    "segments",
    [
        [],
        [on(0.003)],
        [on(0.002, 0.002), on(-0.002, 0.002)],
        [on(0.02, names=(None, None))],
        [on(0.02, names=("edge", None))],
        [on(0.02, probability=0.3)],
        [Segment(0, 10**9, Contact.FREE, 1.0, None)],
    ],
)
def test_small_movements_and_unknown_elements_are_no_matter(segments):
    assert texts(*segments) == []


def test_the_furthest_movement_is_named_with_its_sizes():
    (text,) = texts(on(0.002), on(0.005, 0.006), on(0.001))
    assert "by 8 of its standard deviations" in text
    assert "edge by 6 mm, table by 5 mm" in text
    (turned,) = texts(on(tilt_deg=4.0))
    assert "table by 4 deg" in turned


def test_further_contacts_count_as_well():
    first = on()
    beside = on(0.01)
    further = FurtherContact(Contact.EF, 1.0, 0, None, beside.geometry, (), 2)
    segment = Segment(0, 10**9, Contact.EF, 1.0, first.geometry, (), further=(further,))
    assert texts(segment)
