"""Deviation of each contact from an ideal one beyond the common floor."""

from collections.abc import Sequence
from math import sqrt
from typing import Final

from contact_tracker.config.parameters import ZERO, Model
from contact_tracker.states import CONTACTS
from contact_tracker_lab.calibration.floors import POSITION, ROTATION, excess_significance, learn_floors
from contact_tracker_lab.calibration.learned import rounded, value_of, with_value
from contact_tracker_lab.calibration.segment_residuals import ContactSegment

FLOOR_OF: Final = {"noise.contact_position_m": POSITION, "noise.contact_rotation_rad": ROTATION}
SHOWN: Final = 5.0
"""Standard errors by which residuals must exceed the common floor; many, as neighbours are correlated."""


def learn_contact_errors(model: Model, segments: Sequence[ContactSegment], keys: Sequence[str]) -> Model:
    """The errors ``keys`` of each contact: its own floor beyond the common one, in quadrature.

    They are zero for contacts with too few residuals, or whose residuals the common floor explains.
    """
    if not keys:
        return model
    bare = model
    for key in keys:
        bare = with_value(bare, key, ZERO)
    mine = [[s for s in segments if s.column == column] for column in range(len(CONTACTS))]
    alone = [learn_floors(bare, some, [FLOOR_OF[key] for key in keys])[0] for some in mine]
    for key in keys:
        floor = FLOOR_OF[key]
        own = [value_of(one, floor) ** 2 - value_of(model, floor) ** 2 for one in alone]
        is_significant = [excess_significance(bare, some, floor) > SHOWN for some in mine]
        errors = [rounded(sqrt(max(o, 0.0))) if s else 0.0 for o, s in zip(own, is_significant, strict=True)]
        model = with_value(model, key, (*errors, 0.0))
    return model
