"""A user's own labels: the files in which they come, what they mean, and how a result compares with them."""

import json
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas
import pytest

import contact_tracker
from contact_tracker import Trajectory
from contact_tracker.cli.main import run
from contact_tracker.errors import ChoiceError, NoTruth, UsageError
from contact_tracker.ground_truth import Truth
from contact_tracker.recording import read_labels
from contact_tracker.recording.annotations import meanings_of
from contact_tracker.states import CONTACTS, STATES, Contact
from contact_tracker_lab.evaluation.metrics import tally
from contact_tracker_lab.evaluation.scoring import scoring
from mcap_logs import poses_topic, smooth_poses, write_log

FIRST_NS, LAST_NS = 1_700_000_000 * 10**9, 1_700_000_010 * 10**9
MAP = {"touch": "any", "flat": "f-f|e-f", "unclear": "?"}


def read(path: Path, text: str, meanings: dict[str, str] | None = None, encoding: str = "utf-8") -> Truth:
    path.write_text(text, encoding)
    return read_labels(str(path), FIRST_NS, LAST_NS, meanings)[0]


EXPECTED = [(0, 2_000, Contact.FREE), (2_500, 10_000, Contact.EF)]
REGIONS = [
    {"value": {"start": start, "end": end, "timeserieslabels": [name]}}
    for start, end, name in ((0, 2, "free"), (2.5, 10, "e-f"))
]
FILES = {
    "commas": "start,end,contact\n0,2,free\n2.5,10,e-f\n",
    "spreadsheet": "Start (ms);End (ms);Label\n2500;10000;e-f\n0;2000;free\n",
    "ELAN": "Tier\tBegin Time - ss.msec\tEnd Time - ss.msec\tAnnotation\n"
    "x\t0.0\t2.0\tfree\nx\t2.500\t10.000\te-f\n",
    "durations": "onset,duration,trial_type\n0,2,free\n2.5,7.5,e-f\n",
    "clock": "begin,stop,label\n0:00.0,0:02,free\n0:00:02.5,0:10,e-f\n",
    "stamps": f"start_ns,end_ns,contact\n{FIRST_NS},{FIRST_NS + 2 * 10**9},free\n"
    f"{FIRST_NS + 25 * 10**8},{LAST_NS},e-f\n",
    "Label Studio": json.dumps([{"annotations": [{"result": REGIONS}]}]),
}
ENCODINGS = {"commas": "utf-8-sig", "spreadsheet": "utf-16"}


@pytest.mark.parametrize("kind", FILES)
def test_files_of_labels(tmp_path: Path, kind: str) -> None:
    truth = read(tmp_path / "labels.csv", FILES[kind], encoding=ENCODINGS.get(kind, "utf-8"))
    found = [(interval.start_ns, interval.end_ns + 1, interval.contact) for interval in truth.intervals]
    assert found == [(FIRST_NS + s * 10**6, FIRST_NS + e * 10**6, contact) for s, e, contact in EXPECTED]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("start,end\n0,1\n", "its columns are start, end: needed are start, end .or duration. and contact"),
        ("start,end,contact\n", "it has no label"),
        ("start,end,contact\n0,2,free\n1,3,e-f\n", "free and e-f overlap at 1 s"),
        ("start,end,contact\n3,2,free\n", "free ends at 2, before it starts at 3"),
        ("start,end,contact\na,2,free\n", "'a' is no time"),
        ("start,end,contact\n0,2\n", "row 2 has 2 values"),
        ("start,end,contact\n100000,100001,free\n", "name their unit, as in start_ms"),
        ("[1", "it is no JSON"),
        ("0,1.5,f-f\n1.5,2,free\n", "as start,end,contact"),
        ("0.000000\t1.500000\tf-f\n", "as start,end,contact"),
        (
            "MATLAB 5.0 MAT-file\0\1IM,",
            "labels.csv: it is no text: labels are a table in text, as CSV, or JSON",
        ),
        ("", "it is empty"),
    ],
)
def test_what_is_no_table_of_labels_is_refused(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(NoTruth, match=message):
        read(tmp_path / "labels.csv", text)


def test_labels_that_mean_nothing_known_are_refused(tmp_path: Path) -> None:
    text = "start,end,contact\n0,2,touch\n"
    said = "the label 'touch' is no state: say which it is, as in meanings={'touch': 'any'}: "
    with pytest.raises(ChoiceError, match=said):
        read(tmp_path / "labels.csv", text)
    several = "start,end,contact\n0,2,ff\n2,3,lift\n"
    said = r"the labels 'ff', 'lift' are no states: .*\{'ff': 'any', 'lift': 'any'\}.*; did you mean f-f\?"
    with pytest.raises(ChoiceError, match=said):
        read(tmp_path / "labels.csv", several)
    with pytest.raises(ChoiceError, match="no label tuoch; did you mean touch"):
        read(tmp_path / "labels.csv", text, {"touch": "any", "tuoch": "any"})
    with pytest.raises(ChoiceError, match="a label means states as in touch=any, not 'touch'"):
        meanings_of(["touch"])
    assert meanings_of(["a=b=any", "x=f-f|e-f"]) == {"a=b": "any", "x": "f-f|e-f"}


def test_coarse_labels_are_right_with_each_of_their_states(tmp_path: Path) -> None:
    """Labels at 100 Hz: f-f to 2 s, e-f to 5 s, free to 10 s; touch is true to 5.5 s."""
    text = "start,end,label\n0,3,flat\n3,5.5,touch\n5.5,9,free\n9,10,unclear\n"
    truth = read(tmp_path / "a.csv", text, MAP)
    states = [interval.coarse.states for interval in truth.intervals if interval.coarse]
    assert states == [(Contact.FF, Contact.EF), CONTACTS]
    stamps = FIRST_NS + np.arange(0, 10 * 10**9, 10**7)
    found = np.repeat([STATES.index(one) for one in (Contact.FF, Contact.EF, Contact.FREE)], [200, 300, 500])
    result = tally(scoring(stamps, truth), np.arange(1000), found, 0.93 * np.eye(7)[found] + 0.01)
    assert result.seconds() == pytest.approx(9.0)
    assert result.accuracy() == pytest.approx(8.5 / 9)
    assert result.rows == (*STATES, "flat", "touch")
    confusion = {name: row for name, row in zip(result.rows, result.confusion_s[0], strict=True) if row.any()}
    assert confusion["flat"][[0, 1, 6]] == pytest.approx([2.0, 1.0, 0.0])
    assert confusion["touch"][[0, 1, 6]] == pytest.approx([0.0, 2.0, 0.5])
    assert result.recall[[6, 7, 8]] == pytest.approx([1.0, 1.0, 0.8])
    assert result.f1[[6, 7, 8]] == pytest.approx([7 / 7.5, 1.0, 4 / 4.5])  # flat is also a touch
    assert result.boundary_error_s == pytest.approx([np.nan, 0.5], nan_ok=True)
    assert result.detection_delay_s == pytest.approx([0.0, 0.0])
    assert result.calibration[:, 0].sum() == pytest.approx(9.0)


def test_results_and_commands_compare_with_labels(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    poses = smooth_poses(200)
    log = write_log(tmp_path / "a.mcap", [poses_topic(poses, "/a")])
    labels = tmp_path / "labels.csv"
    labels.write_text("start,end,contact\n0,0.5,touch\n0.5,0.9,air\n")
    options = ["--meaning", "touch=any", "--map", "air=free"]  # its former name
    assert run(["evaluate", str(log), "--labels", str(labels), *options, "--json"]) == 0
    shown = capsys.readouterr()
    assert "label times are taken since the first pose (2 labels)" in shown.err
    total = json.loads(shown.out)["total"]
    result = contact_tracker.segment(contact_tracker.read(log))
    own = contact_tracker.evaluate(result, result.to_pandas("segments"))
    assert own.total.offline.accuracy() == 1.0
    table = pandas.DataFrame({"start": [0.0, 0.5], "end": [0.5, 0.9], "contact": ["touch", "air"]})
    durations = {name: pandas.to_timedelta(table[name], "s") for name in ("start", "end")}
    for times in (table, table.assign(**durations)):
        alike = contact_tracker.evaluate(result, times, {"touch": "any", "air": "free"})
        assert alike.total.offline.accuracy() == pytest.approx(total["offline"]["accuracy"]["all"])
    with pytest.raises(NoTruth, match="labels: its columns are start, end: needed are"):
        contact_tracker.evaluate(result, table[["start", "end"]])
    report = contact_tracker.evaluate(result, labels, {"touch": "any", "air": "free"}, by_arrival=True)
    assert report.total.offline.accuracy() == pytest.approx(total["offline"]["accuracy"]["all"])
    assert report.total.online.accuracy() == pytest.approx(total["online"]["accuracy"]["all"])
    assert report.total.offline.seconds() == pytest.approx(0.9, abs=0.01)
    assert total["arrival"]["scored_s"] == pytest.approx(0.9, abs=0.01)
    assert report.total.arrival is not None
    assert "touch" in str(report)
    for name in ("identifiable", "ambiguous", "moved"):  # labels do not say how the object moved
        assert total["offline"]["accuracy"][name] is None
        assert total["offline"]["subset_s"][name] is None
        assert name not in str(report).splitlines()[0]
    other = write_log(tmp_path / "b.mcap", [poses_topic(poses, "/a")])
    assert run(["evaluate", str(log), str(other), "--labels", str(labels)]) == 2
    assert "--labels are of one recording" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("table", "error", "message"),
    [
        (pandas.DataFrame([[0.0, 0.5, "free"]]), NoTruth, "its columns are 0, 1, 2: needed are start"),
        (pandas.DataFrame([[0, 1, 2]], columns=["start", "end", "end"]), UsageError, "two columns are end"),
        (pandas.DataFrame([[0, 1]], columns=[0, "0"]), UsageError, "two columns are 0: name each"),
        ({"start": [0.0], "end": [0.5, 1.0], "contact": ["free"]}, UsageError, "lists of one length"),
        ({"start": 0.0, "end": 0.5, "contact": "free"}, UsageError, "lists of one length"),
    ],
)
def test_tables_that_are_none_of_labels(table: Any, error: type[Exception], message: str) -> None:
    result = contact_tracker.segment(Trajectory(smooth_poses(20)))
    for take in (result.plot, partial(contact_tracker.evaluate, result)):
        with pytest.raises(error, match=message):
            take(labels=table)


def test_labels_of_a_figure_are_read_before_any_work(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    poses = smooth_poses(400)
    slow = replace(poses, stamp_ns=poses.stamp_ns[0] + np.arange(400) * 10**9 // 4)  # labels go on for 99 s
    log = write_log(tmp_path / "a.mcap", [poses_topic(slow, "/a")])
    labels, words = tmp_path / "labels.csv", ["--meaning", "touch$\\frac$=any", "-o", str(tmp_path / "a.svg")]
    labels.write_text("start,end,contact\n0,1.5,touch$\\frac$\n90,99,free\n")
    command = ["segment", str(log), "--labels", str(labels), "--duration", "2", *words]
    assert run(command) == 0, capsys.readouterr().err
    assert "touch" in (tmp_path / "a.svg").read_text()

    def refuse(*_: object, **__: object) -> None:
        raise AssertionError

    monkeypatch.setattr("contact_tracker.segmenting.OfflineTracker.pieces", refuse)
    labels.write_text("start,end,contact\n0,1.5,contct\n")
    assert run(command) == 2
    assert "'contct' is no state: say which it is, as in --meaning 'contct=any': " in capsys.readouterr().err
    assert run(["segment", "-", *command[2:]]) == 2
    assert "--labels reads the recording twice" in capsys.readouterr().err
