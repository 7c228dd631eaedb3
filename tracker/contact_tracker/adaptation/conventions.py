"""Detection of positions and orientations that do not fit together, by how much of the motion contacts explain.

Positions and orientations in different conventions are valid, each alone, but contacts explain hardly any
of their motion, and much of it in the right reading. So the motion is explained window by window in all
``READINGS``. A remedy is a reading in which contacts explain most windows to the noise.
"""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.adaptation.candidates import can_be_compared
from contact_tracker.adaptation.readings import DELAYS_MS, READINGS, UNITS, Reading, with_delay
from contact_tracker.adaptation.window_scores import TICKS, explain
from contact_tracker.config.parameters import Model
from contact_tracker.inspection.stream_checks import Finding
from contact_tracker.motion.poses import NO_POSES, Poses

Array = NDArray[np.float64]

LEAST_TICK_S: Final = 0.1
"""Shorter ticks are joined, so that a window is long enough for its motion to be restricted by contacts."""
POSES_PER_TICK: Final = 8
"""Number of poses that are read per tick, of more of them."""
MOST_WINDOWS: Final = 30
"""Windows with motion, 60 s of it, after which the comparison ends."""
BETTER_NATS: Final = 60.0
"""A reading is a remedy if it explains the motion better by this much, and most windows to the noise."""
ODD_NATS: Final = 120.0
"""Positions and orientations do not fit together if any reading leads by this much. In 140 recordings that
are right leads are below 65, and in none that fits to the noise above 45; mistakes lead by 40 a window."""
FITS: Final = 3.0
"""Misfit up to which contacts explain a window to the noise; 1 for the right contact."""
FITTING_SHARE: Final = 0.5
"""Least share of windows with motion that a remedy explains to the noise: 0.6 to 0.7 in the right reading of
four contacts in turn, up to 0.45 in wrong ones."""
FEWEST_WINDOWS: Final = 2
TIED_NATS: Final = 5.0
"""Readings this far behind the best are named as well: turns about one axis are alike in some of them."""
MOST_NAMED: Final = 3
NAMELESS: Final = (
    "position and orientation do not fit together: tried were the orders of quaternions and of three angles, "
    "rotation vectors, inverse orientations, swapped and mirrored axes of positions, and delays up to 100 ms, "
    "and contacts explain the motion in none; check how both were exported, in which frame and with which clock"
)


class Conventions(NamedTuple):
    """State of the comparison.

    Parameters
    ----------
    waiting : poses of the incomplete window.
    kept : poses of the ``windows`` with motion, thinned.
    nats, fitting : (K,) log evidence of contacts in each reading, and number of windows that it explains to
        the noise.
    units : (3, U) the same for ``UNITS``, and the number of windows in which they were compared.
    is_settled : whether the comparison has ended.
    found : text of the mistake that was found, or empty.
    """

    waiting: Poses = NO_POSES
    kept: tuple[tuple[Poses, NDArray[np.int64]], ...] = ()
    nats: Array = np.zeros(len(READINGS))
    fitting: Array = np.zeros(len(READINGS))
    units: Array = np.zeros((3, len(UNITS)))
    is_settled: bool = False
    found: str = ""

    @property
    def is_likely(self) -> bool:
        """Whether a mistake is found, or may be found soon."""
        may_be = not self.is_settled and float(self.nats.max() - self.nats[0]) > BETTER_NATS
        return bool(self.found) or may_be

    @property
    def unit(self) -> str:
        """Name of the unit in which contacts explain the motion to the noise, unlike in metres; or empty."""
        nats, fitting, windows = self.units
        best = int(nats.argmax())
        fits = nats[best] > nats[0] + BETTER_NATS and fitting[best] >= FITTING_SHARE * windows[best]
        return UNITS[best].text if fits else ""


NOTHING_KNOWN: Final = Conventions()


def advance(
    known: Conventions, model: Model, sigma: tuple[float, float], poses: Poses, has_odd_unit: bool = False
) -> Conventions:
    """Advance by poses; ``model`` has the ticks of the stream, ``sigma`` is the noise of a pose (m, rad).

    Units are compared only for positions that look odd in metres.
    """
    if not can_be_compared(model):
        return known._replace(is_settled=True)
    if known.is_settled or not len(poses):
        return known
    tick_ns = round(1e9 * max(model.tick_s, LEAST_TICK_S))
    waiting = Poses.join([known.waiting, poses])
    while len(waiting) and len(known.kept) < MOST_WINDOWS:
        tick_of = (waiting.stamp_ns - waiting.stamp_ns[0]) // tick_ns
        if tick_of[-1] < TICKS + 2:
            return known._replace(waiting=waiting)
        window = waiting[: np.searchsorted(tick_of, TICKS + 2)]
        waiting = waiting[np.searchsorted(tick_of, TICKS) :]
        known = _after_window(known, model, sigma, window, tick_ns, has_odd_unit)
    return known._replace(waiting=NO_POSES, is_settled=True)


def findings(known: Conventions) -> tuple[Finding, ...]:
    """The finding, if there is one."""
    return (Finding("conventions", known.found, True),) if known.found else ()


def _after_window(
    known: Conventions,
    model: Model,
    sigma: tuple[float, float],
    window: Poses,
    tick_ns: int,
    has_odd_unit: bool,
) -> Conventions:
    tick_of = (window.stamp_ns - window.stamp_ns[0]) // tick_ns
    usual = np.median(np.bincount(tick_of, minlength=TICKS + 2))
    thinned = slice(None, None, max(int(usual) // POSES_PER_TICK, 1))
    window, tick_of = window[thinned], tick_of[thinned]
    if not np.bincount(tick_of, minlength=TICKS + 2).all():
        return known
    explained = explain(window, tick_of, sigma, model, READINGS)
    if explained is None:
        return known
    known = known._replace(
        kept=(*known.kept, (window, tick_of)),
        nats=known.nats + explained.nats,
        fitting=known.fitting + (explained.misfit < FITS),
    )
    if has_odd_unit:
        units = np.append(_explained(window, tick_of, sigma, model, UNITS), np.ones((1, len(UNITS))), axis=0)
        return known._replace(units=known.units + units, found="")
    count = len(known.kept)
    has_doubled = count & (count - 1) == 0  # it takes some time
    return known._replace(found=_found(known, model, sigma)) if has_doubled or count == MOST_WINDOWS else known


def _found(known: Conventions, model: Model, sigma: tuple[float, float]) -> str:
    """The mistake, with a remedy if one fits."""
    nats, fitting = known.nats, known.fitting
    lead = float(nats.max() - nats[0])
    if lead < BETTER_NATS or len(known.kept) < FEWEST_WINDOWS:
        return ""
    needed = FITTING_SHARE * len(known.kept)
    near = (nats > nats.max() - TIED_NATS).nonzero()[0]
    readings, fit = [READINGS[i] for i in near], fitting[near] >= needed
    if READINGS[nats.argmax()].delay_ms:
        readings, fit = _refined(known, model, sigma, READINGS[nats.argmax()].delay_ms, needed)
    if fit.any():
        texts = [reading.text for reading, one in zip(readings, fit, strict=True) if one]
        return "; or ".join(texts[:MOST_NAMED]) + ("; or others" if len(texts) > MOST_NAMED else "")
    return NAMELESS if lead > ODD_NATS else ""


def _refined(
    known: Conventions, model: Model, sigma: tuple[float, float], delay_ms: float, needed: float
) -> tuple[list[Reading], NDArray[np.bool_]]:
    """The best delay between the neighbours of one of ``DELAYS_MS``, and whether it fits; none at the ends."""
    at = DELAYS_MS.index(delay_ms)
    if at in (0, len(DELAYS_MS) - 1):
        return [], np.zeros(0, np.bool_)
    first, last = DELAYS_MS[at - 1], DELAYS_MS[at + 1]
    while True:
        step = max(round((last - first) / 8), 1)
        readings = [READINGS[0], *map(with_delay, range(first, last + 1, step))]
        nats, fitting = np.sum([_explained(*one, sigma, model, readings) for one in known.kept], axis=0)
        best = int(nats.argmax())
        if step == 1 or not best:
            return [readings[best]], np.array([best > 0 and fitting[best] >= needed])
        middle = round(readings[best].delay_ms)
        first, last = middle - step, middle + step


def _explained(
    window: Poses,
    tick_of: NDArray[np.int64],
    sigma: tuple[float, float],
    model: Model,
    readings: Sequence[Reading],
) -> Array:
    """Rows of the log evidence (K,), and of whether each reading explains the window to the noise."""
    found = explain(window, tick_of, sigma, model, readings)
    if found is None:
        return np.zeros((2, len(readings)))
    return np.array([found.nats, found.misfit < FITS])
