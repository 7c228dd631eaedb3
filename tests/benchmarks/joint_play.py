"""Which joint is named where the joint has play: docs/theory.md, T44.

    python tests/benchmarks/joint_play.py
    python tests/benchmarks/joint_play.py --seeds 1 2 --swings 3 6

An object moves for 8 s in a joint, within 0.3 to 1 Hz, with each of three noises of poses at 200 Hz (0.1 mm
and 0.03 deg, 0.5 and 0.11, 1 and 0.23), each swing (deg, from end to end) and arms of 0.05 or 0.1 to 1 m.
Hinges tilt by ``play`` over 0.1 m, and shift by half of it in the rows ``harmonics`` and ``sides``: with the
angle's first harmonics, in waves of the angle, with its sign, or to the other side where they turn back;
``shift`` is a shift alone by the play. Balls have those shares of the swing about three axes. ``turn and
slide`` is both about one axis, each by itself, and ``curve`` a shift there and back along a bent curve while
the object turns: neither is a joint. ``in stages`` a hinge turns by half of the swing, rests and turns on;
``once`` it turns once. On ``two axes``, ``play`` apart, a box turns by half of the swing about one, rests,
and turns about the other: both are to be named. ``slide`` is a slide by hand on a table along ``play``, with
a turn, once: no joint. ``right`` is the share of the cases in which the joint, or none where
there is none, is named; ``sure and wrong`` in which another one has more than 0.9.
"""

import sys
from collections.abc import Iterator
from typing import Final, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.special import expit

from contact_tracker.arrays import Array
from contact_tracker.config.loading import load_model
from contact_tracker.explanations.conditional_contact import ExplainedTicks, KnownContact
from contact_tracker.explanations.joint_evidence import FittedJoint
from contact_tracker.explanations.joint_parts import find_joints, rests_in
from contact_tracker.geometry.lifted_pose import R, T, lift
from contact_tracker.motion.window import Window, at_rest
from contact_tracker.states import Contact
from contact_tracker.tracking.state import scales_of
from contact_tracker_lab.benchmark.runner import Table, measured, parser_of, report
from contact_tracker_lab.evaluation.tables import number
from contact_tracker_lab.simulate.motion import band_limited

SECONDS, RATE_HZ, TICK = 8, 200, 20
NOISES: Final = ((1e-4, 5e-4), (5e-4, 2e-3), (1e-3, 4e-3))
"""Standard deviations (m, rad) of poses."""
SWINGS_DEG: Final = [30.0, 90.0, 180.0]
BALL_SWINGS_DEG: Final = [10.0, 20.0, 40.0, 90.0]
STROKES_DEG: Final = [15.0, 30.0, 60.0]
"""Turns of slides."""
REST_S: Final = 1.5
ON_TABLE: Final = KnownContact(Contact.FF, np.array([0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 0.0]))
Z: Final = np.array([0.0, 0.0, 1.0])
TILT_LENGTH_M: Final = 0.1
SHARES: Final = {"1 1 1": (1, 1, 1), "1 1 0": (1, 1, 0), "1 0.3 0.3": (1, 0.3, 0.3), "1 0.3 0": (1, 0.3, 0)}
NO_JOINT: Final = ("turn and slide", "curve", "slide")
NAMES: Final = {"hinge in stages": "hinge", "hinge once": "hinge"}
"""The right answers for joints that are not named so themselves."""
COLUMNS: Final = ("joint", "errors", "play, mm", "cases", "right", "sure and wrong", "surely a ball")


class Case(NamedTuple):
    """An object in a ``joint``, and how its errors follow the motion; a screw's ``play_m`` is its pitch."""

    joint: str
    errors: str
    play_m: float
    swing_deg: float
    arm_m: float
    noise: int
    seed: int


def course(rng: np.random.Generator, time_s: Array, hz: float, swing: float) -> Array:
    """A motion (N,) from end to end of a swing."""
    signal = band_limited(rng, time_s, 1, hz)[:, 0]
    return np.asarray(swing * ((signal - signal.min()) / np.ptp(signal) - 0.5))


def strokes(time_s: Array, count: int) -> Array:
    """A smooth motion (N,) from 0 to ``count`` in as many strokes, with rests."""
    seconds = time_s[-1] / count - REST_S
    begins = (np.arange(count) + 0.5) * REST_S + np.arange(count) * (seconds + 0.5 * REST_S)
    way = np.clip((time_s[:, None] - begins) / seconds, 0.0, 1.0)
    return np.asarray((10.0 * way**3 - 15.0 * way**4 + 6.0 * way**5).sum(axis=1))


def scaled(errors: Array) -> Array:
    """Errors (N, K) about their mean, of which the largest is 1."""
    centred = errors - errors.mean(axis=0)
    return np.asarray(centred / np.abs(centred).max())


def tilts(rng: np.random.Generator, errors: str, angle: Array, swing: float) -> Array:
    """(N, 2) tilts of a hinge about x and y, of which the largest is about 1."""
    axis, phase, weight = rng.normal(size=2), rng.uniform(0.0, 2.0 * np.pi, (2, 3)), rng.normal(size=(2, 3))
    axis /= np.linalg.norm(axis)
    if errors == "harmonics":
        waves = np.sin(angle[:, None, None] * np.arange(1, 4) + phase)
        return scaled((weight * waves).sum(axis=2))
    if errors == "waves":
        return np.asarray(np.sin(angle[:, None] / 0.2 + phase[:, 0]))
    if errors == "sign":
        return np.asarray(np.sign(angle)[:, None] * axis)
    if errors == "sides":
        width, side = min(0.1, swing / 6.0), np.zeros(len(angle))
        for now, step in enumerate(np.diff(angle), 1):
            side[now] = np.clip(side[now - 1] + step / width, -1.0, 1.0)
        return np.asarray(side[:, None] * axis)
    return np.zeros((len(angle), 2))


def motion(case: Case) -> tuple[Rotation, Array]:
    """Orientations and places (N, 3) without noise."""
    rng = np.random.default_rng([case.seed, round(1e4 * case.play_m), round(1e2 * case.arm_m), case.noise])
    time_s = np.arange(SECONDS * RATE_HZ) / RATE_HZ
    hz, swing, arm = rng.uniform(0.3, 1.0), np.radians(case.swing_deg), case.arm_m * np.eye(3)[0]
    if case.joint == "ball":
        vectors = [share * course(rng, time_s, hz, swing) for share in SHARES[case.errors]]
        turn = Rotation.from_rotvec(np.column_stack(vectors))
        return turn, turn.apply(arm)
    if case.joint == "slider":
        return Rotation.identity(len(time_s)), arm + Z * course(rng, time_s, hz, 0.3)[:, None]
    if case.joint == "curve":
        way = course(rng, time_s, hz, 1.0) + 0.5
        bend_m, turn = case.play_m * np.sin(np.pi * way), swing * np.sin(2.0 * np.pi * way)
        return Rotation.from_rotvec(turn[:, None] * Z), np.column_stack([0.12 * way, bend_m, 0.0 * way])
    if case.joint == "slide":
        way = strokes(time_s, 1)[:, None]
        turn = Rotation.from_rotvec(swing * way * Z)
        return turn, case.play_m * way * np.eye(3)[1] + turn.apply(arm)
    stages = 1 + (case.joint in ("hinge in stages", "two axes"))
    is_once = case.joint.endswith("once") or stages > 1
    angle = swing / stages * strokes(time_s, stages) if is_once else course(rng, time_s, hz, swing)
    turn = Rotation.from_rotvec(angle[:, None] * Z)
    if case.joint == "two axes":
        second, half = case.play_m * np.eye(3)[1], 0.5 * swing * Z
        around = Rotation.from_rotvec(np.maximum(angle - 0.5 * swing, 0.0)[:, None] * Z)
        first = Rotation.from_rotvec(np.minimum(angle[:, None] * Z, half)).apply(arm)
        return turn, around.apply(first - second) + second
    if case.joint == "screw":
        return turn, turn.apply(arm) + case.play_m * angle[:, None] * Z
    if case.joint == "turn and slide":
        return turn, turn.apply(arm) + Z * course(rng, time_s, hz, 0.1)[:, None]
    tilt = case.play_m / TILT_LENGTH_M * tilts(rng, case.errors, angle, swing)
    turn = Rotation.from_rotvec(np.column_stack([tilt, np.zeros(len(tilt))])) * turn
    phase = rng.uniform(0.0, 2.0 * np.pi, (2, 3))
    shift = scaled(np.sin(angle[:, None] + phase[0]) + 0.5 * np.sin(2.0 * angle[:, None] + phase[1]))
    share = {"shift": 1.0, "harmonics": 0.5, "sides": 0.5}.get(case.errors, 0.0)
    return turn, turn.apply(arm) + share * case.play_m * shift


def window_of(case: Case) -> Window:
    """The ticks of the noisy poses."""
    return ticks_of(*motion(case), case.noise, case.seed)


def ticks_of(turn: Rotation, place: Array, noise: int, seed: int) -> Window:
    """The ticks of poses (N,), (N, 3) with noise."""
    rng, sigma = np.random.default_rng([seed, 1]), np.array(NOISES[noise])
    turn = turn * Rotation.from_rotvec(sigma[1] * rng.normal(size=place.shape))
    zeta = lift(turn.as_matrix(), place + sigma[0] * rng.normal(size=place.shape))
    zeta = zeta.reshape(-1, TICK, zeta.shape[1]).mean(axis=1)
    variance, step = sigma**2 / TICK, np.square(np.diff(zeta, axis=0)).mean(axis=0)
    moved = variance + np.array([step[T].mean(), step[R].sum() / 6.0])
    of_noise, excess = (np.tile(each, (len(zeta), 1)) for each in (variance, moved))
    return Window(np.arange(len(zeta)), zeta, of_noise, excess, frames=np.full(len(zeta), TICK))


def all_fitted(case: Case) -> list[FittedJoint]:
    """The joints of the noisy poses, if any."""
    window, model = window_of(case), load_model()
    rests = rests_in(window.index, at_rest(window, model.tick_s))
    contacts = [ON_TABLE] if case.joint == "slide" else []
    ticks = ExplainedTicks(window, scales_of(model), model.systematic)
    return find_joints(ticks, rests, contacts, 1)


def fitted(case: Case) -> FittedJoint | None:
    """The joint of the noisy poses, if there is one."""
    found = all_fitted(case)
    return found[0] if len(found) == 1 else None


def named(case: Case) -> tuple[str, bool]:
    """The joint that is named, or ``none``, and whether it has more than 0.9."""
    found = all_fitted(case)
    if not found:
        return "none", False
    joint = found[0]
    is_sure = bool(expit(load_model().certainty.posterior_power * joint.log_odds) > 0.9)
    return "two axes" if len(found) == 2 else joint.model.kind.value, is_sure


def cases(swings: list[float], seeds: list[int]) -> Iterator[Case]:
    """All cases of the table; of the usual swings if none are given."""
    rows = [("hinge", "none", 0.0)]
    rows += [
        ("hinge", errors, play_m)
        for errors in ("harmonics", "waves", "sign", "sides", "shift")
        for play_m in (2e-3, 5e-3)
    ]
    rows += [("ball", shares, 0.0) for shares in SHARES] + [("screw", "none", p) for p in (1e-3, 4e-3, 2e-2)]
    rows += [("slider", "none", 0.0), ("turn and slide", "none", 0.0)]
    rows += [("curve", "bend", bend_m) for bend_m in (1e-2, 3e-2, 5e-2)]
    parts = ("none", 0.0), ("harmonics", 2e-3), ("waves", 2e-3), ("sides", 2e-3), ("shift", 2e-3)
    rows += [("hinge " + how, *errors) for how in ("in stages", "once") for errors in parts]
    rows += [("two axes", "apart", apart_m) for apart_m in (3e-3, 1e-2, 3e-2, 1e-1, 0.2)]
    rows += [("slide", "length", length_m) for length_m in (0.05, 0.1, 0.2)]
    usual = {"ball": BALL_SWINGS_DEG, "slide": STROKES_DEG}
    for joint, errors, play_m in rows:
        for swing in swings or usual.get(joint, SWINGS_DEG):
            for arm_m in (0.05, 0.1, 0.3, 1.0)[joint != "ball" :]:
                for noise in range(len(NOISES)):
                    yield from (Case(joint, errors, play_m, swing, arm_m, noise, seed) for seed in seeds)


def main() -> int:
    parser = parser_of(__doc__)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0], help="default: 0")
    parser.add_argument("--swings", type=float, nargs="+", default=[], metavar="DEG")
    args = parser.parse_args()
    jobs = dict[tuple[str, str, str], list[tuple[Case]]]()
    for case in cases(args.swings, args.seeds):
        jobs.setdefault((case.joint, case.errors, f"{1e3 * case.play_m:g}"), []).append((case,))
    answers = dict(measured(named, jobs, args.processes))
    for joint in dict.fromkeys(key[0] for key in jobs):
        answers[joint, "all", ""] = [
            answer for key, of_errors in answers.items() if key[0] == joint for answer in of_errors
        ]
    rows = []
    for (joint, *what), of_errors in answers.items():
        right = "none" if joint in NO_JOINT else NAMES.get(joint, joint)
        shares = (
            [name == right for name, _ in of_errors],
            [is_sure and name != right for name, is_sure in of_errors],
            [is_sure and name == "ball" for name, is_sure in of_errors],
        )
        rows.append([joint, *what, str(len(of_errors)), *(number(float(np.mean(share))) for share in shares)])
    return report(args, play=Table(COLUMNS, rows))


if __name__ == "__main__":
    sys.exit(main())
