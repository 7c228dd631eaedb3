"""Time until a contact is decided, by moves that the tracker suggests and by random ones.

    python tests/benchmarks/informative_motion.py

A simulated hand keeps an object in contact and moves it, a second for each move, along the freedom that the
contact leaves: at first for three seconds to and fro in one direction, which leaves the contact open, then
along all suggestions at once, as far as the contact allows them; for comparison, along all directions that
the true contact leaves, which no tracker knows (``all at once``); to and fro in a random direction of all of
these; or, as a robot is jogged, along or about a random one of its axes (``random axis``). All go up to
15 deg and 26 mm from where a move begins, at the same greatest speed.
Motion capture at 100 Hz, 0.3 mm and 0.15 deg. A contact is decided once the label is right and the motion
leaves no other state open. The table has the median and the mean of the times until then (``decided``; 20 s
where it never is), and until the label is right with a probability above 0.9.
"""

import sys
from collections.abc import Iterator
from itertools import product
from typing import Final, NamedTuple

import numpy as np
from scipy.linalg import null_space

from contact_tracker.arrays import Array
from contact_tracker.config.loading import load_model
from contact_tracker.contacts import CONTACT_MODELS, ContactModel
from contact_tracker.geometry.lifted_pose import lift
from contact_tracker.geometry.linalg import from_rotation_vectors, matrices
from contact_tracker.geometry.linalg import product as turned
from contact_tracker.motion.pose_validation import PoseGate
from contact_tracker.motion.poses import Pose
from contact_tracker.motion.window import LEVER_M
from contact_tracker.tracker import Tracker
from contact_tracker.tracking.informative_motion import SHIFT_M, InformativeMotion, informative_motions
from contact_tracker_lab.benchmark.runner import Table, measured, parser_of, report

RATE_HZ: Final = 100
FIRST_S, LONGEST_S = 3, 20
TOUCHING: Final = 1e-12
"""Elements whose residuals are smaller touch."""
ALIKE: Final = 0.3
"""Size, relative to a whole move, below which what a suggestion adds to the others is left out; with 0.03 and
0.6 the mean of three seeds is 2.1 and 2.2 s until a probability of 0.9, instead of 1.8 s."""
STRATEGIES: Final = ("suggested", "all at once", "random", "random axis")
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
        quat = turned(self.quat_xyzw, from_rotation_vectors(twist[:3] / LEVER_M))
        return self._replace(quat_xyzw=quat, position_m=self.position_m + twist[3:])

    def allowed(self, twist: Array) -> Array:
        """The part of a twist that the contact leaves free, as far as it goes within the limits."""
        jacobian = self.jacobian()
        free = twist - np.linalg.pinv(jacobian) @ (jacobian @ twist)
        length = max(np.linalg.norm(free[:3]), np.linalg.norm(free[3:]))
        return np.asarray(free * (SHIFT_M / length if length > 0.05 * np.linalg.norm(twist) else 0.0))


def poses_of(held: Held, twists: Array, begin_s: float, rng: np.random.Generator) -> Iterator[Pose]:
    """The measured poses of a move of a second along twists (n, 6), with tremor: to and fro along one; along
    several at once, at different frequencies and mixed at random, as fast and as far at most."""
    time_s = np.arange(RATE_HZ) / RATE_HZ
    phases = [(k, 2.0 * np.pi * k * time_s) for k in (1, 2, 3)]
    waves = [wave / (2.0 * k) for k, phase in phases for wave in (1.0 - np.cos(phase), np.sin(phase))]
    mixed = np.linalg.qr(rng.normal(size=(len(twists),) * 2))[0] @ twists if len(twists) > 1 else twists
    path = np.transpose(waves[: len(twists)]) @ mixed
    fastest = _longest(np.diff(path, axis=0, append=0.0)) * RATE_HZ / np.pi
    mixed, path = (array * (SHIFT_M / max(_longest(path), fastest)) for array in (mixed, path))
    tremor = 0.03 * np.sin(2.0 * np.pi * 9.0 * time_s)[:, None] * mixed.sum(axis=0)
    for at_s, twist in zip(begin_s + time_s, path + tremor, strict=True):
        one = held.moved(twist)
        quat = turned(one.quat_xyzw, from_rotation_vectors(rng.normal(0.0, np.radians(0.15), 3)))
        position_m = one.position_m + rng.normal(0.0, 3e-4, 3)
        yield Pose(round(at_s * 1e9), tuple(position_m.tolist()), tuple(quat.tolist()))


def _longest(twists: Array) -> float:
    """The largest turn, times ``LEVER_M``, or shift of twists (n, 6)."""
    return float(np.linalg.norm(twists.reshape(-1, 2, 3), axis=2).max())


def suggested(motions: tuple[InformativeMotion, ...], held: Held) -> Array:
    """The directions (n, 6) of the suggestions, as far as the contact allows them."""
    twists = [np.zeros(6)]
    for motion in motions:
        arm = held.position_m - motion.point_world_m
        turn = matrices(from_rotation_vectors(motion.turn_world_rad))
        shift = motion.shift_world_m + turn @ arm - arm
        twists.append(held.allowed(np.concatenate([motion.turn_body_rad * LEVER_M, shift])))
    _, sizes, directions = np.linalg.svd(np.array(twists) / SHIFT_M, full_matrices=False)
    return np.asarray(directions[sizes > ALIKE])


def next_move(held: Held, strategy: str, tracker: Tracker, rng: np.random.Generator) -> Array:
    """The twists (n, 6) of the next second."""
    if strategy == "all at once":
        return np.asarray(null_space(held.jacobian()).T)
    if strategy == "suggested" and tracker.best is not None:
        asked = suggested(informative_motions(tracker.best), held)
        if len(asked):
            return asked
    while strategy == "random axis":
        twist = held.allowed(np.eye(6)[rng.integers(6)])
        if twist.any():
            return twist[None]
    return held.allowed(rng.normal(size=6))[None]


def run(name: str, strategy: str, seed: int) -> tuple[float, float]:
    """Seconds after the first three until the contact is decided, and until its probability is above 0.9;
    ``LONGEST_S`` if it never is."""
    model = next(model for model in CONTACT_MODELS if model.contact.value == name)
    rng = np.random.default_rng(seed)
    held, tracker, gate = Held.of(model, rng), Tracker.start(load_model()), PoseGate()
    first, times_s = held.allowed(rng.normal(size=6)), [float(LONGEST_S)] * 2
    for second in range(FIRST_S + LONGEST_S):
        twists = first[None] if second < FIRST_S else next_move(held, strategy, tracker, rng)
        for pose in poses_of(held, twists, float(second), rng):
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
    jobs = {case: [(*case, seed) for seed in range(args.seeds)] for case in product(names, STRATEGIES)}
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
