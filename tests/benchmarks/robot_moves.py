"""Poses of a part that a robot moves by a program, without noise: along straight lines, about its tool centre
point and about its edges. Between its moves it stands still, bit for bit."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from contact_tracker.arrays import Array
from contact_tracker.states import Contact
from contact_tracker.trajectory import Trajectory

HALF_M: Final = np.array([0.04, 0.03, 0.05])
"""Half the lengths of the part's edges; its frame is turned and shifted."""
UP_M: Final = np.array([0.0, 0.0, 0.12])
RAMP: Final = 0.25
"""Share of a move in which it gets faster, and in which it gets slower."""
UPRIGHT: Final = Rotation.identity()


@dataclass
class Robot:
    """A robot that moves a part on a table in z = 0, at ``rate_hz``."""

    rate_hz: float
    turn: Rotation = UPRIGHT
    position_m: Array = field(default_factory=lambda: np.array([0.0, 0.0, HALF_M[2]]))
    turns: list[Array] = field(default_factory=list)
    positions_m: list[Array] = field(default_factory=list)
    contacts: list[Contact] = field(default_factory=list)

    def move(self, contact: Contact, seconds: float, to_m: Array, turn: Rotation | None = None) -> None:
        """Move the part's centre along a line, while it turns at the same pace."""
        start, start_m, turn = self.turn, self.position_m, turn or self.turn
        vector = (start.inv() * turn).as_rotvec()
        self._follow(
            contact,
            _ramped(round(seconds * self.rate_hz)),
            lambda s: (start * Rotation.from_rotvec(s * vector), start_m + s * (to_m - start_m)),
        )

    def stand(self, contact: Contact, seconds: float) -> None:
        self.move(contact, seconds, self.position_m)

    def tilt(self, seconds: float, angle_rad: float) -> None:
        """Tilt the part about a lower edge and back."""
        start, start_m = self.turn, self.position_m
        pivot_m = start_m + start.apply([HALF_M[0], 0.0, -HALF_M[2]])
        axis = start.apply([0.0, angle_rad, 0.0])

        def tilted(s: float) -> tuple[Rotation, Array]:
            turn = Rotation.from_rotvec(np.sin(np.pi * s) * axis)
            return turn * start, pivot_m + turn.apply(start_m - pivot_m)

        self._follow(Contact.EF, _ramped(round(seconds * self.rate_hz)), tilted)

    def _follow(self, contact: Contact, path: Array, pose: Callable[[float], tuple[Rotation, Array]]) -> None:
        for s in path.tolist():
            self.turn, self.position_m = pose(s)
            self.turns.append(self.turn.as_quat())
            self.positions_m.append(self.position_m)
            self.contacts.append(contact)


def pick_and_place(rate_hz: float, seed: int, turn_rad: float = 0.0, slides: bool = True) -> Robot:
    """Three cycles: slide and tilt the part if it ``slides``, lift it, carry it over, and set it down.

    It turns by about ``turn_rad`` about all axes on its way, and is upright again when it is down.
    """
    rng, robot = np.random.default_rng(seed), Robot(rate_hz)
    robot.stand(Contact.FF, 1.0)
    for _ in range(3):
        for _ in range(3 * slides):
            yaw = Rotation.from_euler("z", rng.uniform(-0.8, 0.8))
            robot.move(Contact.FF, 1.2, np.append(rng.uniform(-0.2, 0.2, 2), HALF_M[2]), robot.turn * yaw)
        robot.stand(Contact.FF, 0.5)
        if slides:
            robot.tilt(2.5, 0.5)
            robot.stand(Contact.FF, 0.5)
        upright, down_m = robot.turn, np.append(rng.uniform(-0.3, 0.3, 2), HALF_M[2])
        lifted, over = (upright * Rotation.from_rotvec(turn_rad * rng.normal(size=3)) for _ in range(2))
        robot.move(Contact.FREE, 1.0, robot.position_m + UP_M, lifted)
        robot.move(Contact.FREE, 1.4, down_m + UP_M, over)
        robot.move(Contact.FREE, 1.0, down_m, upright)
        robot.stand(Contact.FF, 0.8)
    return robot


def logged(
    robot: Robot, seed: int, noise: tuple[float, float] = (0.0, 0.0), step_m: float = 1e-6
) -> tuple[Trajectory, NDArray[np.int64]]:
    """The log of the part's frame, which is turned and shifted as the world is, with ``noise`` (m, rad) and
    positions rounded to ``step_m``; and the column (N,) of the contact at each pose."""
    rng = np.random.default_rng(seed)
    turns, positions_m = Rotation.from_quat(robot.turns), np.array(robot.positions_m)
    world, world_m = Rotation.from_rotvec(0.1 * rng.normal(size=3)), 0.5 * rng.normal(size=3)
    frame, frame_m = Rotation.from_rotvec(rng.normal(size=3)), 0.05 * rng.normal(size=3)
    turns = world * turns
    positions_m = world.apply(positions_m) + world_m + turns.apply(frame_m)
    count = len(positions_m)
    turns = turns * frame * Rotation.from_rotvec(noise[1] * rng.normal(size=(count, 3)))
    positions_m = positions_m + noise[0] * rng.normal(size=(count, 3))
    stamp_ns = np.round(np.arange(count) * (1e9 / robot.rate_hz)).astype(np.int64)
    rounded_m = np.round(positions_m / step_m) * step_m
    columns = np.array([contact.column for contact in robot.contacts])
    return Trajectory.from_arrays(stamp_ns, rounded_m, turns.as_quat(), time_unit="ns"), columns


def _ramped(count: int) -> Array:
    """The way (N,) from 0 to 1 of a move that gets faster and slower at a constant rate."""
    time = (np.arange(count) + 1) / count
    way = np.cumsum(np.minimum(1.0, np.minimum(time, 1.0 - time) / RAMP))
    return np.asarray(way / way[-1])
