"""``view`` of one recording and of several, of parts of them, and errors for unusable ones."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from rerun.chunk import RrdReader

from contact_tracker.cli.main import run
from contact_tracker.ground_truth import Truth
from contact_tracker.recording import write_recording
from contact_tracker.states import Contact
from contact_tracker.viewer import canvas, sinks
from mcap_logs import smooth_poses


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A log of 4 s; the true contact changes after 2 s."""
    poses = smooth_poses(800)
    first, last = int(poses.stamp_ns[0]), int(poses.stamp_ns[-1])
    truth = Truth.from_changes([first, first + 2_000_000_000], ["free", "v-f"], last)
    path = tmp_path_factory.mktemp("view") / "log.mcap"
    write_recording(str(path), poses, truth, {})
    return path


@pytest.fixture
def shown(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder with a file for each recording that would be shown in the viewer."""
    folder = tmp_path / "shown"
    folder.mkdir()

    def to_files() -> sinks.Sink:
        return lambda recording, blueprint: sinks.to_file(folder / f"{len(list(folder.iterdir()))}.rrd")(
            recording, blueprint
        )

    monkeypatch.setattr(sinks, "to_viewer", to_files)
    return folder


def states(path: Path, entity: str) -> list[tuple[float, str]]:
    """Seconds and state of each change."""
    found = []
    for chunk in RrdReader(path).stream().filter(content=f"/{entity}").to_chunks():
        batch = chunk.to_record_batch()
        if "StateChange:state" in batch.schema.names:
            since = batch.column(canvas.TIMELINE).to_numpy(zero_copy_only=False).astype(float) * 1e-9
            found += [
                (t, v[0]) for t, v in zip(since, batch.column("StateChange:state").to_pylist(), strict=True)
            ]
    return sorted(found)


def test_a_part_has_the_times_of_the_whole(log: Path, tmp_path: Path) -> None:
    path = tmp_path / "part.rrd"
    assert run(["view", str(log), "--start", "1", "--duration", "2", "--save", str(path), "-q"]) == 0
    assert states(path, canvas.TRUTH) == [(1.0, "free"), (2.0, "v-f")]
    assert states(path, canvas.SMOOTHED)[0][0] == pytest.approx(1.0, abs=0.01)
    assert run(["view", str(log), "--duration", "1.5", "--save", str(path), "-q"]) == 0
    assert states(path, canvas.TRUTH) == [(0.0, Contact.FREE.value)], "what comes later is not shown"


def test_several_are_shown_and_an_unusable_one_is_named(
    log: Path, shown: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = tmp_path / "other.mcap"
    other.write_bytes(log.read_bytes())
    broken = tmp_path / "broken.mcap"
    broken.write_text("no recording")
    assert run(["view", str(log), str(broken), str(other), str(log), "-q"]) == 1
    assert capsys.readouterr().err.count("broken.mcap") == 1
    assert len(list(shown.iterdir())) == 2, "one that is named twice is shown once"


def test_a_file_holds_one_recording(log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "both.rrd"
    (tmp_path / "other.mcap").write_bytes(log.read_bytes())
    assert run(["view", str(log), str(tmp_path / "other.mcap"), "--save", str(path)]) == 2
    assert "each LOG of its own" in capsys.readouterr().err
    assert not path.exists()


@pytest.mark.parametrize("command", ["view", "live"])
def test_a_browser_and_a_window_exclude_each_other(
    command: str, log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = ["--save", "x.rrd"] if command == "view" else ["--rerun"]
    assert run([command, str(log), "--web", *other]) == 2
    assert "--web" in capsys.readouterr().err
