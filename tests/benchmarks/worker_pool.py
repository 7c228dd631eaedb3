"""Worker processes of a benchmark."""

import argparse
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import get_context
from pathlib import Path
from typing import TypeVar

T = TypeVar("T")


@contextmanager
def worker_pool(processes: int) -> Iterator[ProcessPoolExecutor]:
    """A pool of ``processes`` whose numerics use one thread each."""
    for library in ("OMP", "OPENBLAS", "MKL"):
        os.environ[f"{library}_NUM_THREADS"] = "1"  # spawned, so that the workers' numpy sees it
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
        yield pool


def submit_folders(
    pool: ProcessPoolExecutor, measure: Callable[[str], T], folders: Sequence[Path]
) -> "dict[str, list[Future[T]]]":
    """``measure`` called with each recording of the ``folders``, by the folders' names."""
    return {
        folder.name: [pool.submit(measure, str(path)) for path in sorted(folder.glob("*.mcap"))]
        for folder in folders
    }


def folder_of_recordings(text: str) -> Path:
    """The type of an argument: a folder with recordings."""
    if not any(Path(text).glob("*.mcap")):
        raise argparse.ArgumentTypeError(f"{text!r} is no folder with .mcap files")
    return Path(text)


def folders_option(option: str, folders: Sequence[Path]) -> str:
    """``folders`` as kept commands have them; nothing without any."""
    return f" {option} {' '.join(f'FOLDER/{folder.name}' for folder in folders)}" if folders else ""
