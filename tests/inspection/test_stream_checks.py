"""Stream checks: warnings for streams with known mistakes, none for correct recordings."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from contact_tracker.config.table_reading import TableReading
from contact_tracker.inspection.stream_checks import (
    BLOCK,
    KEPT,
    NOTHING_INSPECTED,
    Inspection,
    findings,
    inspect,
)
from contact_tracker.motion.poses import Poses
from contact_tracker.recording import open_log
from smooth_motion import START_NS, moving, smooth

RECORDINGS = ("paper_experiment", "all_states", "robot_1khz", "vision_30hz")
each_recording = pytest.mark.parametrize("name", RECORDINGS)


def recorded(path):
    return Poses.join(list(open_log(str(path)).batches()))


@pytest.fixture(scope="session")
def recordings(pytestconfig):
    return {name: recorded(pytestconfig.rootpath / "recordings" / f"{name}.mcap") for name in RECORDINGS}


def until(poses, seconds):
    return poses[poses.stamp_ns <= poses.stamp_ns[0] + seconds * 1e9]


def inspected(poses, batch=100, before=NOTHING_INSPECTED) -> Inspection:
    for first in range(0, len(poses), batch):
        before = inspect(before, poses[first : first + batch])
    return before


def is_in_doubt(inspection):
    return any(finding.doubts_labels for finding in findings(inspection))


def kinds(poses, batch=100):
    return [finding.kind for finding in findings(inspected(poses, batch))]


def scaled(poses, factor):
    return Poses(poses.stamp_ns, poses.position_m * factor, poses.quat_xyzw)


def shifted(poses, offset_m, late_ns=0):
    return Poses(poses.stamp_ns + late_ns, poses.position_m + offset_m, poses.quat_xyzw)


def merged(*streams):
    every = Poses.join(streams)
    return every[np.argsort(every.stamp_ns, kind="stable")]


def unit(quat):
    return quat / np.linalg.norm(quat, axis=1)[:, None]


def averaged(poses, width):
    """A moving average."""
    kernel, half = np.ones(width) / width, width // 2
    position, quat = (
        np.stack([np.convolve(column, kernel, "valid") for column in rows.T], axis=1)
        for rows in (poses.position_m, poses.quat_xyzw)
    )
    return Poses(poses.stamp_ns[half:-half], position, unit(quat))


def lagging(poses, share=0.3):
    """A causal first-order filter."""
    position, quat = poses.position_m.copy(), poses.quat_xyzw.copy()
    for rows in (position, quat):
        for i in range(1, len(rows)):
            rows[i] = share * rows[i] + (1.0 - share) * rows[i - 1]
    return Poses(poses.stamp_ns, position, unit(quat))


def interpolated(poses):
    """Every second pose is replaced by one between its neighbours."""
    poses = poses[: len(poses) // 2 * 2 - 1]
    kept, time = poses[::2], poses.stamp_ns - poses.stamp_ns[0]
    position = np.stack([np.interp(time, time[::2], column) for column in kept.position_m.T], axis=1)
    quat = Slerp(time[::2].astype(float), Rotation.from_quat(kept.quat_xyzw))(time.astype(float)).as_quat()
    sign = np.where((quat * poses.quat_xyzw).sum(axis=1) < 0.0, -1.0, 1.0)
    return Poses(poses.stamp_ns, position, quat * sign[:, None])


FILTERS = {
    "average of 3": lambda poses: averaged(poses, 3),
    "average of 5": lambda poses: averaged(poses, 5),
    "first order": lagging,
    "interpolated": interpolated,
}
each_filter = pytest.mark.parametrize("distort", FILTERS.values(), ids=FILTERS)


def odometry(rate_hz, sigma_m, sigma_rad, seed=0):
    """A mobile robot: some 2 m/s over tens of metres."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(round(60 * rate_hz)) / rate_hz
    yaw = np.cumsum(smooth(rng, time_s, 0.3, 0.2)[:, 0]) / rate_hz
    speed = 1.2 + 0.8 * np.sin(0.3 * time_s)
    way = np.stack([np.cos(yaw), np.sin(yaw), 0.0 * yaw], axis=1)
    noise = rng.normal(size=(len(yaw), 3)) * (sigma_m, sigma_m, 0.0)
    turn = np.outer(yaw + rng.normal(size=len(yaw)) * sigma_rad, (0.0, 0.0, 1.0))
    position = np.cumsum(way * speed[:, None], axis=0) / rate_hz + noise
    stamp_ns = START_NS + np.rint(1e9 * time_s).astype(np.int64)
    return Poses(stamp_ns, position, Rotation.from_rotvec(turn).as_quat())


@each_recording
def test_a_correct_recording_has_no_warnings(recordings, name):
    assert kinds(recordings[name]) == []


@pytest.mark.long
@pytest.mark.parametrize("part", ["cube_tosses", "physics/paper", "physics/hard", "physics/singular"])
def test_other_recordings_have_no_warnings(shared_recordings, part):
    for path in sorted((shared_recordings / part).glob("*.mcap")):
        assert kinds(recorded(path)) == [], path.name


@pytest.mark.long
def test_tosses_in_other_units_are_reported(shared_recordings):
    """Recordings of 0.6 s."""
    for path in sorted((shared_recordings / "cube_tosses").glob("*.mcap")):
        for factor, unit in ((1e2, "centimetres"), (1e3, "millimetres")):
            (finding,) = findings(inspected(scaled(recorded(path), factor)), ["cm", "mm"])
            assert finding.kind == "units", path.name
            assert unit in finding.text, path.name


@each_recording
@pytest.mark.parametrize(("factor", "unit"), [(1e2, "centimetres"), (1e3, "millimetres")])
def test_other_units_are_found_at_once(recordings, name, factor, unit):
    """At rest by their noise, in motion also by their speed."""
    state = inspected(until(scaled(recordings[name], factor), 2.0))
    (finding,) = findings(state)
    assert finding.kind == "units"
    assert finding.doubts_labels
    assert "check their unit" in finding.text, "no remedy that was not tried"
    assert unit in findings(state, ["cm", "mm"])[0].text
    assert is_in_doubt(state)


@each_recording
@pytest.mark.parametrize("factor", [1e-2, 1e-3])
def test_metres_in_columns_of_smaller_units_are_reported(recordings, name, factor):
    (finding,) = findings(inspected(scaled(recordings[name], factor)))
    assert finding.kind == "units"
    assert finding.text.startswith("positions look too small for metres")
    assert not finding.doubts_labels


@each_recording
def test_an_object_far_from_its_origin_is_in_metres(recordings, name):
    """The origin moves with the errors of the orientation, here by 20 to 120 mm."""
    far = recordings[name].of_point(10.0 * np.array([0.6, -0.48, 0.64]))
    (finding,) = findings(inspected(far))  # the same motion as that of the world in a body
    assert finding.kind == "inverse"
    assert "if the body's origin is that far from the object" in finding.text
    assert "units" in kinds(scaled(far, 1e3))


def test_places_that_are_measured_much_better_than_turns_are_in_metres():
    """Fast motion is that of metres."""
    assert kinds(moving(np.random.default_rng(0), 20.0, 100.0, 1e-6, np.radians(0.5))) == []


@pytest.mark.parametrize("sigma_m", [5e-5, 3e-4])
def test_an_object_that_turns_about_its_origin_is_in_metres(sigma_m):
    """As in the calibration of a tip."""
    poses = moving(np.random.default_rng(0), 20.0, 100.0, sigma_m, np.radians(0.15), rms_m=1e-4)
    assert kinds(poses) == []


@pytest.mark.parametrize("batch", [1, 7, 100])
def test_a_pose_that_never_changes_is_reported_until_it_does(batch):
    """As of a static transform, or of an object that is not tracked."""
    poses = moving(np.random.default_rng(0), 3.0, 100.0, 3e-4, 1e-3)
    before = Poses(
        poses.stamp_ns - 10**10, poses.position_m[:1].repeat(300, 0), poses.quat_xyzw[:1].repeat(300, 0)
    )
    (finding,) = findings(still := inspected(before, batch))
    assert finding.text.startswith("the pose never changes")
    assert not finding.doubts_labels, "no label is certain without motion"
    assert findings(inspected(poses, batch, still)) == ()


@pytest.mark.parametrize("rate_hz", [5, 10])
def test_an_object_that_turns_fast_about_its_origin_at_a_low_rate_is_in_metres(rate_hz):
    rng, time_s = np.random.default_rng(0), np.arange(0.0, 60.0, 1.0 / rate_hz)
    turns = np.stack([0.4 * np.sin(2.0 * np.pi * hz * time_s) for hz in (1.5, 1.1, 0.7)], axis=1)
    position_m = 5e-5 * rng.normal(size=(len(time_s), 3))
    stamps_ns = 10**18 + np.round(1e9 * time_s).astype(np.int64)
    assert kinds(Poses(stamps_ns, position_m, Rotation.from_rotvec(turns).as_quat())) == []


@pytest.mark.parametrize("rate_hz", [5, 30, 200])
@pytest.mark.parametrize(("sigma_m", "sigma_rad"), [(0.003, 1e-4), (0.005, 1e-5), (0.003, 2e-3), (0.0, 0.0)])
def test_a_mobile_robot_is_in_metres(rate_hz, sigma_m, sigma_rad):
    assert kinds(odometry(rate_hz, sigma_m, sigma_rad)) == []


def test_a_finding_is_permanent(recordings):
    poses = recordings["paper_experiment"]
    state = inspected(scaled(poses[:400], 1e3))
    assert is_in_doubt(inspected(poses[400:], before=state))


@pytest.mark.parametrize(("first_hz", "second_hz"), [(30, 30), (200, 200), (200, 60), (1000, 1000)])
def test_two_bodies_that_take_turns_are_found(first_hz, second_hz):
    first, second = (
        moving(np.random.default_rng(i), 2.0, rate, 3e-4, 2e-3)
        for i, rate in enumerate([first_hz, second_hz])
    )
    state = inspected(merged(first, shifted(second, [0.3, 0.2, 0.0], round(3e8 / first_hz))))
    (finding,) = findings(state)
    assert finding.kind == "bodies"
    assert finding.doubts_labels
    assert is_in_doubt(state)


def test_two_bodies_in_random_order_are_found(recordings):
    rng, rows = np.random.default_rng(1), np.arange(400)
    first, second = recordings["paper_experiment"][rows], recordings["all_states"][rows]
    choice = rng.random(len(rows)) < 0.5
    position = np.where(choice[:, None], first.position_m, second.position_m)
    quat = np.where(choice[:, None], first.quat_xyzw, second.quat_xyzw)
    assert "bodies" in kinds(Poses(first.stamp_ns, position, quat))


@pytest.mark.parametrize(
    ("apart_mm", "every", "in_turns"),
    [(3, 2, True), (5, 2, True), (5, 8, True), (20, 4, True), (5, 2, False), (20, 4, False)],
)
def test_two_bodies_close_to_each_other_are_found_in_motion(recordings, apart_mm, every, in_turns):
    """Two bodies that move together, at up to 0.3 m/s, with 0.3 mm of noise."""
    poses = recordings["paper_experiment"][1100::every]
    numbers = np.arange(len(poses)) if in_turns else np.random.default_rng(4).permutation(len(poses))
    aside = 1e-3 * apart_mm * np.array([0.6, -0.5, 0.62]) * (numbers % 2)[:, None]
    found = inspected(
        Poses(poses.stamp_ns, poses.position_m + aside, poses.quat_xyzw)[: 200 if in_turns else 800]
    )
    assert found.bodies
    assert is_in_doubt(found)


@pytest.mark.parametrize("apart_mm", [0.5, 1.0])
def test_cameras_that_take_turns_and_hardly_differ_are_one_body(recordings, apart_mm):
    poses = recordings["paper_experiment"][::2]
    aside = 1e-3 * apart_mm * (np.arange(len(poses)) % 2)[:, None] * np.array([0.6, -0.5, 0.62])
    assert not inspected(Poses(poses.stamp_ns, poses.position_m + aside, poses.quat_xyzw)).bodies


def test_a_vibration_is_no_second_body(recordings):
    """The object vibrates by 2 mm at 37 Hz."""
    poses = recordings["paper_experiment"][::2]
    shaken = 2e-3 * np.sin(2e-9 * np.pi * 37.0 * (poses.stamp_ns - poses.stamp_ns[0]))
    position = poses.position_m + shaken[:, None] * [0.0, 0.6, 0.8]
    assert not inspected(Poses(poses.stamp_ns, position, poses.quat_xyzw)).bodies


@each_recording
def test_outliers_are_no_second_body(recordings, name):
    rng, poses = np.random.default_rng(0), recordings[name]
    off = rng.random(len(poses)) < 0.1
    position = poses.position_m + off[:, None] * rng.normal(size=(len(poses), 3))
    assert kinds(Poses(poses.stamp_ns, position, poses.quat_xyzw)) == []


@each_recording
def test_a_default_pose_is_no_second_body(recordings, name):
    poses = recordings[name]
    lost = (np.random.default_rng(0).random(len(poses)) < 0.1)[:, None]
    away = Poses(
        poses.stamp_ns,
        np.where(lost, 0.0, poses.position_m),
        np.where(lost, [0.0, 0.0, 0.0, 1.0], poses.quat_xyzw),
    )
    assert kinds(away) == []


def test_an_orientation_or_position_that_never_changes(recordings):
    poses = recordings["paper_experiment"][:1000]
    unturned = Poses(poses.stamp_ns, poses.position_m, np.tile([0.0, 0.0, 0.0, 1.0], (len(poses), 1)))
    unmoved = Poses(poses.stamp_ns, np.zeros((len(poses), 3)), poses.quat_xyzw)
    for stream, word in ((unturned, "orientation"), (unmoved, "position")):
        (finding,) = findings(inspected(stream))
        assert finding.kind == "orientation"
        assert finding.doubts_labels
        assert f"the {word} never changes" in finding.text
        assert kinds(stream[:99]) == []
        assert kinds(merged(stream, shifted(poses, [0.0, 0.0, 0.0], 10**10))) == []
    assert kinds(Poses(unturned.stamp_ns, unmoved.position_m, unturned.quat_xyzw)) == ["still"]


@each_filter
@pytest.mark.parametrize(("name", "seconds"), [("paper_experiment", 8.0), ("robot_1khz", 2.0)])
def test_filtered_poses_are_found(recordings, distort, name, seconds):
    state = inspected(distort(until(recordings[name], seconds)))
    (finding,) = findings(state)
    assert finding.kind == "filtered"
    assert not finding.doubts_labels
    assert not is_in_doubt(state)


@pytest.mark.parametrize("sigma_m", [0.0, 1e-7, 1e-5, 1e-3])
@pytest.mark.parametrize("rate_hz", [10, 30, 200])
def test_motion_is_no_filter(rate_hz, sigma_m):
    """With any share of motion in the third differences."""
    assert kinds(moving(np.random.default_rng(3), 60.0, rate_hz, sigma_m, 5.0 * sigma_m)) == []


def test_dropped_and_held_poses_are_no_filter(recordings):
    poses, rng = recordings["paper_experiment"], np.random.default_rng(0)
    assert kinds(poses[rng.random(len(poses)) < 0.5]) == []
    held = poses[np.arange(len(poses)) // 3 * 3]
    assert kinds(Poses(poses.stamp_ns, held.position_m, held.quat_xyzw)) == []


STREAMS = {
    "as it is": lambda poses: poses,
    "millimetres": lambda poses: scaled(poses, 1e3),
    "filtered": lambda poses: averaged(poses, 3),
    "two bodies": lambda poses: merged(poses, shifted(poses[::2], [0.3, 0.0, 0.0], 10**6)),
}


@pytest.mark.parametrize("change", STREAMS.values(), ids=STREAMS)
@given(sizes=st.lists(st.integers(1, 700), min_size=1, max_size=30))
@settings(max_examples=6)
def test_results_do_not_depend_on_how_the_stream_is_split(recordings, change, sizes):
    poses = change(recordings["paper_experiment"][:1500])
    whole, state, first = inspect(NOTHING_INSPECTED, poses), NOTHING_INSPECTED, 0
    for size in [*sizes, len(poses)]:
        if first < len(poses):
            state = inspect(state, poses[first : first + size])
            first += size
    assert findings(state) == findings(whole)
    for part, other in zip(_numbers(state), _numbers(whole), strict=True):
        np.testing.assert_allclose(part, other, rtol=1e-9, atol=1e-12)


def _numbers(state):
    for value in state:
        if isinstance(value, Poses):
            yield from value.columns
        elif isinstance(value, tuple):
            yield from _numbers(value)
        elif not isinstance(value, TableReading):
            yield value


def test_memory_is_bounded(recordings):
    state = NOTHING_INSPECTED
    for batch in recordings["robot_1khz"].batches():
        state = inspect(state, batch)
        assert len(state.recent) < KEPT + BLOCK
        assert len(state.first) == 1
