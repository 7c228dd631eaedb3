"""Which suffixes name an output, and the libraries that some of them take. Importing this costs nothing."""

from importlib import import_module
from pathlib import Path
from typing import Final, NamedTuple

from contact_tracker.extras import extra


class Library(NamedTuple):
    """The ``module`` of ours that needs it, its ``extra``, and what for."""

    module: str
    extra: str
    purpose: str


LIBRARIES: Final = {
    ".parquet": Library("parquet", "parquet", "a Parquet file"),
    ".mcap": Library("foxglove_scene", "foxglove", "an MCAP file for Foxglove"),
    ".html": Library("report_html", "report", "a report"),
}
SUFFIXES: Final = (".csv", ".jsonl", *LIBRARIES, ".srt")
TICKS: Final = (".jsonl", ".parquet")
"""Outputs with a row per tick."""
WHOLE: Final = (".mcap", ".html")
"""Outputs that are made of all of a recording at once: it is kept in memory until then."""


def require_library(path: Path) -> None:
    """Raise MissingExtra, before any work, if a library is not installed that writing ``path`` takes."""
    library = LIBRARIES.get(path.suffix.lower())
    if library is not None:
        with extra(library.extra, library.purpose):
            import_module(f"contact_tracker.exports.{library.module}")
