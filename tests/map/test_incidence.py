"""Elements incident with known ones: their prior, and their recognition."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from contact_tracker.config.loading import load_model
from contact_tracker.contacts import CONTACT_MODELS
from contact_tracker.geometry.elements import Line, Plane, Point, numbers
from contact_tracker.map.association import LENGTH_M, incident
from contact_tracker.map.pairs import pair_priors as prior_given
from contact_tracker.states import Contact
from contact_tracker.tracking.belief import Detail
from contact_tracker_lab.simulate import Scenario, simulate
from contact_tracker_lab.simulate.scenarios import Phase
from pose_filter import forward

MODEL = load_model()
SURE_M, SURE_RAD = 1e-3, 3e-3
FAR_M = 0.03
WITH = {"f": Contact.FE, "e": Contact.EE, "v": Contact.VF}  # of each kind a contact whose object has it
seeds = st.integers(0, 2**32 - 1)
quickly = settings(max_examples=10, deadline=None)
steps = pytest.mark.parametrize("step", ["f>e", "f>v", "e>f", "e>v", "v>e", "v>f"])


def unit(rng):
    v = rng.normal(size=3)
    return v / np.linalg.norm(v)


def elements_at(rng, place):
    """A vertex at ``place``, an edge through it and a face with the edge."""
    n, v = unit(rng), rng.normal(size=3)
    d = np.cross(n, v) / np.linalg.norm(np.cross(n, v))
    jacobian = np.vstack([np.eye(3), place])
    of_plane = SURE_RAD**2 * jacobian @ (np.eye(3) - np.outer(n, n)) @ jacobian.T
    of_plane[3, 3] += SURE_M**2
    across = np.eye(3) - np.outer(d, d)
    of_line = np.kron(np.diag([SURE_RAD**2, SURE_M**2]), across)
    return {
        "f": Plane(n, float(n @ place), of_plane),
        "e": Line(d, place + 0.05 * d, of_line),
        "v": Point(place, SURE_M**2 * np.eye(3)),
    }


def cost(kind, known, element, body_m):
    """Half the squared distance of an object's element from its prior."""
    model = CONTACT_MODELS[WITH[kind].column]
    anchors = np.tile(body_m, 2)
    prior = prior_given(model, [(known, None)])
    (pivot,) = prior.line_points_m
    x, size = np.ones(model.family.SIZE), len(numbers(element))
    part = slice(0, size) if model.body_in_1 else slice(model.family.SIZE - size, model.family.SIZE)
    x[part] = numbers(element)
    x = model.family.normalise(x, np.where(np.isnan(pivot), anchors, pivot))
    off = np.zeros_like(x)
    off[part] = x[part] - prior.mean[0, part]
    return 0.5 * off @ prior.information[0] @ off


def moved_off(element, landmark, rng):
    """The element shifted so that it is not incident with the landmark."""
    if isinstance(element, Plane):
        return replace(element, offset_m=element.offset_m + FAR_M)
    along = next((one.direction for one in (landmark, element) if isinstance(one, Line)), unit(rng))
    away = np.cross(along, unit(rng))
    if isinstance(landmark, Plane):
        away = landmark.normal
    return replace(element, point_m=element.point_m + FAR_M * away / np.linalg.norm(away))


@steps
@quickly
@example(seed=57594)
@given(seed=seeds)
def test_incident_elements_cost_little_and_others_much(step, seed):
    """Of a known element, and an incident one of another kind."""
    rng = np.random.default_rng(seed)
    place, body_m = 0.1 * rng.normal(size=3), 0.1 * rng.normal(size=3)
    landmark, kind = elements_at(rng, place)[step[0]], step[2]
    element, known = incident_at(landmark, kind, rng, place), incident(landmark, kind, body_m)
    assert cost(kind, known, element, body_m) < 3.0  # places are hardly determined
    assert cost(kind, known, moved_off(element, landmark, rng), body_m) > 20.0


def incident_at(landmark, kind, rng, place):
    """A random element of a kind that is incident with ``landmark`` near ``place``."""
    match landmark:
        case Plane(normal):
            at = place + 0.1 * np.cross(normal, unit(rng))
            d = np.cross(normal, unit(rng))
            return Point(at) if kind == "v" else Line(d / np.linalg.norm(d), at)
        case Line(direction):
            n = np.cross(direction, unit(rng))
            n /= np.linalg.norm(n)
            return Point(place) if kind == "v" else Plane(n, float(n @ place))
        case Point():
            n = unit(rng)
            return Line(n, place) if kind == "e" else Plane(n, float(n @ place))


def test_an_edge_through_a_known_vertex_is_recognised_sooner():
    """A vertex on a face, then an edge of it: only a turn in the face is unknown."""
    recording = simulate(Scenario((Phase(Contact.VF, 4.0), Phase(Contact.EF, 2.5))), 4)
    change_ns = next(i.start_ns for i in recording.truth.intervals if i.contact is Contact.EF)

    def delay_s(recognised):
        model = replace(MODEL, geometry=replace(MODEL.geometry, revisit_prior=recognised))
        beliefs = [seen.belief for seen in forward(recording.poses, model, detail=Detail.SHARED)]
        since = [b for b in beliefs if b.stamp_ns >= change_ns]
        right = [b.contact is Contact.EF for b in since]
        last_wrong = max(i for i, is_right in enumerate(right) if not is_right)
        assert right[-1]
        return (since[last_wrong + 1].stamp_ns - change_ns) / 1e9

    assert delay_s(MODEL.geometry.revisit_prior) < delay_s(1e-9) - 0.1


@pytest.mark.parametrize("kind", ["e", "v"])
@pytest.mark.parametrize("turns", [(0.0, 0.0), (1e-4, 0.0), (1e-4, 1e-14)])
def test_a_face_with_restricted_rotation_informs_about_its_neighbours(kind, turns):
    face = Plane(np.array([0.0, 0.0, 1.0]), 0.2, np.diag([*turns, 0.0, 1e-6]))
    out = np.diagonal(incident(face, kind, np.zeros(3)).covariance)[-1]
    assert out == pytest.approx(1e-6 + 0.5 * sum(turns) * (0.5 * LENGTH_M) ** 2)
