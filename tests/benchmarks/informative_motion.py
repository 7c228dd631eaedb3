"""Time until a contact is decided, by moves that the tracker suggests and by random ones.

    python tests/benchmarks/informative_motion.py

A simulated hand keeps an object in contact and moves it, a second for each move, along the freedom that the
contact leaves: at first for three seconds to and fro in one direction, which leaves the contact open, then by
the suggestion of most expected evidence, as far as the contact allows it; in random directions; or, as a
robot is jogged, along or about a random one of its axes (``random axis``). All go up to 15 deg and 26 mm.
Motion capture at 100 Hz, 0.3 mm and 0.15 deg. A contact is decided once the label is right and the motion
leaves no other state open. The table has the median and the mean of the times until then (``decided``; 20 s
where it never is), and until the label is right with a probability above 0.9.
"""

import sys
from collections.abc import Iterator
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.config.loading import load_model
from contact_tracker.contacts import CONTACT_MODELS, ContactModel
from contact_tracker.geometry.rotation import from_rotation_vectors, matrices, product
from contact_tracker.motion.lifted_pose import lift
from contact_tracker.motion.pose_validation import PoseGate
from contact_tracker.motion.poses import Pose
from contact_tracker.motion.window import LEVER_M
from contact_tracker.tracker import Tracker
from contact_tracker.tracking.informative_motion import (
    SHIFT_M,
    InformativeMotion,
    informative_motions,
)
from contact_tracker_lab.benchmark.runner import Table, measured, parser_of, report

Array = NDArray[np.float64]

RATE_HZ: Final = 100
FIRST_S, LONGEST_S = 3, 20
TOUCHING: Final = 1e-12
"""Elements whose residuals are smaller touch."""
STRATEGIES: Final = ("suggested", "random", "random axis")
COLUMNS: Final = (
    *("contact", "runs"),
    *(f"{one}: {time}, s" for one in STRATEGIES for time in ("decided", "0.9")),
)


class Held(NamedTuple):
    """An object in contact: the ``model`` with its true geometry x, and the pose ``T_world_body``."""

    model: ContactModel
    x: Array
    quat_xyzw: Array
    position_m: Array

    @classmethod
    def of(cls, model: ContactModel, rng: np.random.Generator) -> "Held":
        """Random elements within 0.1 m of a random pose, which is brought into contact."""
        family = model.family
        position_m, quat = rng.normal(0.0, 0.3, 3), rng.normal(size=4)
        x = rng.normal(0.0, 0.06, family.SIZE)
        for first in (family.FORM.d1, family.FORM.d2):
            if first >= 0:
                x[first : first + 3] = rng.normal(size=3)
        anchors = model.anchors(position_m)
        x = family.normalise(x + family.place(anchors), anchors)
        return cls(model, x, quat / np.linalg.norm(quat), position_m).moved(np.zeros(6))

    def jacobian(self) -> Array:
        """(K, 6) of the residuals, by turns about the body's axes times ``LEVER_M`` and shifts."""
        zeta = self.model.lifted(lift(matrices(self.quat_xyzw), self.position_m))
        moves = (self.model.family.rows(self.x) @ self.model.moves).swapaxes(0, 1)
        return np.asarray(moves @ zeta / np.repeat([LEVER_M, 1.0], 3))

    def residual(self) -> Array:
        zeta = lift(matrices(self.quat_xyzw), self.position_m)
        return np.asarray(self.model.family.rows(self.x) @ self.model.lifted(zeta))

    def moved(self, twist: Array) -> "Held":
        """After a twist (6,), and brought back into contact."""
        one = self._displaced(twist)
        for _ in range(20):
            residual = one.residual()
            if np.abs(residual).max() < TOUCHING:
                break
            one = one._displaced(-np.linalg.pinv(one.jacobian()) @ residual)
        return one

    def _displaced(self, twist: Array) -> "Held":
        quat = product(self.quat_xyzw, from_rotation_vectors(twist[:3] / LEVER_M))
        return self._replace(quat_xyzw=quat, position_m=self.position_m + twist[3:])

    def allowed(self, twist: Array) -> Array:
        """The part of a twist that the contact leaves free, as far as it goes within the limits."""
        jacobian = self.jacobian()
        free = twist - np.linalg.pinv(jacobian) @ (jacobian @ twist)
        length = max(np.linalg.norm(free[:3]), np.linalg.norm(free[3:]))
        return np.asarray(free * (SHIFT_M / length if length > 0.05 * np.linalg.norm(twist) else 0.0))


def poses_of(held: Held, twist: Array, begin_s: float, rng: np.random.Generator) -> Iterator[Pose]:
    """The measured poses of a move to and fro within a second, with tremor."""
    time_s = np.arange(RATE_HZ) / RATE_HZ
    share = 0.5 - 0.5 * np.cos(2.0 * np.pi * time_s) + 0.03 * np.sin(2.0 * np.pi * 9.0 * time_s)
    for at_s, part in zip(begin_s + time_s, share, strict=True):
        one = held.moved(part * twist)
        turned = product(one.quat_xyzw, from_rotation_vectors(rng.normal(0.0, np.radians(0.15), 3)))
        position_m = one.position_m + rng.normal(0.0, 3e-4, 3)
        yield Pose(round(at_s * 1e9), tuple(position_m.tolist()), tuple(turned.tolist()))


def suggested(found: tuple[InformativeMotion, ...], held: Held) -> Array | None:
    """The twist of the first suggestion that the contact does not forbid altogether."""
    for one in found:
        arm = held.position_m - one.point_world_m
        turn = matrices(from_rotation_vectors(one.turn_world_rad))
        shift = one.shift_world_m + turn @ arm - arm
        twist = held.allowed(np.concatenate([one.turn_body_rad * LEVER_M, shift]))
        if twist.any():
            return twist
    return None


def random_twist(held: Held, strategy: str, rng: np.random.Generator) -> Array:
    """A random twist that the contact allows."""
    while strategy == "random axis":
        twist = held.allowed(np.eye(6)[rng.integers(6)])
        if twist.any():
            return twist
    return held.allowed(rng.normal(size=6))


def run(name: str, strategy: str, seed: int) -> tuple[float, float]:
    """Seconds after the first three until the contact is decided, and until its probability is above 0.9;
    ``LONGEST_S`` if it never is."""
    model = next(one for one in CONTACT_MODELS if one.contact.value == name)
    rng = np.random.default_rng(seed)
    held, tracker, gate = Held.of(model, rng), Tracker.start(load_model()), PoseGate()
    first, times_s = held.allowed(rng.normal(size=6)), [float(LONGEST_S)] * 2
    for second in range(FIRST_S + LONGEST_S):
        twist = first
        if second >= FIRST_S:
            best = tracker.best
            found = () if best is None or strategy != "suggested" else informative_motions(best)
            asked = suggested(found, held)
            twist = random_twist(held, strategy, rng) if asked is None else asked
        for pose in poses_of(held, twist, float(second), rng):
            for belief in tracker.update(gate.arrive(pose)):
                after_s = pose.stamp_ns * 1e-9 - FIRST_S
                if second < FIRST_S or belief.contact is not model.contact:
                    continue
                is_sure = belief.probability[model.contact.column] > 0.9
                for k, is_reached in enumerate((not belief.inseparable, is_sure)):
                    times_s[k] = min(times_s[k], after_s) if is_reached else times_s[k]
        if max(times_s) < LONGEST_S:
            break
    return times_s[0], times_s[1]


def main() -> int:
    parser = parser_of(__doc__)
    parser.add_argument("--seeds", type=int, default=10, help="default: %(default)s")
    args = parser.parse_args()
    names = [model.contact.value for model in CONTACT_MODELS]
    jobs = {
        (name, strategy): [(name, strategy, seed) for seed in range(args.seeds)]
        for name in names
        for strategy in STRATEGIES
    }
    found = dict(measured(run, jobs, args.processes))
    for strategy in STRATEGIES:
        found["all", strategy] = [times_s for name in names for times_s in found[name, strategy]]
    rows = []
    for name in (*names, "all"):
        times = [np.array(found[name, strategy]) for strategy in STRATEGIES]
        cells = [f"{np.median(one):.1f} / {np.mean(one):.1f}" for both in times for one in both.T]
        rows.append([name, str(len(times[0])), *cells])
    return report(args, informative=Table(COLUMNS, rows))


if __name__ == "__main__":
    sys.exit(main())
