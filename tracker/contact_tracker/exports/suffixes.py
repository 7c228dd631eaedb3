"""Suffixes of outputs, and the libraries that some of them need. Importing this is cheap."""

from importlib import import_module
from pathlib import Path
from typing import Final, NamedTuple

from contact_tracker.extras import extra


class Library(NamedTuple):
    """The ``module`` of this package that needs a library, its ``extra``, and the purpose."""

    module: str
    extra: str
    purpose: str


LIBRARIES: Final = {
    ".mcap": Library("foxglove_scene", "foxglove", "an MCAP file for Foxglove"),
    ".html": Library("report_html", "report", "a report"),
}
FIGURES: Final = (".png", ".pdf", ".svg")
SUFFIXES: Final = (".csv", ".jsonl", ".parquet", *LIBRARIES, *FIGURES, ".srt")
TICKS: Final = (".jsonl", ".parquet")
"""Outputs with a row per tick."""
WHOLE: Final = (*LIBRARIES, *FIGURES)
"""Outputs that need the whole recording in memory."""


def require_library(path: Path) -> None:
    """Raise MissingExtra, before any work, if a library for writing ``path`` is not installed."""
    library = LIBRARIES.get(path.suffix.lower())
    if library is not None:
        with extra(library.extra, library.purpose):
            import_module(f"contact_tracker.exports.{library.module}")
