"""Motion along a curved surface is none of the six contacts, and is not reported as free."""

import numpy as np
import pytest

from contact_tracker.geometry.elements import Origins, Plane
from contact_tracker.map.map import EMPTY_MAP, Accuracy, Map, NamedElement, known_to
from contact_tracker.motion.pose_validation import gate
from contact_tracker.motion.window import window_of
from contact_tracker.states import CONTACTS, Contact
from contact_tracker.tracking import segment_fit
from contact_tracker.tracking.ambiguity import most_beside
from contact_tracker.tracking.offline_smoother import segment
from contact_tracker.tracking.segment_fit import SegmentTicks, fit_segment
from contact_tracker.wrenches.contact_evidence import WindowEvidence
from pose_filter import forward
from restricted_motions import MOTIONS, poses_of, tilted_mug
from short_recordings import MODEL, needs_kernels

FREE = Contact.FREE.column


@needs_kernels
def test_a_rolling_disc_is_not_surely_free():
    """Its rim is hard to find in most pieces of the motion."""
    poses = gate(poses_of(MOTIONS["disc of 0.1 m that rolls on a face"], np.random.default_rng(1), 12.0))
    segmentation = segment(poses, MODEL)
    assert np.mean(segmentation.beliefs.probability[20:, FREE] > 0.9) < 0.15
    assert any(set(one.inseparable) == set(CONTACTS) for one in segmentation.segments)


@needs_kernels
def test_curved_motion_is_tested_before_wrenches_decide(monkeypatch):
    monkeypatch.setattr(segment_fit, "curved_probabilities", lambda window, *_: np.full(len(window), 0.99))
    poses = gate(poses_of(MOTIONS["free"], np.random.default_rng(1), 3.0))
    window = window_of([one.tick for one in forward(poses, MODEL)], MODEL)

    def fitted(*nats):
        """With this log evidence of wrenches by state."""
        evidence = WindowEvidence(np.array(nats), {}) if nats else None
        ticks = SegmentTicks(window, Contact.FREE, MODEL, EMPTY_MAP, Origins.zero(), evidence)
        return fit_segment(ticks)

    assert set(fitted().inseparable) == set(CONTACTS)
    touching = fitted(0.0, 0.0, 0.0, 40.0, 39.0, 0.0, -40.0)
    assert touching.contact is Contact.VF
    assert touching.inseparable == (Contact.FV,)
    assert touching.geometry is None
    apart = fitted(*[-40.0] * 6, 0.0)
    assert apart.contact is Contact.FREE
    assert apart.inseparable == ()
    assert apart.share[FREE] > 0.9


@needs_kernels
@pytest.mark.parametrize("with_map", [False, True])
def test_where_some_contacts_cannot_be_curved_motion_is_any_of_the_others(with_map):
    """With one face as surroundings, free motion is open to all contacts with it."""
    face = known_to(Plane(np.array([0.0, 0.0, 1.0]), -0.6), Accuracy())
    table = Map(listed_environment=(NamedElement("table", face),), environment_complete=True)
    known_map = table if with_map else EMPTY_MAP
    possible = {Contact.FF, Contact.EF, Contact.VF} if with_map else set(CONTACTS)
    assert not with_map or set(known_map.allowed) == possible
    poses = gate(poses_of(MOTIONS["vertex on a sphere of 0.2 m"], np.random.default_rng(1), 8.0))
    segmentation = segment(poses, MODEL, known_map=known_map)
    longest = max(segmentation.segments, key=lambda one: one.end_ns - one.start_ns)
    assert longest.contact is Contact.FREE
    assert set(longest.inseparable) == possible
    assert longest.probability < most_beside(len(possible)) + 1e-8
    limit = most_beside(len(possible)) + 1e-8 if with_map else 0.9
    assert segmentation.filtered.probability[-20:, FREE].max() < limit
    assert segmentation.beliefs.probability.sum(axis=1) == pytest.approx(1.0)
    impossible = [contact.column for contact in CONTACTS if contact not in possible]
    assert not segmentation.beliefs.probability[:, impossible].any()


@needs_kernels
def test_of_a_mug_tilted_on_the_rim_of_its_bottom_nothing_is_sure():
    """The faces that touched before show the directions of the rim's axis and of its plane."""
    poses = gate(poses_of(tilted_mug, np.random.default_rng(1), 16.0))
    probability = segment(poses, MODEL).beliefs.probability
    assert np.mean(probability[70:].max(axis=1) > 0.8) < 0.05
    assert np.mean(probability[10:50, Contact.FF.column] > 0.8) > 0.9


@needs_kernels
def test_free_motion_is_free():
    segmentation = segment(gate(poses_of(MOTIONS["free"], np.random.default_rng(1), 10.0)), MODEL)
    longest = max(segmentation.segments, key=lambda one: one.end_ns - one.start_ns)
    assert longest.contact is Contact.FREE
    assert longest.inseparable == ()
    assert longest.probability > 0.9
