"""Calibration by the command: from files to a model and a report, or one line of error."""

import re
import shutil
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import starmap
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from chain_oracle import NOTHING, random_model
from contact_tracker import __version__
from contact_tracker.cli.main import run
from contact_tracker.config.loading import load_model
from contact_tracker.motion.poses import Poses
from contact_tracker.recording import open_log, read_truth, write_recording
from contact_tracker.states import Contact
from contact_tracker_lab.calibration.calibrate import Plan, Source, calibrate, score_model
from contact_tracker_lab.calibration.parameters import model_text, select
from contact_tracker_lab.simulate import Scenario, simulate
from contact_tracker_lab.simulate.scenarios import Phase

MODEL = load_model()


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of three short labelled recordings at 50 Hz."""
    folder = tmp_path_factory.mktemp("logs")
    walks = ("f-f e-f", "e-f f-f", "f-f f-e")
    for number, walk in enumerate(walks):
        phases = tuple(Phase(Contact(name), 1.8) for name in walk.split())
        made = simulate(Scenario(phases, rate_hz=50.0), number)
        write_recording(str(folder / f"log_{number}.mcap"), made.poses, made.truth, made.metadata)
    return folder


@pytest.fixture
def unlabelled(logs: Path, tmp_path: Path) -> Path:
    """One of them without its truth."""
    poses = Poses.collect(open_log(str(logs / "log_0.mcap")))
    write_recording(str(tmp_path / "unlabelled.mcap"), poses, None, {})
    return tmp_path / "unlabelled.mcap"


def refused(capsys: pytest.CaptureFixture[str], code: int, *arguments: object) -> str:
    """The error line of a call, which must not write anything."""
    assert run(["calibrate", *map(str, arguments)]) == code
    out, err = capsys.readouterr()
    assert out == ""
    (line,) = [line for line in err.splitlines() if "warning" not in line]
    assert line.startswith("contact-tracker: error: ")
    return line


def test_a_model_is_learned_and_its_file_says_from_what(
    logs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copytree(logs, tmp_path / "logs")
    options = ["--folds", "0", "--processes", "1", "-o", "mine.toml", "--only", "transitions"]
    command = ["calibrate", "logs", *options]
    assert run([*command, "noise"]) == 0
    out, _ = capsys.readouterr()
    text = (tmp_path / "mine.toml").read_text(encoding="utf-8")
    header = " ".join(line.removeprefix("# ") for line in text.splitlines() if line.startswith("#"))
    assert f"contact-tracker {__version__}" in header
    assert "contact-tracker calibrate logs --only transitions noise -o mine.toml" in header
    assert "3 recordings, 3 with truth: log_0.mcap log_1.mcap log_2.mcap" in header
    assert str(tmp_path) not in text
    assert not re.search(r"\b20\d\d\b", text)  # no date
    model = load_model("mine.toml")
    assert model.name == "mine"
    assert np.argwhere(np.array(model.transitions.counts.changes) > 0.5).tolist() == [[0, 1], [0, 2], [1, 0]]
    assert model.transitions.counts.begins == (2.0, 1.0, *(0.0,) * 5)
    assert 6.0 < sum(model.transitions.counts.moving_s) < 3 * 3.8
    assert model.search == MODEL.search
    weight = f"{MODEL.transitions.prior_changes:g} changes"
    assert all(word in out for word in ("3 recordings", "noise.sigma_position_m", weight))
    # the same data give the same model, also from a learned one
    shutil.copy("mine.toml", "before.toml")
    assert run([*command, "--start", "before.toml"]) == 0
    later = load_model("mine.toml")
    counted, again = (one.transitions.counts.moving_s for one in (model, later))
    np.testing.assert_allclose(again, counted, rtol=0.02)
    assert later.noise == model.noise


def run_all(function: Callable[..., Any], jobs: Sequence[tuple[Any, ...]]) -> list[Any]:
    """Each job in this process."""
    return list(starmap(function, jobs))


def test_held_out_recordings_are_scored_by_models_not_trained_on_them(logs: Path, unlabelled: Path) -> None:
    names = sorted(map(str, logs.glob("*.mcap")))
    sources = (Source(names[0]), Source(names[1]), Source(str(unlabelled)))
    calibration = calibrate(Plan(sources, MODEL, select(["transitions"]), 2), run_all)
    assert [study.counts is not None for study in calibration.studies] == [True, True, False]
    assert calibration.model.noise == MODEL.noise
    assert len(calibration.held_out) == 2
    other = calibrate(Plan(sources[:1], MODEL, select(["transitions"]), 0), run_all)
    again = score_model(sources[1], other.model)
    assert again is not None
    before, after = calibration.held_out[1]
    assert after.offline.log_loss == pytest.approx(again.offline.log_loss)
    assert after.offline.log_loss != before.offline.log_loss
    for which, loss in enumerate(calibration.log_loss):
        tallies = [one for pair in calibration.held_out for one in (pair[which].online, pair[which].offline)]
        lost = sum(one.log_loss_s for one in tallies)
        assert loss == pytest.approx(lost / sum(one.seconds() for one in tallies))


@pytest.mark.long
def test_folds_are_reported(logs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    two = [str(logs / "log_0.mcap"), str(logs / "log_1.mcap")]
    output = tmp_path / "mine.toml"
    alone = ["--processes", "1"]
    assert run(["calibrate", *two, "--only", "transitions", *alone, "-o", str(output)]) == 0
    out, err = capsys.readouterr()
    rows = [line.split() for line in out.splitlines() if line.startswith(("smoothed", "filtered"))]
    cases = [[mode, when] for when in ("before", "after") for mode in ("smoothed", "filtered")]
    assert [row[:2] for row in rows] == cases
    assert all(float(number) >= 0.0 for row in rows for number in row[2:])
    assert f"wrote {output}" in err


def test_without_truth_the_noise_is_learned(unlabelled: Path, tmp_path: Path) -> None:
    output = tmp_path / "mine.toml"
    assert run(["calibrate", str(unlabelled), "--only", "noise", "--folds", "0", "-o", str(output)]) == 0
    learned = load_model(str(output))
    assert learned.noise.sigma_position_m != MODEL.noise.sigma_position_m
    assert learned.transitions == MODEL.transitions


@pytest.mark.parametrize(
    ("arguments", "code", "parts"),
    [
        (["LOGS", "-o", "folder.toml"], 2, ["folder.toml", "it is a folder"]),
        (["LOGS", "--only", "nose", "-o", "m.toml"], 2, ["nose", "noise.sigma_position_m"]),
        (["LOGS", "--start", "unheard_of", "-o", "m.toml"], 2, ["unheard_of", "default"]),
        (["LOGS", "--folds", "4", "-o", "m.toml"], 2, ["--folds 4 of 3 recordings"]),
        (["LOGS", "--folds", "1", "-o", "m.toml"], 2, ["--folds", "above 1"]),
        (["-", "-o", "m.toml"], 2, ["calibrate", "file"]),
        (["folder.toml", "-o", "m.toml"], 1, ["folder.toml", "holds no recording (.mcap"]),
        (["UNLABELLED", "--folds", "0", "-o", "m.toml"], 1, ["no recording has truth: --only noise"]),
    ],
)
def test_impossible_calls_are_one_line_and_leave_no_file(
    arguments: list[str],
    code: int,
    parts: list[str],
    logs: Path,
    unlabelled: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(unlabelled.parent)
    (unlabelled.parent / "folder.toml").mkdir()
    places = {"LOGS": str(logs), "UNLABELLED": str(unlabelled)}
    line = refused(capsys, code, *(places.get(word, word) for word in arguments))
    assert all(part in line for part in parts), line
    assert {path.name for path in unlabelled.parent.iterdir()} == {"unlabelled.mcap", "folder.toml"}


def test_short_recordings_do_not_change_the_transitions(logs: Path, tmp_path: Path) -> None:
    log, truth = tmp_path / "short.mcap", read_truth(str(logs / "log_0.mcap"))
    for count in (1, 2):
        few = Poses.collect(open_log(str(logs / "log_0.mcap")))[:count]
        write_recording(str(log), few, truth, {})
        calibration = calibrate(Plan((Source(str(log)),), MODEL, select(["transitions"]), 0), run_all)
        assert sum(calibration.model.transitions.counts.moving_s) == 0.0


def test_the_readable_part_of_a_damaged_recording_is_learned_from(
    logs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    damaged, output = tmp_path / "damaged.mcap", tmp_path / "mine.toml"
    damaged.write_bytes((logs / "log_0.mcap").read_bytes()[:-400])
    code = run(["calibrate", str(damaged), "--only", "transitions", "--folds", "0", "-o", str(output)])
    assert code == 3
    assert "damaged.mcap" in capsys.readouterr().err
    load_model(str(output))


names = st.text(st.characters(exclude_categories=("C", "Zl", "Zp", "Zs")), max_size=30)
positive = st.floats(1e-9, 1e6)


@settings(max_examples=25, deadline=None)
@given(name=names, seed=st.integers(0, 2**32 - 1), sigma=positive, empty=st.booleans(), header=st.text())
def test_a_written_model_is_the_model(tmp_path_factory, name, seed, sigma, empty, header):
    counts = NOTHING if empty else random_model(np.random.default_rng(seed)).transitions.counts
    noise = replace(MODEL.noise, sigma_position_m=sigma)
    model = replace(MODEL, name=name, noise=noise, transitions=replace(MODEL.transitions, counts=counts))
    path = tmp_path_factory.mktemp("written") / "model.toml"
    path.write_text(model_text(model, [header, "a\nb"]), encoding="utf-8")
    assert load_model(str(path)) == model
