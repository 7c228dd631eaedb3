"""Oracles of the identifiability benchmark, and the classes of errors."""

from dataclasses import replace
from functools import cache
from itertools import product

import numpy as np
import pytest

import geometry
import identifiability
import oracle
import tracking
from contact_tracker.ground_truth import Truth, TruthInterval
from contact_tracker.states import STATES, Contact
from contact_tracker.tracking.belief import Segment
from contact_tracker.tracking.segmentation import Beliefs
from contact_tracker_lab.evaluation.metrics import tally
from contact_tracker_lab.evaluation.scoring import Subset, scoring
from identifiability_tables import Class, Mistake
from resampling import Phases
from short_recordings import FACE_TO_EDGE, MODEL, recorded

SECOND = 1_000_000_000


@cache
def tracked_and_oracles():
    """f-f, then e-f: poses, truth, result of the tracker, phases and results of the oracles."""
    simulated = recorded(FACE_TO_EDGE)
    poses = simulated.poses[:1200]
    tracked = tracking.track(poses, MODEL)
    true = oracle.phases(simulated.truth)
    return poses, simulated.truth, tracked, true, oracle.evaluate(true, tracked, poses.position_m[0], MODEL)


def test_every_oracle_names_the_true_contact() -> None:
    *_, true, oracles = tracked_and_oracles()
    right = [phase.contact.column for phase in true]
    assert {o: label.tolist() for o, label in oracles.label.items()} == dict.fromkeys(oracle.ORACLES, right)
    # true elements fit as well as fitted ones, and have no complexity
    given, fitted = (e[range(len(right)), right] for e in (oracles.given, oracles.evidence))
    assert (given > fitted + 1.0).all()
    assert (given < fitted + 20.0).all()


def test_wrong_elements_do_not_help() -> None:
    poses, _, tracked, true, oracles = tracked_and_oracles()
    moved = oracle.evaluate(true, tracked, poses.position_m[0] + 0.01, MODEL)
    right = [phase.contact.column for phase in true]
    assert (moved.given[range(2), right] < oracles.given[range(2), right] - 100.0).all()
    np.testing.assert_allclose(moved.evidence, oracles.evidence, atol=0.5)  # of fitted contacts


def test_intervals_with_the_same_elements_are_one_phase() -> None:
    simulated = recorded(FACE_TO_EDGE)
    first, second = oracle.phases(simulated.truth)
    middle = (first.start_ns + first.end_ns) // 2
    begin, *rest = simulated.truth.intervals
    parts = replace(begin, end_ns=middle, motion="rest"), replace(begin, start_ns=middle + 1)
    unknown = TruthInterval(begin.end_ns, begin.end_ns, None)
    split = Truth((*parts, unknown, *rest))
    assert [(p.start_ns, p.end_ns, p.contact) for p in oracle.phases(split)] == [
        (p.start_ns, p.end_ns, p.contact) for p in (first, second)
    ]


def test_each_mistake_has_one_class() -> None:
    """The tracker's labels replaced by e-f throughout: all of f-f is wrong."""
    poses, truth, tracked, true, oracles = tracked_and_oracles()
    found = tracked.segmentation
    wrong = Beliefs.of(replace(b, contact=Contact.EF) for b in found.beliefs)
    altered = tracked._replace(segmentation=replace(found, beliefs=wrong))
    scored = scoring(poses.stamp_ns, truth)
    compared = identifiability.compare("short", poses, scored, true, altered, oracles, MODEL)
    (mistake,) = compared.mistakes
    lasted_s = scored.seconds[scored.truth == Contact.FF.column].sum()
    assert mistake.near_s == pytest.approx(0.25, abs=0.02)
    assert mistake.near_s + mistake.clear_s == pytest.approx(lasted_s)
    assert (mistake.true, mistake.taken, mistake.reason()) == (Contact.FF, Contact.EF, Class.OWN)
    assert not mistake.beside
    margin = oracles.evidence[0, Contact.FF.column] - oracles.evidence[0, Contact.EF.column]
    assert mistake.fitted == pytest.approx(margin, abs=5.0)  # the same ticks except at one end
    assert mistake.known > mistake.fitted > 3.0
    confusion_s = compared.confusion_s[tracking.NAME]
    assert confusion_s[0, 1] == pytest.approx(lasted_s)
    assert np.trace(compared.confusion_s["given"]) == pytest.approx(confusion_s.sum())


def test_each_interval_of_wrong_labels_is_classified_separately() -> None:
    """Two wrong intervals in one phase, the second with two labels: evidence is of these ticks only."""
    poses, truth, tracked, true, oracles = tracked_and_oracles()
    found = tracked.segmentation
    labels = [b.contact for b in found.beliefs]
    labels[10:13] = [Contact.EF] * 3
    labels[16:22] = [Contact.FREE] * 3 + [Contact.VF] * 3
    wrong = Beliefs.of(replace(b, contact=c) for b, c in zip(found.beliefs, labels, strict=True))
    altered = tracked._replace(segmentation=replace(found, beliefs=wrong))
    scored = scoring(poses.stamp_ns, truth)
    compared = identifiability.compare("short", poses, scored, true, altered, oracles, MODEL)
    first, second = (m for m in compared.mistakes if m.clear_s > 0.1)
    assert (first.taken, first.seconds) == (Contact.EF, pytest.approx(0.3, abs=0.01))
    assert second.seconds == pytest.approx(0.6, abs=0.01)
    assert first.beside
    assert second.beside
    span = int(tracked.start_ns[16]), int(tracked.stamp_ns[21])
    v_f = oracle.evidence_within(int(tracked.start_ns[19]), span[1], tracked, MODEL)[Contact.VF.column]
    f_f = oracle.evidence_within(*span, tracked, MODEL)[Contact.FF.column]
    assert second.fitted == pytest.approx(f_f - v_f)  # free motion has no evidence
    path = np.array([c.column for c in labels])
    corrected = path.copy()
    corrected[16:22] = Contact.FF.column
    prior = oracle.log_prior(corrected, tracked.window, MODEL) - oracle.log_prior(path, tracked.window, MODEL)
    assert second.prior == pytest.approx(prior)
    assert prior > 5.0, "two changes less"


def test_prior_probabilities_of_all_paths_add_up_to_one() -> None:
    *_, tracked, _, _ = tracked_and_oracles()
    window = tracked.window.cut(10, 13)
    log_prior = [oracle.log_prior(np.array(path), window, MODEL) for path in product(range(7), repeat=3)]
    assert np.exp(log_prior).sum() == pytest.approx(1.0)
    lasting = oracle.log_prior(np.zeros(3, np.int64), window, MODEL)
    assert lasting > max(oracle.log_prior(np.array(path), window, MODEL) for path in ([0, 0, 1], [0, 1, 0]))


def mistake(
    oracles: Contact = Contact.EF,
    fitted: float = 9.0,
    clear_s: float = 1.25,
    prior: float = -5.0,
    true: Contact = Contact.EF,
    beside: bool = False,
) -> Mistake:
    return Mistake(
        recording="some_00",
        rate_hz=200.0,
        sigma_mm=0.3,
        start_s=1.0,
        end_s=2.5,
        phase_s=3.0,
        true=true,
        taken=Contact.EE,
        near_s=0.25,
        clear_s=clear_s,
        oracles={"fitted": oracles, "given": true, "rule": oracles},
        beside=beside,
        fitted=fitted,
        known=15.0,
        prior=prior,
    )


def test_mistakes_are_classified_by_the_probability_of_the_truth_as_label() -> None:
    assert [m.log_odds() for m in (mistake(), mistake(fitted=-3.0), mistake(beside=True))] == [
        4.0,
        -8.0,
        10.0,
    ]
    assert mistake().log_odds(known=True) == 10.0
    mistakes = mistake(), mistake(prior=-7.0), mistake(prior=-9.5), mistake(prior=-9.5, beside=True)
    assert [m.reason() for m in mistakes] == [Class.OWN, Class.TIE, Class.LESS, Class.OWN]
    assert {m.reason(known=True) for m in (*mistakes, mistake(oracles=Contact.EE))} == {Class.OWN}


# --- intervals -------------------------------------------------------------------------------------------


def scored_phases(seed: int, phases: int):
    """Phases of 1 s, every second one f-f, each labelled right or wrong as a whole with probability 0.9."""
    rng = np.random.default_rng(seed)
    column = np.arange(phases) % 2
    ends = (1 + np.arange(phases)) * SECOND
    truth = Truth(
        tuple(
            TruthInterval(int(e - SECOND), int(e) - 1, STATES[c]) for c, e in zip(column, ends, strict=True)
        )
    )
    scored = scoring(np.arange(0, int(ends[-1]), SECOND // 20, dtype=np.int64), truth)
    label = np.where(rng.random(phases) < 0.7, column, 2)
    probability = np.full((phases, 7), 0.1 / 6)
    probability[np.arange(phases), label] = 0.9
    return scored, (np.repeat(np.arange(phases), 20), label, probability)


def test_phases_add_up_to_the_tally() -> None:
    scored, answer = scored_phases(1, 30)
    whole, parts = tally(scored, *answer), Phases.of(scored, *answer)
    assert len(parts.label_s) == 30
    np.testing.assert_allclose(parts.belief_s.sum(axis=0), whole.calibration, atol=1e-9)
    assert parts.label_s[:, 1].sum() / parts.label_s[:, 0].sum() == pytest.approx(whole.accuracy())


def test_intervals_have_the_width_of_a_binomial_share() -> None:
    """The standard deviation of a share p of n phases is sqrt(p (1 - p) / n)."""
    for phases in (30, 270):
        scored, answer = scored_phases(2, phases)
        whole, parts = tally(scored, *answer), Phases.of(scored, *answer)
        p = whole.accuracy()
        low, high = parts.accuracy()
        width = 2 * 1.645 * np.sqrt(p * (1 - p) / phases)
        assert high - low == pytest.approx(width, rel=0.15)
        assert low < p < high
        low, high = parts.calibration_error()
        assert high - low == pytest.approx(width, rel=0.25)
        assert low < whole.calibration_error < high
    twice = parts + parts
    assert twice.accuracy()[1] - twice.accuracy()[0] == pytest.approx(width / np.sqrt(2), rel=0.15)


def test_the_calibration_error_of_exact_probabilities_is_that_of_a_binomial_share() -> None:
    """One bin with p = 0.9: mean absolute deviation, and its 95 % quantile."""
    scored, answer = scored_phases(4, 270)
    sigma = np.sqrt(0.9 * 0.1 / 270)
    expected = np.sqrt(2 / np.pi) * sigma, 1.96 * sigma
    assert Phases.of(scored, *answer).calibration_error_if_exact() == pytest.approx(expected, rel=0.1)


def test_without_phases_there_is_no_interval() -> None:
    scored, answer = scored_phases(3, 4)
    nothing = Phases.of(scored.within(Subset.AMBIGUOUS), *answer)
    bands = nothing.accuracy(), nothing.calibration_error(), nothing.calibration_error_if_exact()
    assert np.isnan(bands).all()


# --- covariances -----------------------------------------------------------------------------------------


def test_only_segments_that_are_mostly_right_have_true_elements() -> None:
    scored, _ = scored_phases(4, 4)  # f-f, e-f, f-f, e-f, 1 s each
    spans = [(0.0, 1.4), (0.4, 1.9), (1.4, 2.9), (5.0, 6.0)]
    segments = [Segment(round(a * SECOND), round(b * SECOND), Contact.FF, 1.0, None) for a, b in spans]
    assert geometry.correctly_labelled(segments, scored) == [segments[0], segments[2]]
