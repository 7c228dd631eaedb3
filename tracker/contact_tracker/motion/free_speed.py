"""Evidence for free motion by the speed of a stretch of motion (docs/theory.md, T52).

An object is moved faster through the air than in contact. How fast that is differs between recordings, so it
is learned from the recording. Slow motion is no evidence, since an object may be held still in the air.
"""

from math import log
from typing import Final, NamedTuple, Self

USUAL: Final = log(0.6)
"""Mean over recordings of the log of the largest speed (m/s) of free motion, and its standard deviation
between recordings. These and the following are measured on 39 recordings with truth, as the test of this
module does again; between other recordings the speed differs more than the 0.34 of these."""
USUAL_SPREAD: Final = 0.5
FREE_SPREAD: Final = 0.25
"""Standard deviation of the log speed of free motion within a recording."""
CONTACT_SLOWER: Final = 1.4
"""How much lower the log speed is in contact, in the mean, and its standard deviation."""
CONTACT_SPREAD: Final = 0.67
STILL: Final = -20.0
"""Log speed (m/s) of no motion."""


class FreeSpeed(NamedTuple):
    """The speed of free motion, as learned so far, and the present stretch of fast motion."""

    mean: float = USUAL
    """Mean of the log of the largest speed (m/s) in a stretch of free motion, ..."""
    variance: float = USUAL_SPREAD**2
    """... and the variance of this mean."""
    peak: float = STILL
    """Log of the largest speed (m/s) in the present stretch; ``STILL`` if there is none."""
    p_free: float = 0.0
    """Probability that the latest tick of the stretch is free motion."""

    def evidence(self, log_speed: float) -> float:
        """Evidence (nats) for free motion of a stretch with this largest log speed; zero if it is slow."""
        free, contact = self.variance + FREE_SPREAD**2, self.variance + CONTACT_SPREAD**2
        fastest = CONTACT_SLOWER * free / (contact - free)  # beyond, the ratio would fall again
        apart = min(log_speed - self.mean, fastest)
        ratio = log(contact / free) - apart**2 / free + (apart + CONTACT_SLOWER) ** 2 / contact
        return max(0.5 * ratio, 0.0)

    def added_evidence(self, speed_m_s: float) -> float:
        """Evidence (nats) for free motion that the newest tick adds to its stretch by its speed."""
        return self.evidence(max(_log(speed_m_s), self.peak)) - self.evidence(self.peak)

    def update(self, speed_m_s: float, p_free: float) -> Self:
        """After a tick with this speed, free with probability ``p_free``. A slow tick ends the stretch, from
        which the speed of free motion is learned."""
        log_speed = _log(speed_m_s)
        if self.evidence(log_speed):
            return self._replace(peak=max(self.peak, log_speed), p_free=p_free)
        if self.peak == STILL:
            return self
        information = self.p_free / FREE_SPREAD**2
        variance = 1.0 / (1.0 / self.variance + information)
        return type(self)(self.mean + variance * information * (self.peak - self.mean), variance)


NOT_WEIGHED: Final = FreeSpeed(mean=-STILL)
"""By which no speed is evidence."""


def _log(speed_m_s: float) -> float:
    return log(speed_m_s) if speed_m_s > 0.0 else STILL
