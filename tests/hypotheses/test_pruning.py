"""Pruning of weak hypotheses hardly changes the beliefs."""

from itertools import islice, pairwise
from pathlib import Path
from typing import Final

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import pruning
from contact_tracker.config.loading import load_model
from contact_tracker.contacts import CONTACT_MODELS
from contact_tracker.hypotheses import compiled
from contact_tracker.hypotheses.bank import Bank, blank
from contact_tracker.hypotheses.births import Birth, add, uninformed_proposal
from contact_tracker.hypotheses.global_search import (
    best_donors,
    is_due,
    prune,
    select_for_search,
    within_far_margin,
)
from contact_tracker.hypotheses.refit import accumulate, is_deferred, recover_fallen, refit
from contact_tracker.hypotheses.schedule import (
    DEFER_NATS,
    DROP_NATS,
    FAR_NATS,
    FITTING_RMS,
    IS_SEARCH_AGE,
    PROTECTION_NATS,
    PROTECTION_TICKS,
    UNTHINNED_TICKS,
    burn_in_ticks,
)
from contact_tracker.motion.poses import Poses
from contact_tracker.recording import open_log
from contact_tracker.states import STATES, Contact
from contact_tracker.tracking.state import scales_of
from pose_filter import after as after_tick
from pose_filter import forward
from short_recordings import FACE_TO_EDGE, MODEL, recorded

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

EDGE_FACE: Final = CONTACT_MODELS[Contact.EF.column]
SHIPPED: Final = sorted((Path(__file__).parents[2] / "recordings").glob("[rv]*.mcap"))
KERNELS_OR_NOT: Final = [
    False,
    pytest.param(True, marks=pytest.mark.skipif(not compiled.in_use(), reason="no kernels")),
]


@pytest.mark.long
@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_pruning_does_not_change_the_beliefs(path: Path) -> None:
    poses, model = Poses.collect(open_log(str(path))), load_model()
    own = pruning.track(poses, model)
    other = pruning.track(poses, pruning.with_margin(model, np.inf))
    assert other.hypotheses > 1.3 * own.hypotheses
    same, apart = compared(own, other)
    assert same.all()
    assert apart.max() < 1e-3


def compared(own: pruning.Run, other: pruning.Run) -> tuple[Bools, Array]:
    """Whether the labels of each tick are equal, and the largest difference of its probabilities."""
    tied = np.diff(np.sort(own.probability, axis=1)[:, -2:], axis=1)[:, 0] < 1e-6  # decided by rounding
    same = own.probability.argmax(axis=1) == other.probability.argmax(axis=1)
    return tied | same, np.abs(own.probability - other.probability).max(axis=1)


def test_a_wider_margin_does_not_change_the_beliefs() -> None:
    poses = recorded(FACE_TO_EDGE).poses[:800]
    own, other = pruning.track(poses, MODEL), pruning.track(poses, pruning.with_margin(MODEL, 40.0))
    assert other.hypotheses > own.hypotheses
    apart = np.abs(own.probability - other.probability).max(axis=1)
    assert np.quantile(apart, 0.9) < 1e-3
    assert (own.probability.argmax(axis=1) == other.probability.argmax(axis=1)).mean() > 0.99
    row = pruning.row("short", np.inf, own, other)
    assert len(row) == len(pruning.COLUMNS)
    assert row[:2] == ["short", "none"]
    assert pruning.row("short", 40.0, own, own)[2:8] == ["1.000", *["0.0000"] * 4, "1.00"]


def protection_at_birth(begins, model):
    """``protected_until`` of a new hypothesis."""
    birth = Birth(begins, 0, 0, 0, 0.0, np.zeros((0, len(STATES))), np.eye(3))
    return float(add(blank(model, 0), model, birth).protected_until[0])


@pytest.mark.parametrize("model", CONTACT_MODELS, ids=lambda model: model.contact.value)
def test_weak_hypotheses_are_kept_until_their_geometry_can_converge(model):
    """For f-f this is sooner (5 unknowns, 3 rows a pose) than for e-e (8 unknowns, 1 row)."""
    ages = np.array([0.9, 1.1]) * burn_in_ticks(model.family.PARAMETERS / model.family.ROWS)
    bank = blank(model, 2).replace_columns(log_likelihood=-1000.0, rms=10.0, number=[0, 1])
    bank = bank.replace_columns(
        protected_until=protection_at_birth(uninformed_proposal(model), model)
    ).replace_onset_columns(effective_ticks=ages)
    assert prune(bank, 5, 0.0, 40.0).number.tolist() == [0]
    weak, near = bank.pick(np.array([1])), bank.replace_columns(log_likelihood=-1.0).pick(np.array([1]))
    assert not len(select_for_search(weak, model))
    assert len(select_for_search(near, model)) == IS_SEARCH_AGE[int(ages[1])]
    due = int(np.flatnonzero(IS_SEARCH_AGE[: int(ages[0]) + 1])[-1])
    assert (
        len(
            select_for_search(
                bank.replace_onset_columns(effective_ticks=float(due)).pick(np.array([0])), model
            )
        )
        == 1
    )


def test_hypotheses_far_behind_are_outside_of_the_margin():
    behind = [-FAR_NATS, -1.01 * FAR_NATS, np.nan]
    bank = blank(EDGE_FACE, 3).replace_columns(log_birth_weight=1.0, log_likelihood=np.array(behind) - 1.0)
    assert within_far_margin(bank).tolist() == [True, False, False]


def test_hypotheses_behind_are_updated_later():
    behind = [-DEFER_NATS, -1.01 * DEFER_NATS, np.nan]
    bank = blank(EDGE_FACE, 3).replace_columns(log_birth_weight=1.0, log_likelihood=np.array(behind) - 1.0)
    assert is_deferred(bank).tolist() == [False, True, True]


@pytest.mark.parametrize("in_use", KERNELS_OR_NOT)
def test_falling_hypotheses_are_refitted_until_they_fit(in_use, monkeypatch):
    """In the same tick, with more steps than others."""
    monkeypatch.setattr(compiled, "in_use", lambda: in_use)
    model, scales = EDGE_FACE, scales_of(MODEL)
    ticks = list(forward(recorded(FACE_TO_EDGE).poses[:860], MODEL))
    state, window = ticks[39].state, ticks[40].state.window
    assert not is_due(model, 40)
    bank = state.banks[model.contact.column]
    near = (bank.log_weight > -DEFER_NATS) & (bank.effective_ticks > 10.0)
    off = model.turned(bank.x, Rotation.from_rotvec([0.9, 0.0, 0.0]).as_matrix())
    displaced = bank.replace_columns(x=np.where(near[:, None], off, bank.x))
    stepped = refit(accumulate(displaced, model, window, scales), model, window, scales)
    fallen = near & (stepped.log_weight < bank.log_weight - DROP_NATS) & (stepped.rms > FITTING_RMS)
    assert fallen.any()
    state = state._replace(
        banks=(*state.banks[: model.contact.column], displaced, *state.banks[model.contact.column + 1 :])
    )
    after = after_tick(state, ticks[40].tick)[0].banks[model.contact.column]
    right = ticks[40].state.banks[model.contact.column]
    for number in bank.number[fallen]:
        assert after.log_weight[after.number == number] == pytest.approx(
            right.log_weight[right.number == number], abs=0.2
        )
    far = recover_fallen(stepped, bank.log_weight - 1.1 * DEFER_NATS, model, window, scales)
    assert (far.protected_until > stepped.protected_until).any()
    np.testing.assert_array_equal(
        far.replace_columns(protected_until=stepped.protected_until).words, stepped.words
    )  # no further steps
    negligible = recover_fallen(stepped, bank.log_weight - 1.1 * PROTECTION_NATS, model, window, scales)
    np.testing.assert_array_equal(negligible.words, stepped.words)


@pytest.mark.parametrize("k", [40, 41])
@pytest.mark.parametrize("in_use", KERNELS_OR_NOT)
def test_falling_hypotheses_that_do_not_recover_are_kept_for_a_while(in_use, k, monkeypatch):
    """If they were near the best, and do not fit: other hypotheses may find their geometry."""
    monkeypatch.setattr(compiled, "in_use", lambda: in_use)
    model, ticks = EDGE_FACE, list(forward(recorded(FACE_TO_EDGE).poses[:860], MODEL))
    state, column = ticks[k - 1].state, model.contact.column
    bank = state.banks[column].pick(np.flatnonzero(state.banks[column].effective_ticks > 3.0))
    off = model.turned(bank.x, Rotation.from_rotvec([0.9, 0.0, 0.0]).as_matrix())
    held = np.arange(len(bank)) % 4 < 2  # to wrong elements
    bank = bank.replace_columns(
        prior_index=held,
        prior_mean=np.where(held[:, None], off, 0.0),
        prior_information=held[:, None, None] * 1e12 * np.eye(model.family.SIZE),
    )
    group = np.arange(len(bank)) % 3
    was = np.array([-0.9 * DEFER_NATS, -1.1 * DEFER_NATS, -1.1 * PROTECTION_NATS])[group]
    excessive = bank.log_likelihood + 100.0  # the weight falls by this much
    long = np.arange(len(bank)) % 8 == 0  # some are protected for longer already
    bank = bank.replace_columns(
        log_likelihood=excessive, log_birth_weight=was - excessive, protected_until=1e3 * long
    )
    state = state._replace(
        model=pruning.with_margin(MODEL, np.inf),
        banks=(*state.banks[:column], bank, *state.banks[column + 1 :]),
    )
    after = after_tick(state, ticks[k].tick)[0].banks[column]
    stays = np.isin(bank.number, after.number)
    after, group = after.pick(np.flatnonzero(np.isin(after.number, bank.number))), group[stays]
    assert (after.protected_until[long[stays]] == 1e3).all()
    after, group = after.pick(np.flatnonzero(~long[stays])), group[~long[stays]]
    is_protected, near = after.protected_until > 0.0, group == 0
    assert set(group) == {0, 1, 2}
    assert is_protected[near].any()
    assert is_protected[group == 1].any() == is_due(model, k)  # else it is deferred
    assert not is_protected[group == 2].any()
    np.testing.assert_allclose(
        after.protected_until[is_protected], after.effective_ticks[is_protected] + PROTECTION_TICKS
    )
    if not is_due(model, k):  # else they have received geometry of others
        assert (after.rms[near] < FITTING_RMS).any()
        np.testing.assert_array_equal(is_protected[near], after.rms[near] > FITTING_RMS)


def test_protection_keeps_weak_hypotheses_until_it_ends():
    bank = blank(EDGE_FACE, 3).replace_columns(
        protected_until=[0.0, 30.0, 29.9], log_likelihood=-1e3, number=[0, 1, 2]
    )
    assert prune(bank.replace_onset_columns(effective_ticks=30.0), 3, 0.0, 20.0).number.tolist() == [1]


@pytest.mark.parametrize("in_use", KERNELS_OR_NOT)
def test_young_hypotheses_are_pruned_only_after_a_search(in_use, monkeypatch):
    monkeypatch.setattr(compiled, "in_use", lambda: in_use)
    dropped = 0
    for before, after in pairwise(forward(recorded(FACE_TO_EDGE).poses[:500], MODEL)):
        now = before.state.ticks
        for model, bank, left in zip(CONTACT_MODELS, before.state.banks, after.state.banks, strict=True):
            young = bank.number[bank.onset > now + 1 - UNTHINNED_TICKS]
            gone = len(set(young) - set(left.number))
            assert not gone or is_due(model, now)
            dropped += gone
    assert dropped


@pytest.mark.parametrize("is_protected", [True, False])
@pytest.mark.parametrize("in_use", KERNELS_OR_NOT)
def test_protected_hypotheses_recover_their_minimum(in_use, is_protected, monkeypatch):
    """A hypothesis far behind receives its geometry from others of its contact."""
    monkeypatch.setattr(compiled, "in_use", lambda: in_use)
    model, ticks = EDGE_FACE, list(forward(recorded(FACE_TO_EDGE).poses[:860], MODEL))
    column, start = model.contact.column, 39
    assert [is_due(model, start + i) for i in range(3)] == [False, False, True]
    state = ticks[start - 1].state
    bank = state.banks[column]
    near = (bank.effective_ticks > burn_in_ticks(model.needed)) & (bank.log_weight > -DEFER_NATS)
    near[bank.best_row] = False
    row = int(np.flatnonzero(near)[-1])
    this = np.arange(len(bank)) == row
    displaced = bank.replace_columns(
        x=np.where(this[:, None], model.turned(bank.x, np.eye(3)[[1, 2, 0]]), bank.x),
        log_likelihood=np.where(this, -1e3, bank.log_likelihood),
        rms=np.where(this, 50.0, bank.rms),
        protected_until=np.where(
            this & is_protected, bank.effective_ticks + PROTECTION_TICKS, bank.protected_until
        ),
    )
    state = state._replace(banks=(*state.banks[:column], displaced, *state.banks[column + 1 :]))
    for later in ticks[start : start + 3]:
        assert displaced.number[row] in state.banks[column].number
        state, _ = after_tick(state, later.tick)
    bank = state.banks[column]
    assert (bank.log_weight[bank.number == displaced.number[row]] > -FAR_NATS).tolist() == [
        True
    ] * is_protected


def donor_and_recipient() -> Bank:
    """A hypothesis that fits, and one that does not fit after 20 ticks."""
    model, ticks = EDGE_FACE, next(islice(forward(recorded(FACE_TO_EDGE).poses, MODEL), 39, None))
    bank = ticks.state.banks[model.contact.column]
    fitting, lost = bank.best_row, int(np.flatnonzero(bank.effective_ticks > 10.0)[0])
    two = bank.pick(np.array([fitting, lost]))
    x = np.array([two.x[0], model.turned(two.x, np.eye(3)[[1, 2, 0]])[1]])
    assert two.onset[0] != two.onset[1]
    two = two.replace_onset_columns(effective_ticks=np.where(two.onsets.onset == two.onset[0], 60.0, 20.0))
    return two.replace_columns(
        x=x, rms=[1.0, 50.0], log_birth_weight=0.0, log_likelihood=0.0, needs_search=1, protected_until=0.0
    )


@pytest.mark.parametrize("age", [3.0, 60.0])
@pytest.mark.parametrize("behind", [0.9, 1.1])
def test_weak_hypotheses_donate_no_geometry(age, behind):
    """Except during burn-in, before they may have found their minimum."""
    two = donor_and_recipient()
    two = two.replace_onset_columns(effective_ticks=np.where(two.onsets.onset == two.onset[0], age, 20.0))
    two = two.replace_columns(log_likelihood=[-behind * FAR_NATS, 0.0])
    offered = age < burn_in_ticks(EDGE_FACE.needed) or behind < 1.0
    assert best_donors(two, EDGE_FACE, scales_of(MODEL)).tolist() == [0, 0 if offered else 1]


@pytest.mark.parametrize("protected_until", [19.9, 20.0])
@pytest.mark.parametrize("behind", [1.0, 1.01])
def test_weak_hypotheses_receive_no_geometry(protected_until, behind):
    """Unless they are protected."""
    two = donor_and_recipient().replace_columns(
        protected_until=[0.0, protected_until], log_likelihood=[0.0, -behind * FAR_NATS]
    )
    receives = behind == 1.0 or protected_until == 20.0
    assert best_donors(two, EDGE_FACE, scales_of(MODEL)).tolist() == [0, 0 if receives else 1]
