"""Maximum-likelihood elements of a further contact (docs/theory.md, T26), and their complexity (T19, T36)."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.config.parameters import SystematicErrors
from contact_tracker.contacts import ContactModel
from contact_tracker.formations.conditional import TINY, ConditionalMotion, coefficients
from contact_tracker.geometry.elements import ContactGeometry, Origins
from contact_tracker.hypotheses.bank import Bank, blank
from contact_tracker.hypotheses.evidence import EvidenceParameters, complexity, weak_prior
from contact_tracker.hypotheses.observability import contact_geometry
from contact_tracker.hypotheses.refinement import refine
from contact_tracker.hypotheses.refit import accumulate_window
from contact_tracker.motion.lifted_pose import T
from contact_tracker.motion.window import Window

Array = NDArray[np.float64]


class FittedElements(NamedTuple):
    """A ``bank`` of one hypothesis with the elements x, and their ``information`` (P, P) in its
    ``window``."""

    model: ContactModel
    bank: Bank
    window: Window
    information: Array

    def geometry(
        self, scales: EvidenceParameters, origins: Origins, errors: SystematicErrors
    ) -> ContactGeometry:
        """The elements with covariance; ``origins`` and ``errors`` as of ``contact_geometry``."""
        fit = self.bank, 0, self.model, scales, self.window
        return contact_geometry(*fit, origins, errors, self.information)


def fit_elements(model: ContactModel, x: Array, window: Window, scales: EvidenceParameters) -> FittedElements:
    """Refine x (S,) from near the minimum, with the noise of each tick of the window."""
    bank = accumulate_window(blank(model, 1).replace_columns(x=x[None]), model, window, scales)
    fitted, information = refine(bank, model, window, scales)
    return FittedElements(model, fitted, window, information)


def elements_complexity(
    model: ContactModel,
    x: Array,
    motion: ConditionalMotion,
    window: Window,
    scales: EvidenceParameters,
    noise_factor: float = 1.0,
) -> float:
    """Complexity (nats) of elements x (S,) fitted to ``window``, with ``noise_factor`` times its noise.

    Excludes the information of the first tick and of the free-motion prediction
    (``evidence.complexity``).
    """
    family = model.family
    anchors = model.anchors(window.zeta[:, T].mean(axis=0))[None]
    prior = weak_prior(family, anchors, scales.reach_m)
    c = coefficients(model, x)
    noise = np.sqrt(np.square(motion.gradients(c) * motion.noise_sd[:, None]).sum(axis=2)) + TINY  # (W, K)
    along = family.tangent(x[None], anchors)[0].T @ family.rows_derivative(x[None])[0]  # (K, P, C)
    slopes = np.einsum("kpc,wc->wkp", along, model.lifted(motion.new)) / (noise_factor * noise[..., None])
    hessian = np.einsum("wkp,wkq->kpq", slopes, slopes)
    gain = motion.evidence(c).gain.mean() / family.ROWS
    ticks = max(float(window.motion_ratio.sum()), 1.0)
    share = scales.prior_predictive_share * model.needed / ticks * np.exp(-2.0 * gain)
    given = slopes[0].T @ slopes[0]
    return float(
        complexity(
            family,
            x[None],
            x[None],
            anchors,
            hessian[None],
            given[None],
            np.full((1, family.ROWS), min(share, 1.0)),
            prior,
        )[0]
    )
