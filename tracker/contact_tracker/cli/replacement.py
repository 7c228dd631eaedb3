"""What a command reads, which it never replaces, and the option to replace recordings."""

import argparse
from collections.abc import Iterable


def add_overwrite(parser: argparse.ArgumentParser) -> None:
    """``--overwrite``."""
    parser.add_argument("--overwrite", action="store_true", help="replace FILE even if it is a recording")


def files_read(logs: Iterable[str], model: str, known: str | None) -> list[str]:
    """The files that a command reads: all parts of ``logs``, the model, what is known with its meshes.

    Raises
    ------
    UnreadableRecording, KnowledgeError
        There is no such recording, or the file of what is known cannot be read.
    """
    from contact_tracker.config.loading import model_file
    from contact_tracker.prior_map_files.loading import files_named
    from contact_tracker.recording import parts_of

    parts = [part for log in logs for part in parts_of(log)]
    return [*parts, str(model_file(model)), *map(str, files_named(known) if known is not None else ())]
