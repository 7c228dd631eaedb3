"""Metrics of the evaluation: against sampling every millisecond, by hand, and by invariants."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from contact_tracker.arrays import Array, Ints
from contact_tracker.ground_truth import Truth
from contact_tracker.states import STATES, Contact
from contact_tracker_lab.evaluation.metrics import Tally, quantile, tally
from contact_tracker_lab.evaluation.scoring import (
    UNSCORED,
    Scoring,
    Subset,
    scoring,
    tick_containing,
    tick_in_force,
)

MS = 1_000_000
EPOCH_NS = 1_700_000_000_000_000_000
SEEDS = st.integers(0, 2**32 - 1)
FIGURES = ("macro_f1", "log_loss", "brier", "calibration_error", "sure_wrong", "missed_share", "never_share")


def make_truth(
    *phases: tuple[str, int], motion: tuple[str, ...] = (), singular: tuple[int, ...] = ()
) -> Truth:
    """Phases of (label, milliseconds) one after the other from EPOCH_NS on."""
    *starts, end = (EPOCH_NS + MS * np.cumsum([0, *(ms for _, ms in phases)])).tolist()
    truth = Truth.from_changes(starts, [label for label, _ in phases], end - 1)
    kinds = zip(truth.intervals, (*motion, *["normal"] * (len(phases) - len(motion))), strict=True)
    return Truth(tuple(replace(x, motion=kind, singular=i in singular) for i, (x, kind) in enumerate(kinds)))


def frames(ms: int, every: int = 10) -> Ints:
    return EPOCH_NS + np.arange(0, ms, every, dtype=np.int64) * MS


def one_hot(columns: Ints) -> Array:
    return np.eye(len(STATES))[columns]


def tally_of(scored: Scoring, columns: Ints, probability: Array | None = None) -> Tally:
    """Tally of one belief per frame; without ``probability`` the label has probability 1."""
    p = one_hot(columns) if probability is None else probability
    return tally(scored, np.arange(len(columns)), columns, p)


def columns_of(stamp_ns: Ints, *phases: tuple[str, int]) -> Ints:
    return scoring(stamp_ns, make_truth(*phases)).truth


def figures(result: Tally) -> list[float]:
    accuracy = [f(s) for s in Subset for f in (result.accuracy, result.seconds)]
    return [*accuracy, *(getattr(result, name) for name in FIGURES)]


def test_within_an_unscored_gap_every_time_of_change_is_right() -> None:
    stamps = frames(4000)
    scored = scoring(stamps, make_truth(("free", 2000), ("?", 100), ("v-f", 1900)))
    for change_ms, off_s in ((2050, 0.0), (1980, 0.02), (2150, 0.05)):
        columns = columns_of(stamps, ("free", change_ms), ("v-f", 4000 - change_ms))
        assert tally_of(scored, columns).boundary_s == pytest.approx([off_s])
    assert scored.seconds[scored.subsets[Subset.ALL]].sum() == pytest.approx(3.9)


@pytest.mark.parametrize(
    "phases",
    [
        (("free", 2000), ("?", 400), ("v-f", 1600)),  # the time of the change is not known
        (("free", 2000), ("v-f", 200)),  # too short
        (("free", 2000), ("?", 50), ("free", 1000)),  # no change at all
    ],
)
def test_changes_that_are_not_scored(phases: tuple[tuple[str, int], ...]) -> None:
    assert scoring(frames(sum(ms for _, ms in phases)), make_truth(*phases)).changes == ()


def test_indistinguishable_contacts_are_scored_separately() -> None:
    """f-f at rest, then moved; e-f in pure translation; free. Found: f-f, then free."""
    truth = make_truth(
        ("f-f", 1000), ("f-f", 1000), ("e-f", 1000), ("free", 1000),
        motion=("rest", "normal", "translation", "normal"), singular=(2,),
    )  # fmt: skip
    stamps = frames(4000)
    scored = scoring(stamps, truth)
    columns = columns_of(stamps, ("f-f", 2100), ("free", 1900))
    clear, open_ = (tally_of(scored.within(s), columns) for s in (Subset.IDENTIFIABLE, Subset.AMBIGUOUS))
    assert (clear.seconds(), open_.seconds()) == (pytest.approx(2.0), pytest.approx(2.0))
    assert (clear.accuracy(), clear.sure_wrong, clear.brier) == (1.0, 0.0, 0.0)
    assert open_.accuracy() == pytest.approx(0.5)
    assert open_.brier == pytest.approx(1.0)
    # a change belongs to the phase after it; free was found 0.9 s early
    assert (clear.into.tolist(), open_.into.tolist()) == ([Contact.FREE.column], [Contact.EF.column])
    assert clear.boundary_s == pytest.approx([0.9])
    assert open_.missed_share == 1.0
    together = clear + open_
    assert figures(together)[1::2][0] == pytest.approx(4.0)
    assert together.brier == pytest.approx(tally_of(scored, columns).brier)


@pytest.mark.parametrize("count", [0, 1, 2])
@pytest.mark.parametrize("truth", [Truth(()), make_truth(("?", 1000)), make_truth(("f-f", 1000))])
def test_metrics_of_few_frames_or_no_truth_are_well_defined(count: int, truth: Truth) -> None:
    result = tally_of(scoring(frames(10 * count), truth), np.zeros(count, np.int64))
    expected = 1.0 if result.seconds() else np.nan
    assert result.accuracy() == pytest.approx(expected, nan_ok=True)
    assert result.macro_f1 == pytest.approx(expected, nan_ok=True)
    assert quantile(result.delay_s, 0.5) != quantile(result.delay_s, 0.5)


def test_figures_by_state_by_hand() -> None:
    """2 s f-f, 1 s e-f, 1 s free; throughout the posterior has 0.7 for f-f and 0.3 for e-f."""
    stamps = frames(4000)
    scored = scoring(stamps, make_truth(("f-f", 2000), ("e-f", 1000), ("free", 1000)))
    result = tally_of(scored, np.zeros(400, np.int64), np.tile([0.7, 0.3, 0, 0, 0, 0, 0], (400, 1)))
    ff, ef, ee, free = (c.column for c in (Contact.FF, Contact.EF, Contact.EE, Contact.FREE))
    assert result.seconds_by_state[[ff, ef, ee, free]] == pytest.approx([2.0, 1.0, 0.0, 1.0])
    assert result.recall[[ff, ef, ee, free]] == pytest.approx([1.0, 0.0, np.nan, 0.0], nan_ok=True)
    assert result.f1[[ff, ef, ee, free]] == pytest.approx([2 / 3, 0.0, np.nan, 0.0], nan_ok=True)
    assert result.macro_f1 == pytest.approx(2 / 9)
    assert result.calibration_error == pytest.approx(0.2)
    assert result.sure_wrong == 0.0
    assert tally_of(scored, np.zeros(400, np.int64)).sure_wrong == pytest.approx(0.5)
    assert result.into.tolist() == [ef, free]
    assert np.isnan(result.detection_delay_s).all()


def random_case(seed: int, unscored: bool) -> tuple[Scoring, Truth, Ints, Ints, Ints, Array]:
    """Random truth, frames (with dropouts below 0.3 s) and beliefs, all on whole milliseconds."""
    rng = np.random.default_rng(seed)
    names = [s.value for s in STATES[:4]] + ["?"] * unscored
    phases = [(str(rng.choice(names)), int(rng.integers(1, 900))) for _ in range(6)]
    motion = tuple(rng.choice(["normal", "rest"], 6).tolist())
    truth = make_truth(*phases, motion=motion, singular=tuple(rng.choice(6, 2).tolist()))
    steps = rng.choice([5, 7, 30, 150], size=150, p=[0.45, 0.4, 0.1, 0.05])
    stamps = EPOCH_NS + np.cumsum(steps) * MS
    ticks = stamps[np.sort(rng.choice(150, 30, replace=False))]
    p = rng.dirichlet(np.full(7, 0.3), size=30)
    labels = np.repeat(rng.integers(0, 4, 15), 2)
    return scoring(stamps, truth), truth, stamps, ticks, labels, p


def per_ms(stamps: Ints) -> list[int]:
    """The latest frame at each millisecond from the first frame on."""
    ends = [*stamps[1:].tolist(), int(2 * stamps[-1] - stamps[-2])]
    return [i for i, (a, b) in enumerate(zip(stamps.tolist(), ends, strict=True)) for _ in range(a, b, MS)]


def true_column(truth: Truth, stamp: int) -> int:
    for row in truth.intervals:
        if row.start_ns <= stamp <= row.end_ns:
            return UNSCORED if row.contact is None else STATES.index(row.contact)
    return UNSCORED


@settings(max_examples=8, deadline=None)
@given(SEEDS, st.booleans())
def test_sums_agree_with_every_millisecond(seed: int, online: bool) -> None:
    scored, truth, stamps, ticks, labels, p = random_case(seed, unscored=True)
    tick = (tick_in_force if online else tick_containing)(stamps, ticks)
    result = tally(scored, tick, labels, p)
    seconds = right = log_loss = brier = sure_wrong = near_s = 0.0
    bins: dict[int, list[tuple[float, bool]]] = {}
    column = [true_column(truth, int(s)) for s in stamps]
    known = [i for i, c in enumerate(column) if c >= 0]
    changes = [(stamps[i + 1], stamps[j]) for i, j in pairwise(known) if column[i] != column[j]]
    used: dict[int, int] = {}
    for frame in per_ms(stamps):
        used[frame] = used.get(frame, 0) + 1
        if used[frame] > 100 or column[frame] < 0:
            continue
        if online:
            reported = [k for k, t in enumerate(ticks) if t <= stamps[frame]][-1:]
        else:
            reported = [k for k, t in enumerate(ticks) if t >= stamps[frame]][:1]
        belief = p[reported[0]] if reported else np.full(7, 1 / 7)
        label = int(labels[reported[0]]) if reported else None
        is_top = bool(reported) and int(np.argmax(belief)) == column[frame]
        seconds += 1e-3
        right += 1e-3 * (label == column[frame])
        log_loss -= 1e-3 * np.log(max(belief[column[frame]], 1e-12))
        brier += 1e-3 * sum((belief[k] - (k == column[frame])) ** 2 for k in range(7))
        sure_wrong += 1e-3 * (max(belief) > 0.9 and not is_top)
        bins.setdefault(min(int(max(belief) * 15), 14), []).append((float(max(belief)), is_top))
        near_s += 1e-3 * any(a - 250 * MS <= stamps[frame] <= b + 250 * MS for a, b in changes)
    assert result.seconds() == pytest.approx(seconds)
    assert result.seconds(Subset.CLEAR) == pytest.approx(seconds - near_s)
    assert result.seconds(Subset.IDENTIFIABLE) + result.seconds(Subset.AMBIGUOUS) == pytest.approx(seconds)
    if seconds:
        gaps = [abs(sum(t for _, t in rows) - sum(c for c, _ in rows)) * 1e-3 for rows in bins.values()]
        assert result.accuracy() == pytest.approx(right / seconds)
        assert result.log_loss == pytest.approx(log_loss / seconds)
        assert result.brier == pytest.approx(brier / seconds)
        assert result.sure_wrong == pytest.approx(sure_wrong / seconds)
        assert result.calibration_error == pytest.approx(sum(gaps) / seconds)


@settings(max_examples=8, deadline=None)
@given(SEEDS)
def test_changes_agree_with_every_millisecond(seed: int) -> None:
    scored, truth, stamps, ticks, labels, p = random_case(seed, unscored=False)
    tick = tick_in_force(stamps, ticks)
    result = tally(scored, tick, labels, p)
    column = [true_column(truth, int(s)) for s in stamps]
    found = [int(labels[k]) if k >= 0 else -1 for k in tick]
    at = per_ms(stamps)
    true_ms, found_ms = [column[i] for i in at], [found[i] for i in at]
    # frames after the truth's end are not scored: phases are runs of equal truth, cut there
    edges = [0, *(t for t in range(1, len(at)) if true_ms[t] != true_ms[t - 1]), len(at)]
    phases = [(a, b) for a, b in pairwise(edges) if true_ms[a] >= 0]
    boundary, delay = [], []
    for (a, b), (_, c) in pairwise(phases):
        if b - a < 300 or c - b < 300:
            continue
        into = true_ms[b]
        turns = [t for t in range(a + 1, c) if found_ms[t] == into and found_ms[t - 1] != into]
        boundary.append(min((abs(t - b) for t in turns), default=None))
        lasting = (t for t in range(b, c - 299) if all(found_ms[u] == into for u in range(t, t + 300)))
        delay.append(next((t - b for t in lasting), None))
    for found_s, expected_ms in ((result.boundary_error_s, boundary), (result.detection_delay_s, delay)):
        expected = [np.nan if ms is None else ms * 1e-3 for ms in expected_ms]
        assert found_s == pytest.approx(expected, nan_ok=True)


@settings(max_examples=20, deadline=None)
@given(SEEDS, SEEDS)
def test_adding_recordings_is_concatenating_them(seed_a: int, seed_b: int) -> None:
    def recording(seed: int) -> tuple[Ints, Truth, Ints, Array]:
        rng = np.random.default_rng(seed)
        middle = [(str(rng.choice(["f-f", "?", "e-e"])), int(rng.integers(50, 700))) for _ in range(4)]
        truth = make_truth(("free", 400), *middle, ("free", 400))
        length = 800 + sum(ms for _, ms in middle)
        stamps = frames(length + 20)  # the last frames are outside the truth: no weight depends on later ones
        labels = np.repeat(rng.integers(0, 7, len(stamps)), 20)[: len(stamps)]
        return stamps, truth, labels, rng.dirichlet(np.full(7, 0.3), len(stamps))

    both = recording(seed_a), recording(seed_b)
    first, second = (tally_of(scoring(stamps, truth), *found) for stamps, truth, *found in both)
    separate, ((stamps_a, truth_a, labels_a, p_a), (stamps_b, truth_b, labels_b, p_b)) = first + second, both
    later = int(stamps_a[-1] - stamps_b[0]) + 60_000 * MS
    moved = [replace(i, start_ns=i.start_ns + later, end_ns=i.end_ns + later) for i in truth_b.intervals]
    whole = scoring(np.append(stamps_a, stamps_b + later), Truth(truth_a.intervals + tuple(moved)))
    together = tally_of(whole, np.append(labels_a, labels_b), np.vstack([p_a, p_b]))
    assert figures(together) == pytest.approx(figures(separate), nan_ok=True)
    assert together.delay_s == pytest.approx(separate.delay_s)
    assert together.boundary_s == pytest.approx(separate.boundary_s)
