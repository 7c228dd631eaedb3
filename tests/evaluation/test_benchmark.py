"""The benchmark: lags, other methods and tables, by brute force or by hand, on short data."""

from operator import add
from pathlib import Path

import numpy as np
import pytest

from contact_tracker.errors import UsageError
from contact_tracker.ground_truth import Truth
from contact_tracker.states import STATES, Contact
from contact_tracker_lab.benchmark import benchmark, bic, fixed_windows, others, tracked
from contact_tracker_lab.benchmark.fixed_windows import Windows
from contact_tracker_lab.benchmark.scores import OFFLINE, Answer, Method, Score
from contact_tracker_lab.evaluation.scoring import Scoring, Subset, scoring
from short_recordings import FACE_TO_EDGE, MODEL, recorded

SECOND = 1_000_000_000


def truth_of(*phases: tuple[str, float]) -> Truth:
    """Phases of (label, seconds)."""
    *starts, end = np.cumsum([0, *(round(seconds * SECOND) for _, seconds in phases)]).tolist()
    return Truth.from_changes(starts, [label for label, _ in phases], end - 1)


def stamps(seconds: float, every_s: float = 0.01) -> np.ndarray:
    return np.arange(0, round(seconds * SECOND), round(every_s * SECOND), dtype=np.int64)


def windows_at(
    end_s: list[float], half_s: float, scored: Scoring, log_minimum: np.ndarray | None = None
) -> Windows:
    values = np.zeros((len(end_s), 6)) if log_minimum is None else log_minimum
    end_ns = np.array([round(s * SECOND) for s in end_s], np.int64)
    return Windows(scored, end_ns, np.exp(values), values, round(half_s * SECOND), 0.1)


def test_each_frame_is_labelled_by_the_right_window() -> None:
    frame = stamps(8.0, 0.5)
    windows = windows_at([5.0, 6.0, 7.0], 2.5, scoring(frame, truth_of(("f-f", 8.0))))
    by_second = {s: i for i, s in enumerate((frame / SECOND).tolist())}
    online, offline = map(windows.ticks, (0.0, OFFLINE))
    assert [online[by_second[s]] for s in (4.5, 5.0, 5.5, 7.5)] == [-1, 0, 0, 2]
    # offline, the one whose middle (2.5, 3.5 or 4.5 s) is nearest
    assert [offline[by_second[s]] for s in (0.0, 2.5, 3.5, 4.5, 7.5)] == [0, 0, 1, 2, 2]


def recorded_windows(seed: int, noise: float) -> Windows:
    """8 s of f-f, e-f and free; each state has its own level of the minima."""
    rng = np.random.default_rng(seed)
    scored = scoring(stamps(8.0), truth_of(("f-f", 3.0), ("e-f", 2.0), ("free", 3.0)))
    end_s = np.arange(10, 80) / 10
    level = scored.truth[np.searchsorted(scored.stamp_ns, np.round((end_s - 0.5) * SECOND))]
    values = level[:, None] / 2.0 + noise * rng.normal(size=(len(end_s), 6))
    return windows_at(end_s.tolist(), 0.5, scored, values)


def test_an_hmm_that_learned_on_some_recordings_is_right_on_others() -> None:
    tuning, test = ([recorded_windows(seed, 0.1) for seed in seeds] for seeds in ((0, 1), (2, 3)))
    short = windows_at([], 0.5, scoring(stamps(0.5), truth_of(("f-f", 0.5))))
    *scores, nothing = fixed_windows.hmm_scores([*test, short], tuning, MODEL)
    for by_method in scores:
        offline = by_method[Method(fixed_windows.HMM, OFFLINE)].main
        assert offline.accuracy() > 0.98
        assert offline.boundary_s.max() < 0.2
        online = by_method[Method(fixed_windows.HMM, 0.0)].main
        # in the first second no window is full, and then it is half a second late, as windows are
        assert online.confusion_s[Subset.ALL, Contact.FF.column, -1] == pytest.approx(1.0)
        assert online.accuracy() < offline.accuracy()
    assert {score.main.accuracy() for score in nothing.values()} == {0.0}
    assert {round(score.main.log_loss, 9) for score in nothing.values()} == {round(np.log(7), 9)}
    both = add(*(one[Method(fixed_windows.HMM, 0.0)] for one in scores))
    assert both.main.seconds() == pytest.approx(16.0)
    untrained = fixed_windows.hmm_scores(test, [], MODEL)
    assert {score.main.accuracy() for one in untrained for score in one.values()} == {0.0}


def test_the_criterion_by_hand() -> None:
    chi_sq, parameters = np.zeros(7), np.array([5, 7, 7, 6, 6, 8, 0])
    exact = bic.criteria(chi_sq, parameters, 100)
    assert STATES[int(exact.argmax())] is Contact.FF
    assert exact[0] == pytest.approx(-0.5 * (5 + 100 * 3) * np.log(100))
    assert exact[6] == pytest.approx(-0.5 * 100 * 6 * np.log(100))
    # v-f has 100 - 6 parameters fewer than free: the largest misfit that is tolerated
    saved = (100 - 6) * np.log(100)
    for misfit, best in ((saved - 1, Contact.VF), (saved + 1, Contact.FREE)):
        chi_sq = np.where(np.arange(7) == Contact.VF.column, misfit, np.where(np.arange(7) == 6, 0.0, 1e6))
        found = bic.criteria(chi_sq, parameters, 100)
        assert STATES[int(found.argmax())] is best
        assert found[Contact.VF.column] - found[6] == pytest.approx((saved - misfit) / 2)


@pytest.mark.long
def test_a_short_recording_by_every_method() -> None:
    simulated = recorded(FACE_TO_EDGE)
    poses = simulated.poses[:1200]
    scored, ticks = scoring(poses.stamp_ns, simulated.truth), bic.Ticks.of(poses, MODEL)
    answers = {
        **{method: label(poses) for method, label in tracked.methods(MODEL).items()},
        **fixed_windows.smallest_answers(Windows.of(poses, scored)),
        **bic.on_windows(poses, scored, ticks),
        **bic.between_change_points(poses, scored, ticks),
        **bic.on_true_segments(poses, scored, ticks),
        Method(others.STILL, 0.0): others.answer_by_speed(poses),
    }
    scores = {method: Score.of(answer, scored).main for method, answer in answers.items()}
    right = {method: score.accuracy() for method, score in scores.items()}
    tracker = {method.when: accuracy for method, accuracy in right.items() if method.name == tracked.NAME}
    assert tracker["offline"] > 0.95
    assert tracker["online"] < tracker["lag 1 s"]
    assert right[Method(bic.SEGMENTS, OFFLINE)] == pytest.approx(1.0)
    assert right[Method(bic.CHANGES, OFFLINE)] > 0.9
    assert right[Method(others.STILL, 0.0)] < 0.5  # it is moved all the time
    online = {m.name: score for m, score in scores.items() if m.wait_s == 0}
    for name in (fixed_windows.SMALLEST, bic.WINDOWS):
        # the first window of 500 frames is full after 2.5 s
        unanswered_s = online[name].confusion_s[Subset.ALL, :, -1].sum()
        assert unanswered_s == pytest.approx(499 * 0.005, abs=0.02)
    assert online[tracked.NAME].log_loss < online[fixed_windows.SMALLEST].log_loss


OWN_METHOD = """
import numpy as np

def always_free(stamp_ns, position_m, quat_xyzw):
    assert position_m.shape == (len(stamp_ns), 3) and quat_xyzw.shape == (len(stamp_ns), 4)
    return ["free"] * len(stamp_ns)
"""


def test_others_add_a_function_or_labels(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder, labels, script = tmp_path / "recordings", tmp_path / "theirs", tmp_path / "own.py"
    for place in (folder / "short", labels):
        place.mkdir(parents=True)
    shipped = Path(__file__).parents[2] / "recordings" / "all_states.mcap"
    (folder / "short" / "one_01.mcap").write_bytes(shipped.read_bytes())
    (labels / "one_01.csv").write_text("start,end,contact\n0,1000,free\n")
    script.write_text(OWN_METHOD)
    asked = [str(folder), "--method", f"{script}:always_free", "--labels", str(labels), "--processes", "1"]
    assert benchmark.main([*asked, "--only", others.STILL]) == 0
    header, *rows = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert header[:3] == ["method", "when", "short"]
    assert {row[0] for row in rows} == {"speed", asked[2], "theirs"}
    theirs, function = (next(row for row in rows if row[0] == name) for name in ("theirs", asked[2]))
    assert float(theirs[2]) == float(function[2]) > 0.05  # the share of the time in which it is free
    assert float(theirs[-1]) < 0.1  # CPU time is that of the row
    with pytest.raises(SystemExit):
        benchmark.main([str(folder), "--only", "trakcer", "--processes", "1"])
    assert "no method is tracker;" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("found", "message"),
    [
        (["up"] * 3, "no contact 'up'"),
        (["free"] * 2, r"\(2,\) for 3 poses"),
        (np.full((3, 7), 0.5), "add up to 1"),
    ],
)
def test_what_is_no_answer_is_refused(found: object, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        others.answer_of(found, 3, "own.py:label")


def test_probabilities_and_missing_labels_are_answers() -> None:
    probability = np.eye(7)[[6, 0, 3]]
    assert others.answer_of(probability, 3, "own").label.tolist() == [6, 0, 3]
    some = others.answer_of(["", "f-f", "free"], 3, "own")
    assert (some.tick.tolist(), some.label[1:].tolist()) == ([-1, 1, 2], [0, 6])


def test_splits_and_takes_are_by_name() -> None:
    takes = [Path(f"{scene}_{take}.mcap") for scene in ("book", "mug") for take in (20, 21, 22)]
    assert [benchmark.split_of(path) for path in takes[:3]] == ["tuning", "test", "tuning"]
    earlier = [benchmark.earlier_take(path, takes) for path in takes]
    assert earlier == [None, takes[0], takes[0], None, takes[3], takes[3]]
    no_takes = [Path("paper_00.mcap"), Path("paper_01.mcap")]
    assert benchmark.earlier_take(no_takes[1], no_takes) is None


def test_intervals_have_the_width_of_a_binomial_share() -> None:
    """The standard deviation of a share p of n phases is sqrt(p (1 - p) / n)."""
    for phases in (30, 270):
        column = np.arange(phases) % 2
        scored = scoring(stamps(float(phases), 0.05), truth_of(*((STATES[c], 1.0) for c in column)))
        label = np.where(np.random.default_rng(2).random(phases) < 0.7, column, 2)
        answer = Answer.certain(np.repeat(np.arange(phases), 20), label)
        score = Score.of(answer, scored)
        p = score.main.accuracy()
        assert score.phase_s[:, 1].sum() / score.phase_s[:, 0].sum() == pytest.approx(p)
        low, high = score.band()
        width = 2 * 1.645 * np.sqrt(p * (1 - p) / phases)
        assert high - low == pytest.approx(width, rel=0.15)
        assert low < p < high
    twice = (score + score).band()
    assert twice[1] - twice[0] == pytest.approx(width / np.sqrt(2), rel=0.15)
    assert np.isnan(Score.of(answer, scored.within(Subset.AMBIGUOUS)).band()).all()
