"""Births at known elements: likely where they touch, unlikely elsewhere; returning gains nothing."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from contact_tracker.config.loading import load_model
from contact_tracker.contacts import CONTACT_MODELS
from contact_tracker.geometry.elements import Origins
from contact_tracker.geometry.lifted_pose import lift
from contact_tracker.hmm import log_sum_exp
from contact_tracker.hypotheses.births import (
    FREE,
    MOST_BIRTHS,
    propose_births,
    proximity_evidence,
    reweight_transitions,
    share_with_faces,
)
from contact_tracker.hypotheses.evidence import EvidenceParameters
from contact_tracker.map.file import map_from
from contact_tracker.map.pairs import Frame, named_pairs
from contact_tracker.motion.poses import Pose, Poses
from contact_tracker.motion.window import Window
from contact_tracker.states import CONTACTS, STATES, Contact
from contact_tracker.tracking.contact_filter import predict_transitions, ticks_of
from contact_tracker.tracking.transition_model import tick_transitions
from pose_filter import PoseFilter

ACCURACY = {"sigma_position_m": 1e-4, "sigma_rotation_deg": 0.05}
CUBE_M = 0.2
TABLE = {"normal": [0, 0, 1], "offset_m": 0.0, "name": "table", **ACCURACY}
CUBE_ON_TABLE = map_from(
    {
        "environment": {"plane": [TABLE], "complete": True},
        "object": {"box": {"size_m": [CUBE_M] * 3, **ACCURACY}},
    }
)
MODEL = load_model()
SCALES = EvidenceParameters(0.3, 0.1, 0.03, 1.0, 0.1)
ON_EDGE = np.array([[1, 0, 0], [0, 1, -1], [0, 1, 1]]) / np.sqrt([[1], [2], [2]])


def tick(rotation, height_m):
    """One tick of the cube, its middle ``height_m`` over the table."""
    zeta = lift(rotation, np.array([0.3, -0.2, height_m]))
    return Window(np.array([7]), zeta[None], np.array([[1e-8, 1e-6]]), np.zeros((1, 2)))


def proximity(newest, known_map=CUBE_ON_TABLE):
    found = []
    for model in CONTACT_MODELS:
        begins = propose_births(
            model, known_map, None, 0.0, Frame.around(Origins.zero(), newest.zeta[-1, 9:12])
        )
        found.append((named_pairs(known_map, model), proximity_evidence(model, begins, newest, SCALES)))
    return found


def log_odds(rotation, height_m):
    found = proximity(tick(rotation, height_m))
    return {contact: evidence.log_odds for contact, (_, evidence) in zip(CONTACTS, found, strict=True)}


def expected(rotation, height_m, activity=1.0):
    """Log rates of change and of staying for the object at this height."""
    evidence = [m for _, m in proximity(tick(rotation, height_m))]
    return reweighted(*tick_transitions(MODEL, activity), evidence)


def reweighted(change, stay, evidence):
    odds, gain = (np.array([getattr(one, name) for one in evidence]) for name in ("log_odds", "gain"))
    return reweight_transitions(change, stay, odds, gain)


def test_contacts_with_larger_errors_are_possible_at_larger_distances():
    """A rounded corner, a few millimetres over the table, within the error of the contact."""
    corner = Rotation.align_vectors([[0, 0, -1]], [[1, 1, 1]])[0].as_quat()
    height_m = CUBE_M * np.sqrt(0.75) + 3e-3
    poses = [Pose(i * 10**8, (0.3, -0.2, height_m), tuple(corner.tolist())) for i in range(2)]
    one = PoseFilter(MODEL, known_map=CUBE_ON_TABLE)
    for pose in poses:
        one.update(pose)
    state = one.state
    loose = replace(MODEL, noise=replace(MODEL.noise, contact_position_m=(0, 0, 0, 3e-3, 0, 0, 0)))
    newest = next(ticks_of([Poses.collect(poses)], MODEL))
    before, after = (
        predict_transitions(state._replace(model=model), newest, state.window).log_transition[FREE]
        for model in (MODEL, loose)
    )
    assert after[Contact.VF.column] > before[Contact.VF.column] + 1.0


@pytest.mark.parametrize("height_m", [0.1, 0.1003, 0.15])
def test_probabilities_add_up_to_one(height_m):
    change, stay = expected(np.eye(3), height_m)
    for i in range(len(STATES)):
        kept = -np.inf if i == FREE else stay[i]
        assert np.logaddexp(log_sum_exp(change[i]), kept) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("contact", CONTACTS)
def test_uncertain_elements_count_by_the_errors_of_their_residuals(contact):
    """The noise that the log odds of one pair imply is the spread over drawn elements."""
    model, rng = CONTACT_MODELS[contact.column], np.random.default_rng(3)
    side = {
        "plane": [{"normal": [0, 0, 1], "offset_m": 0.1, "sigma_position_m": 0.02, "sigma_rotation_deg": 2}],
        "line": [{"direction": [0, 1, 0], "point_m": [0.2, 0, 0.1], "sigma_position_m": 0.02}],
        "point": [{"point_m": [0.1, 0.2, 0.05], "sigma_position_m": 0.02}],
    }
    known_map = map_from({"object": {**side, "complete": True}, "environment": {**side, "complete": True}})
    newest = tick(Rotation.from_rotvec([0.3, 0.4, 0.2]).as_matrix(), 0.2)
    begins = propose_births(model, known_map, None, 0.0, Frame.around(Origins.zero(), newest.zeta[-1, 9:12]))
    gain = proximity_evidence(model, begins, newest, SCALES).gain
    rows = begins.rows
    tangent = model.family.tangent(rows.prior_mean, np.nan_to_num(rows.line_anchor))[0]
    covariance = np.linalg.inv(tangent.T @ rows.prior_information[0] @ tangent)
    drawn = (
        rows.prior_mean[0]
        + rng.multivariate_normal(np.zeros(len(covariance)), covariance, 40_000) @ tangent.T
    )
    spread = model.measure(drawn, newest.zeta[-1:]).residual[:, :, 0].var(axis=0)
    expected = 0.5 * np.log1p(np.array([1.0 / 3.0] * (len(spread) - 1) + [SCALES.reach_m**2]) / spread)
    sine_counts_as_certain = contact is Contact.EE
    assert gain[1] == pytest.approx(expected[-1], abs=0.1 if sine_counts_as_certain else 0.03)
    if len(spread) > 1:
        assert gain[0] == pytest.approx(expected[:-1].mean(), abs=0.03)


def test_of_many_pairs_the_most_probable_begin():
    """Of 150 known vertices at the table, and the unknown ones."""
    heights_m = CUBE_M / 2 * (1.0 + 0.001 * np.arange(150))
    points = [{"point_m": [0.0, 0.0, -height_m]} for height_m in heights_m]
    known_map = map_from({"environment": {"plane": [TABLE]}, "object": {"point": points}})
    pairs, evidence = proximity(tick(np.eye(3), CUBE_M / 2), known_map)[Contact.VF.column]
    kept = evidence.proposals
    certain = kept.rows.elements_known
    assert certain.sum() == MOST_BIRTHS
    known = [number for number, pair in enumerate(pairs) if pair.is_certain]
    assert kept.rows.known_pair_index[certain].tolist() == known[:MOST_BIRTHS]  # the nearest ones
    assert (~certain).sum() == sum(not pair.is_certain for pair in pairs) > 0
    assert log_sum_exp(kept.log_share) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("sigma_position_m", [1e-6, 1.0])
@pytest.mark.parametrize("sigma_rotation_deg", [1e-4, 60.0])
def test_all_standard_deviations_that_are_allowed_can_be_compared(sigma_position_m, sigma_rotation_deg):
    sigma = {"sigma_position_m": sigma_position_m, "sigma_rotation_deg": sigma_rotation_deg}
    for away_m in (0.0, 1e6):
        box = {"size_m": [0.1, 0.2, 0.3], "position_m": [away_m, 0.0, 0.0], **sigma}
        known = map_from({"environment": {"box": [box]}, "object": {"box": [box]}})
        for _, evidence in proximity(tick(ON_EDGE, 0.1), known):
            assert np.isfinite(evidence.log_odds)
            assert np.exp(evidence.log_share).sum() == pytest.approx(1.0)


def test_a_new_face_may_lie_in_a_plane_in_which_a_known_edge_lies_unless_faces_cannot_occur():
    """Coming from that edge, what both constrain is no evidence any more."""
    gain = np.full((6, 2), 4.0)
    odds = np.array([0.0, 8.0, 0.0, 3.0, 0.0, 0.0])
    faces, shown = share_with_faces(odds, gain, 0.5)
    np.testing.assert_allclose(faces, [8.0 + np.log(0.5), *odds[1:]])
    change, stay = tick_transitions(MODEL, 1.0)
    moved, _ = reweight_transitions(change, stay, faces, shown)
    by_odds, _ = reweight_transitions(change, stay, odds, gain)
    assert moved[FREE, 0] > by_odds[FREE, 0] + 4.0
    assert moved[Contact.EF.column, 0] == pytest.approx(change[Contact.EF.column, 0], abs=1.0)
    crossing = np.array([0.0] * 5 + [8.0])  # known edges that cross lie in no common plane
    np.testing.assert_array_equal(share_with_faces(crossing, gain, 0.5)[0], crossing)
    nowhere = np.array([-1e3, *odds[1:]])
    np.testing.assert_array_equal(share_with_faces(nowhere, gain, 0.5)[0], nowhere)
    np.testing.assert_array_equal(share_with_faces(np.zeros(6), gain, 0.5)[0], np.zeros(6))
