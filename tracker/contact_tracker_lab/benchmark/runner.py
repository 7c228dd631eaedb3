"""Common parts of benchmarks: arguments, worker processes, and saved tables."""

import argparse
import json
import os
import sys
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from tqdm import tqdm

from contact_tracker.cli.arguments import add_processes
from contact_tracker.cli.terminal import show
from contact_tracker.processes import Workers
from contact_tracker_lab.evaluation.tables import table

Key = TypeVar("Key", bound=Hashable)
Found = TypeVar("Found")
Job = tuple[Any, ...]


class Table(NamedTuple):
    """Named ``columns``, and ``rows`` of as many formatted cells."""

    columns: tuple[str, ...]
    rows: list[list[str]]


def parser_of(
    description: str | None, has_sets: bool = False, folder: Path | None = None
) -> argparse.ArgumentParser:
    """The arguments of every benchmark; with ``has_sets`` also those of sets of recordings, in ``folder`` if
    no folder is named."""
    parser = argparse.ArgumentParser(
        description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    if has_sets:
        parser.add_argument("folder", type=Path, nargs="?" if folder else None, default=folder)
        parser.add_argument("--set", nargs="+", default=[], metavar="NAME", help="only these sets")
    parser.add_argument("--tables", type=Path, metavar="JSON", help="keep the tables in this file")
    add_processes(parser, 61, 2, "recordings at once (default: 2)")
    return parser


def find_sets(folder: Path, names: Sequence[str]) -> dict[str, list[Path]]:
    """Recordings by the name of their folder; only the ``names`` sets, if any are named.

    ``folder`` may also be one recording.
    """
    sets: dict[str, list[Path]] = {}
    for path in [folder] if folder.is_file() else sorted(folder.rglob("*.mcap")):
        sets.setdefault(path.parent.name, []).append(path)
    unknown = set(names) - set(sets)
    if unknown or not sets:
        raise SystemExit(
            f"{folder}: no set {' '.join(sorted(unknown))}; there are: {' '.join(sets) or 'none'}"
        )
    return {name: paths for name, paths in sets.items() if not names or name in names}


def measured(
    measure: Callable[..., Found], jobs: Mapping[Key, Sequence[Job]], processes: int
) -> Iterator[tuple[Key, list[Found]]]:
    """For each key the results of ``measure`` with each of its jobs, in processes of one thread each.

    Raises
    ------
    ContactTrackerError
        A process was killed, for example because it took too much memory.
    """
    for library in ("OMP", "OPENBLAS", "MKL"):
        os.environ[f"{library}_NUM_THREADS"] = "1"  # for numpy in spawned workers
    with Workers(processes) as pool:
        pending = {key: [pool.submit(measure, *job) for job in arguments] for key, arguments in jobs.items()}
        for key, futures in tqdm(pending.items(), file=sys.stderr, disable=None):
            yield key, [future.result() for future in futures]


def report(args: argparse.Namespace, **tables: Table) -> int:
    """Print the tables, save them if asked; returns the exit code."""
    show("\n\n".join(table(header, rows) for header, rows in tables.values() if rows))
    if args.tables:
        keep(args.tables, typed_command(getattr(args, "folder", None)), tables)
    return 0


def typed_command(folder: Path | None = None) -> str:
    """The command as pages show it: FOLDER for the recordings, without the place of the tables."""
    script = Path(sys.argv[0])
    is_module = script.name == "__main__.py"
    name = f"-m contact_tracker_lab.{script.parent.name}" if is_module else f"tests/benchmarks/{script.name}"
    words = [name, *sys.argv[1:]]
    for option in ("--tables", "--processes"):
        if option in words:
            index = words.index(option)
            del words[index : index + 2]
    command = " ".join(["python", *words])
    return command if folder is None else command.replace(str(folder), "FOLDER")


def keep(path: Path, command: str, tables: Mapping[str, Table]) -> None:
    """Write the tables of one run, for the pages."""
    filled = {name: columns._asdict() for name, columns in tables.items() if columns.rows}
    text = json.dumps({"command": command, "tables": filled}, indent=1, ensure_ascii=False)
    path.write_text(f"{text}\n", encoding="utf-8")
