"""What benchmarks share: arguments, worker processes, and kept tables."""

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
    """The arguments of every benchmark; with ``has_sets`` those of sets of recordings, too, in ``folder`` if
    none is named."""
    parser = argparse.ArgumentParser(
        description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    if has_sets:
        parser.add_argument("folder", type=Path, nargs="?" if folder else None, default=folder)
        parser.add_argument("--set", nargs="+", default=[], metavar="NAME", help="only these sets")
    parser.add_argument("--tables", type=Path, metavar="JSON", help="keep the tables in this file")
    add_processes(parser, 61, 2, "recordings at once (default: 2)")
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
        os.environ[f"{library}_NUM_THREADS"] = "1"  # spawned, so that the workers' numpy sees it
    with Workers(processes) as pool:
        futures = {key: [pool.submit(measure, *job) for job in some] for key, some in jobs.items()}
        for key, some in tqdm(futures.items(), file=sys.stderr, disable=None):
            yield key, [one.result() for one in some]


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
