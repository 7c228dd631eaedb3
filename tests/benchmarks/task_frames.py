"""Task frames of simulated contacts and joints against the true ones: docs/python.md, frames for control.

    python tests/benchmarks/task_frames.py --seeds 5

An object is in one contact for 12 s, or in one joint (200 Hz, 0.3 mm, 0.15 deg). ``free twists`` is the
greatest angle between the twists that the frame leaves free and those that the true constraint does, about
the body's origin and with turns times 0.1 m; ``z`` the angle of its z axis; ``power`` the greatest of the
frame's wrenches with the true free twists, of unit length. Medians over the recordings. ``within 3 sd``: the
share of the angles of z about x and y that are within three standard deviations of the truth.
"""

import sys
from typing import Final, NamedTuple

import numpy as np
from scipy.linalg import subspace_angles

from contact_tracker import Trajectory, segment
from contact_tracker.arrays import Array
from contact_tracker.contacts.task_frame import T_world_body, TaskFrame, joint_frame, task_frame
from contact_tracker.explanations.joint_models import JointKind
from contact_tracker.geometry.elements import Plane
from contact_tracker.states import CONTACTS
from contact_tracker_lab.benchmark.runner import Table, measured, parser_of, report
from contact_tracker_lab.evaluation.tables import number
from contact_tracker_lab.simulate import Phase, Scenario, named_scenario, simulate
from summaries import share_within_3

SECONDS, LEVER_M = 12.0, 0.1
COLUMNS: Final = ("frame", "recordings", "found", "free twists, deg", "z, deg", "power", "within 3 sd")
FREE: Final = {"slider": "vz", "ball": "wx wy wz"}


class Compared(NamedTuple):
    """Figures of one recording: angles in degrees, and of z in standard deviations (2,)."""

    twists_deg: float
    z_deg: float
    power: float
    z_sd: tuple[float, ...]


def compared(found: TaskFrame, true: TaskFrame, at_m: Array) -> Compared:
    """The figures of a frame, with twists about a point."""
    free = [_about(frame.free_twists, at_m) for frame in (found, true)]
    wrenches = found.wrenches
    wrenches = np.hstack([wrenches[:, :3], (wrenches[:, 3:] - np.cross(at_m, wrenches[:, :3])) / LEVER_M])
    units = free[1] / np.linalg.norm(free[1], axis=1)[:, None]
    twists_deg = np.degrees(subspace_angles(*(one.T for one in free)).max())
    z = found.T_world_task[:3, :3].T @ true.T_world_task[:3, 2]
    z *= np.sign(z[2])
    sd = found.sd
    is_known = sd is not None and min(sd[3:5]) > 0.0
    z_sd = (float(abs(z[1]) / sd[3]), float(abs(z[0]) / sd[4])) if sd is not None and is_known else ()
    power = np.abs(wrenches @ units.T).max()
    return Compared(float(twists_deg), float(np.degrees(np.hypot(z[0], z[1]))), float(power), z_sd)


def _about(twists: Array, at_m: Array) -> Array:
    """Twists (K, 6) about the world's origin as those about a point, turns in units of length."""
    moved = twists[:, :3] + np.cross(twists[:, 3:], at_m)
    return np.hstack([moved, LEVER_M * twists[:, 3:]])


def measure(name: str, seed: int) -> Compared | None:
    """Of a recording; None if no such contact or joint is found."""
    contact = next((contact for contact in CONTACTS if contact.value == name), None)
    scenario = Scenario((Phase(contact, SECONDS),)) if contact else named_scenario(name, seed)
    made = simulate(scenario, seed)
    poses = made.poses[made.poses.stamp_ns < made.poses.stamp_ns[0] + SECONDS * 1e9]
    given = Trajectory.from_arrays(poses.stamp_ns, poses.position_m, poses.quat_xyzw, time_unit="ns")
    result = segment(given)
    row = int(np.abs(given.stamp_ns - given.stamp_ns[0] - SECONDS * 5e8).argmin())
    frames = [frame for frame in result.task_frames(SECONDS / 2.0) if frame.contact.value == name]
    if not frames:
        return None
    pose = T_world_body(poses.position_m[row], poses.quat_xyzw[row])
    geometry, true = made.truth.intervals[0].geometry, None
    if made.joint is not None and not isinstance(made.joint.environment, Plane):
        pitch_m = made.joint.pitch_m_per_rad or 0.0
        true = joint_frame(JointKind(name), made.joint.environment, FREE.get(name, "wz"), pitch_m)
    elif contact is not None and geometry is not None:
        true = task_frame(contact, geometry, pose)
    assert true is not None
    return compared(frames[0], true, pose[:3, 3])


def main() -> int:
    parser = parser_of(__doc__)
    parser.add_argument("--seeds", type=int, default=5, help="number of each (default: %(default)s)")
    args = parser.parse_args()
    names = [*(contact.value for contact in CONTACTS), *(kind.value for kind in JointKind)]
    jobs = {name: [(name, seed) for seed in range(1, args.seeds + 1)] for name in names}
    rows = []
    for name, some in measured(measure, jobs, args.processes):
        found = [one for one in some if one is not None]
        medians = np.median([one[:3] for one in found], axis=0) if found else np.full(3, np.nan)
        within = share_within_3([value for one in found for value in one.z_sd])
        cells = (*(number(float(value)) for value in medians), number(within))
        rows.append([name, str(len(some)), str(len(found)), *cells])
    return report(args, frames=Table(COLUMNS, rows))


if __name__ == "__main__":
    sys.exit(main())
