"""Detection of wrong quaternion conventions, by how much of the motion contacts explain.

Quaternions with their components in another order, or inverted while positions are not, are valid rotations,
but their turns do not match the positions: contacts explain hardly any of such motion, and much of it in the
right convention. So trackers with the common wrong conventions run beside one with the quaternions as given,
until that one leads by enough.
"""

from typing import Final, NamedTuple

import numpy as np

from contact_tracker.adaptation.candidates import can_be_compared
from contact_tracker.adaptation.explained import Explained, follow
from contact_tracker.adaptation.rest import KEPT_TICKS
from contact_tracker.config.parameters import Model
from contact_tracker.inspection.stream_checks import Finding
from contact_tracker.landmarks.prior_map import PriorMap
from contact_tracker.motion.poses import NO_POSES, Poses
from contact_tracker.tracking import tracker

_W_FIRST: Final = "like w x y z in fields that are x y z w"
_W_LAST: Final = "like x y z w in fields that are w x y z"
_INVERTED: Final = "and inverted (rotation of the world in the body): reorder and conjugate them"
READINGS: Final = (
    ("", np.arange(4), 1.0),
    (f"{_W_FIRST}: reorder them", np.array([1, 2, 3, 0]), 1.0),
    ("inverted (rotation of the world in the body): conjugate them", np.arange(4), -1.0),
    (f"{_W_FIRST}, {_INVERTED}", np.array([1, 2, 3, 0]), -1.0),
    (f"{_W_LAST}: reorder them", np.array([3, 0, 1, 2]), 1.0),
    (f"{_W_LAST}, {_INVERTED}", np.array([3, 0, 1, 2]), -1.0),
)
"""What quaternions look, the fields of x y z w, and the sign of x y z. The first leaves poses as they
are; its tracker is none of those side by side, since all that are compared here must have the same noise."""
SAFE_NATS: Final = 15.0
SAFE_AFTER_S: Final = 2.0
"""The poses are right after this much motion, if they lead all other readings by this much."""
WRONG_NATS: Final = 30.0
WRONG_FACTOR: Final = 1.5
"""The poses are wrong if another reading leads by this much, and has this many times their log evidence."""
TIED_NATS: Final = 5.0
"""Readings this far behind the best are named as well: turns about one axis are alike in some of them."""
USUAL_S: Final = 15.0
"""Motion (s) after which poses are assumed to be right, unless another reading leads by ``DOUBT_NATS``."""
DOUBT_NATS: Final = 5.0
LONGEST_S: Final = 60.0
"""Motion (s) after which they are assumed to be right in any case."""


class Conventions(NamedTuple):
    """State of the comparison.

    Parameters
    ----------
    trackers : one for each of READINGS; none before the rate is known and once ``is_settled``.
    is_settled : whether the comparison has ended.
    found : text of the mistake that was found, or empty.
    waiting : the latest poses of a rest, by which the trackers are not updated yet.
    """

    trackers: tuple[Explained, ...]
    is_settled: bool
    found: str
    waiting: Poses


NOTHING_KNOWN: Final = Conventions((), False, "", NO_POSES)


def advance(
    known: Conventions, model: Model, knowledge: PriorMap, poses: Poses, rests: bool = False
) -> Conventions:
    """Advance by poses; ``model`` has the ticks of the stream. With ``knowledge``, or without any evidence,
    nothing is compared.

    Of poses in which the object ``rests`` only the latest are used, since they carry no information.
    """
    if knowledge or not can_be_compared(model):
        return known._replace(is_settled=True)
    if known.is_settled or not len(poses):
        return known
    poses = Poses.join([known.waiting, poses])
    if not rests:
        return _compared(known._replace(waiting=NO_POSES), model, poses)
    latest = poses.stamp_ns >= poses.stamp_ns[-1] - KEPT_TICKS * model.tick_ns
    return known._replace(waiting=poses[latest])


def findings(known: Conventions) -> tuple[Finding, ...]:
    """The finding, if there is one."""
    return (Finding("quaternions", known.found, True),) if known.found else ()


def read(poses: Poses, reading: int) -> Poses:
    """Poses with their quaternions read in one of READINGS."""
    _, order, sign = READINGS[reading]
    quat = poses.quat_xyzw[:, order] * [sign, sign, sign, 1.0]
    return Poses(poses.stamp_ns, poses.position_m, np.ascontiguousarray(quat))


def _compared(known: Conventions, model: Model, poses: Poses) -> Conventions:
    """Compare the log evidence of contacts in each reading with that of the poses as they are."""
    trackers = known.trackers or tuple(Explained(tracker.start(model)) for _ in READINGS)
    after = tuple(follow(one, read(poses, reading))[0] for reading, one in enumerate(trackers))
    explained, moved_s = np.array([one.state.log_evidence for one in after]), after[0].moved_s
    other, lead = int(explained.argmax()), float(explained[0] - explained[1:].max())
    if lead < -WRONG_NATS and explained[other] > WRONG_FACTOR * explained[0]:
        near = (explained[1:] > explained[other] - TIED_NATS).nonzero()[0] + 1
        found = "; or ".join(READINGS[i][0] for i in near)
        return Conventions((), True, f"quaternions look {found}", NO_POSES)
    is_safe = moved_s > SAFE_AFTER_S and lead > SAFE_NATS
    if is_safe or (moved_s > USUAL_S and lead > -DOUBT_NATS) or moved_s > LONGEST_S:
        return Conventions((), True, "", NO_POSES)
    return Conventions(after, False, "", NO_POSES)
