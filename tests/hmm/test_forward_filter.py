"""Incremental Viterbi and smoothing against all paths, against those of the whole recording, and in long
streams."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from contact_tracker import hmm
from contact_tracker.hmm.forward_filter import ForwardFilter, ForwardMessage
from contact_tracker.hmm.smoother import OpenTicks
from trellis_cases import Case
from whole_trellis import Trellis, smooth

TOLERANCE = 1e-6
seeds = st.integers(0, 2**32 - 1)


def run(steps, log_initial, every, tolerance=TOLERANCE):
    """Inference with a release of decided ticks every ``every`` ticks: path, posterior, and the numbers of
    ticks whose posterior and path are released after each. A step of None is skipped."""
    forward, past, survivors = hmm.ForwardFilter(log_initial), hmm.OpenTicks(), hmm.Survivors()
    path, posterior, released = [], [], []
    for tick, step in enumerate(steps, start=1):
        if step is None:
            for each in (forward, past, survivors):
                each.skip()
        else:
            message = forward.advance(*step)
            past.append(message)
            survivors.append(message)
        if tick % every == 0:
            probability, certain = past.look_back(forward.frontier, tolerance)
            posterior.append(probability[:certain])
            past.drop(certain)
            path += survivors.decided_prefix(forward.frontier)
            released.append((past.first, survivors.first))
    if len(past):
        posterior.append(past.look_back(forward.frontier, tolerance)[0])
    return path + survivors.finish(forward.frontier), np.concatenate(posterior), released


def steps_of(trellis, log_transition):
    """State, onset and log-likelihood of the hypotheses in each tick, and the change before it."""
    ticks = zip(trellis.alive, trellis.log_likelihood, log_transition, strict=True)
    return [(trellis.state[alive], trellis.onset[alive], value, change) for alive, value, change in ticks]


@settings(max_examples=30, deadline=None)
@given(seed=seeds, every=st.integers(1, 7), scale=st.sampled_from([1.0, 1e4]))
def test_pieces_of_any_trellis_are_those_of_all_paths(seed, every, scale):
    """Also where one path has nearly all the weight; and so is the smoothing of the whole."""
    case = Case(seed)
    case.value *= scale
    paths = case.paths()
    evidence = np.logaddexp.reduce([weight for weight, _ in paths])
    expected = np.zeros((case.ticks, case.states))
    for weight, segments in paths:
        for h, onset, end in segments:
            expected[onset:end, case.state[h]] += np.exp(weight - evidence)
    initial, change = case.model
    path, posterior, _ = run(steps_of(case.trellis, change), initial, every)
    assert path == [(case.state[h], onset, end) for h, onset, end in max(paths)[1]]
    np.testing.assert_allclose(posterior, expected, atol=TOLERANCE)
    of_whole, log_evidence = smooth(case.trellis, *case.model)
    np.testing.assert_allclose(of_whole, expected, atol=1e-9)
    assert log_evidence == pytest.approx(evidence, rel=1e-12, abs=1e-9)


def test_a_hypothesis_that_fell_back_beyond_all_floats_may_still_win():
    """Without noise, log-likelihoods differ by thousands, and later by as much the other way."""
    state, onset = np.array([0, 0, 1, 1, 1, 1]), np.array([0, 2, 0, 1, 2, 3])
    alive = [np.array(rows) for rows in ([0, 2], [0, 3], [0, 1, 4], [0, 1, 5])]
    log_likelihood = [np.array(values) for values in ([0.0, 0.0], [0.0, 0.0], [-2e3, 0.0, 0.0])]
    trellis = Trellis(state, onset, alive, [*log_likelihood, np.array([0.0, -4e3, -4e3])])
    even = np.full(2, np.log(0.5)), np.full((4, 2, 2), np.log(0.5))
    path, posterior, released = run(steps_of(trellis, even[1]), even[0], every=3)
    assert path == [(0, 0, 4)]
    assert released[0] == (0, 0)
    np.testing.assert_allclose(posterior, smooth(trellis, *even)[0], atol=TOLERANCE)


@settings(max_examples=20, deadline=None)
@given(seed=seeds)
@pytest.mark.parametrize("checked", [1, 16])
def test_decided_ticks_are_those_that_no_later_data_can_change(checked, seed):
    """Extreme later data: only one of the hypotheses at the cut survives."""
    case = Case(seed, sizes=((3, 6), (4, 5)), death=0.1, absent=0.0, forbidden=0.0)
    trellis, (initial, change) = case.trellis, case.model
    cut = case.ticks - 1
    forward, past = hmm.ForwardFilter(initial), hmm.OpenTicks()
    for b in range(cut):
        alive = trellis.alive[b]
        past.append(
            forward.advance(trellis.state[alive], trellis.onset[alive], trellis.log_likelihood[b], change[b])
        )
    seen = []
    for h in trellis.alive[cut - 1]:
        likelihood = trellis.log_likelihood[cut - 1][trellis.alive[cut - 1] == h]
        alone = trellis._replace(
            alive=[*trellis.alive[: cut - 1], np.array([h])],
            log_likelihood=[*trellis.log_likelihood[: cut - 1], likelihood],
        )
        seen.append(smooth(alone, initial, change[:cut])[0])
    spread = np.ptp(seen, axis=0).max(axis=1)
    for tolerance in (TOLERANCE, *(spread + 1e-9), *np.maximum(spread - 1e-9, 0.0)):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("contact_tracker.hmm.smoother._CHECK_INTERVAL", checked)
            certain = past.count_decided(forward.frontier, float(tolerance))
        assert certain == int(np.argmax(np.append(spread, np.inf) > tolerance + 1e-12))


def test_hypotheses_may_agree_on_late_ticks_and_differ_on_earlier_ones():
    """State 0 begins at tick 20 after state 1, or at tick 40 after state 2; later ticks are equal."""
    never = np.full((3, 3), -np.inf)
    into_0 = {
        tick: np.where(np.eye(3)[:, [before]] * np.eye(3)[0], 0.0, -np.inf)
        for tick, before in ((20, 1), (40, 2))
    }
    forward, past = hmm.ForwardFilter(np.log(np.full(3, 1 / 3))), hmm.OpenTicks()
    for tick in range(64):
        alive = (
            [(1, 0)] * (tick < 20)
            + [(2, 0)] * (tick < 40)
            + [(0, 20)] * (tick >= 20)
            + [(0, 40)] * (tick >= 40)
        )
        state, onset = np.array(alive).T
        past.append(forward.advance(state, onset, np.zeros(len(alive)), into_0.get(tick, never)))
    posterior, certain = past.look_back(forward.frontier, TOLERANCE)
    assert certain == 0
    np.testing.assert_allclose(posterior[[10, 30, 50]], [[0, 0.5, 0.5], [0.5, 0, 0.5], [1, 0, 0]], atol=1e-12)


def hours(ticks, evidence, rng, states=3):
    """A stream of ticks with ``evidence`` per tick and state; onsets are thinned by age as in the tracker."""
    onset = [np.zeros(0, np.int64) for _ in range(states - 1)]
    for now in range(ticks):
        for i, old in enumerate(onset):
            old = np.append(old, now)
            age = now + 1 - old
            span = 2 ** np.maximum(np.floor(np.log2(age / 10)) + 1, 0).astype(np.int64)
            group = np.where(age <= 10, -old - 1, old // span + (span << 40))
            onset[i] = old[np.unique(group, return_index=True)[1]]
            onset[i].sort()
        state = np.repeat(np.arange(states), [*map(len, onset), 1])
        since = np.concatenate([*onset, [now]])
        value = np.array([*evidence, 0.0])[state] * (now - since) + 0.1 * rng.normal(size=len(since))
        kept = (value + 0.1 >= value.max() - 70.0) | (now - since < 30)
        onset = [since[kept & (state == i)] for i in range(states - 1)]
        yield state[kept], since[kept], np.where(state == states - 1, 0.0, value)[kept]


@pytest.mark.parametrize(("evidence", "certain"), [((0.5, -0.5), True), ((0.0, 0.0), False)])
def test_hypotheses_and_rounding_stay_bounded_for_hours(evidence, certain):
    """In one long contact, and at rest, where no tick is decided and all stay open."""
    rng, ticks = np.random.default_rng(1), 2000
    change = np.log(np.full((3, 3), 0.01))
    forward, past, survivors = hmm.ForwardFilter(np.log(np.full(3, 1 / 3))), hmm.OpenTicks(), hmm.Survivors()
    for state, onset, value in hours(ticks, evidence, rng):
        step = forward.advance(state, onset, value, change)
        past.append(step)
        survivors.append(step)
        if (past.first + len(past)) % 1000 == 0:
            probability, until = past.look_back(forward.frontier, TOLERANCE)
            past.drop(until)
    assert len(forward.frontier.onset) < 200
    assert forward.frontier.log_weight.max() == pytest.approx(0.0, abs=3.0)  # weights are renormalised
    assert (len(past) < 1100) is certain
    assert past.size < 10_000 * ticks
    if certain:
        assert probability[0].argmax() == 0
        ((contact, _, end),) = survivors.finish(forward.frontier)[-1:]
        assert (contact, end) == (0, ticks)


def with_free_joined(path):
    """The path with consecutive segments of the last state in one."""
    joined = []
    for state, onset, end in path:
        if joined and state == joined[-1][0] == 2:
            onset = joined.pop()[1]
        joined.append((state, onset, end))
    return joined


@settings(max_examples=12, deadline=None)
@given(seed=seeds, every=st.integers(3, 40), share=st.sampled_from([0.1, 0.5, 0.95]))
def test_skipped_ticks_are_ticks_without_change(seed, every, share):
    """Skipping equals a tick with the same likelihoods, without births, in which free motion lasts."""
    rng, ticks = np.random.default_rng(seed), 70
    initial, change = np.log(np.full(3, 1 / 3)), np.log(rng.dirichlet(np.full(3, 0.5), (ticks, 3)) + 1e-9)
    none = np.full((3, 3), -np.inf)
    none[2, 2] = 0.0
    skipped = rng.random(ticks) < share
    skipped[0] = False
    whole, short, since = [], [], np.zeros((0, 2), np.int64)
    for tick in range(ticks):
        if skipped[tick]:
            state, onset, value, _ = whole[-1]
            whole.append((state, np.append(onset[:-1], tick), value, none))
            short.append(None)
            continue
        since = np.concatenate([since[rng.random(len(since)) < 0.8], [[0, tick], [1, tick]]])
        since = since[np.lexsort((since[:, 1], since[:, 0]))]
        state, onset = np.concatenate([since, [[2, tick]]]).T
        value = np.append(rng.normal(size=len(since)), 0.0)
        whole.append((state, onset, value, change[tick]))
        short.append(whole[-1])
    paths, posteriors, released = zip(
        *(run(steps, initial, every, 1e-9) for steps in (whole, short)), strict=True
    )
    assert with_free_joined(paths[0]) == with_free_joined(paths[1])
    np.testing.assert_allclose(posteriors[1], posteriors[0], atol=4e-9)
    for (by_ticks, _), (by_skips, _) in zip(*released, strict=True):
        assert by_skips >= by_ticks  # skipped ticks after the last decided one are released with it


@pytest.mark.filterwarnings("error")
def test_the_smallest_weights_stay_finite():
    """A weight near the smallest positive number is divided by more than one."""
    change = np.log(np.array([[0.9, 0.1], [0.1, 0.9]]))
    for behind in np.arange(-747.0, -738.0, 0.05):
        forward = hmm.ForwardFilter(np.log([0.5, 0.5]))
        forward.advance(np.array([0, 1]), np.zeros(2, int), np.zeros(2), change)
        state, onset = np.array([0, 0, 0, 0, 1]), np.array([0, 1, 1, 1, 0])
        forward.advance(state, onset, np.array([behind, 0.0, 0.0, 0.0, 0.0]), change)
        frontier = forward.frontier
        assert np.isfinite(frontier.log_weight).all()
        assert frontier.probability.sum() == pytest.approx(1.0)


EVERY = [np.arange(tick + 1) for tick in range(60)]
FIRST_ROW = [np.zeros(1, np.int64), *(np.arange(1, tick + 1) for tick in range(1, 18)), np.arange(3, 19)]
FIRST_ROW[10:18] = [np.delete(onsets, 1) for onsets in FIRST_ROW[10:18]]


@pytest.mark.parametrize(
    ("alive_onsets", "drop_at", "dropped"),
    [
        pytest.param(EVERY, 50, 20, id="more than the first rows"),
        pytest.param([*EVERY[:16], np.arange(1, 17)], None, 0, id="a released row is reused for the newest"),
        # onset 18 leaves the row to onset 1, which is over by the end; onset 2 was over long before
        pytest.param(FIRST_ROW, None, 0, id="an onset in the first row keeps it"),
    ],
)
def test_onsets_keep_their_rows_in_the_smoother(alive_onsets, drop_at, dropped):
    """Incremental against batch smoothing, for random likelihoods and these onsets alive in each tick."""
    rng, ticks = np.random.default_rng(5), len(alive_onsets)
    value = 0.05 * rng.normal(size=(2, ticks, ticks + 1))
    initial, change = np.log([0.5, 0.5]), np.log(rng.dirichlet(np.ones(2), (ticks, 2)))
    forward, past, alive = hmm.ForwardFilter(initial), hmm.OpenTicks(), []
    for tick, onsets in enumerate(alive_onsets):
        state, onset = np.repeat([0, 1], len(onsets)), np.tile(onsets, 2)
        alive.append(np.concatenate([onsets, ticks + onsets]))
        past.append(forward.advance(state, onset, value[state, onset, tick + 1], change[tick]))
        if tick == drop_at:  # earlier ticks are released
            past.drop(dropped)
    trellis = Trellis(
        np.repeat([0, 1], ticks),
        np.tile(np.arange(ticks), 2),
        alive,
        [value.reshape(-1, ticks + 1)[rows, tick + 1] for tick, rows in enumerate(alive)],
    )
    expected = smooth(trellis, initial, change)[0][dropped:]
    np.testing.assert_allclose(past.posterior(forward.frontier), expected, atol=1e-9)


def test_posteriors_are_renormalised_after_rounding():
    past, frontier = hmm.OpenTicks(), hmm.FilterFrontier(*map(np.array, ([1], [0], [0.0], [0.0], [1])))
    for chance in (0.0, 0.9):  # instead of 1
        way = np.array([0]), np.array([1]), np.array([1.0])
        source = np.array([[0.0, 0.0], [chance, 0.0]])
        past.append(hmm.ForwardMessage(len(past), source, *way, np.zeros((2, 2))))
    np.testing.assert_allclose(past.posterior(frontier), [[0.0, 1.0], [1.0, 0.0]], atol=1e-12)


def test_weights_may_have_any_common_factor():
    frontier = hmm.FilterFrontier(*map(np.array, ([0, 1], [0, 1], [-2000.0, -2000.0], [0.0, 0.0], [0, 0])))
    np.testing.assert_allclose(frontier.probability, [0.5, 0.5])


# --- invalid input of the forward filter, and the memory of open ticks ---
CHANGE = np.log(np.full((2, 2), 0.5))


def begun() -> ForwardFilter:
    running = ForwardFilter(np.log([0.5, 0.5]))
    running.advance(np.array([0, 1]), np.array([0, 0]), np.zeros(2), CHANGE)
    return running


@pytest.mark.parametrize("unknown", [0, 7])
def test_a_hypothesis_with_an_unknown_onset_is_refused_among_valid_ones(unknown: int) -> None:
    """Onset 0 has been dropped, onset 7 is in the future."""
    running, one, none = begun(), np.ones(1, np.int64), np.zeros(1)
    running.advance(one, one, none, CHANGE)
    running.advance(one, one, none, CHANGE)
    with pytest.raises(ValueError, match="unknown onset"):
        running.advance(np.array([0, 1, 1]), np.array([2, 1, unknown]), np.zeros(3), CHANGE)


@pytest.mark.parametrize("odd", [np.nan, np.inf, -np.inf])
def test_a_likelihood_that_is_not_finite_is_refused_among_finite_ones(odd: float) -> None:
    with pytest.raises(ValueError, match="no path"):
        begun().advance(np.array([0, 1]), np.array([0, 0]), np.array([0.0, odd]), CHANGE)


def message(ways: int, tick: int = 0) -> ForwardMessage:
    onset = np.zeros(ways, np.int32)
    return ForwardMessage(
        tick, np.zeros((2, 2)), onset, np.zeros(ways, np.int8), np.zeros(ways), np.zeros((2, 2), np.int32)
    )


def test_open_ticks_count_kept_and_released_rows() -> None:
    """The smoother uses it to release ticks early, so that memory stays bounded."""
    ticks = OpenTicks()
    assert ticks.size == 0
    sizes = []
    for tick, ways in enumerate((1, 1000, 1)):
        ticks.append(message(ways, tick))
        sizes.append(ticks.size)
    few, many = sizes[0], sizes[1] - sizes[0]
    assert few > 0
    arrays = sum(part.nbytes for part in message(1000)[2:5])
    assert arrays == pytest.approx(many, rel=0.2)
    assert sizes[2] == many + 2 * few
    ticks.drop(2)
    assert (ticks.size, len(ticks), ticks.first) == (few, 1, 2)
    ticks.drop(1)
    assert (ticks.size, len(ticks), ticks.first) == (few, 0, 3)  # ticks may be skipped after the last step
    ticks.skip()
    assert few < ticks.size < 1.5 * few
    ticks.drop(1)
    assert (ticks.size, len(ticks), ticks.first) == (few, 0, 4)
