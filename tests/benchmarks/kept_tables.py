"""Tables of benchmarks, kept as JSON in docs/benchmarks/."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final, NamedTuple

ROOT: Final = Path(__file__).resolve().parents[2]
FOLDER: Final = ROOT / "docs" / "benchmarks"


class Table(NamedTuple):
    """Named ``columns``, and ``rows`` of as many formatted cells."""

    columns: tuple[str, ...]
    rows: list[list[str]]


class Kept(NamedTuple):
    """The ``tables`` of one run by name, and the ``command`` that reproduces them."""

    command: str
    tables: dict[str, Table]


def keep(path: Path, command: str, tables: Mapping[str, Table]) -> None:
    """Write the tables of one run."""
    data = {
        "command": command,
        "tables": {name: {"columns": table.columns, "rows": table.rows} for name, table in tables.items()},
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(data, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def read(path: Path) -> Kept:
    """Read the tables written by ``keep``."""
    data = json.loads(path.read_text(encoding="utf-8"))
    tables = {name: Table(tuple(one["columns"]), one["rows"]) for name, one in data["tables"].items()}
    return Kept(data["command"], tables)


def to_markdown(table: Table) -> str:
    """The table in Markdown."""
    rows: list[Sequence[str]] = [table.columns, ["---"] * len(table.columns), *table.rows]
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)
