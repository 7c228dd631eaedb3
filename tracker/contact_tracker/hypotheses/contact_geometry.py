"""From a fitted hypothesis to the elements a user reads, in the frames the user knows."""

import numpy as np
from numpy.typing import NDArray

from contact_tracker.contacts import ContactModel
from contact_tracker.geometry.elements import ContactGeometry, by_foot, shifted
from contact_tracker.hypotheses.bank import Bank
from contact_tracker.hypotheses.evidence import EvidenceParameters
from contact_tracker.hypotheses.observability import observed_geometry
from contact_tracker.motion.window import Window

Array = NDArray[np.float64]


def contact_geometry(
    bank: Bank,
    row: int,
    model: ContactModel,
    scales: EvidenceParameters,
    window: Window,
    origin_m: Array,
    information: Array | None = None,
) -> ContactGeometry:
    """Elements of hypothesis ``row``, with covariance and what the motion left open.

    ``window`` gives the noise of the ticks, ``origin_m`` is the world's origin in which the bank works;
    ``information`` as in ``observability``.
    """
    one = bank.single(row)
    found = observed_geometry(one, model, scales, window.usual_variance, information)
    if not np.isnan(one.line_anchor).all():  # else lines are given by the feet that are asked for
        body_m = one.weighted_position_sum[0] / one.weight[0]
        found = ContactGeometry(by_foot(found.object, np.zeros(3)), by_foot(found.environment, body_m))
    return ContactGeometry(found.object, shifted(found.environment, origin_m))
