"""Convert a fitted hypothesis to elements with covariance, in the frames of the user."""

import numpy as np
from numpy.typing import NDArray

from contact_tracker.config.parameters import SystematicErrors
from contact_tracker.contacts import ContactModel
from contact_tracker.geometry.elements import ContactGeometry, by_foot, shifted
from contact_tracker.hypotheses.bank import Bank
from contact_tracker.hypotheses.evidence import EvidenceParameters
from contact_tracker.hypotheses.observability import observed_geometry
from contact_tracker.hypotheses.systematic_errors import systematic_covariance
from contact_tracker.motion.window import Window

Array = NDArray[np.float64]


def contact_geometry(
    bank: Bank,
    row: int,
    model: ContactModel,
    scales: EvidenceParameters,
    window: Window,
    origin_m: Array,
    errors: SystematicErrors,
    information: Array | None = None,
) -> ContactGeometry:
    """Elements of hypothesis ``row``, with covariance and unobserved directions.

    ``window`` has the ticks and their noise, ``errors`` are those that are not noise; ``origin_m`` (3,) is
    the origin of the bank's coordinates in the world; ``information`` as in ``observed_geometry``.
    """
    one, systematic = bank.single(row), np.zeros(())
    if errors.are_given:
        systematic = systematic_covariance(
            one, model, window, scales.reach_m, errors, is_refined=information is not None
        )
    found = observed_geometry(one, model, scales, window.usual_variance, information, systematic)
    if not np.isnan(one.line_anchor).all():  # other lines have their point near the body already
        body_m = one.weighted_position_sum[0] / one.weight[0]
        found = ContactGeometry(by_foot(found.object, np.zeros(3)), by_foot(found.environment, body_m))
    return ContactGeometry(found.object, shifted(found.environment, origin_m))
