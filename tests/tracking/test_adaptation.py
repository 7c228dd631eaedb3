"""Adaptation to the stream: length of ticks, and the noise of a tick by evidence."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from itertools import pairwise
from typing import Final

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter1d
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

import as_values
from contact_tracker import segmenting
from contact_tracker.arrays import Array
from contact_tracker.geometry.lifted_pose import T
from contact_tracker.motion.pose_validation import LONGEST_WAIT_NS, PoseGate
from contact_tracker.motion.poses import Poses
from contact_tracker.motion.tick_averaging import tick_variances
from contact_tracker.recording import read_truth
from contact_tracker.segmenting import OfflineTracker
from contact_tracker.states import STATES, Contact
from contact_tracker.tracker import Tracker
from contact_tracker.tracking.ambiguity import at_most
from contact_tracker.tracking.belief import Belief, Detail
from contact_tracker.tracking.contact_filter import ticks_of
from contact_tracker.tracking.filter_bank import (
    LASTING_TICKS,
    RATE_POSES,
    RATIO_POSES,
    SPAN_TICKS,
    is_moving,
    mixed_with_uniform,
    mixture,
    period_for_all_s,
    with_ticks_for,
)
from contact_tracker.tracking.noise_choice import NO_RESTS, RestScatter, are_kept
from contact_tracker.tracking.offline_smoother import segment
from contact_tracker.tracking.segmentation import Segmentation
from contact_tracker.tracking.transition_model import log_initial, tick_transitions
from contact_tracker_lab.evaluation.evaluate import evaluate
from contact_tracker_lab.simulate import simulate
from distortions import exponential, interpolated, low_pass, moving_average, thinned, turned
from pose_filter import forward
from short_recordings import EDGE_TO_EDGES, FACE_TO_EDGE, MODEL, SHIPPED, needs_kernels, recorded, shipped
from smooth_motion import moving, unturned, with_noise
from whole_trellis import RecordedPass, smooth

PAPER = "paper_experiment"
AUTOCORRELATION = np.exp(-0.005 / 2.0)
"""From pose to pose at 200 Hz, of an error with a correlation time of 2 s."""


def accuracies(poses: Poses, found) -> tuple[float, float]:
    truth = read_truth(str(SHIPPED / "paper_experiment.mcap"))
    scores = evaluate(poses, truth, found)
    return scores.offline.accuracy(), scores.online.accuracy()


@pytest.mark.long
@needs_kernels
def test_contacts_are_found_in_poses_that_were_filtered() -> None:
    """The noise estimated from third differences is much too small, so that contacts do not fit."""
    poses = interpolated(shipped(PAPER))
    offline, online = accuracies(poses, segmenting.segment(poses, MODEL))
    assert offline > 0.95
    assert online > 0.8
    without_adaptation, _ = accuracies(poses, segment(poses, MODEL))
    assert without_adaptation < 0.7


FILTERS: Final[dict[str, tuple[Callable[[Poses], Poses], bool]]] = {
    "none": (lambda poses: poses, False),
    "average of 3": (lambda poses: moving_average(poses, 3), True),
    "first order": (lambda poses: exponential(poses, 0.3), True),
    "interpolated": (interpolated, True),
}


@needs_kernels
@pytest.mark.parametrize(("distort", "is_filtered"), FILTERS.values(), ids=FILTERS)
def test_poses_look_filtered_once_the_least_noise_of_a_tick_is_excluded(
    distort: Callable[[Poses], Poses], is_filtered: bool
) -> None:
    state, _ = as_values.advance(as_values.start(MODEL), distort(shipped(PAPER)[1000:3000]), Detail.WEIGHTS)
    assert [finding.kind for finding in state.findings] == ["filtered"] * is_filtered
    assert not any(finding.doubts_labels for finding in state.findings)


@pytest.mark.long
@needs_kernels
def test_a_contact_that_changes_in_a_long_gap_does_so_in_its_middle() -> None:
    """From e-f to v-f after 20 s; neither is fitted to poses of the other. The gap has rows of its own."""
    gap_s, poses = (19.0, 26.0), shipped(PAPER)[1000:7000]  # f-f, e-f and v-f
    whole = segmenting.segment(poses, MODEL)
    time_s = (poses.stamp_ns - poses.stamp_ns[0]) / 1e9
    segmentation = segmenting.segment(poses[(time_s < gap_s[0]) | (time_s > gap_s[1])], MODEL)
    contacts = [one.contact for one in segmentation.segments]
    assert contacts == [Contact.FF, Contact.EF, Contact.VF, Contact.VF, Contact.VF]
    assert [len(one.inseparable) for one in segmentation.segments] == [0, 0, 0, 6, 0]
    for one, other in zip(segmentation.segments[1:3], whole.segments[1:3], strict=True):
        assert np.linalg.norm(one.geometry.object.point_m - other.geometry.object.point_m) < 0.004
    change_s = (segmentation.segments[2].start_ns - poses.stamp_ns[0]) / 1e9
    assert gap_s[0] - 0.5 < change_s < gap_s[1]  # the ticks before it fit both
    stamps_s = (segmentation.beliefs.stamp_ns - poses.stamp_ns[0]) / 1e9
    inside = (stamps_s > gap_s[0] + 0.2) & (stamps_s < min(gap_s[1], gap_s[0] + 5.0) - 0.2)
    p_first, p_second = segmentation.beliefs.probability[inside][:, [Contact.EF.column, Contact.VF.column]].T
    assert p_first[0] > 0.35 > 0.3 > p_first[-1]
    assert p_second[0] < 0.65 < 0.7 < p_second[-1]


@pytest.mark.long
@needs_kernels
def test_a_long_rest_does_not_count_as_motion() -> None:
    """Filtered noise sometimes exceeds the threshold of motion; over 20 s that must not add up."""
    rest = 20 * 200
    poses = low_pass(after_rest(shipped(PAPER)[:3000], 20.0), 20.0)
    state, _ = as_values.advance(as_values.start(MODEL), poses[:rest], Detail.WEIGHTS)
    assert state.filters.moved_s < 0.2
    _, beliefs = as_values.advance(state, poses[rest:], Detail.WEIGHTS)
    moving = [belief.contact for belief in beliefs if belief.stamp_ns > shipped(PAPER).stamp_ns[1000]]
    assert np.mean([contact is Contact.FF for contact in moving]) > 0.75


def test_the_calmest_rest_shows_which_noise_is_too_large() -> None:
    """A hand that holds the object nearly still moves it more than noise does; it is no noise."""
    rest = [tick for tick in ticks_of([after_rest(shipped(PAPER)[:2], 3.0)[:-2]], MODEL) if tick.count]
    variance = float(np.prod(tick_variances(rest[-1].noise, np.array(20.0), MODEL)) ** 0.5)

    def scatter_of(size: float) -> RestScatter:
        scatter, rng = NO_RESTS, np.random.default_rng(1)
        for tick in rest:
            trembling = tick.zeta + size * rng.normal(size=tick.zeta.shape)
            scatter = scatter.append(replace(tick, zeta=trembling), moves=False)
        return scatter

    scales = np.array([[1.0, 1.0], [4.0, 4.0], [8.0, 8.0]]) ** 2 * variance
    assert scatter_of(0.0).allows(scales).tolist() == [True, True, False]
    held = RestScatter(least=scatter_of(0.0).least)
    for tick in rest:  # later, in a hand
        held = held.append(replace(tick, zeta=tick.zeta + 1e-2 * (tick.start_ns % 7)), moves=False)
    assert held.least == scatter_of(0.0).least
    assert scatter_of(1e-2).allows(scales).all()
    for same in (
        NO_RESTS.append(rest[0], moves=False).append(rest[0], moves=False),
        NO_RESTS.append(rest[0], True),
    ):
        assert same.allows(scales).all(), "equal poses and motion show nothing"


def after_rest(poses: Poses, rest_s: float) -> Poses:
    """The same motion after a rest at its first pose, with the same noise."""
    rng, rate_hz = np.random.default_rng(1), 1e9 / float(np.median(np.diff(poses.stamp_ns)))
    count = int(rest_s * rate_hz)
    still = Poses(
        poses.stamp_ns[0] + np.rint(np.arange(-count, 0) * 1e9 / rate_hz).astype(np.int64),
        poses.position_m[0] + 3e-4 * rng.normal(size=(count, 3)),
        np.tile(poses.quat_xyzw[0], (count, 1)),
    )
    quat = turned(still, 2.6e-3 * rng.normal(size=(count, 3)))
    sign = np.sign((quat * still.quat_xyzw).sum(axis=1, keepdims=True))
    return Poses.join([replace(still, quat_xyzw=quat * sign), poses])


@cache
def at_once(lag_s: float) -> tuple[Poses, Tracker, list[Belief]]:
    poses = moving_average(recorded(FACE_TO_EDGE).poses, 3)[:400]
    return poses, *as_values.advance(as_values.start(MODEL, lag_s), poses)


@settings(max_examples=3)
@given(st.lists(st.integers(1, 150), min_size=1, max_size=30), st.sampled_from([0.0, 0.5]))
def test_beliefs_do_not_depend_on_how_poses_are_split(sizes: list[int], lag_s: float) -> None:
    poses, whole, expected = at_once(lag_s)
    state, beliefs = as_values.start(MODEL, lag_s), []
    edges = [0, *np.minimum(np.cumsum(sizes), len(poses)).tolist(), len(poses)]
    for first, end in pairwise(edges):
        if end > first:
            some = poses[first:end]
            state, new = as_values.advance(state, next(iter(some)) if end == first + 1 else some)
            beliefs += new
    assert [b.stamp_ns for b in beliefs] == [b.stamp_ns for b in expected]
    for one, other in zip(beliefs, expected, strict=True):
        assert one.contact is other.contact
        assert one.probability == pytest.approx(other.probability, abs=1e-12)
    assert state.filters.log_weight == pytest.approx(whole.filters.log_weight, abs=1e-9)


def test_a_stream_may_end_before_its_rate_is_known_and_continue_after_its_end() -> None:
    poses = recorded(FACE_TO_EDGE).poses
    for count in (1, 2, RATE_POSES - 1, RATE_POSES, RATIO_POSES - 1, RATIO_POSES, 200):
        state, beliefs = as_values.advance(as_values.start(MODEL), poses[:count])
        state, rest = as_values.finish(state)
        assert [*beliefs, *rest][-1].stamp_ns == poses.stamp_ns[count - 1]
        state, more = as_values.advance(state, poses[300:400])
        assert more
        assert min(b.stamp_ns for b in more) > poses.stamp_ns[count - 1]
    assert as_values.finish(as_values.start(MODEL))[1] == []
    assert as_values.start(MODEL).report is None


@pytest.mark.parametrize("lag_s", [0.0, 0.2])
def test_no_tick_is_answered_twice_where_the_other_filters_begin(lag_s: float) -> None:
    """Ticks that were complete before their last pose was used are closed already."""
    poses = recorded(FACE_TO_EDGE).poses
    for count in (20, 40, RATIO_POSES - 1, RATIO_POSES + 10):
        gate, state, beliefs = PoseGate(), Tracker.start(MODEL, lag_s), list[Belief]()
        for pose in poses[:count]:
            beliefs += state.update(gate.arrive(pose))
        beliefs += [*state.update(gate.end()), *state.finish()]
        stamps_ns = [one.stamp_ns for one in beliefs]
        assert stamps_ns == sorted(set(stamps_ns))
        assert stamps_ns[-1] == poses.stamp_ns[count - 1]


def test_evidence_is_that_of_all_paths() -> None:
    """As by smoothing over all hypotheses, except for those that were pruned."""
    whole = RecordedPass()
    for last in forward(recorded(EDGE_TO_EDGES).poses[:700], MODEL):
        whole.note(last)
    steps = np.array([tick_transitions(MODEL, exposed).log_transition for exposed in whole.exposure])
    _, expected = smooth(whole.trellis, log_initial(MODEL), steps)
    assert last.state.log_evidence == pytest.approx(expected, abs=0.05)


@given(st.integers(0, 2**32 - 1), st.floats(1e-6, 1e-2))
def test_noise_of_any_size_is_no_motion(seed: int, sigma: float) -> None:
    rng = np.random.default_rng(seed)
    rest = np.array([[*np.eye(3).ravel(), 0.3, 0.1, 0.2]])
    zeta = np.zeros((200, 25))
    zeta[:, :12] = rest + sigma * rng.normal(size=(200, 12))
    assert np.mean([is_moving(latest(zeta[:i])) for i in range(1, 200)]) < 0.05
    zeta[:, T] += 4.0 * sigma * np.arange(200)[:, None]
    assert np.mean([is_moving(latest(zeta[:i])) for i in range(SPAN_TICKS + LASTING_TICKS, 200)]) > 0.9


def latest(zeta: np.ndarray) -> np.ndarray:
    return zeta[-SPAN_TICKS - LASTING_TICKS :]


@pytest.mark.long
@needs_kernels
def test_correlated_errors_are_found_by_the_evidence() -> None:
    lasting_m, poses, rng = 5e-4, shipped(PAPER), np.random.default_rng(4)
    white = np.sqrt(1.0 - AUTOCORRELATION**2) * rng.normal(size=(len(poses) + 2000, 6))
    errors = lfilter([1.0], [1.0, -AUTOCORRELATION], white, axis=0)
    position, turn = poses.position_m + lasting_m * errors[2000:, :3], 5.0 * lasting_m * errors[2000:, 3:]
    moved = replace(poses, position_m=position, quat_xyzw=turned(poses, turn))
    tracked = OfflineTracker(MODEL)
    segmentation = Segmentation.join(list(tracked.pieces(moved)))
    assert tracked.report.lasting[0] == pytest.approx(lasting_m, rel=0.6)
    offline, _ = accuracies(poses, segmentation)
    assert offline > 0.9


@pytest.mark.long
@needs_kernels
def test_contacts_are_found_in_few_poses() -> None:
    """Differences of such poses are mostly motion; the evidence finds that the noise is smaller."""
    poses = thinned(shipped(PAPER), 5.0, 0.01, np.random.default_rng(5))
    tracked = OfflineTracker(MODEL)
    segmentation = Segmentation.join(list(tracked.pieces(poses)))
    assert accuracies(poses, segmentation)[0] > 0.9
    assert tracked.report.chosen.noise.estimate_share < 1.0


@pytest.mark.parametrize(
    ("rate_hz", "tick_s"), [(200.0, 0.1), (30.0, 0.1), (16.0, 0.1), (10.0, 0.15), (1.0, 1.5), (0.1, 3.0)]
)
def test_a_tick_has_more_than_one_pose(rate_hz: float, tick_s: float) -> None:
    assert with_ticks_for(MODEL, 1.0 / rate_hz).tick_s == pytest.approx(tick_s)
    poses = moving(np.random.default_rng(1), 30.0 / rate_hz, rate_hz, 3e-4, 3e-3)
    state, _ = as_values.finish(as_values.advance(as_values.start(MODEL), poses)[0])
    assert state.best.model.tick_s == pytest.approx(tick_s)


weights = st.lists(st.floats(0.0, 1.0), min_size=7, max_size=7).filter(lambda w: sum(w) > 1e-3)


@given(st.lists(st.tuples(weights, st.floats(-30.0, 0.0)), min_size=1, max_size=5))
def test_a_mixture_is_a_distribution_and_its_label_the_most_probable(trackers) -> None:
    beliefs = []
    for weight, _ in trackers:
        posterior = np.array(weight) / sum(weight)
        label = STATES[int(posterior.argmax())]
        beliefs.append(Belief(5, label, posterior, 3, None, np.full(6, np.nan)))
    both = mixture(beliefs, np.array([log_weight for _, log_weight in trackers]))
    for probability in (both.probability, mixed_with_uniform(both.probability)):
        assert (probability >= 0.0).all()
        assert probability.sum() == pytest.approx(1.0)
    assert both.contact is STATES[int(both.probability.argmax())]
    assert both.onset_ns <= both.stamp_ns
    assert mixed_with_uniform(both.probability).max() < 0.6


def test_what_no_tracker_names_but_is_most_probable_is_not_told_from_the_label() -> None:
    """As when one has spread its probability over f-f, e-f and v-f, and the other over v-f and e-f: the label
    has elements, those of a tracker."""
    one = np.array([0.4, 0.35, 0.0, 0.25, 0.0, 0.0, 0.0])
    other = np.array([0.05, 0.4, 0.0, 0.45, 0.0, 0.1, 0.0])
    beliefs = (
        Belief(5, Contact.FF, one, 3, None, np.full(6, np.nan), inseparable=(Contact.EF, Contact.VF)),
        Belief(5, Contact.VF, other, 3, None, np.full(6, np.nan), inseparable=(Contact.EE,)),
    )
    both = mixture(beliefs, np.zeros(2))
    assert both.contact is Contact.VF
    assert both.inseparable == (Contact.EF, Contact.EE)
    assert both.probability[Contact.VF.column] > both.probability[Contact.EF.column] > 0.2


def test_an_open_formation_limits_the_probability_of_the_mixture() -> None:
    certain = np.full(7, 1e-3)
    certain[Contact.EF.column] = 1.0 - certain[:6].sum()
    limited = at_most(certain, Contact.EF)
    own = Belief(5, Contact.EF, limited, 3, None, np.full(6, np.nan), is_open=True)
    other = Belief(5, Contact.EF, certain, 3, None, np.full(6, np.nan))
    both = mixture((own, other), np.log([0.6, 0.4]))
    assert both.is_open
    assert both.probability[Contact.EF.column] == pytest.approx(0.9)
    rolled = np.roll(certain, Contact.VF.column - Contact.EF.column)
    other = replace(other, contact=Contact.VF, probability=rolled)
    both = mixture((own, other), np.log([0.4, 0.6]))
    assert (both.contact, both.is_open) == (Contact.VF, False)


def test_the_tracker_with_the_best_evidence_remains() -> None:
    state = as_values.start(MODEL)
    for some in moving_average(recorded(FACE_TO_EDGE).poses, 5).batches():
        before, state = state, as_values.advance(state, some)[0]
        if len(before.filters.filters) > 1:
            white = [one.state.model for one in before.filters.filters if not one.state.model.correlation]
            floors = [model.noise.floor_position_m for model in white]
            assert floors == sorted(floors)
    assert state.best.model.noise.floor_position_m > MODEL.noise.floor_position_m
    given = replace(MODEL.with_noise(3e-4, 2.6e-3), name="given")
    known, _ = as_values.advance(as_values.start(given), recorded(FACE_TO_EDGE).poses)
    assert known.is_decided
    assert known.filters.grid.last.noise.sigma_position_m == pytest.approx(3e-4)
    assert given == known.best.model


def test_the_prior_has_an_effect_in_the_first_seconds_only() -> None:
    """The prior favours the second by 12 nats, the evidence is 5 against it, and the third is behind."""
    log_prior = np.array([0.0, 12.0, -2.0])
    log_weight = np.array([10.0, 5.0, -45.0]) + log_prior
    for moved_s, expected in (
        (1.0, [True, True, True]),
        (2.0, [True, True, False]),
        (12.0, [True, True, False]),
        (30.0, [True, False, False]),
    ):
        assert are_kept(log_weight, log_prior, moved_s).tolist() == expected
    more_evidence = log_weight + np.array([8.0, 0.0, 0.0])  # 13 nats against it: both agree
    assert are_kept(more_evidence, log_prior, 9.0).tolist() == [True, True, False]
    assert are_kept(more_evidence, log_prior, 10.0).tolist() == [True, False, False]


@pytest.mark.parametrize(("ahead", "chosen"), [(14.0, 0), (16.0, 1)])
def test_the_price_of_a_tolerance_also_counts_in_the_end(ahead: float, chosen: int) -> None:
    price = np.array([0.0, -15.0])
    assert are_kept(np.array([0.0, ahead - 15.0]), price, 12.0, price).all() == (chosen == 0)
    assert are_kept(np.array([0.0, ahead - 15.0]), price, 30.0, price).argmax() == chosen


def rolling(seed: int) -> Poses:
    """Poses at 60 Hz of a trolley on an uneven floor (20 s), which rises by 2.5 mm and tilts by 0.28 deg
    (standard deviations), as a recorded one does."""
    rng, count, rate_hz = np.random.default_rng(seed), 1200, 60.0

    def wave(time_s: float, size: float) -> Array:
        smooth = gaussian_filter1d(rng.normal(size=count), time_s * rate_hz, mode="wrap")
        return size * smooth / smooth.std()

    tilt = np.radians([wave(0.06, 0.2) + wave(1.0, 0.2) for _ in range(2)])
    yaw, speed = np.cumsum(wave(1.0, 1.0)) / rate_hz, (0.5 + wave(0.5, 0.1)) / rate_hz
    way = np.cumsum(speed * np.cos(yaw)), np.cumsum(speed * np.sin(yaw)), wave(1.5, 2.5e-3)
    turn = Rotation.from_euler("zyx", np.c_[yaw, *tilt]) * Rotation.from_rotvec(
        5e-4 * rng.normal(size=(count, 3))
    )
    position_m = np.transpose(way) + 1e-4 * rng.normal(size=(count, 3))
    return Poses(np.round(np.arange(count) / rate_hz * 1e9).astype(np.int64), position_m, turn.as_quat())


@pytest.mark.long
@needs_kernels
def test_a_trolley_on_an_uneven_floor_is_on_its_face_to_a_tolerance() -> None:
    found = Segmentation.join([*OfflineTracker(MODEL).pieces(rolling(3))])
    assert np.mean([contact is Contact.FF for contact in found.beliefs.contacts]) > 0.9
    longest = max(found.segments, key=lambda segment: segment.end_ns - segment.start_ns)
    assert Contact.FREE not in longest.inseparable  # a machine that never tilts an object is more exact
    within_m, within_rad = longest.tolerance
    assert within_m < 1e-3  # the floor is piecewise flat, as the price of a change allows
    assert within_rad == pytest.approx(np.radians(0.28), rel=0.4)
    exact = Segmentation.join([*OfflineTracker(MODEL).pieces(recorded(FACE_TO_EDGE).poses)])
    assert {segment.tolerance for segment in exact.segments} == {None}


@needs_kernels
def test_noise_of_filtered_poses_at_rest_is_not_taken_for_motion() -> None:
    """In the first five seconds of rest only the prior, that objects rest on faces, determines the label."""
    rest = low_pass(shipped(PAPER)[:1000], 20.0)
    state, beliefs = as_values.advance(as_values.start(MODEL), rest)
    assert not state.is_decided
    assert np.mean([belief.contact is Contact.FF for belief in beliefs]) > 0.7
    without_adaptation = segment(rest, MODEL).filtered
    assert np.mean([contact is Contact.FF for contact in without_adaptation.contacts]) < 0.5


@needs_kernels
def test_offline_smooth_free_motion_at_the_start_is_no_contact() -> None:
    poses = simulate("all_states", 0).poses[:2000]  # free until 5.5 s, then v-f
    segments = segmenting.segment(poses, MODEL).segments
    assert segments[-1].contact is Contact.VF
    first_contact = next(segment for segment in segments if segment.contact is not Contact.FREE)
    assert (first_contact.start_ns - poses.stamp_ns[0]) * 1e-9 > 5.0


@pytest.mark.parametrize("seed", range(4))
def test_ticks_follow_the_mean_period_of_jittered_stamps_without_gaps(seed: int) -> None:
    rows = 20 * np.arange(20) + np.random.default_rng(seed).integers(-6, 7, 20) + 6
    rows[10:] += 200
    state, _ = as_values.advance(as_values.start(MODEL), shipped(PAPER)[rows], Detail.WEIGHTS)
    assert state.filters.filters[0].state.model.tick_s == pytest.approx(0.15, abs=0.008)


def test_ticks_follow_a_lasting_change_of_the_rate() -> None:
    """Ten poses at 2 s spacing before a recording decide nothing; and of a slower rate ticks get longer."""
    poses = recorded(FACE_TO_EDGE).poses
    slow_ns = poses.stamp_ns[0] - 2_000_000_000 * np.arange(10, 0, -1)
    slow_start = Poses.join([replace(poses[:10], stamp_ns=slow_ns), poses])
    state, beliefs = as_values.advance(as_values.start(MODEL), slow_start, Detail.WEIGHTS)
    ticks_ns = np.diff([belief.stamp_ns for belief in beliefs if belief.stamp_ns > poses.stamp_ns[0]])
    assert np.median(ticks_ns[5:]) == pytest.approx(1e8, rel=0.01)
    assert min(ticks_ns) > 0
    assert period_for_all_s(slow_start.stamp_ns, MODEL) == pytest.approx(0.005)
    later_ns = poses.stamp_ns[-1] + 500_000_000 * np.arange(1, 15)
    state, _ = as_values.advance(state, replace(poses[:14], stamp_ns=later_ns), Detail.WEIGHTS)
    assert state.best.model.tick_s == pytest.approx(0.5 * MODEL.poses_per_tick)


@pytest.mark.parametrize("first_s", [0.005, 0.02, 2.0])
def test_answers_do_not_wait_until_the_rate_is_known(first_s: float) -> None:
    """The first tick has an answer when it is over; ticks for the first period, if that is another one, end
    with the poses from which the rate is known."""
    poses, model = recorded(FACE_TO_EDGE).poses[:200], replace(MODEL, tick_s=0.015)
    stamp_ns = poses.stamp_ns + (np.arange(200) > 0) * round((first_s - 0.005) * 1e9)
    state, arrival_ns, beliefs = as_values.start(model), list[int](), list[Belief]()
    for pose in replace(poses, stamp_ns=stamp_ns):
        state, some = as_values.advance(state, pose, Detail.WEIGHTS)
        beliefs += some
        arrival_ns += [pose.stamp_ns] * len(some)
    first_tick_s = max(0.015, with_ticks_for(model, first_s).tick_s)
    assert arrival_ns[0] - stamp_ns[0] <= (first_tick_s + 0.005) * 1e9
    stamps_ns = np.array([belief.stamp_ns for belief in beliefs])
    assert (np.diff(stamps_ns) > 0).all()
    known = stamps_ns > stamp_ns[RATE_POSES]
    assert (np.array(arrival_ns) - stamps_ns)[known].max() == 5_000_000
    assert np.diff(stamps_ns[known]).max() == 15_000_000


def test_ticks_go_out_in_time_while_poses_are_held() -> None:
    """Of a tick whose poses have jumped away no evidence is left; its answer comes a tenth later at most."""
    poses = recorded(FACE_TO_EDGE).poses[:1200]
    away = np.zeros((len(poses), 1))
    away[500:700] = 1.0
    away[900:] = 1.0  # and stay there
    gate, state = PoseGate(), as_values.start(MODEL)
    delays_ns, counts = list[int](), list[float]()
    for pose in replace(poses, position_m=poses.position_m + 0.3 * away):
        arrival = gate.arrive(pose)
        state, beliefs = as_values.take(state, arrival, Detail.WEIGHTS)
        delays_ns += [(arrival.time_ns or 0) - belief.stamp_ns for belief in beliefs]
        best = state.best
        if best is not None and beliefs:
            counts.append(float(best.window.frames[-1]))
    interval_ns = int(poses.stamp_ns[1] - poses.stamp_ns[0])
    assert max(delays_ns[1:]) <= LONGEST_WAIT_NS + 1e8 + interval_ns
    assert min(delays_ns) == 0
    assert counts.count(0.0) >= 18
    assert gate.counts["excursion"] == 200
    assert gate.counts["long_excursion"] == 1


@pytest.mark.long
@needs_kernels
def test_in_bursts_of_poses_the_noise_is_decided_as_well() -> None:
    """Most ticks are in gaps there; those with frames show the motion."""
    rng, time_s = np.random.default_rng(3), np.cumsum(np.tile([0.05, 0.05, 1.0], 220))
    still = np.zeros_like(time_s)
    place = 0.1 * np.array([np.sin(0.5 * time_s), np.cos(0.3 * time_s), 0.2 * np.sin(0.2 * time_s)]).T
    turn = np.array([still, 0.2 * np.sin(0.4 * time_s), 0.3 * np.sin(0.3 * time_s)]).T
    poses = with_noise(rng, time_s, place, Rotation.from_rotvec(turn), 2e-4, 2e-4)
    state, _ = as_values.advance(as_values.start(MODEL), poses[:100])
    assert len(state.filters.filters) > 3
    state, _ = as_values.advance(state, poses[100:])
    assert len(state.filters.filters) < 3
    assert state.filters.moved_s > 5.0


@needs_kernels
def test_poses_too_far_apart_for_any_evidence_are_followed_by_one_tracker() -> None:
    """Hours of poses five seconds apart fit in a small file; none of them decides between trackers."""

    steps = np.random.default_rng(4).normal(size=(300, 3))
    state, _ = as_values.advance(as_values.start(MODEL), unturned(0.01 * np.cumsum(steps, axis=0), 5 * 10**9))
    assert state.is_decided
    assert not state.checks.conventions.mistake
    state, _ = as_values.advance(as_values.start(MODEL), unturned(np.zeros((100, 3)), 1_250_000_000))
    assert len(state.filters.filters) > 3
