"""Libraries that only some formats need: extras of the package, imported where such a format is met."""

from importlib import import_module
from types import ModuleType
from typing import Final

from contact_tracker.errors import UnreadableRecording

_EXTRAS: Final = {"rosbags": "bags", "mcap_protobuf": "foxglove", "polars": "tables"}


class MissingExtra(UnreadableRecording):
    """A library that this format needs is not installed."""


def need(module: str, what: str) -> ModuleType:
    """The module of an optional library that reads ``what``.

    Raises
    ------
    MissingExtra
        It is not installed; the text names the extra.
    """
    try:
        return import_module(module)
    except ImportError as error:
        extra = _EXTRAS[module.partition(".")[0]]
        raise MissingExtra(f"{what} needs a library: pip install 'contact-tracker[{extra}]'") from error
