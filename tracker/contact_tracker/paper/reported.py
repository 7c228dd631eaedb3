"""The errors that the paper reports for its first experiment (section IV B, Fig. 4)."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final, NamedTuple

from contact_tracker.states import Contact

UNREPORTED: Final = float("nan")


class ReportedError(NamedTuple):
    """Of one element; nan where the paper gives no figure."""

    angle_deg: float
    distance_mm: float


REPORTED_ERRORS: Final[Mapping[tuple[Contact, str], ReportedError]] = MappingProxyType(
    {
        (Contact.FF, "object"): ReportedError(0.12, UNREPORTED),
        (Contact.FF, "environment"): ReportedError(0.12, UNREPORTED),
        (Contact.EF, "object"): ReportedError(0.76, 5.6),
        (Contact.EF, "environment"): ReportedError(0.72, UNREPORTED),
        (Contact.VF, "object"): ReportedError(UNREPORTED, 9.4),
        (Contact.VF, "environment"): ReportedError(0.14, UNREPORTED),
        (Contact.EE, "object"): ReportedError(0.43, 6.3),
        (Contact.EE, "environment"): ReportedError(0.15, 4.0),
    }
)
"""By contact and side."""
