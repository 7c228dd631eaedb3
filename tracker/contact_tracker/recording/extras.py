"""Libraries that only some formats need: extras of the package, imported where such a format is met."""

from types import ModuleType
from typing import Final

from contact_tracker.errors import MissingExtra as MissingExtra
from contact_tracker.extras import module_of_extra

_EXTRAS: Final = {"rosbags": "bags", "mcap_protobuf": "foxglove", "polars": "tables"}


def need(module: str, what: str) -> ModuleType:
    """The module of an optional library that reads ``what``.

    Raises
    ------
    MissingExtra
        It is not installed; the text names the extra.
    """
    return module_of_extra(module, _EXTRAS[module.partition(".")[0]], what)
