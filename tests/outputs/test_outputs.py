"""Beliefs and segments as text: read back where programs read them, in words where people do."""

import io
import json
from dataclasses import replace

import numpy as np
import pytest

from contact_tracker.config.loading import load_model
from contact_tracker.contacts import face_face
from contact_tracker.explanations.joint_evidence import Joint
from contact_tracker.explanations.joint_models import JointKind
from contact_tracker.exports.formats import json_line, open_text
from contact_tracker.exports.report_html import table_html
from contact_tracker.geometry.elements import ContactGeometry, Line, Plane, Point, canonical, shifted
from contact_tracker.outputs.adaptation import noise_text
from contact_tracker.outputs.joint_runs import joint_runs
from contact_tracker.outputs.text import change_lines, describe, describe_segment, status_text, table
from contact_tracker.states import STATES, Contact
from contact_tracker.tracking.belief import Belief, FurtherContact, Segment
from contact_tracker.tracking.filter_bank import Report

ORIGIN_NS = 1_700_000_000_123_456_789
EDGE = Line(np.array([1.0, 0.0, 0.0]), np.array([0.0, -0.05, 0.1]), np.diag([0, 1e-4, 4e-4, 0, 1e-6, 9e-6]))
FACE = Plane(np.array([0.0, 0.0, 1.0]), 0.25, np.diag([4e-6, 1e-6, 0, 1e-8]))
ON_FACE = ContactGeometry(EDGE, FACE)


def belief(contact: Contact, geometry: ContactGeometry | None) -> Belief:
    probability, stamp_ns, onset_ns = np.full(7, 0.01), ORIGIN_NS + 2_500_000_000, ORIGIN_NS + 10**9
    probability[contact.column] = 0.94
    return Belief(stamp_ns, contact, probability, onset_ns, geometry, np.full(6, np.nan))


def test_a_json_line_reads_back_exactly() -> None:
    content = json.loads(json_line(belief(Contact.EF, ON_FACE)))
    assert content["stamp_ns"] == ORIGIN_NS + 2_500_000_000
    assert content["onset_ns"] == ORIGIN_NS + 1_000_000_000
    assert content["contact"] == "e-f"
    assert content["probability"] == {s.value: 0.94 if s is Contact.EF else 0.01 for s in STATES}
    assert content["geometry"]["object"]["line"]["point_m"] == EDGE.point_m.tolist()
    assert content["geometry"]["environment"]["plane"]["offset_m"] == 0.25
    assert content["geometry"]["environment"]["plane"]["normal_sd"] == pytest.approx([2e-3, 1e-3, 0])


def test_unknown_deviations_are_null_and_a_probability_that_is_none_is_refused() -> None:
    unknown = ContactGeometry(Point(np.zeros(3)), FACE)
    content = json.loads(json_line(belief(Contact.VF, unknown)))
    assert content["geometry"]["object"]["point_sd_m"] == [None, None, None]
    broken = belief(Contact.FREE, None)
    broken.probability[0] = np.nan
    with pytest.raises(ValueError, match="JSON"):
        json_line(broken)


@pytest.mark.parametrize(("sd_m", "text"), [(3e-6, "+/- 0.003 mm"), (3e-10, "+/- below 0.001 mm")])
def test_deviations_of_exact_poses_have_no_figures(sd_m: float, text: str) -> None:
    assert f"m {text} on face" in describe(ContactGeometry(Point(np.zeros(3), sd_m**2 * np.eye(3)), FACE))


def test_a_table_of_latex_has_the_rows_of_the_table_with_its_signs_escaped() -> None:
    named = replace(FACE, name="x_mm degree & 100%")
    geometry = ContactGeometry(ON_FACE.object, named)
    segments = [Segment(ORIGIN_NS, ORIGIN_NS + 10**9, Contact.VF, 0.5, geometry)]
    file = io.StringIO(newline="")
    with open_text(".tex", file, "segments", lambda: ORIGIN_NS) as append:
        append(segments)
    *_, row, bottom, end = file.getvalue().splitlines()
    assert row.startswith(r"0.00 & 1.00 & v-f & 0.50 & edge along")
    face = r"face x\_mm degree \& 100\% normal (0.00 0.00 1.00)~$\pm$~0.11$^\circ$ at 0.250~m~$\pm$~0.1~mm"
    assert row.endswith(rf"on {face} \\")
    assert (bottom, end) == (r"\bottomrule", r"\end{tabular}")


def test_geometry_in_words_has_elements_and_deviations() -> None:
    assert describe(ON_FACE) == (
        "edge along (1.00 0.00 0.00) +/- 1.1 deg through (0.000 -0.050 0.100) m +/- 3 mm"
        " on face normal (0.00 0.00 1.00) +/- 0.11 deg at 0.250 m +/- 0.1 mm"
    )
    corner = ContactGeometry(Point(np.array([1e-9, -1e-9, 0.3]), np.eye(3) * 0.09), Plane(np.ones(3), -0.0))
    assert describe(corner) == (
        "vertex (0.000 0.000 0.300) m +/- 300 mm on face normal (1.00 1.00 1.00) at 0.000 m"
    )
    assert describe(None) == ""


def test_offsets_that_a_face_on_a_face_does_not_show_are_said_to_be_unknown() -> None:
    """Motion in f-f shows the difference of the offsets; their own deviations are the prior's, as is 0."""
    covariance = np.zeros((7, 7))
    covariance[:6, :6] = 1e-6 * np.eye(6)
    covariance[6, 6] = 1e-8
    x = np.array([0.0, 0.0, 1.0, 0.0, 1.0, 0.0, -0.081])
    for reach_m in (0.05, 0.3, 2.0):
        geometry = ContactGeometry(*face_face.elements(x, covariance, reach_m))
        assert geometry.has_open_offset == (True, True)
        assert describe(geometry, (Contact.EF,)) == (
            "face normal (0.00 0.00 1.00) +/- 0.057 deg (offset not known) on "
            "face normal (0.00 1.00 0.00) +/- 0.057 deg (offset not known); or e-f"
        )
        assert geometry.to_json()["environment"]["plane"]["offset_m"] == -0.081
    moved = ContactGeometry(geometry.object, shifted(geometry.environment, np.array([0.3, -0.4, 0.7])))
    assert moved.has_open_offset == (True, True)
    assert canonical(replace(geometry.object, normal=np.array([0.0, 0.0, -1.0]))).offset_m == 0.0


def test_offsets_that_are_known_otherwise_are_said() -> None:
    """A table that the user knows, and what the faces of other contacts are known to."""
    covariance = np.diag([1e-6, 1e-6, 0, 0.09])
    unknown = Plane(np.array([0.0, 0.0, 1.0]), 0.0, covariance)
    on_table = ContactGeometry(unknown, replace(FACE, name="table"))
    assert on_table.has_open_offset == (True, False)
    assert "+/- 0.057 deg (offset not known) on face table normal" in describe(on_table)
    assert describe(on_table).endswith("at 0.250 m +/- 0.1 mm")
    part = ContactGeometry(replace(unknown, name="part bottom"), replace(unknown, offset_m=0.2))
    assert part.has_open_offset == (False, False)
    assert ContactGeometry(FACE, EDGE).has_open_offset == (False, False)
    assert ContactGeometry(Plane(np.ones(3), 0.0), Plane(np.ones(3), 0.0)).has_open_offset == (False, False)


def test_text_lines_count_time_from_the_first_pose() -> None:
    (line,) = change_lines(belief(Contact.FREE, None), True, (), (), ORIGIN_NS)
    assert line.split() == ["2.50", "free", "0.94", "1.00"]
    assert status_text(belief(Contact.EF, ON_FACE), ORIGIN_NS).strip().startswith("2.50 s  e-f for 1.5 s ")
    header, line = table([Segment(ORIGIN_NS, ORIGIN_NS + 10**9, Contact.EF, 0.5, ON_FACE)], ORIGIN_NS)
    assert line.split()[:4] == ["0.00", "1.00", "e-f", "0.50"]
    assert header.index("contact") == line.index("e-f")


def test_segments_with_one_joint_have_one_row_of_it() -> None:
    """A drawer that rests at its ends, and another line than that of the drawer."""
    drawer = Joint(JointKind.SLIDER, 0.98, EDGE, EDGE, None, None)
    near, far = (replace(EDGE, point_m=EDGE.point_m + shift) for shift in ([0.0, 0.0, 2e-3], [0.0, 0.1, 0.0]))
    pulled_again, another = (replace(drawer, environment=line) for line in (near, far))
    joints = [drawer, None, pulled_again, drawer, another, None, another]
    contacts = [Contact.FF] * 5 + [Contact.FREE, Contact.FF]
    segments = [
        Segment(ORIGIN_NS + n * 10**9, ORIGIN_NS + (n + 1) * 10**9, contact, 0.5, ON_FACE, joint=joint)
        for n, (contact, joint) in enumerate(zip(contacts, joints, strict=True))
    ]
    rows = [line.split()[:4] for line in table(segments, ORIGIN_NS)]
    of_joints = [(start, end) for start, end, sign, _ in rows[1:] if sign == "="]
    assert of_joints == [("0.00", "4.00"), ("4.00", "5.00"), ("6.00", "7.00")]
    assert table_html(segments, ORIGIN_NS).count("= slider") == 3


def test_a_joint_has_no_row_over_other_motion_in_the_same_contact() -> None:
    """A drawer is pulled, lifted out and slid on a table, and pulled again."""
    drawer = Joint(JointKind.SLIDER, 0.98, EDGE, EDGE, None, None)
    on_table = replace(ON_FACE, environment=replace(ON_FACE.environment, offset_m=0.4))
    parts = [(ON_FACE, drawer), (ON_FACE, None), (ON_FACE, drawer), (on_table, None), (ON_FACE, drawer)]
    segments = [
        Segment(ORIGIN_NS + n * 10**9, ORIGIN_NS + (n + 1) * 10**9, Contact.FF, 0.5, geometry, joint=joint)
        for n, (geometry, joint) in enumerate(parts)
    ]
    assert [(run.first, run.last) for run in joint_runs(segments)] == [(0, 2), (4, 4)]


def test_where_the_contact_is_open_a_joint_stands_alone_and_a_further_contact_is_no_surer() -> None:
    """A slider is also two faces on two faces: these hold only if the first is f-f, the slider anyway."""
    end_ns = ORIGIN_NS + 10**9
    faces = ContactGeometry(FACE, FACE)
    further = FurtherContact(Contact.FF, 1.0, ORIGIN_NS, end_ns, faces, (Contact.EF,), 5)
    joint = Joint(JointKind.SLIDER, 0.98, EDGE, EDGE, None, None)
    others = tuple(state for state in STATES if state is not Contact.FF)
    for inseparable, of_joint in ((others, "; for any contact"), ((Contact.EF,), "")):
        segment = Segment(ORIGIN_NS, end_ns, Contact.FF, 0.4, ON_FACE, inseparable, (further,), joint)
        _, first, second, third, _ = table([segment], ORIGIN_NS)
        assert first.endswith("; or any other" if len(inseparable) == 6 else "; or e-f")
        assert second.split()[2:5] == ["+", "f-f", "0.40"]
        assert second.endswith(f"{describe(faces)}; or e-f")
        assert third.split()[2:5] == ["=", "slider", "0.98"]
        assert third.endswith(f"m +/- 3 mm{of_joint}")
        # any parallel line of the object is as good
        assert "axis along (1.00 0.00 0.00) +/- 1.1 deg through the body's origin on axis along" in third
        html = table_html([segment], ORIGIN_NS)
        assert "; or e-f</td>" in html
        assert f"{of_joint}</td>" in html


def test_a_row_names_contacts_that_are_likelier_than_its_label_and_the_rest_of_a_doubtful_one() -> None:
    """The label is that of the most probable sequence; with less than 0.9 and nothing after ``or``, the
    contacts that with the label reach 0.9."""
    others = tuple(state for state in STATES if state is not Contact.FF)

    def row(inseparable=(), **shares):
        posterior = np.array([shares.get(state.name.lower(), 0.0) for state in STATES])
        p = posterior[Contact.FF.column]
        segment = Segment(ORIGIN_NS, ORIGIN_NS, Contact.FF, p, None, inseparable, posterior=posterior)
        assert describe_segment(segment) in table_html([segment], ORIGIN_NS)
        return describe_segment(segment)

    assert row(others, ff=0.12, free=0.56, ef=0.29, ee=0.03) == "or free 0.56, e-f 0.29, any other"
    assert row((Contact.EF, Contact.FREE), ff=0.4, free=0.5, ef=0.1) == "or free 0.50, e-f"
    assert row((Contact.FREE,), ff=0.4, free=0.6) == "or free 0.60"
    assert row(others, ff=0.6, free=0.4) == "or any other"
    assert row(ff=0.55, free=0.3, vf=0.04, ef=0.06, ee=0.05) == "or free 0.30, e-f 0.06"
    assert row(ff=0.91, free=0.09) == ""


MODEL = load_model()


def text_of(*, is_decided=True, model=MODEL, lasting=(1e-4, 5e-4), **more):
    report = Report(model, model, is_decided, (3e-4, 2e-3), (1e-4, 1e-3), lasting, 20.0, ())
    return noise_text(report._replace(**more))


def test_what_too_little_motion_shows_is_assumed_and_not_found():
    """Nothing more is to come when the line is printed."""
    text = text_of(is_decided=False, moved_s=11.74)
    assert "there is too little motion to estimate the noise of ticks" in text
    assert "ticks (11.7 s of motion; up to 30 s are needed): " in text, (
        "even a long recording may have too little"
    )
    assert text.endswith(
        " a tick and slowly varying errors of 0.1 mm 0.029 deg are assumed (set it by --noise)"
    )
    assert "yet" not in text
    assert "assumed" not in text_of()
    assert "(as given)" in text_of(is_decided=False, model=MODEL.with_noise(3e-4, 2e-3))


def test_the_point_of_the_noise_is_named_if_it_is_not_the_origin():
    assert text_of(lasting=(0.0, 0.0)).startswith("noise 0.3 mm 0.11 deg a pose, ")
    moved = text_of(lasting=(0.0, 0.0), point_m=(0.0, 0.104, -9.9))
    assert moved.startswith("noise 0.3 mm 0.11 deg a pose at the point (0.00 0.10 -9.90) m of the body, ")
