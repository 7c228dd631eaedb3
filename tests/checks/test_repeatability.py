"""A finding says where estimates of what seems to be one element differ by more than noise allows."""

from dataclasses import replace

import numpy as np
import pytest
from benchmarks.distortions import bent

from checked_stream import MODEL, stream_of
from contact_tracker.checks import map_use
from contact_tracker.checks.map_use import Repeatability
from contact_tracker.config.parameters import SystematicErrors
from contact_tracker.geometry.elements import ContactGeometry, Plane, Point, shifted
from contact_tracker.motion.pose_validation import gate
from contact_tracker.segmenting import segmented
from contact_tracker.states import Contact
from contact_tracker.tracking.belief import Segment
from contact_tracker.trajectory import Trajectory
from contact_tracker.trajectory.arguments import model_from
from short_recordings import shipped

NONE = SystematicErrors()
TURN, SHIFT = 1e-3, 1e-3
"""Standard deviations (rad, m) of the elements below."""


def plane(normal=(0.0, 0.0, 1.0), offset_m=0.5):
    normal = np.array(normal) / np.linalg.norm(normal)
    covariance = np.zeros((4, 4))
    covariance[:3, :3], covariance[3, 3] = TURN**2 * (np.eye(3) - np.outer(normal, normal)), SHIFT**2
    return Plane(normal, offset_m, covariance)


def point(x_m=0.0):
    return Point(np.array([x_m, 0.0, 0.0]), SHIFT**2 * np.eye(3))


def segments(*pairs):
    return [
        Segment(10**9 * i, 10**9 * (i + 1) - 1, Contact.VF, 1.0, ContactGeometry(*pair))
        for i, pair in enumerate(pairs)
    ]


def observed(given, **changes):
    return Repeatability().update_segments(given, stream_of(**changes))


def findings(found, errors):
    return found.findings(stream_of(best=replace(MODEL, systematic=errors)), [])


def accuracy_finding(poses, accuracy=None):
    report = segmented(Trajectory(gate(poses)), model_from("default", accuracy=accuracy)).report
    return [finding for finding in report.findings if finding.kind == "accuracy"]


@pytest.mark.long
def test_it_is_found_in_a_bent_volume_and_not_where_errors_are_given():
    distorted = bent(shipped("paper_experiment")[:6000:2], np.random.default_rng(6))
    (found,) = accuracy_finding(distorted)
    assert "--accuracy" in found.text
    assert "\n" not in found.text
    assert not found.doubts_labels
    assert not accuracy_finding(distorted, "0.5mm,0.1deg")


def test_the_text_has_the_pair_that_differs_most():
    found = observed(segments(*((point(), plane((tilt, 0.0, 1.0))) for tilt in (0.0, 0.01, 0.02))))
    assert (found.near, found.apart) == (6, 3)
    (said,) = findings(found, NONE)
    assert "3 of 6 pairs; the face of the surroundings from 0.00 s and from 2.00 s by 1.1 deg, " in said.text
    (said,) = findings(found, SystematicErrors(1e-5, 1e-5))
    assert "errors larger than these" in said.text


def test_given_elements_and_those_without_covariance_are_not_compared():
    given = replace(plane(), name="table")
    unknown = replace(plane((0.01, 0.0, 1.0)), covariance=None)
    found = observed(segments((point(), given), (point(0.05), plane()), (point(0.1), unknown)))
    assert found.near == 0
    assert len(found.latest) == 4


def test_it_does_not_depend_on_where_the_bodys_origin_is():
    """Far away, the offsets of faces that are turned by a degree differ by much more than those near them."""
    away_m, pairs = np.array([6.0, -4.8, 6.4]), [(plane((0.015 * i, 0.0, 1.0)), point()) for i in range(3)]
    moved = [(shifted(ours, away_m), theirs) for ours, theirs in pairs]
    near, far = observed(segments(*pairs)), observed(segments(*moved), body_m=away_m)
    assert (near.near, near.apart) == (far.near, far.apart)
    assert near.worst[2].sigmas == pytest.approx(far.worst[2].sigmas, rel=1e-3)


def open_face(tilt):
    """A face of unknown offset, as of an object that tilts on it."""
    one = plane((tilt, 0.0, 1.0), 0.0)
    covariance = one.covariance.copy()
    covariance[3, 3] = 0.09
    return replace(one, covariance=covariance)


AGREE = segments((point(), plane()), (point(1e-3), plane(offset_m=0.502)))
TILTED = segments((point(), plane()), (point(), plane((0.01, 0.0, 1.0))))
# as in f-f, with the origin of the body far away: a small angle there is a large distance
FLAT = segments(*((plane(offset_m=0.0), other) for other in (plane(), plane((1e-3, 0.0, 1.0), 0.55))))
OPEN = segments((open_face(0.0), open_face(0.0)), (point(), plane((0.01, 0.0, 1.0), 0.1)))
FREE = replace(OPEN[0], contact=Contact.FREE, geometry=None)
BESIDE = {
    "turned": plane((0.05, 0.0, 1.0)),
    "shifted": plane(offset_m=0.52),
    "the other side": plane((0.0, 0.0, -1.0), -0.5),
}
DOUBTFUL = {
    "improbable": {"probability": 0.2},
    "open to free motion": {"inseparable": (Contact.FREE,)},
}
PAIRS = {
    "they agree": (AGREE, 2, 0),
    **{name: (segments((point(), plane()), (point(0.05), face)), 0, 0) for name, face in BESIDE.items()},
    "faces of unknown offset differ by their normals alone": (FLAT, 2, 0),
    "a face on which an object tilts is one": (OPEN, 1, 1),
    "a table and a shelf may be nearly parallel": ([OPEN[0], FREE, OPEN[1]], 0, 0),
    **{name: ([TILTED[0], replace(TILTED[1], **doubt)], 0, 0) for name, doubt in DOUBTFUL.items()},
}


@pytest.mark.parametrize(("given", "near", "apart"), PAIRS.values(), ids=PAIRS)
def test_pairs_near_each_other_are_compared(given, near, apart):
    found = observed(given)
    assert (found.near, found.apart) == (near, apart)
    assert apart or findings(found, NONE) == []


def test_only_the_latest_elements_are_kept():
    found = observed(segments(*[(point(), plane())] * 100))
    assert len(found.latest) == map_use.MOST_ELEMENTS
