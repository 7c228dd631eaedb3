"""Incremental Viterbi and smoothing against those of the whole recording, and in long streams."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from chain_oracle import noisy_trellis, random_model, walk
from contact_tracker import hmm
from contact_tracker.tracking.transition_model import log_initial, tick_transitions
from trellis_cases import Case

TOLERANCE = 1e-6
seeds = st.integers(0, 2**32 - 1)
many = settings(max_examples=40, deadline=None)


def run(trellis, log_initial, log_transition, every, tolerance=TOLERANCE):
    """Inference with a release of decided ticks every ``every`` ticks: path, posterior, and the numbers of
    ticks whose posterior and path are released after each."""
    forward, past, survivors = hmm.ForwardFilter(log_initial), hmm.OpenTicks(), hmm.Survivors()
    path, posterior, released = [], [], []
    for b, (alive, likelihood) in enumerate(zip(trellis.alive, trellis.log_likelihood, strict=True), start=1):
        step = forward.advance(trellis.state[alive], trellis.onset[alive], likelihood, log_transition[b - 1])
        past.append(step)
        survivors.append(step)
        if b % every == 0:
            probability, certain = past.look_back(forward.frontier, tolerance)
            posterior.append(probability[:certain])
            past.drop(certain)
            path += survivors.decided_prefix(forward.frontier)
            released.append((past.first, survivors.first))
    if len(past):
        posterior.append(past.look_back(forward.frontier, tolerance)[0])
    return path + survivors.finish(forward.frontier), np.concatenate(posterior), released


def whole(trellis, log_initial, log_transition):
    path = hmm.viterbi(trellis, log_initial, log_transition)
    return [(int(trellis.state[h]), a, b) for h, a, b in path], hmm.smooth(
        trellis, log_initial, log_transition
    )[0]


def pruned(trellis, log_initial, log_transition, margin=20.0):
    """Without negligible hypotheses, as in the tracker."""
    forward, negligible = hmm.ForwardFilter(log_initial), np.zeros(len(trellis.state), bool)
    alive, value = [], []
    for b, (before, likelihood) in enumerate(zip(trellis.alive, trellis.log_likelihood, strict=True)):
        kept = ~negligible[before]
        alive.append(before[kept])
        value.append(likelihood[kept])
        state, onset = trellis.state[alive[-1]], trellis.onset[alive[-1]]
        forward.advance(state, onset, value[-1], log_transition[b])
        frontier = forward.frontier
        good = {
            (a, i)
            for a, i, w in zip(frontier.onset, frontier.state, frontier.log_weight, strict=True)
            if w > -margin
        }
        negligible[alive[-1]] = [pair not in good for pair in zip(onset, state, strict=True)]
    return trellis._replace(alive=alive, log_likelihood=value)


@many
@given(seed=seeds, every=st.integers(1, 7))
def test_pieces_of_any_trellis_equal_the_whole(seed, every):
    case = Case(seed)
    try:
        expected = whole(case.trellis, *case.model)
        path, posterior, _ = run(case.trellis, *case.model, every)
    except ValueError as error:  # of the whole and of the pieces
        assert "no path" in str(error)  # noqa: PT017
        return
    assert path == expected[0]
    np.testing.assert_allclose(posterior, expected[1], atol=TOLERANCE)


def test_a_hypothesis_that_fell_back_beyond_all_floats_may_still_win():
    """Without noise, log-likelihoods differ by thousands, and later by as much the other way."""
    state, onset = np.array([0, 0, 1, 1, 1, 1]), np.array([0, 2, 0, 1, 2, 3])
    alive = [np.array(rows) for rows in ([0, 2], [0, 3], [0, 1, 4], [0, 1, 5])]
    log_likelihood = [np.array(values) for values in ([0.0, 0.0], [0.0, 0.0], [-2e3, 0.0, 0.0])]
    trellis = hmm.Trellis(state, onset, alive, [*log_likelihood, np.array([0.0, -4e3, -4e3])])
    even = np.full(2, np.log(0.5)), np.full((4, 2, 2), np.log(0.5))
    expected_path, expected = whole(trellis, *even)
    assert expected_path == [(0, 0, 4)]
    path, posterior, released = run(trellis, *even, every=3)
    assert path == expected_path
    assert released[0] == (0, 0)
    np.testing.assert_allclose(posterior, expected, atol=TOLERANCE)


@pytest.mark.parametrize("blur", [0.5, 2.0])
def test_pieces_of_a_recording_equal_the_whole_and_are_released_early(blur):
    rng = np.random.default_rng(7)
    model, exposure = random_model(rng), rng.uniform(0.02, 1.0, 150)
    chain = log_initial(model), np.array([tick_transitions(model, e).log_transition for e in exposure])
    trellis = pruned(noisy_trellis(walk(model, exposure, rng), model, exposure, rng, blur), *chain)
    expected_path, expected = whole(trellis, *chain)
    path, posterior, released = run(trellis, *chain, every=30)
    assert path == expected_path
    assert np.abs(posterior - expected).max() < TOLERANCE
    smoothed, decided = np.array(released).T
    if blur == 0.5:  # unambiguous ticks are released long before the end
        assert smoothed[-1] > 60
        assert decided[-1] > 60
    loose = run(trellis, *chain, every=30, tolerance=0.1)
    assert loose[2][2][0] >= released[2][0]
    assert np.abs(loose[1] - expected).max() < 0.1


@many
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
        seen.append(hmm.smooth(alone, initial, change[:cut])[0])
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


# --- long streams ------------------------------------------------------------------------------------------


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
    rng, ticks = np.random.default_rng(1), 4000
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


@many
@given(seed=seeds, every=st.integers(3, 40), share=st.sampled_from([0.1, 0.5, 0.95]))
def test_skipped_ticks_are_ticks_without_change(seed, every, share):
    """Skipping equals a tick with the same likelihoods, without births, in which free motion lasts."""
    rng, ticks = np.random.default_rng(seed), 70
    initial, change = np.log(np.full(3, 1 / 3)), np.log(rng.dirichlet(np.full(3, 0.5), (ticks, 3)) + 1e-9)
    none = np.full((3, 3), -np.inf)
    none[2, 2] = 0.0
    skipped = rng.random(ticks) < share
    skipped[0] = False
    whole = hmm.ForwardFilter(initial), hmm.OpenTicks(), hmm.Survivors()
    short = hmm.ForwardFilter(initial), hmm.OpenTicks(), hmm.Survivors()
    paths, since, onset = ([], []), np.zeros((0, 2), np.int64), np.zeros(1, np.int64)
    for tick in range(ticks):
        if skipped[tick]:
            onset = np.append(onset[:-1], tick)
            for each in short:
                each.skip()
        else:
            since = np.concatenate([since[rng.random(len(since)) < 0.8], [[0, tick], [1, tick]]])
            since = since[np.lexsort((since[:, 1], since[:, 0]))]
            state, onset = np.concatenate([since, [[2, tick]]]).T
            value = np.append(rng.normal(size=len(since)), 0.0)
            step = short[0].advance(state, onset, value, change[tick])
            short[1].append(step)
            short[2].append(step)
        step = whole[0].advance(state, onset, value, none if skipped[tick] else change[tick])
        whole[1].append(step)
        whole[2].append(step)
        assert len(short[1]) == len(whole[1])
        if (tick + 1) % every == 0:
            (expected, certain), (posterior, until) = (
                past.look_back(forward.frontier, TOLERANCE) for forward, past, _ in (whole, short)
            )
            np.testing.assert_allclose(posterior, expected, atol=1e-9)
            assert until >= certain  # it includes skipped ticks after the last decided one
            np.testing.assert_allclose(np.diff(expected[certain - 1 : until], axis=0), 0.0, atol=1e-9)
            for path, (forward, past, survivors) in zip(paths, (whole, short), strict=True):
                past.drop(until)
                path += survivors.decided_prefix(forward.frontier)
            assert short[1].first == whole[1].first
            assert short[1].size > 0 or not len(short[1])
    for path, (forward, _, survivors) in zip(paths, (whole, short), strict=True):
        path += survivors.finish(forward.frontier)
    assert with_free_joined(paths[0]) == with_free_joined(paths[1])


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


def test_hypotheses_with_an_unknown_onset_are_refused():
    forward, one, none, change = (
        hmm.ForwardFilter(np.zeros(2)),
        np.zeros(1, np.int64),
        np.zeros(1),
        np.zeros((2, 2)),
    )
    forward.advance(one, one, none, change)
    for gone in (0, 3):  # onset 0 has been dropped, onset 3 is in the future
        forward.advance(one, one + 1, none, change)
        with pytest.raises(ValueError, match="nothing has begun"):
            forward.advance(one, one + gone, none, change)
        forward = hmm.ForwardFilter(np.zeros(2))
        forward.advance(one, one, none, change)
    with pytest.raises(ValueError, match="no path"):
        forward.advance(one, one + 1, none + np.nan, change)


def test_states_without_predecessor_have_no_origin():
    """The first tick has no predecessor, and a state without path to it has no best one."""
    forward, only = hmm.ForwardFilter(np.log([0.5, 0.25, 0.25])), np.full((3, 3), -np.inf)
    step = forward.advance(np.array([0, 1]), np.zeros(2, int), np.zeros(2), only)
    assert forward.frontier.origin.tolist() == [-1, -1]
    assert step.best.tolist() == [[0, 0, -1], [-1, -1, -1]]
    only[1, 2] = 0.0
    step = forward.advance(np.array([0, 2]), np.array([0, 1]), np.zeros(2), only)
    assert forward.frontier.origin.tolist() == [-1, 1]
    assert step.best.tolist() == [[0, -1, 1], [-1, -1, 1]]


def assert_smoothed(seed, onsets_of_ticks, drop_at=None, dropped=0):
    """Compare incremental with batch smoothing, for random likelihoods and the onsets alive in each tick."""
    rng, ticks = np.random.default_rng(seed), len(onsets_of_ticks)
    value = 0.05 * rng.normal(size=(2, ticks, ticks + 1))
    initial, change = np.log([0.5, 0.5]), np.log(rng.dirichlet(np.ones(2), (ticks, 2)))
    forward, past, alive = hmm.ForwardFilter(initial), hmm.OpenTicks(), []
    for tick, onsets in enumerate(onsets_of_ticks):
        state, onset = np.repeat([0, 1], len(onsets)), np.tile(onsets, 2)
        alive.append(np.concatenate([onsets, ticks + onsets]))
        past.append(forward.advance(state, onset, value[state, onset, tick + 1], change[tick]))
        if tick == drop_at:  # earlier ticks are released
            past.drop(dropped)
    trellis = hmm.Trellis(
        np.repeat([0, 1], ticks),
        np.tile(np.arange(ticks), 2),
        alive,
        [value.reshape(-1, ticks + 1)[rows, tick + 1] for tick, rows in enumerate(alive)],
    )
    expected = hmm.smooth(trellis, initial, change)[0][dropped:]
    np.testing.assert_allclose(past.posterior(forward.frontier), expected, atol=1e-9)


def test_many_onsets_may_stay_open():
    """More than the initial capacity of the smoother; all are kept separate."""
    assert_smoothed(5, [np.arange(tick + 1) for tick in range(60)], drop_at=50, dropped=20)


def test_a_released_row_is_reused_for_another_onset():
    """Sixteen onsets fill the smoother's rows; one that is over by the end takes the row of the newest."""
    assert_smoothed(6, [*(np.arange(tick + 1) for tick in range(16)), np.arange(1, 17)])


def test_an_onset_in_the_first_row_keeps_it_when_another_turns_up():
    """Onset 18 leaves the row to onset 1, which is over by the end; onset 2 was over long before."""
    alive = [np.zeros(1, np.int64), *(np.arange(1, tick + 1) for tick in range(1, 18)), np.arange(3, 19)]
    alive[10:18] = [np.delete(onsets, 1) for onsets in alive[10:18]]
    assert_smoothed(7, alive)


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
