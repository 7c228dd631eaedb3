"""The command line with real files: exit codes and streams."""

import argparse
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import Writer
from scipy.spatial.transform import Rotation

from command_line import DEVNULL, ENVIRONMENT, PIPE, PROGRAM, ROOT, Done, run, started
from contact_tracker.cli import info, main
from contact_tracker.cli.arguments import output_file
from contact_tracker.cli.commands import COMMANDS
from contact_tracker.cli.main import LAB_COMMANDS
from contact_tracker.cli.source import Source
from contact_tracker.config.table_reading import AS_NAMED
from contact_tracker.errors import UsageError
from contact_tracker.ground_truth import Truth
from contact_tracker.motion.poses import Poses
from contact_tracker.recording import open_log, write_recording
from contact_tracker.states import STATES
from contact_tracker.tracker import Tracker
from contact_tracker.tracking.belief import Belief, Detail
from mcap_logs import START_NS as LOGS_START_NS
from mcap_logs import Topic, poses_topic, smooth_poses, tf_topic, transform, write_log

NAMES = [state.value for state in STATES]
RATE_HZ = 100
SIGMA_M = 3e-4
LENGTH_S = 2
START_NS = 1_700_000_000_000_000_000
PROC = Path("/proc")
needs_proc = pytest.mark.skipif(not PROC.is_dir(), reason="needs a system that lists processes in files")


def wait_until_it_waits(process: "subprocess.Popen[bytes]") -> None:
    """Wait until a command with ``-v`` has opened its recording, and sleeps without using CPU time."""
    while b"reading " not in (line := process.stderr.readline()):
        assert line, "it has ended"
    before = None
    while True:
        stat = (PROC / str(process.pid) / "stat").read_text()
        state, *numbers = stat.rpartition(")")[2].split()  # a name may have blanks
        usage = state, numbers[10], numbers[11]  # user and system time
        if state == "S" and usage == before:
            return
        before = usage
        time.sleep(0.2)


def assert_one_line_error(done: Done, code: int, *parts: str) -> None:
    assert done.returncode == code, done.stderr
    assert done.stdout == ""
    (line,) = done.stderr.splitlines()
    assert line.startswith("contact-tracker: error: ")
    for part in parts:
        assert part in line


def write_waves(path: Path, rate_hz: int) -> Path:
    """Some smooth free motion with noise."""
    rng = np.random.default_rng(5)
    seconds = np.arange(LENGTH_S * rate_hz) / rate_hz
    waves = np.sin(seconds[:, None] * rng.uniform(3, 7, 6) + rng.uniform(0, 6, 6))
    poses = Poses(
        START_NS + np.round(seconds * 1e9).astype(np.int64),
        0.1 * waves[:, :3] + rng.normal(0, SIGMA_M, (len(seconds), 3)),
        Rotation.from_rotvec(0.5 * waves[:, 3:] + rng.normal(0, 0.002, (len(seconds), 3))).as_quat(),
    )
    truth = Truth.from_changes([START_NS], ["free"], int(poses.stamp_ns[-1]))
    write_recording(str(path), poses, truth, {"scenario": "waves"})
    return path


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_waves(tmp_path_factory.mktemp("cli") / "free.mcap", RATE_HZ)


@pytest.fixture
def truncated(tmp_path: Path) -> Path:
    """Enough poses for several chunks, the last of them cut off."""
    path = write_waves(tmp_path / "truncated.mcap", 1000)
    path.write_bytes(path.read_bytes()[: path.stat().st_size * 9 // 10])
    return path


def test_the_parser_loads_nothing_that_takes_time() -> None:
    heavy = ("numpy", "scipy", "rerun", "mcap", "mcap_ros2", "filterpy", "tqdm", "matplotlib")
    code = (
        "import sys; from contact_tracker.cli.main import build_parser; build_parser().format_help();"
        f"print([m for m in {heavy} if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], env=ENVIRONMENT, capture_output=True, text=True)
    assert done.stdout == "[]\n", done.stderr


@pytest.mark.parametrize("command", [*(command.name for command in COMMANDS), *LAB_COMMANDS])
def test_the_help_of_each_command_has_an_example(command: str) -> None:
    done = run(command, "--help")
    assert (done.returncode, done.stderr) == (0, "")
    assert f"example:\n  contact-tracker {command} " in done.stdout


def test_a_link_is_written_where_it_leads(log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "there").mkdir()
    (tmp_path / "out.csv").symlink_to(tmp_path / "there" / "out.csv")
    folders = list[Path]()

    def refused(dir: Path, **_: object) -> None:
        folders.append(dir)
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("tempfile.TemporaryFile", refused)
    with pytest.raises(UsageError, match="there is not writable"):
        output_file(".csv")(str(tmp_path / "out.csv"))
    assert folders == [tmp_path.resolve() / "there"]
    (tmp_path / "lost.csv").symlink_to(tmp_path / "gone" / "out.csv")
    with pytest.raises(UsageError, match="gone"):
        output_file(".csv")(str(tmp_path / "lost.csv"))


def test_versions_and_scenarios_are_listed() -> None:
    assert run("--version").stdout.startswith("contact-tracker 0.")
    assert "vision_30hz" in run("simulate", "--list").stdout


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        (["lve", "x.mcap"], ["lve", "did you mean live?"]),
        (["segment", "x.mcap", "--tpic", "a"], ["--tpic", "did you mean --topic?"]),
        (["segment", "--tpic", "a"], ["--tpic", "did you mean --topic?"]),
        (["segment", "--wide"], ["required: LOG"]),
        (["segment", "x.mcap", "--plane", "-1,0,0,2"], ["--plane", "--option=-1,0,0"]),
        (["segment", "x.mcap", "--lag", "1"], ["--lag 1; --lag is an option of live (see"]),
        (["segment", "x.mcap", "-q", "-v"], ["-v", "-q"]),
        (["--print-completion", "fish"], ["bash, zsh, tcsh"]),
        (["live", "x.mcap", "--start", "-1"], ["--start", "negative"]),
        (["live", "x.mcap", "--rate", "0"], ["--rate", "not above zero"]),
        (["live", "x.mcap", "--start", "nan"], ["--start", "finite"]),
        (["live", "x.mcap", "--start", "1e300"], ["--start", "beyond"]),
        (["live", "x.mcap", "--lag", "1e9"], ["--lag", "30 s"]),
        (["segment", "x.mcap", "-o", "out.txt"], ["out.txt", ".csv, .jsonl, .parquet, .mcap"]),
        (["segment", "x.mcap", "-o", "out.rrd"], ["; contact-tracker view LOG --save out.rrd writes it"]),
        (["segment", "x.mcap", "--box", "0.2,0.2"], ["not a list of 3 numbers, such as 0.2,0.1,0.1"]),
        (["segment", "x.mcap", "-o", "nowhere/out.csv"], ["no folder nowhere"]),
        (
            ["segment", "x.mcap", "--json"],
            ["an option of live, compare, info and evaluate", "segment --help"],
        ),
        (["live", "x.mcap", "y.mcap"], ["y.mcap", "contact-tracker live --help"]),
        (["segment", "x.mcap", "--states", "f-x"], ["'f-x' is no contact: choose from f-f"]),
        (["live", "x.mcap", "--states", ""], ["no contact"]),
        (["simulate", "--seed", "-3"], ["--seed"]),
        (["simulate", "paper_experiment"], ["-o FILE.mcap"]),
        (["simulate", "unheard_of", "-o", "x.mcap"], ["unheard_of", "paper_experiment"]),
        (["evaluate", "-"], ["file"]),
        (["segment", "x.mcap", "--up", "0,0,1", "--up", "0,1,0"], ["argument --up: give it once"]),
        (["live", "x.mcap", "--start", "1", "--start=1"], ["argument --start: give it once"]),
        (["view", "x.mcap", "--model", "hand", "--model", "hand"], ["argument --model: give it once"]),
        (["segment", "x.mcap", "-o", "a.csv", "-o", "b.csv"], ["argument -o/--output: give it once"]),
        # names that the recording lacks: another call would do
        (["segment", "LOG", "--all", "--topic", "/none"], ["LOG"]),
        (["info", "LOG", "--topic", "/none"], ["LOG"]),
        (["segment", "LOG", "--frame", "none->of->it"], ["LOG"]),
        (["view", "LOG", "--frame", "none", "--save", "x.rrd"], ["LOG"]),
        (["live", "LOG", "--relative-to", "none"], ["LOG"]),
        (["segment", "LOG", "--wrench", "/none"], ["LOG"]),
        (["segment", "LOG", "--start", "1e6"], ["LOG"]),
        (["segment", "LOG", "--time-unit", "ms"], ["LOG"]),
        # a folder in which no file can be made, which is known before the work
        pytest.param(
            ["segment", "LOG", "-o", "/proc/x.csv"], ["folder /proc is not writable"], marks=needs_proc
        ),
        pytest.param(
            ["live", "LOG", "--state", "/proc/x"], ["folder /proc is not writable"], marks=needs_proc
        ),
        pytest.param(["batch", "LOG", "-o", "/proc/x"], ["folder /proc is not writable"], marks=needs_proc),
    ],
)
def test_wrong_usage_is_one_line_and_2(
    arguments: list[str], parts: list[str], log: Path, tmp_path: Path
) -> None:
    words, said = ([str(log) if word == "LOG" else word for word in some] for some in (arguments, parts))
    assert_one_line_error(run(*words, cwd=tmp_path), 2, *said)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("command", ["live", "segment", "view", "info", "evaluate"])
def test_unusable_input_is_one_line_and_1(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("DISPLAY", ":0")
    assert_one_line_error(run(command, "absent.mcap", cwd=tmp_path), 1, "absent.mcap")
    (tmp_path / "text.mcap").write_text("no recording at all")
    assert_one_line_error(run(command, "text.mcap", cwd=tmp_path), 1, "text.mcap", "not an MCAP file")


def test_live_json_is_a_belief_per_tick_from_a_file_and_from_a_pipe(log: Path) -> None:
    done = run("live", log, "--json")
    assert done.returncode == 0, done.stderr
    beliefs = [json.loads(line) for line in done.stdout.splitlines()]
    stamps = [b["stamp_ns"] for b in beliefs]
    assert len(beliefs) >= 10
    assert stamps == sorted(set(stamps))
    assert START_NS < stamps[0] < stamps[-1] == START_NS + round((LENGTH_S - 1 / RATE_HZ) * 1e9)
    for belief in beliefs:
        keys = ["stamp_ns", "contact", "probability", "onset_ns", "inseparable", "geometry"]
        further = ["contacts", "constraints", "joint", "inseparable_names", "object", "environment"]
        assert list(belief) == [*keys, *further]
        assert set(belief["inseparable"]) <= set(NAMES) - {belief["contact"]}
        assert list(belief["probability"]) == NAMES
        assert sum(belief["probability"].values()) == pytest.approx(1)
        assert belief["contact"] in NAMES
        assert START_NS <= belief["onset_ns"] <= belief["stamp_ns"]
        elements = set() if belief["contact"] == "free" else {"object", "environment"}
        assert set(belief["geometry"]) == elements
    assert run("live", "-", "--json", stdin=log.read_bytes()).stdout == done.stdout


def test_live_text_has_a_line_per_change_one_when_settled_and_a_summary(log: Path) -> None:
    done = run("live", log)
    assert done.returncode == 0, done.stderr
    header, *changes = done.stdout.splitlines()
    assert header.split()[:5] == ["time", "s", "contact", "p", "since"]
    reported = [(line.split()[1], float(line.split()[2]) >= 0.9 and "; or " not in line) for line in changes]
    assert {contact for contact, _ in reported} <= set(NAMES)
    assert reported
    for (before, settled_before), (contact, settled) in pairwise(reported):
        assert contact != before or (settled and not settled_before)
    assert f"{LENGTH_S * RATE_HZ} poses" in done.stderr
    assert "\r" not in done.stderr, "a status line is for terminals"


def test_truncated_input_gives_the_readable_part_and_3(truncated: Path, tmp_path: Path) -> None:
    whole = truncated.read_bytes()
    for command, name, stdin in (("live", truncated, b""), ("info", truncated, b""), ("info", "-", whole)):
        done = run(command, name, "--json", stdin=stdin)
        assert done.returncode == 3, done.stderr
        assert done.stdout.splitlines()
        assert ("it is cut off" if stdin else "truncated.mcap") in done.stderr
        assert "Traceback" not in done.stderr
    assert run("segment", truncated, "-o", tmp_path / "out.csv").returncode == 3
    assert (tmp_path / "out.csv").exists()


def test_follow_waits_for_more_data(truncated: Path) -> None:
    rest = write_waves(truncated.with_name("whole.mcap"), 1000).read_bytes()[truncated.stat().st_size :]
    with started("live", truncated, "--json", "--follow", stdout=PIPE, stderr=PIPE, text=True) as process:
        first = process.stdout.readline()
        with open(truncated, "ab") as growing:
            growing.write(rest)
        others, messages = process.communicate(timeout=60)
    assert (process.returncode, f"{LENGTH_S * 1000} poses" in messages) == (0, True), messages
    assert json.loads(first)["stamp_ns"] < json.loads(others.splitlines()[-1])["stamp_ns"]


def test_an_output_that_cannot_be_replaced_is_refused_before_any_work(log: Path, tmp_path: Path) -> None:
    os.mkfifo(odd := tmp_path / "odd.csv")
    assert_one_line_error(run("segment", log, "-o", odd), 2, odd.name, "not a regular file")
    assert odd.is_fifo()


@pytest.mark.parametrize("arguments", [["--help"], ["live", "LOG", "--json"]], ids=str)
def test_a_closed_pipe_ends_cleanly(arguments: list[str], log: Path) -> None:
    command = [*PROGRAM, *(str(log) if a == "LOG" else a for a in arguments)]
    reading, writing = os.pipe()
    os.close(reading)
    done = subprocess.run(command, env=ENVIRONMENT, stdout=writing, stderr=subprocess.PIPE, text=True)
    os.close(writing)
    assert done.returncode == 0
    assert "Traceback" not in done.stderr
    assert "BrokenPipe" not in done.stderr


def test_closed_streams_are_empty_ones(log: Path) -> None:
    def shell(text: str) -> "subprocess.CompletedProcess[str]":
        command = ["bash", "-c", f'"$@" {text}', "bash", *PROGRAM]
        return subprocess.run(command, env=ENVIRONMENT, capture_output=True, text=True)

    done = shell("live - <&-")
    assert (done.returncode, done.stderr) == (1, "contact-tracker: error: standard input: it is empty\n")
    assert shell(f"info '{log}' >&-").returncode == 0
    assert shell("--version 2>&-").returncode == 0


def test_a_full_disk_under_stdout_is_one_line_and_1(log: Path) -> None:
    with open("/dev/full", "w") as full:
        command = [*PROGRAM, "info", str(log)]
        done = subprocess.run(command, env=ENVIRONMENT, stdout=full, stderr=subprocess.PIPE, text=True)
    assert done.returncode == 1
    (line,) = done.stderr.splitlines()
    assert line.startswith("contact-tracker: error: cannot write")


def test_a_signal_leaves_no_partial_file(log: Path, tmp_path: Path) -> None:
    number = signal.SIGHUP
    words = "segment", "-", "-o", tmp_path / "out.csv"
    with started(*words, stdin=PIPE, preexec_fn=lambda: signal.signal(number, signal.SIG_DFL)) as process:
        process.stdin.write(log.read_bytes())  # and there may be more
        process.stdin.flush()
        while not any(tmp_path.iterdir()):
            assert process.poll() is None
            time.sleep(0.01)
        process.send_signal(number)
        process.wait(timeout=30)
    assert process.returncode == 128 + number
    assert not any(tmp_path.iterdir())


def test_view_of_a_pipe_has_every_pose(log: Path, tmp_path: Path) -> None:
    done = run("view", "-", "--save", tmp_path / "a.rrd", stdin=log.read_bytes())
    assert (done.returncode, done.stdout) == (0, ""), done.stderr
    assert f"{LENGTH_S * RATE_HZ} poses" in done.stderr
    assert (tmp_path / "a.rrd").stat().st_size > 10_000


def test_info_describes_the_poses(log: Path) -> None:
    done = run("info", log, "--json")
    assert done.returncode == 0, done.stderr
    (source,) = json.loads(done.stdout)["sources"]
    assert source["topic"] == "/object/pose"
    assert source["type"] == "geometry_msgs/msg/PoseStamped"
    assert source["poses"] == LENGTH_S * RATE_HZ
    assert source["rate_hz"] == pytest.approx(RATE_HZ)
    assert source["duration_s"] == pytest.approx(LENGTH_S - 1 / RATE_HZ)
    assert source["noise"]["sigma_position_m"] == pytest.approx(SIGMA_M, rel=0.5)
    assert "/object/pose" in run("info", log).stdout


def test_info_shows_the_first_keys_of_long_metadata(tmp_path: Path) -> None:
    with (tmp_path / "a.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        writer.add_metadata("calibration", {f"marker_{i:03}": "1.0" for i in range(100)})
        writer.finish()
    done = run("info", tmp_path / "a.mcap")
    (line,) = (line for line in done.stdout.splitlines() if line.startswith("metadata"))
    assert line.startswith("metadata calibration: marker_000, marker_001, ")
    assert line.endswith("marker_023, and 76 more")


def test_evaluate_names_recordings_that_it_cannot_read_and_goes_on(log: Path, tmp_path: Path) -> None:
    topics = [poses_topic(smooth_poses(60), name) for name in ("/left", "/right")]
    truth = Topic("/contact/truth", "std_msgs/msg/String", [(LOGS_START_NS, {"data": "free"})])
    two, bad = write_log(tmp_path / "two.mcap", [*topics, truth]), tmp_path / "bad.mcap"
    bad.write_text("no recording at all")
    for unreadable, code, words in (
        (two, 2, ("two.mcap", "--topic", "/left", "/right")),
        (bad, 1, ("bad.mcap",)),
    ):
        done = run("evaluate", unreadable, log.parent, "--json")
        assert done.returncode == code
        assert all(word in done.stderr for word in words)
        assert list(json.loads(done.stdout)["recordings"]) == [str(log)]
    assert "offline" in run("evaluate", two, "--topic", "/left").stdout


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs named pipes")
def test_a_pipe_in_a_folder_is_not_waited_for(log: Path, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "a.mcap")
    shutil.copy(log, tmp_path / "b.mcap")
    done = run("evaluate", tmp_path)
    assert done.returncode == 1
    assert "a.mcap: it is not a regular file" in done.stderr
    assert "b.mcap" in done.stdout
    done = run("calibrate", tmp_path, "-o", tmp_path / "m.toml")
    assert_one_line_error(done, 2, "a.mcap is not a regular file")


def test_a_suspicion_that_lasts_is_said_once(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    args = argparse.Namespace(log=str(log), start=0.0, duration=None, table=AS_NAMED)
    source = Source(open_log(str(log)), args.log, args)
    reported_s = []
    for seconds, is_suspected in ((0, 1), (2, 1), (3, 0), (4, 1), (8, 1), (9, 0), (10, 1), (20, 1)):
        source.report_suspicion(seconds * 10**9, ("the map may be wrong",) * is_suspected)
        said = "no label is certain since 4.0 s: the map may be wrong"
        reported_s += [seconds] * capsys.readouterr().err.count(said)
    assert reported_s == [8]


def test_info_reads_a_file_of_many_sources_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("contact_tracker.recording.log.SOURCES_KEPT", 20)
    poses = smooth_poses(60)
    others = [(poses, "world", f"body {i}") for i in range(1, 24)]
    path = write_log(tmp_path / "x.mcap", [tf_topic(poses, "world", "body 0", beside=others)])
    done = run("info", "-", stdin=path.read_bytes())
    assert done.returncode == 0, "even of what can be read only once"
    assert done.stdout.count("60 of ") + done.stdout.count("poses     60") == 20
    assert "more than 20 sources" in done.stdout
    assert done.stdout.count("noise     below 0.001 mm and below 0.001 deg per axis") == 20, "of exact poses"
    single = run("info", path, "--frame", "body 7")
    assert single.stdout.startswith("/tf world->body 7")
    assert "tracking" in single.stdout
    assert run("info", path, "--frame", "nothing").returncode == 2


def test_info_of_many_bodies_takes_little_longer_than_of_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Each is tracked for its share of the updates that one has."""
    poses, kind = smooth_poses(1500), "geometry_msgs/msg/TransformStamped"
    bodies = [
        Topic(f"/{name}", kind, [(pose.stamp_ns, transform(*pose, "world", name)) for pose in poses])
        for name in "abc"
    ]
    path, updates, add = str(write_log(tmp_path / "x.mcap", bodies)), list[int](), Tracker.add

    def counted(tracker: Tracker, batch: Poses, detail: Detail) -> list[Belief]:
        beliefs = add(tracker, batch, detail)
        updates.append(len(beliefs))
        return beliefs

    monkeypatch.setattr(Tracker, "add", counted)
    monkeypatch.setattr(info, "MOST_UPDATES", 150)
    assert main.run(["info", path]) == 0
    out = capsys.readouterr().out
    assert out.count("tracking  noise") == out.count("too short a part was read to estimate") == 3
    assert 10 < sum(updates) < 150 // 3


RECORDING = ROOT / "recordings" / "vision_30hz.mcap"


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Its first 8 s."""
    poses = Poses.collect(open_log(str(RECORDING)))[:250]
    return write_log(tmp_path_factory.mktemp("stream") / "log.mcap", [poses_topic(poses)], chunk_size=4096)


def test_a_live_stream_resumes_after_a_restart_byte_for_byte(recording: Path, tmp_path: Path) -> None:
    part, state, output = tmp_path / "part.mcap", tmp_path / "s.state", ""
    whole = recording.read_bytes()
    for share in (0.3, 0.301, 0.6):
        part.write_bytes(whole[: int(share * len(whole))])
        done = run("live", part, "--json", "--state", state)
        assert done.returncode == 3, "it is truncated"
        output += done.stdout
    assert_resumed(output, recording, state)
    again = run("live", recording, "--state", state)
    assert (again.stdout, again.returncode) == ("", 0)


def assert_resumed(output: str, recording: Path, state: Path) -> None:
    """With what follows, a stream that was ended has the output of a whole one."""
    found = (output + run("live", recording, "--json", "--state", state).stdout).splitlines()
    alone = run("live", recording, "--json").stdout.splitlines()
    assert found == alone[: len(found)]
    assert len(alone) - len(found) <= 1, "the last, partial tick waits"


def test_a_terminated_live_stream_resumes(recording: Path, tmp_path: Path) -> None:
    state = tmp_path / "s.state"
    words, output = ("live", recording, "--json", "--rate", "2", "--state", state), b""
    with started(*words, stdout=PIPE, stderr=DEVNULL) as live:
        output += live.stdout.readline() + live.stdout.readline()
        live.send_signal(signal.SIGTERM)
        output += live.stdout.read()
        assert live.wait(timeout=60) == 128 + signal.SIGTERM
    assert_resumed(output.decode(), recording, state)


@needs_proc
def test_a_live_stream_that_waits_ends_at_once_and_loses_no_pose(tmp_path: Path) -> None:
    """For the time of the next pose, for the file to grow, or for more than was sent."""
    log, state = write_log(tmp_path / "a.mcap", [poses_topic(smooth_poses(60))]), tmp_path / "s.state"
    growing = write_log(tmp_path / "b.mcap", [poses_topic(smooth_poses(600))])
    growing.write_bytes(growing.read_bytes()[:-3000])
    for words in (
        (log, "--rate", "1e-6", "--state", state),
        (growing, "--follow"),
        ("-", "--state", tmp_path / "t.state"),
    ):
        with started("live", *words, "-v", stdin=PIPE, stdout=DEVNULL, stderr=PIPE) as live:
            live.stdin.write(RECORDING.read_bytes()[:200_000] if "-" in words else b"")
            live.stdin.flush()
            wait_until_it_waits(live)
            live.send_signal(signal.SIGTERM)
            assert live.wait(timeout=30) == 128 + signal.SIGTERM
            said = live.stderr.read()
        assert b"Traceback" not in said
        assert log not in words or b"3 poses" in said  # the third one releases the second
    assert (tmp_path / "t.state").is_file()
    assert "60 poses" in run("live", log, "--state", state).stderr


def test_a_state_that_does_not_fit_is_refused_in_one_line(log: Path, tmp_path: Path) -> None:
    state, other = tmp_path / "s.state", tmp_path / "other.mcap"
    run("live", log, "--state", state)
    write_log(other, [poses_topic(smooth_poses(60), "/other")])
    there, here = (open_log(str(path)).source for path in (log, other))
    said = f"is of {there}, not of {here}: name another file"
    assert_one_line_error(run("live", other, "--state", state), 2, said)
    assert_one_line_error(run("live", log, "--state", state, "--lag", "1"), 2, "another model, --lag")
    assert_one_line_error(run("live", log, "--state", state, "--start", "1"), 2, "--state")
    state.write_bytes(state.read_bytes()[:-2000])
    assert_one_line_error(run("live", log, "--state", state), 1, "it is damaged")
    assert_one_line_error(run("live", log, "--state", tmp_path), 1, "it is a folder")
    assert_one_line_error(run("live", log, "--state", tmp_path / "none" / "s.state"), 2, "no folder")


@pytest.mark.parametrize("later_s", [0.1, 40.0])
def test_the_state_of_another_recording_is_for_a_later_one(tmp_path: Path, later_s: float) -> None:
    state, poses = tmp_path / "s.state", smooth_poses(60)
    log = write_log(tmp_path / "a.mcap", [poses_topic(poses)])
    shift_ns, shift_m = round(later_s * 1e9), [0.0, 0.0, 0.1]
    other = Poses(poses.stamp_ns + shift_ns, poses.position_m + shift_m, poses.quat_xyzw)
    ends_before = poses.stamp_ns[-1] < other.stamp_ns[0]
    second = write_log(tmp_path / "b.mcap", [poses_topic(other)])
    run("live", log, "--state", state)
    before, done = state.read_bytes(), run("live", second, "--state", state)
    if ends_before:
        assert (done.returncode, done.stderr.count("120 poses")) == (0, 1), done.stderr
    else:
        assert_one_line_error(done, 2, f"is of another recording, which does not end before {second} begins")
        assert state.read_bytes() == before


def test_the_next_part_of_a_recording_whose_clock_was_reset_goes_on(tmp_path: Path) -> None:
    state, poses = tmp_path / "s.state", smooth_poses(85)
    time_s = 0.005 * np.where(np.arange(85) < 40, np.arange(85) + 1000, np.arange(85) - 40)
    rows, errors = np.column_stack([time_s, poses.position_m, poses.quat_xyzw]), list[str]()
    for name, part in ("1", rows[:75]), ("2", rows[75:]):
        (tmp_path / name).mkdir()
        log = tmp_path / name / "a.csv"
        np.savetxt(log, part, delimiter=",", header="time_s,x,y,z,qx,qy,qz,qw", comments="")
        done = run("live", log, "--state", state)
        assert done.returncode == 0, done.stderr
        errors.append(done.stderr)
    assert "65 poses" in errors[1]
    assert f"resumed from {state}" in errors[1]
    assert "earlier than one before" not in "".join(errors)
