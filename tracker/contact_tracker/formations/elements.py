"""Maximum-likelihood elements of a further contact, as for the first (docs/theory.md, T26)."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.config.parameters import SystematicErrors
from contact_tracker.contacts import ContactModel
from contact_tracker.geometry.elements import ContactGeometry, Origins
from contact_tracker.hypotheses.bank import Bank, blank
from contact_tracker.hypotheses.evidence import EvidenceParameters
from contact_tracker.hypotheses.observability import contact_geometry
from contact_tracker.hypotheses.refinement import refine
from contact_tracker.hypotheses.refit import accumulate_window
from contact_tracker.motion.window import Window

Array = NDArray[np.float64]


class FittedElements(NamedTuple):
    """A ``bank`` of one hypothesis with the elements x, and their ``information`` (P, P) in its
    ``window``."""

    model: ContactModel
    bank: Bank
    window: Window
    information: Array

    @property
    def x(self) -> Array:
        """(S,)"""
        return np.asarray(self.bank.x[0])

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
