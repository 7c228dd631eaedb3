"""Convert a fitted hypothesis to elements with covariance, in the frames of the user."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from contact_tracker.config.parameters import SystematicErrors
from contact_tracker.contacts import ContactModel
from contact_tracker.contacts.parameter_layout import directions
from contact_tracker.geometry.elements import ContactGeometry, Origins, Plane, by_foot, shifted
from contact_tracker.hypotheses.bank import Bank
from contact_tracker.hypotheses.evidence import EvidenceParameters
from contact_tracker.hypotheses.observability import NOISE_MARGIN, information_spectrum, observed_geometry
from contact_tracker.hypotheses.pruning import anchors_of
from contact_tracker.hypotheses.systematic_errors import systematic_covariance
from contact_tracker.map.elements import LOOSE_M, LOOSE_RAD
from contact_tracker.map.sighting import ElementEstimate
from contact_tracker.motion.lifted_pose import R
from contact_tracker.motion.window import Window

Array = NDArray[np.float64]


def contact_geometry(
    bank: Bank,
    row: int,
    model: ContactModel,
    scales: EvidenceParameters,
    window: Window,
    origins: Origins,
    errors: SystematicErrors,
    information: Array | None = None,
) -> ContactGeometry:
    """Elements of hypothesis ``row``, with covariance and unobserved directions.

    ``window`` has the ticks and their noise, ``errors`` are those that are not noise; ``origins`` are
    those of the bank's coordinates; ``information`` as in ``observed_geometry``.
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
    return _in_users_frames(found, window.zeta[-1, R].reshape(3, 3), origins)


def _in_users_frames(found: ContactGeometry, rotation: Array, origins: Origins) -> ContactGeometry:
    """The elements in the frames of the body, which has this ``rotation`` (3, 3), and of the world.

    Of two faces motion shows the difference of the offsets only: the object's stays at the origin.
    """
    ours, theirs = found.object, shifted(found.environment, origins.world_m)
    if isinstance(ours, Plane) and isinstance(theirs, Plane):
        swung_m = theirs.normal @ rotation @ origins.body_m
        return ContactGeometry(ours, replace(theirs, offset_m=float(theirs.offset_m - swung_m)))
    return ContactGeometry(shifted(ours, origins.body_m), theirs)


def element_estimate(
    bank: Bank,
    model: ContactModel,
    scales: EvidenceParameters,
    window: Window,
    information: Array | None = None,
) -> ElementEstimate:
    """What a fit, a ``bank`` of one, says about both its elements together; arguments as above.

    Real elements are not exactly the same at the next touch, so the information is that of a little looser
    elements.
    """
    spectrum = information_spectrum(bank, model, scales, window.usual_variance, information)
    back = np.linalg.inv(spectrum.directions)
    shown = back.T @ (np.maximum(spectrum.values - NOISE_MARGIN, 0.0)[:, None] * back)
    variance = np.full(model.family.SIZE, LOOSE_M**2)
    variance[directions(model.family.FORM)] = LOOSE_RAD**2
    onto = np.linalg.pinv(spectrum.tangent)
    loose = np.linalg.cholesky((onto * variance) @ onto.T)
    values, axes = np.linalg.eigh(loose.T @ shown @ loose)
    values = np.maximum(values, 0.0)
    along = np.linalg.solve(loose.T, axes)
    shown = (along * (values / (1.0 + values))) @ along.T
    rotation = window.zeta[len(window) // 2, R].reshape(3, 3)
    anchors = anchors_of(bank, model)[0]
    return ElementEstimate(model.contact, bank.x[0], spectrum.tangent, shown, anchors, rotation)
