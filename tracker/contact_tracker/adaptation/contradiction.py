"""Whether contacts explain the motion better without what the user has given than with it.

What is given is a prior: where it is right it costs nothing, where it is wrong contacts fit only against it,
or not at all, and others that are not there fit instead. So a tracker that knows nothing runs beside one that
knows what is given; by how much the first explains more is the evidence against what is given.
"""

from typing import Final, NamedTuple

from contact_tracker.adaptation.explained import Explained, follow
from contact_tracker.config.parameters import Model
from contact_tracker.inspection.stream_checks import Finding
from contact_tracker.landmarks.prior_map import PriorMap
from contact_tracker.motion.poses import Poses
from contact_tracker.tracking import tracker

WRONG_NATS: Final = 8.0
"""By so much more is explained without what is given if it is wrong. Directions that are right cost up to 5:
where they are two deviations off, and where a contact that is not there fits for a while."""
DOUBTED_NATS: Final = 6.0
"""From here on no label is sure as long as it is not known."""
LONGEST_S: Final = 60.0
"""Of motion: what has not shown by then does no harm."""


class Contradiction(NamedTuple):
    """What is known so far.

    The trackers that know what is ``given`` and that know ``nothing``, None before the rate is known and once
    it ``is_settled``; the ``lead`` (nats) of the second, and whether that ``is_found`` to be too large.
    """

    given: Explained | None = None
    nothing: Explained | None = None
    lead: float = 0.0
    is_settled: bool = False
    is_found: bool = False

    @property
    def is_likely(self) -> bool:
        """Whether it is found, or may be found soon."""
        return self.is_found or (not self.is_settled and self.lead > DOUBTED_NATS)


def advance(known: Contradiction, model: Model, knowledge: PriorMap, poses: Poses) -> Contradiction:
    """Take in poses; ``model`` has the ticks of the stream. Without ``knowledge`` nothing is compared."""
    if known.is_settled or not knowledge:
        return known._replace(is_settled=True)
    given, with_it = follow(known.given or Explained(tracker.start(model, knowledge=knowledge)), poses)
    nothing, without = follow(known.nothing or Explained(tracker.start(model)), poses)
    lead = known.lead
    for one, other in zip(with_it, without, strict=True):
        lead = other.log_evidence - one.log_evidence
        if lead > WRONG_NATS or other.moved_s > LONGEST_S:
            return Contradiction(lead=lead, is_settled=True, is_found=lead > WRONG_NATS)
    return Contradiction(given, nothing, lead)


def findings(known: Contradiction, knowledge: PriorMap) -> tuple[Finding, ...]:
    """What is to be said."""
    if not known.is_found:
        return ()
    what = "--up" if knowledge.up is not None else "what is given"
    if knowledge.up is not None and (knowledge.environment or knowledge.object):
        what = "--up or what else is given"
    text = (
        f"{what} does not fit the motion: contacts explain more of it without: check it (direction or place, "
        "in metres and in the frame of the poses), or leave it out"
    )
    return (Finding("knowledge", text, True),)
