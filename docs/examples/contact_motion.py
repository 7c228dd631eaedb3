"""Draws docs/images/contact_motion.png: a vertex on a face that rests, slides, rolls, pivots, or sticks and
slips, measured with noise, and what is found: ``python docs/examples/contact_motion.py``."""

from pathlib import Path
from typing import Final

import numpy as np
from matplotlib import pyplot
from scipy.spatial.transform import Rotation

from contact_tracker.contacts.contact_motion import contact_motion
from contact_tracker.geometry.elements import Array, ContactGeometry, Plane, Point

PICTURE: Final = Path(__file__).parents[1] / "images" / "contact_motion.png"
SIGMA_M, SIGMA_RAD = 1e-4, 6e-4
"""Noise of a tick per axis."""
TICK_S, PART_S = 0.1, 10.0
VERTEX_M: Final = np.array([0.05, 0.03, -0.04])
TURN_RAD_S = 0.15


def ways(time_s: Array) -> dict[str, tuple[Array, Array]]:
    """Slip (m) along x, and rotation vectors (rad), of each kind of motion."""
    none, steady = 0.0 * time_s, 0.5 * (1.0 - np.cos(0.8 * time_s))
    x, z = np.eye(3)[[0, 2]]
    jumps = np.floor(time_s / 2.5) + np.clip((time_s % 2.5 - 2.0) / 0.5, 0.0, 1.0)
    return {
        "rests": (none, np.outer(none, x)),
        "slides": (0.04 * steady, np.outer(none, x)),
        "rolls": (none, np.outer(TURN_RAD_S * np.sin(time_s), x)),
        "pivots": (none, np.outer(TURN_RAD_S * time_s, z)),
        "sticks and slips": (0.01 * jumps, np.outer(none, x)),
    }


def main() -> None:
    rng, time_s = np.random.default_rng(4), np.arange(0.0, PART_S, TICK_S)
    count, start = len(time_s), Rotation.from_rotvec([0.3, 0.2, 0.1])
    geometry = ContactGeometry(Point(VERTEX_M, 1e-8 * np.eye(3)), Plane(np.array([0.0, 0.0, 1.0]), 0.0))
    variance = np.tile([SIGMA_M**2, SIGMA_RAD**2], (count, 1))
    figure, (slips, turns) = pyplot.subplots(2, 1, figsize=(10.0, 5.6), sharex=True, layout="constrained")
    for number, (slip_m, turned) in enumerate(ways(time_s).values()):
        rotation = Rotation.from_rotvec(turned) * start
        noisy = Rotation.from_rotvec(SIGMA_RAD * rng.normal(size=(count, 3))) * rotation
        position_m = np.outer(slip_m, [1.0, 0.0, 0.0]) - rotation.apply(VERTEX_M)
        position_m += SIGMA_M * rng.normal(size=(count, 3))
        stamps = (time_s * 1e9).astype(np.int64)
        motion = contact_motion(geometry, stamps, time_s, noisy.as_quat(), position_m, variance)
        assert motion is not None
        at_s = time_s + number * PART_S
        speed, sd = 1e3 * motion.speed_m_per_s, 1e3 * motion.slip_sd_m_per_s
        slips.fill_between(at_s, np.maximum(speed - 3 * sd, 0), speed + 3 * sd, color="C0", alpha=0.25, lw=0)
        slips.plot(at_s, speed, "C0", label=None if number else "found, and 3 standard deviations")
        true = 1e3 * np.abs(np.gradient(slip_m, time_s))
        slips.plot(at_s, true, "k--", lw=0.9, label=None if number else "true")
        turns.plot(at_s, motion.roll_rad_per_s, "C4", label=None if number else "roll")
        turns.plot(at_s, motion.spin_rad_per_s, "C1", label=None if number else "spin")
        slips.text(at_s[0] + 0.3, 31.0, ", ".join(motion.kinds), weight="bold")
        for axes in (slips, turns):
            axes.axvline(at_s[0], color="0.8", lw=0.8)
    slips.set(ylabel="slip (mm/s)", ylim=(0.0, 34.0))
    turns.set(ylabel="angular speed (rad/s)", xlabel="time (s)", xlim=(0.0, 5 * PART_S), ylim=(0.0, 0.2))
    for axes in (slips, turns):
        axes.legend(loc="upper left", bbox_to_anchor=(0.0, 0.9), fontsize=8)
    figure.savefig(PICTURE, dpi=110)


if __name__ == "__main__":
    main()
