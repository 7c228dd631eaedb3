"""No command overwrites its inputs, nor a recording without ``--overwrite``."""

import io
import os
import sys
from pathlib import Path

import numpy as np
import pyarrow
import pytest
import zstandard
from pyarrow import csv as arrow_csv
from pyarrow import parquet

from contact_tracker import files
from contact_tracker.cli.main import run
from contact_tracker.config import shipped
from contact_tracker.ground_truth import Truth
from contact_tracker.recording import write_recording
from mcap_logs import START_NS, smooth_poses

MESH = """v 0 0 0
v 1 0 0
v 0 1 0
v 0 0 1
f 1 3 2
f 1 2 4
f 2 3 4
f 1 4 3
"""
KNOWN = '[object.mesh]\npath = "meshes/part.obj"\n[[environment.mesh]]\nname = "block"\npath = "block.obj"\n'


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A recording, a folder of parts, a model and a map with meshes."""
    poses = smooth_poses()
    truth = Truth.from_changes([START_NS], ["free"], int(poses.stamp_ns[-1]))
    (tmp_path / "parts").mkdir()
    (tmp_path / "meshes").mkdir()
    for name in ("log.mcap", "parts/log_0.mcap", "parts/log_1.mcap"):
        write_recording(str(tmp_path / name), poses, truth, {})
    (tmp_path / "model.toml").write_bytes((shipped() / "default.toml").read_bytes())
    (tmp_path / "known.toml").write_text(KNOWN)
    for name in ("meshes/part.obj", "block.obj"):
        (tmp_path / name).write_text(MESH)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def refusal(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """The one line with which a command refuses, having changed no file."""
    before = {path: path.read_bytes() for path in Path().rglob("*") if path.is_file()}
    assert run(arguments) == 2
    done = capsys.readouterr()
    assert done.out == ""
    (line,) = done.err.splitlines()
    assert line.startswith("contact-tracker: error: cannot write ")
    assert {path: path.read_bytes() for path in Path().rglob("*") if path.is_file()} == before
    return line


def linked(kind: str, name: str, output: str) -> None:
    """``output`` is the same file as ``name``."""
    if kind == "symbolic":
        Path(output).symlink_to(Path(name).absolute())
    else:
        os.link(name, output)


READ = [
    ("log.mcap", "segment log.mcap -o", "out.mcap"),
    ("log.mcap", "view log.mcap --save", "out.rrd"),
    ("parts/log_1.mcap", "calibrate log.mcap parts -o", "out.toml"),
    ("model.toml", "segment log.mcap --model model.toml -o", "out.csv"),
    ("block.obj", "view log.mcap --known known.toml --save", "out.rrd"),
    ("meshes/part.obj", "calibrate log.mcap --known known.toml -o", "out.toml"),
    ("in.mcap", "live in.mcap --state", "./in.mcap"),
    ("model.toml", "live log.mcap --model model.toml --state", "model.toml"),
]


@pytest.mark.parametrize(("read", "command", "output"), READ)
def test_inputs_are_not_overwritten(
    read: str, command: str, output: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    is_even = READ.index((read, command, output)) % 2 == 0
    if not Path(read).exists():
        os.rename("log.mcap", read)
    if Path(output) != Path(read):
        linked("symbolic" if is_even else "hard", read, output)
    line = refusal(capsys, *command.split(), output, *(["--overwrite"] if is_even else []))
    assert Path(output).name in line
    assert read in line


OUTPUTS = [
    ("z.jsonl", "live log.mcap --state ./z.jsonl --overwrite -o"),
    ("log_1.jsonl", "segment parts/log_0.mcap parts/log_1.mcap -o {}.jsonl"),
]


@pytest.mark.parametrize(
    ("name", "command", "kind"),
    [*((*OUTPUTS[0], kind) for kind in ("name", "symbolic", "hard", "dangling")), (*OUTPUTS[1], "dangling")],
)
def test_outputs_do_not_overwrite_each_other(
    name: str, command: str, kind: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = command.split()
    if words[0] == "live":
        words.append("parts/../z.jsonl" if kind == "name" else "out.jsonl")
    output = "log_0.jsonl" if words[0] == "segment" else "out.jsonl"
    if kind in ("symbolic", "hard"):
        Path(name).write_text("old")
    if kind != "name":
        linked("hard" if kind == "hard" else "symbolic", name, output)
    assert "it is another output" in refusal(capsys, *words)


def test_the_file_behind_standard_input_is_not_overwritten(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    os.rename("log.mcap", "in.jsonl")
    with open("in.jsonl", "rb") as file:
        monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(file))
        assert "standard input" in refusal(capsys, *["segment", "-", "-o", "in.jsonl", "--overwrite"])


def test_a_shipped_model_is_not_overwritten(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    os.rename("model.toml", "mocap_200hz.toml")
    monkeypatch.setattr("contact_tracker.config.loading.shipped", lambda: folder)
    refusal(capsys, *["calibrate", "log.mcap", "--start", "mocap_200hz", "-o", "mocap_200hz.toml"])


WRITES = [
    ("segment log.mcap -o", "out.csv"),
    ("view log.mcap --save", "out.rrd"),
    ("calibrate log.mcap --only transitions --folds 0 --processes 1 -o", "out.toml"),
    ("simulate vision_30hz -o", "out.mcap"),
]


def appears_at_the_end(monkeypatch: pytest.MonkeyPatch, happen) -> None:
    """Call a function when the output is complete, before the rename."""
    real = files._finish

    def finish(*arguments) -> None:
        real(*arguments)
        happen()

    monkeypatch.setattr(files, "_finish", finish)


@pytest.mark.parametrize(
    ("how", "source", "command", "output", "said"),
    [
        *(
            (how, "log.mcap", f"{command} {output} --overwrite", output, "it is the input log.mcap; name")
            for how, (command, output) in zip((os.rename, os.link, os.symlink), WRITES, strict=False)
        ),
        (os.rename, "parts/log_0.mcap", " ".join(WRITES[0]), "out.csv", "a recording; --overwrite replaces"),
    ],
)
def test_a_recording_that_takes_the_place_of_the_output_meanwhile_is_not_replaced(
    how,
    source: str,
    command: str,
    output: str,
    said: str,
    folder: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    before = Path(source).read_bytes()
    appears_at_the_end(monkeypatch, lambda: how(source, output))
    assert run(command.split()) == 2
    assert said in capsys.readouterr().err
    assert Path(output).read_bytes() == before
    assert not [path for path in Path().iterdir() if path.suffix == ".part"]


compressed = zstandard.ZstdCompressor().compress


CONTENTS = {
    "whole": lambda log: log,
    "half": lambda log: log[: len(log) // 2],
    "magic": lambda log: log[:8],
    "compressed": compressed,
    "cut compressed": lambda log: compressed(log)[:-9],
    "second frame": lambda log: compressed(b"") + compressed(log),
    "who knows": lambda log: compressed(log)[:6],
}


@pytest.mark.parametrize(
    ("command", "output", "content"),
    [*((*one, "half") for one in WRITES), *((*WRITES[0], name) for name in CONTENTS if name != "half")],
)
def test_a_recording_is_replaced_only_with_overwrite(
    command: str, output: str, content: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    Path("other").write_bytes(CONTENTS[content](Path("log.mcap").read_bytes()))
    os.rename("other", output)
    Path("link" + output).symlink_to(output)
    for name in (output, "link" + output):
        line = refusal(capsys, *command.split(), name)
        assert name in line
        assert "a recording" in line
        assert "--overwrite" in line


@pytest.mark.parametrize(("command", "output"), WRITES)
def test_a_recording_is_replaced_with_overwrite_and_other_results_always(
    command: str, output: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = Path("log.mcap").read_bytes()
    Path(output).write_bytes(before)
    assert run([*command.split(), output, "--overwrite"]) == 0
    made = Path(output).read_bytes()
    assert made != before
    if output != "out.mcap":
        assert run([*command.split(), output]) == 0
    for old in (b"", b"\x28\xb5", compressed(b"old" * 9)) if output == "out.csv" else ():
        Path(output).write_bytes(old)
        assert run([*command.split(), output]) == 0
        assert Path(output).stat().st_size > 50


def test_a_recording_that_cannot_be_read_may_be_one(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    Path("out.csv").write_text("secret")
    real = open

    def refuse(path, *arguments, **options):
        if Path(path).name == "out.csv":
            raise PermissionError(13, "Permission denied", path)
        return real(path, *arguments, **options)

    monkeypatch.setattr("contact_tracker.recording.reading.open", refuse, raising=False)
    with monkeypatch.context() as patch:
        patch.setattr(Path, "read_bytes", lambda path: b"")
        assert "--overwrite" in refusal(capsys, *["segment", "log.mcap", "-o", "out.csv"])


@pytest.mark.parametrize("name", ["take.csv", "take.parquet"])
def test_tables_of_poses_are_recordings(folder: Path, capsys: pytest.CaptureFixture[str], name: str) -> None:
    poses = smooth_poses()
    rows = np.column_stack([poses.stamp_ns * 1e-9, poses.position_m, poses.quat_xyzw])
    columns = ["time [s]", "x [m]", "y [m]", "z [m]", "qx", "qy", "qz", "qw"]
    write = arrow_csv.write_csv if name.endswith("csv") else parquet.write_table
    write(pyarrow.table(dict(zip(columns, rows.T, strict=True))), name)
    assert "it is a recording; --overwrite replaces it" in refusal(capsys, "segment", "log.mcap", "-o", name)
    assert run(["segment", "log.mcap", "-o", name, "--overwrite"]) == 0
    assert run(["segment", "log.mcap", "-o", name]) == 0


LABELS = (
    "start,end,contact\n0,1.5,f-f\n",
    "# of the second take\nBegin Time - ss.msec;End Time - ss.msec;label\n0;1.5;touch\n",
    "start_ms\tend_ms\tcontact\n",
    '[{"label": [{"start": 0, "end": 1.5, "timeserieslabels": ["touch"]}]}]',
)


@pytest.mark.parametrize("labels", LABELS)
def test_labels_of_a_user_are_replaced_only_with_overwrite(
    folder: Path, capsys: pytest.CaptureFixture[str], labels: str
) -> None:
    Path("log.labels.csv").write_text(labels)
    for command in ("segment log.mcap", "live log.mcap", "compare log.mcap log.mcap"):
        line = refusal(capsys, *command.split(), "-o", "log.labels.csv")
        assert line.endswith("it has labels of yours; --overwrite replaces it")
    assert run(["segment", "log.mcap", "-o", "log.labels.csv", "--overwrite"]) == 0
    for command in ("segment log.mcap --rows ticks", "compare log.mcap log.mcap", "segment log.mcap"):
        assert run([*command.split(), "-o", "log.labels.csv"]) == 0
