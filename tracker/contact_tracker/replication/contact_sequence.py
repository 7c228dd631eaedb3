"""The paper's second experiment: identification of an object's contact state over several contacts.

The paper minimises its objectives on windows of 500 poses, ten poses apart (Fig. 5). The tracker gives a
posterior in each tick: online from the poses so far, and offline from the whole recording.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from contact_tracker.adaptation import offline
from contact_tracker.config.loading import load_model
from contact_tracker.evaluation.scoring import scoring, tick_in_force
from contact_tracker.motion.poses import Poses
from contact_tracker.paper import matrix, minimise_slsqp, motion
from contact_tracker.paper.window_curves import WindowCurves, curves
from contact_tracker.replication.noises import NOISES
from contact_tracker.replication.single_contact import MOVED
from contact_tracker.states import Contact
from contact_tracker.tracking.segmentation import Segmentation
from contact_tracker_lab.simulate import simulate

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

FRAMES: Final = 500
STEP: Final = 10
STARTS: Final = 3
COLUMNS: Final = [contact.column for contact in MOVED]


@dataclass(frozen=True, eq=False)
class ContactSequence:
    """The W windows of one recording, and the tracker's segmentation.

    Parameters
    ----------
    noise : its name in ``NOISES``.
    poses : as recorded.
    truth : (N,) column of the true state of each pose.
    windows : minima of all six objectives, by the batched minimiser.
    slsqp_window, slsqp_minimum : (S,) some of the windows, and (S, 4) their minima by SLSQP from three random
        starts, for the contacts of ``MOVED``.
    segmentation : of the tracker.
    """

    noise: str
    poses: Poses
    truth: NDArray[np.int8]
    windows: WindowCurves
    slsqp_window: Ints
    slsqp_minimum: Array
    segmentation: Segmentation

    @property
    def curves(self) -> Array:
        """(W, 4) minima for ``MOVED``, each column over its maximum."""
        return self.windows.normalised[:, COLUMNS]

    @property
    def slsqp_points(self) -> Array:
        """(S, 4) minima by SLSQP, in the scale of ``curves``."""
        return np.asarray(self.slsqp_minimum / self.windows.minimum[:, COLUMNS].max(axis=0))

    @property
    def slsqp_gain(self) -> Array:
        """(S, 4) how much lower the minima by SLSQP are, relative to the curves' maximum."""
        return np.asarray(self.curves[self.slsqp_window] - self.slsqp_points)

    def window_at(self, stamp_ns: Ints) -> Array:
        """Fractional index of the window that ends at each stamp (K,); negative before the first."""
        frame = np.interp(stamp_ns, self.poses.stamp_ns, np.arange(len(self.poses)))
        return np.asarray((frame - (FRAMES - 1)) / STEP)

    @property
    def window_truth(self) -> Ints:
        """(W,) column of a window's state, -1 for one with a change."""
        begin = np.arange(len(self.windows.stamp_ns)) * STEP
        changes = np.concatenate([[0], np.cumsum(self.truth[1:] != self.truth[:-1])])
        whole = changes[begin] == changes[begin + FRAMES - 1]
        return np.where(whole, self.truth[begin], -1).astype(np.int64)

    @property
    def online(self) -> Ints:
        """(W,) the last reported tick at the end of a window."""
        return tick_in_force(self.windows.stamp_ns, self.segmentation.filtered.stamp_ns)

    @property
    def offline(self) -> Ints:
        """(W,) the tick in which a window ends."""
        ticks = self.segmentation.beliefs.stamp_ns
        return np.minimum(np.searchsorted(ticks, self.windows.stamp_ns), len(ticks) - 1).astype(np.int64)

    def lowest(self) -> list[Contact]:
        """(W,) the contact of ``MOVED`` whose curve is lowest in each window."""
        return [MOVED[column] for column in self.curves.argmin(axis=1)]

    def online_labels(self) -> list[Contact]:
        """(W,) the tracker's online label at the end of a window."""
        labels = self.segmentation.filtered.contacts
        return [labels[tick] for tick in self.online]

    def offline_labels(self) -> list[Contact]:
        """(W,) the tracker's offline label at the end of a window."""
        labels = self.segmentation.beliefs.contacts
        return [labels[tick] for tick in self.offline]


def replicate_sequence(noise: str, seed: int, slsqp_every: int) -> ContactSequence:
    """Move the paper's cube at rest, then in f-f, e-f, v-f and e-e for ten seconds each.

    Parameters
    ----------
    noise : a name in ``NOISES``.
    seed : of the recording; with 1 and white noise it is ``recordings/paper_experiment.mcap``.
    slsqp_every : SLSQP, which takes a hundred times longer, runs on every so many-th window.
    """
    simulated = simulate("paper_experiment", seed)
    poses = NOISES[noise](simulated.poses)
    windows = curves(poses, FRAMES, STEP)
    some = np.arange(0, len(windows.stamp_ns), slsqp_every)
    return ContactSequence(
        noise,
        poses,
        scoring(poses.stamp_ns, simulated.truth).truth,
        windows,
        some,
        _by_slsqp(poses, some, np.random.default_rng(seed)),
        offline.segment(poses, load_model()),
    )


def _by_slsqp(poses: Poses, windows: Ints, rng: np.random.Generator) -> Array:
    rotation, p = motion(poses.rotation, poses.position_m - poses.position_m.mean(axis=0))
    return np.array(
        [
            [
                minimise_slsqp(contact, matrix(contact, rotation[frames], p[frames]), rng, STARTS).value
                for contact in MOVED
            ]
            for frames in (slice(STEP * window, STEP * window + FRAMES) for window in windows)
        ]
    )
