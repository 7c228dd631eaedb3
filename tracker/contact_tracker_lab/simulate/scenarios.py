"""Scenarios of simulated recordings (shapes, contacts, motion and measurement), some with names."""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product
from typing import Final, NamedTuple

import numpy as np

from contact_tracker.arrays import Array
from contact_tracker.errors import UsageError
from contact_tracker.explanations.joint_models import JointKind
from contact_tracker.states import STATES, Contact


def box(x: float, y: float, z: float) -> Array:
    return np.array(list(product((-x / 2, x / 2), (-y / 2, y / 2), (-z / 2, z / 2))))


def _prism(polygon: list[tuple[float, float]], length: float) -> Array:
    """A polygon in x and z, extended along y."""
    return np.array([(x, y, z) for y in (-length / 2, length / 2) for x, z in polygon])


_HEXAGON: Final = [(0.12 * float(np.cos(a)), 0.12 * float(np.sin(a))) for a in np.radians(range(0, 360, 60))]
OBJECTS: Final[Mapping[str, Array]] = {
    "cube": box(0.2, 0.2, 0.2),
    "box": box(0.16, 0.22, 0.3),
    "prism": _prism(_HEXAGON, 0.26),
    "wedge": _prism([(-0.1, -0.09), (0.16, -0.09), (-0.1, 0.12)], 0.24),
    "tetrahedron": 0.12 * np.array([(1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)], float),
}
SURROUNDINGS: Final[Mapping[str, Array]] = {
    "desk": box(0.8, 0.6, 0.7),
    "block": box(0.45, 0.4, 0.35),
    "ridge": _prism([(-0.4, -0.2), (0.4, -0.2), (0.15, 0.2), (-0.15, 0.2)], 0.6),
    "frustum": np.concatenate([box(0.7, 0.7, 0.4)[::2], box(0.36, 0.36, 0.4)[1::2]]),
}
"""Vertices of fixed bodies, of which objects touch the top face (+z), or an edge or corner of it."""
CORNER: Final = "table and wall"
"""Surroundings of scenarios with a further contact: two planes at a right angle."""


class Phase(NamedTuple):
    """``contact`` for at least ``duration_s``; longer if the next anchor is too far.

    ``motion``: normal, rest, translation (without rotation), one-axis (rotation about one axis), or tilt
    (rotation about one axis across the normal: the object pivots).
    """

    contact: Contact
    duration_s: float
    motion: str = "normal"


class Further(NamedTuple):
    """A second contact, with a wall, at the same time as that of the phase.

    It lasts from ``start_s`` to ``end_s`` of the recording; None for its beginning or end.
    """

    contact: Contact
    start_s: float | None = None
    end_s: float | None = None


@dataclass(frozen=True)
class Scenario:
    """The contacts, motion and measurement of a recording.

    Parameters
    ----------
    phases : contacts in order; the object is lifted between two if neither contains the other.
    rate_hz : poses per second.
    sigma_position_m, sigma_rotation_rad : white noise per axis (rotation vector in the body frame).
    outlier_probability : share of poses that are 1-6 cm and 4-25 deg off.
    drop_probability : share of poses that are missing.
    hold_probability : share of poses that repeat the one before them.
    jitter_s : standard deviation of the stamps, at most a fifth of the period.
    lead_s : normal motion (s) in a contact before and after singular motion, except at the ends
        of the recording; without it, the object comes and goes by lifts.
    amplitude_m, amplitude_rad : root mean square of the motion in each free direction.
    bandwidth_hz : range of the motion's bandwidth; each phase draws its own.
    object, surroundings : names of shapes.
    further : a second contact of a scenario of one phase; the surroundings are then a table and a wall.
    joint : the joint of a scenario of one free phase; none of the seven states is true then.
    has_wrench : whether the wrench of the hand on the object is measured too; the surroundings are one body.
    name : name in the recording's metadata.
    """

    phases: tuple[Phase, ...]
    rate_hz: float = 200.0
    sigma_position_m: float = 0.0003
    sigma_rotation_rad: float = float(np.radians(0.15))
    outlier_probability: float = 0.0
    drop_probability: float = 0.0
    hold_probability: float = 0.0
    jitter_s: float = 0.0
    lead_s: float = 0.8
    amplitude_m: float = 0.035
    amplitude_rad: float = float(np.radians(10.0))
    bandwidth_hz: tuple[float, float] = (0.5, 1.2)
    object: str = "cube"
    surroundings: str = "desk"
    further: Further | None = None
    joint: JointKind | None = None
    has_wrench: bool = False
    name: str = "custom"


def _phases(duration_s: float, *contacts: Contact) -> tuple[Phase, ...]:
    """One phase of this duration for each contact."""
    return tuple(Phase(contact, duration_s) for contact in contacts)


FORMATIONS: Final[Mapping[str, Scenario]] = {
    name: Scenario(_phases(24.0, first), surroundings=CORNER, further=further, name=name)
    for name, first, further in (
        ("vertex_and_vertex", Contact.VF, Further(Contact.VF)),
        ("edge_and_vertex", Contact.EF, Further(Contact.VF)),
        ("face_and_edge", Contact.FF, Further(Contact.EF)),
        ("face_and_face", Contact.FF, Further(Contact.FF)),
        ("wall_in_between", Contact.VF, Further(Contact.VF, 8.0, 16.0)),
        ("edge_then_wall", Contact.EF, Further(Contact.VF, 8.0, 16.0)),
    )
}
"""Scenarios with two contacts at once: the first named on a table, the other on a wall."""
JOINTS: Final[Mapping[str, Scenario]] = {
    kind.value: Scenario(
        _phases(24.0, Contact.FREE),
        amplitude_m=0.1,
        amplitude_rad=float(np.radians(15.0 if kind is JointKind.BALL else 25.0)),
        joint=kind,
        name=kind.value,
    )
    for kind in JointKind
}
"""Scenarios of an object in a joint: a door, a drawer, a cap, a ball in its socket."""
_RANDOM: Final = "random"
_SEQUENCES: Final = (
    Scenario(
        (Phase(Contact.FF, 5.0, "rest"), *_phases(10.0, Contact.FF, Contact.EF, Contact.VF, Contact.EE)),
        name="paper_experiment",
    ),
    Scenario(
        (
            *_phases(5.5, Contact.FREE, Contact.VF, Contact.EF, Contact.FF),
            *_phases(5.5, Contact.FE, Contact.FV, Contact.FE, Contact.EE),
            Phase(Contact.FREE, 3.0),
        ),
        object="box",
        surroundings="block",
        name="all_states",
    ),
    Scenario(
        (Phase(Contact.FF, 3.0), Phase(Contact.EF, 3.5), Phase(Contact.EE, 4.0)),
        rate_hz=1000.0,
        sigma_position_m=0.00005,
        sigma_rotation_rad=float(np.radians(0.02)),
        object="wedge",
        surroundings="block",
        name="robot_1khz",
    ),
    Scenario(
        _phases(8.0, Contact.VF, Contact.EF, Contact.FREE, Contact.FV, Contact.FE, Contact.FF),
        rate_hz=30.0,
        sigma_position_m=0.0015,
        sigma_rotation_rad=float(np.radians(0.7)),
        outlier_probability=0.01,
        drop_probability=0.05,
        object="prism",
        surroundings="ridge",
        name="vision_30hz",
    ),
    # An object pivots on its own edge, then on one of the surroundings: all six contacts explain the motion,
    # but few explain the wrench of the hand.
    Scenario(
        (
            Phase(Contact.EF, 6.0, "tilt"),
            Phase(Contact.FREE, 6.0),
            Phase(Contact.FE, 6.0, "tilt"),
            Phase(Contact.FREE, 6.0),
        ),
        rate_hz=100.0,
        lead_s=0.0,
        object="box",
        surroundings="block",
        has_wrench=True,
        name="pressed",
    ),
)
_FIXED: Final = {**{scenario.name: scenario for scenario in _SEQUENCES}, **FORMATIONS, **JOINTS}
SCENARIOS: Final = (*(scenario.name for scenario in _SEQUENCES), _RANDOM, *FORMATIONS, *JOINTS)
"""Names of scenarios."""


def named_scenario(name: str, seed: int) -> Scenario:
    """The scenario ``name``; only ``random`` depends on ``seed``. Raises UsageError if unknown."""
    if name not in SCENARIOS:
        raise UsageError(f"unknown scenario {name!r}: choose from {', '.join(SCENARIOS)}")
    return _random(seed) if name == _RANDOM else _FIXED[name]


def _random(seed: int) -> Scenario:
    """A random walk, usually to a contact that contains the present one or is contained in it."""
    rng = np.random.default_rng([seed, 1])
    contact = STATES[rng.integers(7)]
    phases = [Phase(contact, rng.uniform(3.0, 8.0))]
    for _ in range(int(rng.integers(6, 10))):
        if contact is not Contact.FREE and rng.random() < 0.15:
            phases.append(Phase(contact, rng.uniform(1.0, 3.0), "rest"))
        states = [s for s in STATES if s is not contact]
        near = [s for s in states if s.contains(contact) or contact.contains(s)]
        choice = near if rng.random() < 0.8 else states
        contact = choice[rng.integers(len(choice))]
        phases.append(Phase(contact, rng.uniform(3.0, 8.0)))
    return Scenario(
        tuple(phases),
        sigma_position_m=rng.uniform(0.0002, 0.0005),
        sigma_rotation_rad=float(np.radians(rng.uniform(0.1, 0.3))),
        object=str(rng.choice(list(OBJECTS))),
        surroundings=str(rng.choice(list(SURROUNDINGS))),
        name=_RANDOM,
    )
