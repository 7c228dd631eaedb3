"""Optional libraries of some formats, imported when a recording needs them."""

from types import ModuleType
from typing import Final

from contact_tracker.errors import MissingExtra as MissingExtra
from contact_tracker.extras import module_of_extra

_EXTRAS: Final = {"mcap_protobuf": "foxglove", "polars": "tables"}


def need(module: str, what: str) -> ModuleType:
    """Import an optional library that reads ``what``.

    Raises
    ------
    MissingExtra
        The library is not installed; the message names the extra.
    """
    return module_of_extra(module, _EXTRAS[module.partition(".")[0]], what)
