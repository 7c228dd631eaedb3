"""The public API: results equal to those of the internal functions, and errors in one line."""

import subprocess
import sys
from dataclasses import replace
from datetime import timedelta
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pandas
import pytest
from scipy.spatial.transform import Rotation

import contact_tracker
from as_values import finish, start, take
from contact_tracker import ContactTrackerWarning, Trajectory
from contact_tracker.config.loading import load_model
from contact_tracker.errors import MissingExtra, NoPoses, UsageError
from contact_tracker.explanations.joint_evidence import Joint
from contact_tracker.explanations.joint_models import JointKind
from contact_tracker.geometry.elements import Line
from contact_tracker.motion.pose_validation import PoseGate
from contact_tracker.motion.poses import Pose, Poses
from contact_tracker.recording import WRENCH_TYPE, write_recording
from mcap_logs import START_NS, Topic, header, poses_topic, smooth_poses, tf_topic, wrench_stamped, write_log
from pose_tables import NAMES
from short_recordings import FACE_TO_EDGE, recorded

WXYZ = [3, 0, 1, 2]


@pytest.fixture(scope="module")
def poses() -> Poses:
    return recorded(FACE_TO_EDGE).poses


@pytest.fixture(scope="module")
def log(tmp_path_factory, poses) -> Path:
    path = tmp_path_factory.mktemp("api") / "cube.mcap"
    write_recording(str(path), poses, None, {})
    return path


@pytest.fixture(scope="module")
def result(log) -> contact_tracker.Result:
    return contact_tracker.segment(log)


def arrays(poses: Poses) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return poses.stamp_ns, poses.position_m, poses.quat_xyzw


def test_all_names_exist_and_are_imported_on_first_use() -> None:
    assert all(hasattr(contact_tracker, name) for name in contact_tracker.__all__)
    assert set(contact_tracker.__all__) <= set(dir(contact_tracker))
    with pytest.raises(AttributeError, match="no attribute 'sgement'"):
        contact_tracker.sgement  # noqa: B018
    code = (
        "import sys, contact_tracker; assert 'numpy' not in sys.modules; contact_tracker.segment;"
        "print(*{'pandas', 'pyarrow', 'matplotlib', 'foxglove', 'rerun', 'rosbags', 'mcap_protobuf',"
        "'google.protobuf', 'sqlite3'} & set(sys.modules))"
    )
    path = str(Path(contact_tracker.__file__).parent.parent)
    command, environment = [sys.executable, "-c", code], {"PYTHONPATH": path}
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (0, "\n"), done.stderr


def test_a_recording_is_read_as_the_command_reads_it(log, poses) -> None:
    trajectory = contact_tracker.read(log)
    for got, expected in zip(arrays(trajectory.poses), arrays(poses), strict=True):
        np.testing.assert_allclose(got, expected, atol=1e-15)
    assert (trajectory.counts, trajectory.damage, trajectory.name) == ({}, None, "cube.mcap")
    assert "cube.mcap" in repr(trajectory)


@pytest.mark.parametrize(("unit", "factor"), [("s", 10**9), ("ms", 10**6), ("us", 10**3), ("ns", 1)])
def test_stamps_may_have_any_unit(unit, factor) -> None:
    few = smooth_poses(30)
    whole = (few.stamp_ns - few.stamp_ns[0]) / factor
    trajectory = Trajectory.from_arrays(whole, few.position_m, few.quat_xyzw, unit=unit)
    np.testing.assert_array_equal(trajectory.stamp_ns, few.stamp_ns - few.stamp_ns[0])


def test_dates_and_durations_are_stamps_and_quaternions_may_start_with_w() -> None:
    few = smooth_poses(30)
    dates = pandas.date_range("2026-01-01", periods=30, freq="10ms", tz="Europe/Berlin")
    of_numpy = dates.tz_convert(None).to_numpy("datetime64[ns]")
    utc_ns = of_numpy.astype(np.int64)
    durations = (utc_ns // 1000).astype("timedelta64[us]")
    with_zone = [date.to_pydatetime() for date in dates]
    for stamps in (dates, pandas.Series(dates), list(dates), with_zone, of_numpy, durations):
        wxyz = few.quat_xyzw[:, WXYZ]
        found = Trajectory.from_arrays(stamps, few.position_m, wxyz, order="wxyz")
        np.testing.assert_array_equal(found.poses.stamp_ns, utc_ns)
        np.testing.assert_allclose(found.quat_xyzw, few.quat_xyzw, atol=1e-15)
        assert not found.notes
    table = pandas.DataFrame(np.hstack([few.position_m, few.quat_xyzw]), columns=[*"xyzabcd"])
    table["time"] = dates
    trajectory = Trajectory.from_dataframe(
        table, columns=dict(zip(["qx", "qy", "qz", "qw"], "abcd", strict=True))
    )
    np.testing.assert_array_equal(trajectory.stamp_ns, utc_ns)
    with pytest.raises(UsageError, match=r"convert text, as by pandas\.to_datetime"):
        Trajectory.from_arrays(of_numpy.astype(str), few.position_m, few.quat_xyzw)


def test_frames_with_times_as_an_index_or_with_several_levels_of_names() -> None:
    few = smooth_poses(30)
    times = (few.stamp_ns - few.stamp_ns[0]) / 1e9
    table = pandas.DataFrame(
        np.hstack([few.position_m, few.quat_xyzw]), columns=NAMES.split(","), index=times
    )
    with pytest.raises(UsageError, match=r"columns=\{'time': 'c0'\}"):
        Trajectory.from_dataframe(table)
    levels = table.set_axis([*(("p", axis) for axis in "xyz"), *(("q", axis) for axis in "xyzw")], axis=1)
    both = table.assign(sec=times, msec=1e3 * times)  # which are one time twice
    for found in (
        Trajectory.from_dataframe(table, columns={"time": "c0"}),
        Trajectory.from_dataframe(levels.assign(time=times)),
        Trajectory.from_dataframe(both),
    ):
        np.testing.assert_allclose(found.stamp_ns - found.stamp_ns[0], 1e9 * times, atol=1)
        np.testing.assert_allclose(found.position_m, few.position_m)


def test_masked_poses_are_not_finite(poses) -> None:
    hidden = np.arange(len(poses)) % 10 == 3
    masked = np.ma.array(poses.position_m, mask=hidden[:, None].repeat(3, axis=1))
    stamps = np.ma.array(poses.stamp_ns, mask=np.arange(len(poses)) == 0)
    found = Trajectory.from_arrays(poses.stamp_ns, masked, poses.quat_xyzw, unit="ns")
    assert found.counts == {"nonfinite": int(hidden.sum())}
    np.testing.assert_array_equal(found.poses.stamp_ns, poses.stamp_ns[~hidden])
    found = Trajectory.from_arrays(stamps, masked, poses.quat_xyzw, unit="ns")
    assert found.counts["nonfinite"] > hidden.sum()


def test_names_of_columns_have_units_as_in_files(poses) -> None:
    columns = {"time [ms]": poses.stamp_ns / 1e6}
    columns |= {f"{axis} [mm]": 1e3 * values for axis, values in zip("xyz", poses.position_m.T, strict=True)}
    columns |= dict(zip(("qx", "qy", "qz", "qw"), poses.quat_xyzw.T, strict=True))
    trajectory = Trajectory.from_dataframe(columns)
    np.testing.assert_allclose(trajectory.position_m, poses.position_m, rtol=0, atol=1e-12)
    np.testing.assert_allclose(trajectory.stamp_ns, poses.stamp_ns, rtol=0, atol=1000)
    assert not trajectory.notes
    with pytest.warns(ContactTrackerWarning, match="they look like seconds"):
        seconds = Trajectory.from_dataframe(columns | {"time [ms]": poses.stamp_ns / 1e9})
    assert "they look like seconds" in seconds.notes[0]
    arrays = poses.position_m, poses.quat_xyzw
    for time_unit, scale, unit in (("ms", 1e-9, "s"), ("ns", 1e-9, "s"), ("s", 1e-6, "ms")):
        with pytest.warns(ContactTrackerWarning, match=f"look like .*: give time_unit='{unit}'"):
            Trajectory.from_arrays(scale * (poses.stamp_ns - poses.stamp_ns[0]), *arrays, time_unit=time_unit)
    without_units = Trajectory.from_dataframe(columns, columns={"time": "time", "x": "x"})
    np.testing.assert_array_equal(without_units.position_m, trajectory.position_m)
    with pytest.raises(UsageError, match="no column 'X1'; there are"):
        Trajectory.from_dataframe(columns, columns={"x": "X1"})
    columns["x [ft]"] = columns["x [mm]"]
    with pytest.raises(UsageError, match=r"the unit 'ft' of column 'x \[ft\]' is not known"):
        Trajectory.from_dataframe(columns, columns={"x": "x [ft]"})


def test_progress_is_written_or_given(poses, capsys) -> None:
    done = list[int]()
    for progress in (done.append, True):
        contact_tracker.segment(Trajectory(poses[:60]), progress=progress)
    assert (done, done[-1]) == (sorted(done), 60)
    assert "60/60" in capsys.readouterr().err.splitlines()[-1]


def test_model_noise_and_knowledge_are_taken_in_every_form(poses, tmp_path) -> None:
    short = Trajectory(poses[:200])
    (tmp_path / "known.toml").write_text("[up]\ndirection = [0, 0, 1]\n")
    given = [
        ("mocap_200hz", str(tmp_path / "known.toml"), "0.3mm,0.15deg"),
        (load_model("mocap_200hz"), {"up": {"direction": [0, 0, 1]}}, (3e-4, np.radians(0.15))),
        ("mocap_200hz", {"up": {"direction": np.eye(3)[2]}}, "0.3mm,0.15deg"),
    ]
    first, *others = (contact_tracker.segment(short, *options) for options in given)
    for other in others:
        np.testing.assert_allclose(first.beliefs.probability, other.beliefs.probability, atol=1e-9)
    with pytest.raises(UsageError, match="known is a file, a table of its keys or a Map, not 3"):
        contact_tracker.segment(short, known=3)
    assert first.report.noise == pytest.approx((3e-4, np.radians(0.15)))


def test_turns_within_a_tick_leave_no_mean_rotation_but_a_result() -> None:
    """Means of such turns are no rotations, nor have they a positive determinant."""
    turns = Rotation.random(60, rng=np.random.default_rng(1))
    trajectory = Trajectory.from_arrays(0.02 * np.arange(60), -turns.apply((0.1, 0.05, 0.2)), turns)
    assert contact_tracker.segment(trajectory).segments[0].motion is not None


def test_a_position_that_is_not_recorded_has_its_warning_alone() -> None:
    """And none of a division, as where the search for further contacts has no direction to begin with."""
    time_s = np.arange(0.0, 14.0, 0.01)
    turns = np.column_stack([0.4 * np.sin(time_s), np.zeros(1400), 0.5 * np.sin(1.7 * time_s)])
    trajectory = contact_tracker.Trajectory.from_arrays(
        time_s, np.zeros((1400, 3)), Rotation.from_rotvec(turns)
    )
    with pytest.warns(contact_tracker.ContactTrackerWarning, match="position never changes") as shown:
        contact_tracker.segment(trajectory)
    assert not [one for one in shown if issubclass(one.category, RuntimeWarning)]


def test_times_choose_poses_and_segments(result, poses) -> None:
    trajectory, first = result.trajectory, np.datetime64(int(poses.stamp_ns[0]), "ns")
    for begin, end in ((1, 2.5), (pandas.Timedelta("1s"), timedelta(seconds=2.5))):
        part = trajectory[begin:end]
        assert (part.stamp_ns[0], part.stamp_ns[-1]) == (poses.stamp_ns[200], poses.stamp_ns[499])
    assert len(trajectory[first + np.timedelta64(1, "s") :]) == len(poses) - 200
    assert result.at(0.5) is result.segments[0]
    assert result.at(pandas.Timestamp(int(poses.stamp_ns[-1]))) is result.segments[-1]
    for call, wrong in ((trajectory.__getitem__, (3, slice(99, None), slice("a", None))), (result.at, (-1,))):
        for time in wrong:
            with pytest.raises(UsageError):
                call(time)


def test_a_tracker_agrees_with_the_command_and_resumes_bit_for_bit(poses, tmp_path) -> None:
    poses = poses[:250]
    state, passed, expected = start(load_model()), PoseGate(), []
    for pose in poses:
        state, new = take(state, passed.arrive(pose))
        expected += new[-1:]
    expected += finish(state)[1]
    tracker, beliefs = contact_tracker.Tracker(), []
    for number, pose in enumerate(poses):
        beliefs += filter(None, [tracker.update(*pose)])
        if number == 150:
            tracker.save(tmp_path / "state")
            tracker = contact_tracker.Tracker.load(tmp_path / "state")
    beliefs += tracker.finish()
    assert [belief.to_json() for belief in beliefs] == [belief.to_json() for belief in expected]
    assert max(len(repr(belief)) for belief in beliefs) < 1000


def test_slides_along_two_lines_have_a_row_each() -> None:
    """A stage moves along x, rests, moves along y, and back along x."""
    rng, hz = np.random.default_rng(0), 100
    step = (1.0 - np.cos(np.pi * np.arange(2 * hz) / (2 * hz))) / 2.0
    rest, on = np.zeros(hz), np.ones(hz)
    along_x = 0.2 * np.concatenate([rest, step, on, np.ones(2 * hz), on, 1.0 - step, rest])
    along_y = 0.15 * np.concatenate([rest, 0.0 * step, rest, step, on, np.ones(2 * hz), on])
    position_m = np.column_stack([along_x, along_y, np.zeros_like(along_x)])
    turns = Rotation.from_rotvec(2e-3 * rng.normal(size=position_m.shape))
    seconds, noise_m = np.arange(len(position_m)) / hz, 2e-4 * rng.normal(size=position_m.shape)
    moved = Trajectory.from_arrays(seconds, position_m + noise_m, turns, time_unit="s")
    assert str(contact_tracker.segment(moved)).count("= slider") == 3


def test_mistakes_are_errors_of_the_package(poses) -> None:
    stamps, places, turns = arrays(poses)
    for kind, text, mistake in (
        (UsageError, "standard input", lambda: contact_tracker.read("-")),
        (UsageError, r"\(N, 3\)", lambda: Trajectory.from_arrays(stamps, places.T, turns)),
        (NoPoses, "unit of the stamps", lambda: Trajectory.from_arrays(stamps, places, turns)),
        (NoPoses, "no pose", lambda: Trajectory.from_arrays([], np.zeros((0, 3)), np.zeros((0, 4)))),
    ):
        with pytest.raises(kind, match=text):
            mistake()


def test_a_frame_in_another_is_composed_of_the_transforms_between(tmp_path) -> None:
    moving = smooth_poses(40)
    mount = tf_topic([Pose(START_NS, (1.0, 2.0, 3.0), (0.0, 0.0, 0.0, 1.0))], "world", "base", "/tf_static")
    path = write_log(tmp_path / "tf.mcap", [mount, tf_topic(moving, "base", "tool")])
    child = contact_tracker.read(path, child="tool")
    composed = contact_tracker.read(path, parent="world", child="tool")
    np.testing.assert_allclose(child.position_m, moving.position_m)
    np.testing.assert_allclose(composed.position_m, np.add(child.position_m, (1.0, 2.0, 3.0)))
    with pytest.raises(UsageError, match="parent needs child"):
        contact_tracker.read(path, parent="world")


def test_results_replace_recordings_only_with_overwrite(result, log, tmp_path) -> None:
    (tmp_path / "other.mcap").write_bytes(log.read_bytes())
    for call, arguments, words in (
        (result.to_mcap, (log, True), "it is the input"),
        (result.to_mcap, (tmp_path / "other.mcap",), "overwrite=True"),
        (result.to_parquet, (tmp_path / "ticks.csv",), r"must end in \.parquet"),
        (result.to_pandas, ("poses",), "'ticks' or 'segments'"),
    ):
        with pytest.raises(UsageError, match=words):
            call(*arguments)


@pytest.mark.parametrize(("library", "name"), [("pandas", "to_pandas"), ("foxglove", "to_mcap")])
def test_a_missing_library_is_reported_with_its_extra(result, tmp_path, library, name, monkeypatch) -> None:
    ours = "contact_tracker.exports"
    for module in [m for m in sys.modules if m.split(".")[0] == library or m.startswith(ours)]:
        monkeypatch.delitem(sys.modules, module)
    monkeypatch.setitem(sys.modules, library, None)
    arguments = [tmp_path / f"out.{name.removeprefix('to_')}"] if name != "to_pandas" else []
    words = rf"needs {library}: pip install 'contact-tracker\[\w+\]'"
    with pytest.raises(MissingExtra, match=words) as error:
        getattr(result, name)(*arguments)
    assert error.value.__suppress_context__, "one error, not two"
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("stamped", ["none", "few"])
def test_wrenches_have_the_clock_of_the_poses(stamped, tmp_path, monkeypatch) -> None:
    """Stamps are log times only if no pose has a stamp, not if most have none."""
    poses, logged_later_ns = smooth_poses(800), 5_000_000_000
    topic = poses_topic(poses, offset_ns=logged_later_ns)
    for row, (_, message) in enumerate(topic.messages):
        if stamped == "none" or row >= 300:  # those of the first second say what the clock is
            message["header"] = header(0)
    wrench = [0.0, 0.0, 9.0, 0.0, 0.0, 0.0]
    messages = [(stamp + logged_later_ns, wrench_stamped(stamp, wrench)) for stamp in poses.stamp_ns.tolist()]
    path = write_log(tmp_path / "log.mcap", [topic, Topic("/wrench", WRENCH_TYPE, messages)])
    evidence = Mock(side_effect=UsageError("only looked at"))
    monkeypatch.setattr("contact_tracker.segmenting.wrench_evidence", evidence)
    trajectory = contact_tracker.read(path)
    with pytest.raises(UsageError, match="only looked at"):
        contact_tracker.segment(trajectory, wrench="/wrench")
    assert trajectory.by_log_time == (stamped == "none")
    assert trajectory.counts["log_time_as_stamp"] > 0.5 * len(trajectory)
    of_poses, of_wrenches, *_ = evidence.call_args.args
    assert of_poses.stamp_ns.tolist() == of_wrenches.stamp_ns.tolist()


def test_task_frames_of_contacts_at_a_time(result) -> None:
    """While an edge slides on the table, its frame is on both, and two of six coordinates are constrained."""
    middle = next(segment for segment in result.segments if segment.contact.value == "e-f")
    seconds = ((middle.start_ns + middle.end_ns) / 2 - result.origin_ns) * 1e-9
    (frame,) = result.task_frames(seconds)
    assert frame.contact is middle.contact
    np.testing.assert_array_equal(np.flatnonzero(frame.is_constrained), [2, 4])
    table = middle.geometry.environment
    np.testing.assert_allclose(table.normal @ frame.T_world_task[:3, 3], table.offset_m, atol=1e-9)
    np.testing.assert_allclose(np.abs(table.normal @ frame.T_world_task[:3, 2]), 1.0, atol=1e-9)
    assert 0.0 < min(frame.sd) < max(frame.sd) < 0.1


def test_the_frame_of_a_joint_comes_first(result, monkeypatch) -> None:
    axis = Line(np.array([0.0, 0.0, 1.0]), np.zeros(3))
    segment = replace(result.segments[1], joint=Joint(JointKind.HINGE, 1.0, axis, axis, 0.0, None))
    monkeypatch.setattr(contact_tracker.Result, "at", lambda *_: segment)
    frames = result.task_frames((segment.start_ns - result.origin_ns) * 1e-9)
    assert frames[0].name == "revolute"
    assert segment.to_json()["joint"]["task_frame"]["constrained"] == ["vx", "vy", "vz", "wx", "wy"]
