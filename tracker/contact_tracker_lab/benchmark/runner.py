"""What benchmarks share: arguments, worker processes, figures over recordings, and kept tables."""

import argparse
import json
import os
import sys
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import reduce
from multiprocessing import get_context
from operator import add
from pathlib import Path
from typing import Any, Final, NamedTuple, TypeVar

import numpy as np
from tqdm import tqdm

from contact_tracker.cli.terminal import show
from contact_tracker_lab.evaluation.evaluate import Evaluation
from contact_tracker_lab.evaluation.tables import number, table

Key = TypeVar("Key", bound=Hashable)
Found = TypeVar("Found")
Job = tuple[Any, ...]

FIGURES: Final = (
    *("accuracy offline", "accuracy online", "sure and wrong offline", "sure and wrong online"),
    *("ECE offline", "ECE online", "worst accuracy offline", "worst accuracy online"),
    *("within 3 sd", "median sd"),
)


class Table(NamedTuple):
    """Named ``columns``, and ``rows`` of as many formatted cells."""

    columns: tuple[str, ...]
    rows: list[list[str]]


def parser_of(
    description: str | None, has_sets: bool = False, folder: Path | None = None
) -> argparse.ArgumentParser:
    """The arguments of every benchmark; with ``has_sets`` those of sets of recordings, too, in ``folder`` if
    none is named."""
    parser = argparse.ArgumentParser(
        description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    if has_sets:
        parser.add_argument("folder", type=Path, nargs="?" if folder else None, default=folder)
        parser.add_argument("--set", nargs="+", default=[], metavar="NAME", help="only these sets")
    parser.add_argument("--tables", type=Path, metavar="JSON", help="keep the tables in this file")
    parser.add_argument("--processes", type=int, default=2)
    return parser


def find_sets(folder: Path, wanted: Sequence[str]) -> dict[str, list[Path]]:
    """Recordings by the name of their folder; only the ``wanted`` sets, if any are named.

    ``folder`` may also be one recording.
    """
    sets: dict[str, list[Path]] = {}
    for path in [folder] if folder.is_file() else sorted(folder.rglob("*.mcap")):
        sets.setdefault(path.parent.name, []).append(path)
    unknown = set(wanted) - set(sets)
    if unknown or not sets:
        raise SystemExit(
            f"{folder}: no set {' '.join(sorted(unknown))}; there are: {' '.join(sets) or 'none'}"
        )
    return {name: paths for name, paths in sets.items() if not wanted or name in wanted}


def recordings_in(folders: Sequence[Path]) -> dict[str, list[Job]]:
    """One job for each recording of the ``folders``, by the folders' names."""
    return {folder.name: [(str(path),) for path in sorted(folder.glob("*.mcap"))] for folder in folders}


def measured(
    measure: Callable[..., Found], jobs: Mapping[Key, Sequence[Job]], processes: int
) -> Iterator[tuple[Key, list[Found]]]:
    """For each key the results of ``measure`` with each of its jobs, in processes of one thread each."""
    for library in ("OMP", "OPENBLAS", "MKL"):
        os.environ[f"{library}_NUM_THREADS"] = "1"  # spawned, so that the workers' numpy sees it
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
        futures = {key: [pool.submit(measure, *job) for job in some] for key, some in jobs.items()}
        for key, some in tqdm(futures.items(), file=sys.stderr, disable=None):
            yield key, [one.result() for one in some]


def figures(evaluations: Sequence[Evaluation]) -> list[str]:
    """The ``FIGURES`` over recordings."""
    both = [(one.offline, one.online) for one in evaluations]
    accuracy = np.array([[tally.accuracy() for tally in pair] for pair in both])
    geometry = reduce(add, [one.geometry for one in evaluations])
    columns = (
        accuracy.mean(axis=0),
        np.mean([[tally.sure_wrong for tally in pair] for pair in both], axis=0),
        np.mean([[tally.calibration_error for tally in pair] for pair in both], axis=0),
        accuracy.min(axis=0),
        [geometry.within_3_sd, geometry.median_sd],
    )
    return [number(float(value)) for column in columns for value in column]


def mean_of_known(values: Sequence[float]) -> float:
    """The mean without nan values; nan if there are no others."""
    known = [value for value in values if np.isfinite(value)]
    return float(np.mean(known)) if known else float("nan")


def median_of_known(values: Sequence[float]) -> float:
    """The median without nan values; nan if there are no others."""
    known = [value for value in values if np.isfinite(value)]
    return float(np.median(known)) if known else float("nan")


def shares_row(name: str, recordings: Sequence[tuple[float, ...]]) -> list[str]:
    """A row of the total duration (s) of ``recordings``, the first figure of each, and the other figures (s)
    as shares of it."""
    seconds, *parts = (sum(column) for column in zip(*recordings, strict=True))
    return [name, f"{seconds:.0f}", *(number(part / seconds) for part in parts)]


def report(args: argparse.Namespace, **tables: Table) -> int:
    """Print the tables, and keep them if asked; returns the exit code."""
    show("\n\n".join(table(*one) for one in tables.values() if one.rows))
    if args.tables:
        keep(args.tables, typed_command(getattr(args, "folder", None)), tables)
    return 0


def typed_command(folder: Path | None = None) -> str:
    """The command as pages show it: recordings are in FOLDER, and nothing of where tables are kept."""
    script = Path(sys.argv[0])
    is_module = script.name == "__main__.py"
    name = f"-m contact_tracker_lab.{script.parent.name}" if is_module else f"tests/benchmarks/{script.name}"
    words = [name, *sys.argv[1:]]
    for option in ("--tables", "--processes"):
        if option in words:
            at = words.index(option)
            del words[at : at + 2]
    command = " ".join(["python", *words])
    return command if folder is None else command.replace(str(folder), "FOLDER")


def keep(path: Path, command: str, tables: Mapping[str, Table]) -> None:
    """Write the tables of one run, for the pages."""
    kept = {"command": command, "tables": {name: one._asdict() for name, one in tables.items() if one.rows}}
    path.write_text(json.dumps(kept, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
