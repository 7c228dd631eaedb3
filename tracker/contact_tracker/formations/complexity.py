"""Complexity of elements fitted to the ticks of a further contact (docs/theory.md, T19 and T36)."""

import numpy as np
from numpy.typing import NDArray

from contact_tracker.contacts import ContactModel
from contact_tracker.formations.conditional import TINY, ConditionalMotion, coefficients
from contact_tracker.hypotheses.evidence import EvidenceParameters, complexity, weak_prior
from contact_tracker.motion.lifted_pose import T
from contact_tracker.motion.window import Window

Array = NDArray[np.float64]


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
