"""A map that contradicts the motion is reported, and one that fits is not."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import as_values
from checked_stream import stream_of, updated
from contact_tracker.checks.checks import Contradiction
from contact_tracker.map.file import map_from
from contact_tracker.map.map import Map
from contact_tracker.motion.pose_validation import gate
from contact_tracker.motion.poses import Poses
from contact_tracker.recording import read_truth
from contact_tracker.segmenting import segmented
from contact_tracker.tracking.segmentation import Segmentation
from contact_tracker.trajectory import Trajectory
from contact_tracker_lab.evaluation.evaluate import evaluate
from distortions import moving_average
from short_recordings import MODEL, SHIPPED, needs_kernels, shipped
from smooth_motion import least_jerk, moving, slid_and_tilted, with_noise


def up(direction: list[float]) -> Map:
    return map_from({"up": {"direction": list(np.array(direction) / np.linalg.norm(direction))}})


def poses_of(name: str) -> Poses:
    return gate(shipped(name))


def tracked(poses: Poses, known_map: Map) -> tuple[list[str], Segmentation]:
    found = segmented(Trajectory(poses), MODEL, known_map)
    texts = [finding.text for finding in found.report.findings if finding.kind == "knowledge"]
    return texts, found.segmentation


@needs_kernels
def test_a_wrong_direction_is_reported_and_no_label_is_surely_wrong() -> None:
    poses = poses_of("robot_1khz")[:6000]
    (text,), found = tracked(poses, up([1.0, 0.0, 0.0]))
    assert text.startswith("--up does not fit the motion")
    scores = evaluate(poses, read_truth(str(SHIPPED / "robot_1khz.mcap")), found)
    assert scores.offline.sure_wrong == 0.0
    assert scores.online.sure_wrong < 0.01, "before it is reported"


Z = np.array([0.0, 0.0, 1.0])
SLOPE = np.array([0.0, -0.6, 0.8])


def tilting(rng: np.random.Generator) -> Poses:
    """A box in the hand, then on an edge on a slope, about which alone it turns. A box with a face on a wall
    across the edge would tilt like that too, if ``--up`` did not exclude it."""
    poses = moving(rng, 12.0, 200.0)
    time_s = (poses.stamp_ns - poses.stamp_ns[0]) * 1e-9
    axis = np.cross(SLOPE, [1.0, 0.0, 0.0])
    axis /= np.linalg.norm(axis)
    start = int(np.searchsorted(time_s, 3.0))
    turn, place_m = Rotation.from_quat(poses.quat_xyzw), poses.position_m.copy()
    tilt = 0.3 * np.sin(2.5 * (time_s - 3.0)) * (time_s >= 3.0)
    turn = turn[np.minimum(np.arange(len(poses)), start)]
    edge_m = place_m[start] + [0.05, 0.1, -0.1]
    place_m[start:] = edge_m + Rotation.from_rotvec(tilt[start:, None] * axis).apply(place_m[start] - edge_m)
    free = Rotation.from_quat(poses.quat_xyzw[:start])
    turn = Rotation.concatenate([free, Rotation.from_rotvec(tilt[start:, None] * axis) * turn[start:]])
    return with_noise(rng, time_s, place_m, turn)


def slid_and_tilted_by_hand(rng: np.random.Generator) -> Poses:
    """A box that slides on a table with normal z, and is then tilted about one of its edges and put back six
    times; the poses of a point far from the edge. A face across the edge fits without ``--up``, but motion in
    one direction leaves that open."""
    time_s = np.arange(0.0, 34.0, 0.005)
    slid, cycle_s = np.clip((time_s - 1.0) / 2.0, 0.0, 1.0), np.maximum(time_s - 4.0, 0.0) % 5.0
    up_by, back_by = (np.clip((cycle_s - start) / 1.5, 0.0, 1.0) for start in (0.0, 2.0))
    tilt = 0.5 * (up_by**2 * (3.0 - 2.0 * up_by) - back_by**2 * (3.0 - 2.0 * back_by))
    turn = Rotation.from_euler("ZY", np.c_[0.2 * np.sin(3.0 * slid), tilt])
    touch_m = np.c_[0.06 * np.sin(7.0 * slid), 0.05 * np.sin(9.0 * slid), 0.0 * slid]
    return with_noise(rng, time_s, touch_m - turn.apply([0.12, -0.01, -0.12]), turn)


def carried_in_one_plane(rng: np.random.Generator) -> Poses:
    """An arm carries a part between places on one line, and tilts it in the air; the poses of its tool centre
    point, which is always in the vertical plane through that line: a vertex on that plane fits, too."""
    places_m, turns = [np.zeros(3)], [np.zeros(3)]
    seconds = [2.0]
    for side in (1, -1, 1, -1, 1):
        at_m = np.array([0.24, 0.97, 0.0]) * rng.uniform(0.08, 0.2) * side
        yaw, tilt = [0.0, 0.0, rng.uniform(-1.0, 1.0)], rng.uniform(-0.4, 0.4, 3)
        up_m, high_m = [0.0, 0.0, 0.15], [0.0, 0.0, 0.175]
        for wait_s, place_m, turn in (
            (1.0, places_m[-1] + up_m, turns[-1]),
            (1.5, at_m + high_m, tilt),
            (1.0, at_m + up_m, yaw),
            (0.9, at_m, yaw),
            (2.0, at_m, yaw),
        ):
            places_m.append(np.asarray(place_m))
            turns.append(np.asarray(turn))
            seconds.append(wait_s)
    time_s, end_s = np.arange(0.0, sum(seconds), 0.01), np.cumsum(seconds)
    leg = np.clip(np.searchsorted(end_s, time_s), 1, len(end_s) - 1)
    part = least_jerk((time_s - end_s[leg - 1]) / np.take(seconds, leg))[:, None]
    place_m = np.take(places_m, leg - 1, axis=0) * (1.0 - part) + np.take(places_m, leg, axis=0) * part
    start, end = (Rotation.from_rotvec(np.take(turns, leg - back, axis=0)) for back in (1, 0))
    turn = Rotation.from_rotvec(part * (end * start.inv()).as_rotvec()) * start
    return with_noise(rng, time_s, place_m, turn, 5e-5, float(np.radians(0.02)))


@needs_kernels
@pytest.mark.parametrize(
    ("motion", "normal"), [(tilting, SLOPE), (slid_and_tilted_by_hand, Z), (carried_in_one_plane, Z)]
)
def test_a_correct_direction_is_not_refuted_by_what_it_excludes(
    motion: Callable[[np.random.Generator], Poses], normal: np.ndarray[Any, Any]
) -> None:
    texts, found = tracked(motion(np.random.default_rng(0)), up(list(normal)))
    assert texts == []
    assert found.segments


@needs_kernels
@pytest.mark.parametrize(
    ("width_m", "fits"), [pytest.param(0.12, True, marks=pytest.mark.long), (0.02, False)]
)
def test_a_table_that_fits_does_not_excuse_a_box_that_does_not(width_m: float, fits: bool) -> None:
    size_m = np.array([0.2, 0.12, 0.08])
    table = {"normal": [0.0, 0.0, 1.0], "offset_m": 0.0, "name": "table"}
    box = {"size_m": [0.2, width_m, 0.08]}
    known = map_from({"environment": {"plane": [table]}, "object": {"box": box}})
    found = segmented(Trajectory(slid_and_tilted(np.random.default_rng(0), size_m)), MODEL, known)
    assert (found.report.findings == ()) == fits, found.report.findings
    assert (found.beliefs.probability.max() > 0.9) == fits


@pytest.mark.long
@needs_kernels
def test_exact_knowledge_fits_filtered_poses() -> None:
    """Their errors look smaller than they are; what is left of them is no motion that refutes a table."""
    table, size_m = {"normal": [0.0, 0.0, 1.0], "offset_m": 0.0}, [0.2, 0.12, 0.08]
    known = map_from({"environment": {"plane": [table]}, "object": {"box": {"size_m": size_m}}})
    rng = np.random.default_rng(3)
    first = slid_and_tilted(rng, np.array(size_m))[0]
    error = Rotation.from_rotvec(np.radians(0.15) * rng.normal(size=(450, 3)))
    resting = Poses(
        first.stamp_ns + np.arange(450) * 6_666_667,
        first.position_m + 3e-4 * rng.normal(size=(450, 3)),
        (Rotation.from_quat(first.quat_xyzw) * error).as_quat(),
    )
    state, _ = as_values.advance(as_values.start(MODEL, known_map=known), moving_average(resting, 3))
    assert not state.checks.contradiction.is_likely(state.stream)


@needs_kernels
@pytest.mark.parametrize("is_filtered", [False, True])
def test_before_the_noise_is_chosen_filtered_poses_refute_nothing_until_the_end(is_filtered: bool) -> None:
    """It is taken for motion; labels are in doubt until then."""
    box = slid_and_tilted(np.random.default_rng(1), np.array([0.2, 0.12, 0.08]))[:1500]
    noise = replace(
        MODEL.noise, floor_position_m=(2.0 if is_filtered else 1.0) * MODEL.noise.floor_position_m
    )
    stream = stream_of(up([0.6, 0.0, 0.8]), is_chosen=False, best=replace(MODEL, noise=noise))
    known = updated(Contradiction(), box.batches(), stream)
    assert known.is_likely(stream)
    assert known.is_found is not is_filtered
    assert known.finish().is_found


@needs_kernels
def test_results_do_not_depend_on_how_the_poses_are_split() -> None:
    poses, known_map = poses_of("robot_1khz")[:4000], up([1.0, 0.0, 0.0])
    ends = []
    for size in (7, 400):
        batches = (poses[first : first + size] for first in range(0, len(poses), size))
        known = updated(Contradiction(), batches, stream_of(known_map))
        ends.append((known.is_found, known.lead))
    assert ends[0] == ends[1]
    assert ends[0][0]
