"""The files that a command reads and never overwrites, and the option to overwrite recordings."""

import argparse
from collections.abc import Iterable


def add_overwrite(parser: argparse.ArgumentParser) -> None:
    """``--overwrite``."""
    parser.add_argument("--overwrite", action="store_true", help="replace FILE even if it is a recording")


def files_read(logs: Iterable[str], model: str, known: str | None) -> list[str]:
    """The files that a command reads: all parts of ``logs``, the model, the prior map with its meshes.

    Raises
    ------
    UnreadableRecording, KnowledgeError
        A recording or the prior-map file cannot be read.
    """
    from contact_tracker.config.loading import model_file
    from contact_tracker.prior_map_files.loading import files_named
    from contact_tracker.recording import parts_of

    parts = [part for log in logs for part in parts_of(log)]
    return [*parts, str(model_file(model)), *map(str, files_named(known) if known is not None else ())]
