"""Recordings made with a physics engine, MuJoCo: a compliant hand moves an object that contact forces hold.

    python -m contact_tracker_lab.physics FOLDER

makes two sets. ``sequence``: random walks over the six contacts and free motion. ``everyday``: an object
stands on a table, is carried for a second or two, touches table or board for half a second, and is put down;
each scene has two takes in the same frames. Even numbers are for tuning, odd ones for testing.

The hand follows the kinematic motion of this package with a spring and a damper at the touching point,
trembles, and presses the object on its contact; at rest it lets go. The true contacts follow from the poses
of the engine (``touching``), not from the commands to the hand.
"""

import argparse
import hashlib
import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from contact_tracker.arrays import Array
from contact_tracker.cli.arguments import add_processes
from contact_tracker.cli.terminal import show
from contact_tracker.errors import DIFFERENT, DONE, ContactTrackerError, UsageError, module_of_extra
from contact_tracker.exports.formats import check_output
from contact_tracker.geometry.polyhedron import Feature, Polyhedron, convex
from contact_tracker.ground_truth import Truth
from contact_tracker.processes import Workers
from contact_tracker.recording import write_recording
from contact_tracker.states import STATES, Contact
from contact_tracker_lab.evaluation.tables import table
from contact_tracker_lab.simulate.motion import Path as HandPath
from contact_tracker_lab.simulate.motion import move
from contact_tracker_lab.simulate.plan import Leg, Rigid, plan
from contact_tracker_lab.simulate.scenarios import (
    OBJECTS,
    SURROUNDINGS,
    Phase,
    Scenario,
    box,
    named_scenario,
)
from contact_tracker_lab.simulate.simulator import (
    BODY_M,
    WORLD_M,
    Simulated,
    measure,
    moved_vertices,
    random_frame,
    stamps,
)
from contact_tracker_lab.simulate.touching import intervals, touch_at
from contact_tracker_lab.simulate.wrench import MASS_KG, PRESS_N, contact_normals, press_share

HAND_HZ: Final = 1000
"""Steps of the hand per second; the engine makes two steps in each."""
STIFFNESS: Final = (800.0, 10.0)
"""Stiffness of the hand (N/m, N m/rad); it is damped so that it does not swing."""
TREMOR: Final = (0.0002, float(np.radians(0.1)), 8.0, 12.0)
"""Root mean squares (m, rad) of the tremor per axis, and its range of frequencies (Hz)."""
FALLEN_M: Final = 0.1
"""Vertical distance (m) from the hand's goal beyond which the object has slid off the desk after the hand let
go of it: another plan is drawn. An object that slides on the desk stays."""
_SCENE: Final = """<mujoco><option timestep="0.0005" integrator="implicitfast" cone="elliptic">
<flag multiccd="enable"/></option>
<default><geom type="mesh" friction="0.1 0.001 0.0001" solref="0.002 1" solimp="0.99 0.999 0.0001"/></default>
<asset>{meshes}</asset><worldbody>{fixed}
<body><freejoint/><geom mesh="object" mass="{mass}"/></body></worldbody></mujoco>"""
_DRAWS: Final = 500


@dataclass(frozen=True, eq=False)
class Scene(Polyhedron):
    """Several fixed ``bodies``; ``features``: those that objects touch."""

    bodies: tuple[Polyhedron, ...]

    @classmethod
    def of(cls, *vertices: Array) -> "Scene":
        """Scene of a body whose top is touched, and of further bodies, whose faces towards +x are."""
        first, *further = map(convex, vertices)
        sides = [max(body.of_kind("f"), key=lambda face: float(face.normals[0, 0])) for body in further]
        apart = [replace(side, indices=frozenset(i + 1000 for i in side.indices)) for side in sides]
        return cls(np.concatenate(vertices), (*first.top, *apart), (first, *further))

    @property
    def top(self) -> tuple[Feature, ...]:
        return self.features


class Made(NamedTuple):
    """A recording to be made: its name and shapes, and the seeds of its frames and of its motion."""

    name: str
    scenario: Scenario
    object: Polyhedron
    scene: Scene
    frame_seed: int
    seed: int


def walk(number: int) -> Made:
    """A recording of the set ``sequence``."""
    scenario = named_scenario("random", 146 + number)
    scenario = replace(scenario, phases=scenario.phases[:6], rate_hz=200.0)
    scene = Scene.of(SURROUNDINGS[scenario.surroundings])
    return Made(f"sequence_{number:02d}", scenario, convex(OBJECTS[scenario.object]), scene, number, number)


BOARD: Final = box(0.04, 0.6, 0.5) + np.array([-0.36, 0.0, 0.85])
"""A board that hangs upright above the desk."""
HANDLED: Final = ("box", "wedge")


def handling(shape: str, take: int) -> Made:
    """A recording of the set ``everyday``: each take has its own motion and noise."""
    rng = np.random.default_rng([take, *shape.encode()])
    phases = [Phase(Contact.FF, 2.5, "rest")]
    for _ in range(3):
        phases.append(Phase(Contact.FREE, rng.uniform(1.0, 2.0)))
        touch = (Contact.EF, Contact.VF, Contact.FF)[rng.integers(3)]
        phases += [Phase(touch, rng.uniform(0.5, 1.2)), Phase(Contact.FREE, rng.uniform(1.0, 2.0))]
        phases += [Phase(Contact.FF, rng.uniform(0.5, 1.0)), Phase(Contact.FF, rng.uniform(1.0, 2.5), "rest")]
    scenario = Scenario(
        tuple(phases),
        rate_hz=100.0,
        sigma_position_m=float(rng.uniform(0.0001, 0.0003)),
        sigma_rotation_rad=float(np.radians(rng.uniform(0.05, 0.2))),
        amplitude_m=0.02,
        amplitude_rad=float(np.radians(6.0)),
        lead_s=0.0,
        object=shape,
        name="everyday",
    )
    scene = Scene.of(SURROUNDINGS[scenario.surroundings], BOARD)
    seed = 1000 + 10 * HANDLED.index(shape)
    return Made(f"{shape}_{take:02d}", scenario, convex(OBJECTS[shape]), scene, seed, seed + take)


def simulate_physics(made: Made) -> Simulated:
    """Let the hand move the object, and measure its poses.

    Raises
    ------
    MissingExtra : MuJoCo is not installed.
    """
    scenario, frames = made.scenario, np.random.default_rng([made.frame_seed, 2])
    body, world = random_frame(frames, BODY_M), random_frame(frames, WORLD_M)
    rng = np.random.default_rng([made.seed, 3])
    for _ in range(_DRAWS):
        legs = _planned(rng, made)
        paths = [move(rng, leg, HAND_HZ, scenario) for leg in legs]
        goal_m = np.concatenate([path.pose.translation for path in paths])
        pose = _moved_by_hand(rng, made, legs, paths)
        if np.abs(pose.translation - goal_m)[:, 2].max() < FALLEN_M:
            break
    else:
        raise UsageError(f"{made.name}: the object falls from these surroundings")
    stride = round(HAND_HZ / scenario.rate_hz)
    pose = Rigid(pose.rotation[::stride], pose.translation[::stride])
    motion = [leg.motion for leg, path in zip(legs, paths, strict=True) for _ in path.touch_scene][::stride]
    stamp_ns = stamps(rng, len(motion), scenario)
    poses = measure(rng, stamp_ns, world @ pose @ body.inverse(), scenario)
    touches = [
        touch_at(made.object, made.scene.bodies, *frame)
        for frame in zip(pose.rotation, pose.translation, strict=True)
    ]
    truth = Truth(tuple(intervals(stamp_ns, touches, motion, body, world)))
    metadata = {
        "generator": "contact_tracker_lab.physics, MuJoCo " + _engine().__version__,
        "seed": str(made.seed),
        "object": scenario.object,
        "object_vertices_m": moved_vertices(made.object, body),
        "surroundings": scenario.surroundings,
        "surroundings_vertices_m": moved_vertices(made.scene, world),
        "up_world": json.dumps(world.rotation[:, 2].tolist()),
        "noise": json.dumps([scenario.rate_hz, scenario.sigma_position_m, scenario.sigma_rotation_rad]),
    }
    return Simulated(poses, truth, metadata)


def _planned(rng: np.random.Generator, made: Made) -> list[Leg]:
    """Legs after which the object stays where the hand lets go of it."""
    for _ in range(_DRAWS):
        legs = plan(rng, made.scenario.phases, made.object, made.scene, made.scenario.lead_s)
        if made.scenario.name != "everyday" or all(_stands(leg) for leg in legs if leg.motion == "rest"):
            return legs
    raise UsageError(f"{made.name}: the object does not stand on these surroundings")


def _stands(leg: Leg) -> bool:
    """Whether gravity holds the object on the face on which it lies; level within 2.6 deg, and 20 mm from the
    edges, are choices of the scenario."""
    anchor, chart = leg.start, leg.chart
    if anchor.normal[2] < 0.999:
        return False
    height_m = anchor.normal @ (anchor.pose.translation - anchor.touch_scene)
    middle = anchor.pose.translation - anchor.normal * height_m
    in_object = anchor.rotation.T @ (middle - anchor.pose.translation)
    clearances = chart.environment.point_clearance(middle), chart.object.point_clearance(in_object)
    return min(clearances) > 0.02


def _moved_by_hand(
    rng: np.random.Generator, made: Made, legs: Sequence[Leg], paths: Sequence[HandPath]
) -> Rigid:
    """Poses (N,), one for each step of the hand, of the object in the scene."""
    engine = _engine()
    shapes = {"object": made.object, **{f"fixed{i}": shape for i, shape in enumerate(made.scene.bodies)}}
    meshes = [
        f'<mesh name="{name}" vertex="{" ".join(map(repr, shape.vertices.ravel().tolist()))}"/>'
        for name, shape in shapes.items()
    ]
    fixed = "".join(f'<geom mesh="{name}"/>' for name in shapes if name != "object")
    scene = _SCENE.format(meshes="".join(meshes), fixed=fixed, mass=MASS_KG)
    model = engine.MjModel.from_xml_string(scene)
    data = engine.MjData(model)
    goal = Rigid.join([path.pose for path in paths])
    touch = np.concatenate([path.touch_object for path in paths])
    normal = np.concatenate([contact_normals(leg, path) for leg, path in zip(legs, paths, strict=True)])
    lengths = [len(path.touch_scene) for path in paths]
    lets_go = made.scenario.name == "everyday"
    touches = [leg.contact is not Contact.FREE for leg in legs]
    holds = [not (lets_go and leg.motion == "rest") for leg in legs]
    press, held = (press_share(np.repeat(flags, lengths), HAND_HZ) for flags in (touches, holds))
    time_s = np.arange(len(touch)) / HAND_HZ
    frequency, phase = rng.uniform(*TREMOR[2:], (8, 6)), rng.uniform(0.0, 2.0 * np.pi, (8, 6))
    waves = np.sin(2.0 * np.pi * frequency * time_s[:, None, None] + phase)
    shake = 0.5 * waves.sum(axis=1)  # signals of unit power
    goal_r = goal.rotation @ Rotation.from_rotvec(TREMOR[1] * shake[:, :3]).as_matrix()
    goal_p = goal.translation + TREMOR[0] * shake[:, 3:]
    speed = np.gradient(goal_p, axis=0) * HAND_HZ
    turn = np.zeros_like(goal_p)
    turn[1:] = Rotation.from_matrix(goal_r[1:] @ np.swapaxes(goal_r[:-1], 1, 2)).as_rotvec() * HAND_HZ
    data.qpos[:3], data.qpos[3:] = goal_p[0], Rotation.from_matrix(goal_r[0]).as_quat(scalar_first=True)
    engine.mj_forward(model, data)
    inertia = float(model.body_inertia[1].mean())
    damping = 1.4 * np.sqrt(STIFFNESS[0] * MASS_KG), 1.4 * np.sqrt(STIFFNESS[1] * inertia)
    rotation, translation = np.empty_like(goal_r), np.empty_like(goal_p)
    for i in range(len(goal_p)):
        r = data.xmat[1].reshape(3, 3)
        rotation[i], translation[i] = r, data.qpos[:3]
        arm, goal_arm, spin = r @ touch[i], goal_r[i] @ touch[i], r @ data.qvel[3:]
        miss = goal_p[i] + goal_arm - translation[i] - arm
        slip = speed[i] + np.cross(turn[i], goal_arm) - data.qvel[:3] - np.cross(spin, arm)
        error = 0.5 * np.cross(r, goal_r[i], axis=0).sum(axis=1)  # the sine of a small angle
        force = STIFFNESS[0] * miss + damping[0] * slip - PRESS_N * press[i] * normal[i]
        moment = STIFFNESS[1] * error + damping[1] * (turn[i] - spin)
        moment += np.cross(translation[i] + arm - data.xipos[1], force)
        force = force - MASS_KG * model.opt.gravity
        data.xfrc_applied[1, :3], data.xfrc_applied[1, 3:] = held[i] * force, held[i] * moment
        engine.mj_step(model, data, nstep=2)
        engine.mj_kinematics(model, data)  # for the poses after the step
    return Rigid(rotation, translation)


def _engine() -> Any:
    return module_of_extra("mujoco", "simulate", "simulation with a physics engine")


SETS: Final = {
    "sequence": tuple(walk(number) for number in range(4)),
    "everyday": tuple(handling(thing, take) for thing in HANDLED for take in range(2)),
}
MADE_WITH: Final = "3.17.0"
PUBLISHED: Final[Mapping[str, tuple[str, str]]] = {
    "sequence_00": ("1b87b53638aeebc7", "0.22 0.00 0.00 0.36 0.12 0.00 0.29"),
    "sequence_01": ("8d4356569d226d29", "0.16 0.00 0.12 0.20 0.00 0.00 0.50"),
    "sequence_02": ("1df891b9bf1c6d61", "0.00 0.14 0.22 0.22 0.00 0.12 0.28"),
    "sequence_03": ("f49482764ca7896c", "0.00 0.24 0.30 0.00 0.16 0.14 0.15"),
    "box_00": ("f7c87a30e2a5b846", "0.55 0.05 0.00 0.01 0.00 0.00 0.34"),
    "box_01": ("25851a34fb16e677", "0.45 0.04 0.00 0.09 0.00 0.00 0.37"),
    "wedge_00": ("0a28076124e4d7bd", "0.47 0.06 0.02 0.07 0.00 0.03 0.28"),
    "wedge_01": ("ff056491dc58c092", "0.49 0.08 0.00 0.01 0.00 0.00 0.38"),
}
"""Digest of poses and labels with this release of MuJoCo, and share of the time in each state."""
_ALIKE: Final = 0.05
"""Largest difference of shares with another release or processor, which may round differently; a choice, not
measured."""


def make(made: Made, path: Path, overwrite: bool) -> tuple[list[str], bool]:
    """Write a recording; returns its figures, and whether they agree with the published ones."""
    check = check_output(path, overwrite)
    simulated = simulate_physics(made)
    write_recording(str(path), simulated.poses, simulated.truth, simulated.metadata, check)
    stamp_ns, spans = simulated.poses.stamp_ns, simulated.truth.intervals
    column = np.array([-1 if span.contact is None else span.contact.column for span in spans])
    labels = column[simulated.truth.at(stamp_ns)]
    shares = [float(np.mean(labels == state.column)) for state in STATES]
    numbers = (stamp_ns, simulated.poses.position_m, simulated.poses.quat_xyzw, labels)
    digest = hashlib.sha256(b"".join(array.tobytes() for array in numbers)).hexdigest()[:16]
    text = " ".join(f"{share:.2f}" for share in shares)
    expected = PUBLISHED.get(made.name, ("", ""))
    apart = max((abs(a - float(b)) for a, b in zip(shares, expected[1].split(), strict=False)), default=1.0)
    alike = "same" if digest == expected[0] else "alike" if apart < _ALIKE else "differs"
    counts = f"{(stamp_ns[-1] - stamp_ns[0]) * 1e-9:.0f}", str(len(stamp_ns)), str(len(spans))
    return [made.name, *counts, *text.split(), digest, alike], alike != "differs"


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("--overwrite", action="store_true", help="replace recordings that exist")
    add_processes(parser, 61, 2, "recordings at once (default: 2)")
    args = parser.parse_args(argv)
    try:
        _engine()
        files = ((made, args.folder / name) for name, recordings in SETS.items() for made in recordings)
        jobs = [(made, folder / f"{made.name}.mcap") for made, folder in files]
        for _, path in jobs:
            path.parent.mkdir(parents=True, exist_ok=True)
            check_output(path, args.overwrite)
        with Workers(args.processes) as pool:
            futures = [pool.submit(make, *job, args.overwrite) for job in jobs]
            rows, are_alike = zip(*(future.result() for future in futures), strict=True)
    except (ContactTrackerError, OSError) as error:
        parser.error(str(error))
    header = ("recording", "s", "poses", "intervals", *STATES, "sha256", f"as with MuJoCo {MADE_WITH}")
    show(table(header, rows))
    return DONE if all(are_alike) else DIFFERENT


if __name__ == "__main__":
    sys.exit(main())
