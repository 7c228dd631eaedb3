"""Evidence for free motion by the speed of a stretch of motion (docs/theory.md, T52).

An object is moved faster through the air than in contact. How fast that is differs between recordings, so it
is learned from the recording. Slow motion is no evidence, since an object may be held still in the air. A
stretch ends where free motion gets slow; a contact counts its speed once, since who wipes goes on as fast.
"""

from math import inf, log
from typing import Final, NamedTuple, Self

USUAL: Final = log(0.7)
"""Mean over recordings of the log of the largest speed (m/s) in a phase of free motion, and its standard
deviation between recordings. These and the following are measured on 39 simulated recordings with truth, as
the test of this module does again; between other recordings the speed differs more than the 0.34 of these."""
USUAL_SPREAD: Final = 0.5
FREE_SPREAD: Final = 0.25
"""Standard deviation of the log speed of free motion within a recording."""
CONTACT_SLOWER: Final = 1.24
"""How much lower the log speed is in contact, in the mean, and its standard deviation."""
CONTACT_SPREAD: Final = 0.71


class FreeSpeed(NamedTuple):
    """The speed of free motion, as learned so far, and the present stretch of motion."""

    mean: float = USUAL
    """Mean of the log of the largest speed (m/s) in a stretch of free motion, ..."""
    variance: float = USUAL_SPREAD**2
    """... and the variance of this mean."""
    peak: float = -inf
    """Log of its largest speed (m/s), if that was fast; else minus infinity."""
    p_free: float = 0.0
    """Probability that the latest tick is free motion."""

    def evidence(self, log_speed: float) -> float:
        """Evidence (nats) for free motion of motion with this largest log speed; zero if it is slow."""
        apart = log_speed - self.mean
        if apart < -CONTACT_SLOWER:
            return 0.0
        free, contact = self.variance + FREE_SPREAD**2, self.variance + CONTACT_SPREAD**2
        apart = min(apart, CONTACT_SLOWER * free / (contact - free))  # beyond, the ratio would fall again
        ratio = log(contact / free) - apart**2 / free + (apart + CONTACT_SLOWER) ** 2 / contact
        return max(0.5 * ratio, 0.0)

    def added_evidence(self, log_speed: float) -> float:
        """Evidence (nats) for free motion that a tick with this log speed adds to its stretch."""
        evidence = self.evidence(log_speed)
        return max(evidence - self.evidence(self.peak), 0.0) if evidence else 0.0

    def update(self, log_speed: float, p_free: float) -> Self:
        """After a tick with this log speed, free with probability ``p_free``. A slow tick ends a stretch of
        free motion, from which the speed of free motion is learned."""
        if self.evidence(log_speed):
            return self._replace(peak=max(self.peak, log_speed), p_free=p_free)
        if self.peak == -inf or self.p_free < 0.5:
            return self._replace(p_free=p_free)
        information = self.p_free / FREE_SPREAD**2
        variance = 1.0 / (1.0 / self.variance + information)
        return type(self)(self.mean + variance * information * (self.peak - self.mean), variance)
