"""Test whether the prior map contradicts the motion.

Known elements are a prior. A correct one hardly lowers the evidence; with a wrong one true contacts fit badly
or not at all. So a tracker without the prior map runs beside one with it; the difference of their evidence is
the evidence against the prior map.
"""

from typing import Final, NamedTuple

from contact_tracker.adaptation.explained import Explained
from contact_tracker.config.parameters import Model
from contact_tracker.hypotheses.evidence import AS_WELL
from contact_tracker.inspection.stream_checks import Finding
from contact_tracker.landmarks.prior_map import PriorMap
from contact_tracker.motion.poses import Poses
from contact_tracker.states import Contact
from contact_tracker.tracking.belief import Belief, Detail

WRONG_NATS: Final = 8.0
"""Lead of the tracker without the prior map above which the prior map is reported as wrong. Correct
directions cost up to 7 nats: if they are off by 2.5 standard deviations, or while a wrong contact fits."""
LOST_NATS: Final = 15.0
"""The same for the lead since any tick: one part of the prior map may be wrong after another has fitted.
Correct ones lose up to 8 nats."""
DOUBTED_NATS: Final = 6.0
"""Lead above which probabilities are reduced."""
LONGEST_S: Final = 60.0
"""Seconds of motion after which the comparison ends: an error that is not detected by then is harmless."""


class Contradiction(NamedTuple):
    """State of the comparison.

    The trackers with the prior map (``given``) and without (``nothing``), None before the rate is known and
    once the comparison ``is_settled``; the part that counts of the evidence of the second over the first
    (``lead``, nats), and its largest increase until now since any tick (``lost``); and whether a
    contradiction ``is_found``.
    """

    given: Explained | None = None
    nothing: Explained | None = None
    lead: float = 0.0
    lost: float = 0.0
    is_settled: bool = False
    is_found: bool = False

    @property
    def is_likely(self) -> bool:
        """Whether a contradiction is found, or may be found soon."""
        return self.is_found or (not self.is_settled and self.lead > DOUBTED_NATS)


def advance(
    known: Contradiction,
    model: Model,
    knowledge: PriorMap,
    poses: Poses,
    is_chosen: bool = True,
    rests: bool = False,
    is_filtered: bool = False,
) -> Contradiction:
    """Advance by poses; ``model`` has the ticks and the noise of the stream. Without ``knowledge`` nothing is
    compared.

    Noise that is taken for motion has more evidence without prior map. So the comparison begins again where
    ``model`` changes, and until it ``is_chosen`` it is not settled, and nothing counts while the object
    ``rests``; where noise ``is_filtered``, it is taken for motion at rest as well, and nothing is found.
    """
    if known.is_settled or not knowledge:
        return known._replace(is_settled=True)
    if not len(poses):
        return known
    if known.given is not None and known.given.grid.model != model:
        known = Contradiction()
    given = known.given or Explained.start(model, knowledge)
    nothing = known.nothing or Explained.start(model)
    difference = nothing.filter.state.log_evidence - given.filter.state.log_evidence
    with_it, without = given.update(poses), nothing.update(poses, Detail.SHARED)
    lead, lost, is_found = known.lead, known.lost, known.is_found
    for one, other in zip(with_it, without, strict=True):
        before, difference = difference, other.log_evidence - one.log_evidence
        if (is_chosen or not rests) and not _is_undecided(one.belief, other.belief):
            lead += difference - before
            lost = max(lost + difference - before, 0.0)
        is_found = (is_chosen or not is_filtered) and (is_found or _refutes(lead, lost))
        if is_chosen and (is_found or other.moved_s > LONGEST_S):
            return Contradiction(None, None, lead, lost, is_settled=True, is_found=is_found)
    return Contradiction(given, nothing, lead, lost, is_found=is_found)


def finish(known: Contradiction) -> Contradiction:
    """At the end of the stream, whose noise may not have been chosen: labels were in doubt then."""
    return known._replace(is_found=known.is_found or _refutes(known.lead, known.lost))


def _refutes(lead: float, lost: float) -> bool:
    return lead > WRONG_NATS or lost > LOST_NATS


def _is_undecided(given: Belief, nothing: Belief) -> bool:
    """Whether motion in few directions does not decide between the contacts of the two trackers: that of
    ``nothing`` has more evidence because something else, such as the hand, keeps a constraint (T24)."""
    if not nothing.p_restricted or given.contact not in nothing.inseparable:
        return False
    return not _residual(given) >= AS_WELL * max(1.0, _residual(nothing))  # unknown ones do not decide


def _residual(belief: Belief) -> float:
    """Whitened residual of the label; nan if it is not known yet."""
    return 1.0 if belief.contact is Contact.FREE else float(belief.residual[belief.contact.column])


def findings(known: Contradiction, knowledge: PriorMap) -> tuple[Finding, ...]:
    """The finding, if a contradiction is found."""
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
