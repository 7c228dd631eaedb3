"""Evidence for free motion by the speed of a stretch of motion (docs/theory.md, T52).

An object is moved faster through the air than in contact. How fast that is differs between recordings, so it
is learned from the recording. Slow motion is no evidence, since an object may be held still in the air. The
speed counts once for a contact, however long it lasts: who wipes a table goes on as fast.
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
    """The speed of free motion, as learned so far, the present stretch of fast motion, and the largest speeds
    since earlier ticks."""

    mean: float = USUAL
    """Mean of the log of the largest speed (m/s) in a stretch of free motion, ..."""
    variance: float = USUAL_SPREAD**2
    """... and the variance of this mean."""
    peak: float = -inf
    """Log of the largest speed (m/s) in the present stretch; minus infinity without one."""
    p_free: float = 0.0
    """Probability that the latest tick of the stretch is free motion."""
    largest: tuple[tuple[int, float], ...] = ()
    """Fast ticks since which none was faster, and their log speeds, which fall."""

    def evidence(self, log_speed: float) -> float:
        """Evidence (nats) for free motion of motion with this largest log speed; zero if it is slow."""
        apart = log_speed - self.mean
        if apart < -CONTACT_SLOWER:
            return 0.0
        free, contact = self.variance + FREE_SPREAD**2, self.variance + CONTACT_SPREAD**2
        apart = min(apart, CONTACT_SLOWER * free / (contact - free))  # beyond, the ratio would fall again
        ratio = log(contact / free) - apart**2 / free + (apart + CONTACT_SLOWER) ** 2 / contact
        return max(0.5 * ratio, 0.0)

    def added_evidence(self, onset: int, log_speed: float) -> float:
        """Evidence (nats) for free motion, against a contact since tick ``onset``, that the newest tick adds
        to that of the fastest tick since then."""
        evidence = self.evidence(log_speed)
        if not evidence:
            return 0.0
        before = next((speed for tick, speed in self.largest if tick >= onset), -inf)
        return max(evidence - self.evidence(max(before, self.peak)), 0.0)

    def update(self, tick: int, log_speed: float, p_free: float) -> Self:
        """After a ``tick`` with this speed, free with probability ``p_free``. A slow tick ends the stretch,
        from which the speed of free motion is learned."""
        if self.evidence(log_speed):
            faster = tuple(row for row in self.largest if row[1] > log_speed)
            peak = max(self.peak, log_speed)
            return self._replace(peak=peak, p_free=p_free, largest=(*faster, (tick, log_speed)))
        if self.peak == -inf:
            return self
        information = self.p_free / FREE_SPREAD**2
        variance = 1.0 / (1.0 / self.variance + information)
        mean = self.mean + variance * information * (self.peak - self.mean)
        return self._replace(mean=mean, variance=variance, peak=-inf)
