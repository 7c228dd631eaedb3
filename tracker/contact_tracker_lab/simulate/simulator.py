"""Simulation of a scenario from a seed: poses measured with noise, outliers and dropouts, and the truth."""

import json
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import butter, filtfilt
from scipy.spatial.transform import Rotation

from contact_tracker.arrays import Array, Ints
from contact_tracker.errors import UsageError
from contact_tracker.geometry.polyhedron import Polyhedron, convex, unit
from contact_tracker.ground_truth import FurtherTruth, Truth, TruthInterval
from contact_tracker.motion.poses import Poses
from contact_tracker.states import Contact
from contact_tracker.wrenches.wrenches import Wrenches
from contact_tracker_lab.simulate.corner import move_in_corner
from contact_tracker_lab.simulate.jointed import TrueJoint, move_in_joint
from contact_tracker_lab.simulate.motion import Path, move
from contact_tracker_lab.simulate.plan import Leg, Rigid, plan
from contact_tracker_lab.simulate.scenarios import (
    OBJECTS,
    SURROUNDINGS,
    Scenario,
    named_scenario,
)
from contact_tracker_lab.simulate.wrench import measure_wrenches

START_NS = 1_700_000_000_000_000_000
WORLD_M, BODY_M = 1.0, 0.06
"""Spread (m) of the scene's origin in the world, and of the object's middle in the body frame."""
OUTLIER_M = (0.01, 0.06)
OUTLIER_RAD = (float(np.radians(4.0)), float(np.radians(25.0)))


def stamps(rng: np.random.Generator, count: int, scenario: Scenario) -> Ints:
    """Stamps (count,) in ns, strictly increasing; jitter moves the stamp, not the pose."""
    period = 1e9 / scenario.rate_hz
    jitter = np.clip(rng.normal(0.0, 1.0, count) * scenario.jitter_s * 1e9, -0.4 * period, 0.4 * period)
    return START_NS + np.rint(np.arange(count) * period + jitter).astype(np.int64)


def measure(rng: np.random.Generator, stamp_ns: Ints, pose: Rigid, scenario: Scenario) -> Poses:
    """Measured poses of the true poses ``pose`` (N,) of the body in the world."""
    count = len(stamp_ns)
    turn = rng.normal(0.0, 1.0, (count, 3)) * scenario.sigma_rotation_rad
    shift = rng.normal(0.0, 1.0, (count, 3)) * scenario.sigma_position_m
    is_outlier = rng.random(count) < scenario.outlier_probability
    turn[is_outlier] += _random_vectors(rng, count, OUTLIER_RAD)[is_outlier]
    shift[is_outlier] += _random_vectors(rng, count, OUTLIER_M)[is_outlier]
    quat = (Rotation.from_matrix(pose.rotation) * Rotation.from_rotvec(turn)).as_quat()
    agrees = np.einsum("ni,ni->n", quat[1:], quat[:-1]) >= 0.0
    quat[1:] *= np.cumprod(np.where(agrees, 1.0, -1.0))[:, None]  # q and -q are one rotation
    fresh = rng.random(count) >= scenario.hold_probability
    fresh[0] = True
    source = np.maximum.accumulate(np.where(fresh, np.arange(count), 0))
    kept = rng.random(count) >= scenario.drop_probability
    kept[0] = True
    return Poses(stamp_ns, (pose.translation + shift)[source], quat[source])[kept]


def _random_vectors(rng: np.random.Generator, count: int, length: tuple[float, float]) -> Array:
    """Vectors (count, 3) of random direction, with lengths uniform in ``length``."""
    directions = unit(rng.normal(0.0, 1.0, (count, 3)))
    return np.asarray(directions * rng.uniform(*length, (count, 1)), float)


def rate_hz(poses: Poses) -> float:
    """Pose rate by the median step between stamps."""
    return 1e9 / float(np.median(np.diff(poses.stamp_ns)))


def smoothed(poses: Poses, smooth: Callable[[Array], Array]) -> Poses:
    """Apply a filter along time to positions and quaternions of continuous sign."""
    quat = smooth(poses.quat_xyzw)
    norm = np.linalg.norm(quat, axis=1)[:, None]
    return replace(poses, position_m=smooth(poses.position_m), quat_xyzw=quat / norm)


def low_pass(poses: Poses, cutoff_hz: float) -> Poses:
    """Second-order Butterworth filter, forward and backward; poses at too low a rate stay unchanged."""
    if rate_hz(poses) <= 2.2 * cutoff_hz:
        return poses
    b, a = butter(2, 2.0 * cutoff_hz / rate_hz(poses))
    return smoothed(poses, lambda rows: np.asarray(filtfilt(b, a, rows, axis=0)))


@dataclass(frozen=True, eq=False)
class Simulated:
    """A labelled recording: measured poses, ground truth, and metadata of its generation; the joint in which
    the object moves, and the measured wrenches of the hand, if any."""

    poses: Poses
    truth: Truth
    metadata: dict[str, str]
    joint: TrueJoint | None = None
    wrenches: Wrenches | None = None


def simulate(scenario: str | Scenario, seed: int) -> Simulated:
    """Move an object through the contacts of ``scenario`` and measure its poses.

    Parameters
    ----------
    scenario : a Scenario, or the name of one in ``SCENARIOS``.
    seed : any non-negative integer; equal seeds give equal recordings. Motion and measurement draw from
        independent generators: other noise leaves the motion unchanged, and wrenches leave the poses.

    Raises
    ------
    UsageError : an unknown name, or a negative seed.
    """
    if seed < 0:
        raise UsageError("the seed must not be negative")
    if isinstance(scenario, str):
        scenario = named_scenario(scenario, seed)
    streams = np.random.SeedSequence(seed).spawn(4)
    motion_rng, frame_rng, sensor_rng, wrench_rng = (np.random.default_rng(stream) for stream in streams)
    object = convex(OBJECTS[scenario.object])
    world, body = random_frame(frame_rng, WORLD_M), random_frame(frame_rng, BODY_M)

    def measured(pose: Rigid) -> tuple[Ints, Poses]:
        """Stamps and measurements of the poses of the object in its surroundings."""
        stamp_ns = stamps(sensor_rng, len(pose.translation), scenario)
        return stamp_ns, measure(sensor_rng, stamp_ns, world @ pose @ body.inverse(), scenario)

    contact, duration_s, _ = scenario.phases[0]  # joints and further contacts have one phase
    time_s = np.linspace(0.0, duration_s, round(duration_s * scenario.rate_hz), endpoint=False)
    metadata = _metadata(scenario, seed, moved_vertices(object, body))
    if scenario.joint is not None:  # no contact is scored
        pose, joint = move_in_joint(motion_rng, scenario.joint, scenario, time_s, body, world)
        stamp_ns, poses = measured(pose)
        truth = Truth((TruthInterval(int(stamp_ns[0]), int(stamp_ns[-1]), None),))
        return Simulated(poses, truth, metadata | {"joint": joint.to_json()}, joint)
    if scenario.further is not None:
        pose, *touches = move_in_corner(motion_rng, object, scenario, scenario.further.contact, time_s)
        stamp_ns, poses = measured(pose)
        on_table, on_wall = (touch.geometry(body, world) for touch in touches)
        since_s, until_s = scenario.further.start_s or 0.0, scenario.further.end_s or duration_s
        rows = np.minimum(np.searchsorted(time_s, (0.0, duration_s, since_s, until_s)), len(time_s) - 1)
        start_ns, end_ns, since_ns, until_ns = stamp_ns[rows].tolist()
        second = FurtherTruth(since_ns, until_ns, scenario.further.contact, on_wall)
        truth = Truth((TruthInterval(start_ns, end_ns, contact, geometry=on_table, further=(second,)),))
        return Simulated(poses, truth, metadata)
    scene = convex(SURROUNDINGS[scenario.surroundings])
    legs = plan(motion_rng, scenario.phases, object, scene, scenario.lead_s)
    paths = [move(motion_rng, leg, scenario.rate_hz, scenario) for leg in legs]
    stamp_ns, poses = measured(Rigid.join([path.pose for path in paths]))
    truth = Truth(tuple(_intervals(legs, paths, stamp_ns, body, world)))
    metadata["surroundings_vertices_m"] = moved_vertices(scene, world)  # unlike table and wall
    wrenches = None
    if scenario.has_wrench:
        wrenches = measure_wrenches(wrench_rng, stamp_ns, scenario.rate_hz, legs, paths, object, body)
    return Simulated(poses, truth, metadata, wrenches=wrenches)


def _intervals(
    legs: list[Leg], paths: list[Path], stamp_ns: Ints, body: Rigid, world: Rigid
) -> list[TruthInterval]:
    """Intervals of contacts; the pose between two legs belongs to the more constrained contact."""
    result, start, frame = list[TruthInterval](), 0, 0
    for leg, path, following in zip(legs, paths, (*legs[1:], None), strict=True):
        frame += len(path.touch_scene)
        end = frame + (following is not None and following.contact.codimension < leg.contact.codimension)
        geometry = None
        if leg.contact is not Contact.FREE:
            touch = path.touch_object.mean(axis=0), path.touch_scene.mean(axis=0)
            geometry = leg.chart.geometry(body, world, *touch)
        span, is_singular = (int(stamp_ns[start]), int(stamp_ns[end - 1])), leg.motion != "normal"
        result.append(TruthInterval(*span, leg.contact, leg.motion, is_singular, geometry))
        start = end
    return result


def random_frame(rng: np.random.Generator, spread_m: float) -> Rigid:
    return Rigid(Rotation.from_quat(rng.normal(size=4)).as_matrix(), rng.uniform(-spread_m, spread_m, 3))


def moved_vertices(shape: Polyhedron, frame: Rigid) -> str:
    """The vertices (V, 3) in the frame of the recording, as JSON text for metadata."""
    return json.dumps((shape.vertices @ frame.rotation.T + frame.translation).tolist())


def _metadata(scenario: Scenario, seed: int, vertices_m: str) -> dict[str, str]:
    noise = {
        "rate": scenario.rate_hz,
        "pos_std_m": scenario.sigma_position_m,
        "rot_std_deg": float(np.degrees(scenario.sigma_rotation_rad)),
        "outlier_p": scenario.outlier_probability,
        "outlier_pos_m": OUTLIER_M,
        "outlier_rot_deg": tuple(np.degrees(OUTLIER_RAD).tolist()),
        "drop_p": scenario.drop_probability,
        "hold_p": scenario.hold_probability,
        "jitter_s": scenario.jitter_s,
    }
    return {
        "scenario": scenario.name,
        "seed": str(seed),
        "generator": "contact_tracker.simulate",
        "object": scenario.object,
        "object_vertices_m": vertices_m,
        "surroundings": scenario.surroundings,
        "noise": json.dumps(noise),
    }
