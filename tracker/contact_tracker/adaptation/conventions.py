"""Mistakes of convention in how poses were recorded, recognised by what contacts explain of the motion.

A quaternion with its components in another order, or inverted beside a position that is not, is a rotation
like any other, and turns about no point that the position knows of: contacts explain next to nothing of such
motion, and much of it once the quaternions are read as they were meant. So trackers that read them in the
usual wrong ways run beside those that take them as they are, until these lead by enough.
"""

from typing import Final, NamedTuple

import numpy as np

from contact_tracker.adaptation.explained import Explained, follow
from contact_tracker.adaptation.rest import KEPT_TICKS
from contact_tracker.config.parameters import Model
from contact_tracker.inspection.stream_checks import Finding
from contact_tracker.landmarks.prior_map import PriorMap
from contact_tracker.motion.poses import NO_POSES, Poses
from contact_tracker.tracking import tracker

READINGS: Final = (
    ("", np.arange(4), 1.0),
    ("quaternions look like w x y z in fields that are x y z w: reorder them", np.array([1, 2, 3, 0]), 1.0),
    ("quaternions look inverted (rotation of the world in the body): conjugate them", np.arange(4), -1.0),
    (
        "quaternions look like w x y z in fields that are x y z w, and inverted (rotation of the world in "
        "the body): reorder and conjugate them",
        np.array([1, 2, 3, 0]),
        -1.0,
    ),
)
"""What is wrong, where x y z w are, and the sign of x y z. The first takes poses as they are: the trackers
that are compared have to take their noise to be the same."""
SAFE_NATS: Final = 15.0
SAFE_AFTER_S: Final = 2.0
"""After so much motion a lead by so much over all other readings settles it."""
WRONG_NATS: Final = 30.0
WRONG_FACTOR: Final = 1.5
"""By so much, and so many times as much, another reading explains more if the poses are wrong."""
USUAL_S: Final = 15.0
"""Motion (s) after which poses are taken as they are, unless another reading leads by ``DOUBT_NATS``."""
DOUBT_NATS: Final = 5.0
LONGEST_S: Final = 60.0
"""Motion (s) after which they are in any case."""


class Conventions(NamedTuple):
    """What is known so far.

    ``trackers`` of READINGS, none before the rate is known and once it is settled; whether it
    ``is_settled``; the text of what was ``found``, empty if nothing was; the latest poses of a rest, which
    the trackers have not taken in (``waiting``).
    """

    trackers: tuple[Explained, ...]
    is_settled: bool
    found: str
    waiting: Poses


NOTHING_KNOWN: Final = Conventions((), False, "", NO_POSES)


def advance(
    known: Conventions, model: Model, knowledge: PriorMap, poses: Poses, rests: bool = False
) -> Conventions:
    """Take in poses; ``model`` has the ticks of the stream. With ``knowledge`` nothing is compared.

    Poses in which the object ``rests`` are skipped but for the latest, since they cost time and show nothing.
    """
    if knowledge:
        return known._replace(is_settled=True)
    if known.is_settled or not len(poses):
        return known
    poses = Poses.join([known.waiting, poses])
    if not rests:
        return _compared(known._replace(waiting=NO_POSES), model, poses)
    latest = poses.stamp_ns >= poses.stamp_ns[-1] - KEPT_TICKS * model.tick_ns
    return known._replace(waiting=poses[latest])


def findings(known: Conventions) -> tuple[Finding, ...]:
    """What is to be said."""
    return (Finding("quaternions", known.found, True),) if known.found else ()


def read(poses: Poses, reading: int) -> Poses:
    """Poses with their quaternions read in one of READINGS."""
    _, order, sign = READINGS[reading]
    quat = poses.quat_xyzw[:, order] * [sign, sign, sign, 1.0]
    return Poses(poses.stamp_ns, poses.position_m, quat)


def _compared(known: Conventions, model: Model, poses: Poses) -> Conventions:
    """What contacts explain in each reading, against what they explain of the poses as they are."""
    trackers = known.trackers or tuple(Explained(tracker.start(model)) for _ in READINGS)
    after = tuple(follow(one, read(poses, reading))[0] for reading, one in enumerate(trackers))
    explained, moved_s = np.array([one.state.log_evidence for one in after]), after[0].moved_s
    other, lead = int(explained.argmax()), float(explained[0] - explained[1:].max())
    if lead < -WRONG_NATS and explained[other] > WRONG_FACTOR * explained[0]:
        return Conventions((), True, READINGS[other][0], NO_POSES)
    is_safe = moved_s > SAFE_AFTER_S and lead > SAFE_NATS
    if is_safe or (moved_s > USUAL_S and lead > -DOUBT_NATS) or moved_s > LONGEST_S:
        return Conventions((), True, "", NO_POSES)
    return Conventions(after, False, "", NO_POSES)
