"""Writes the tables of the pages on benchmarks from the JSON files in docs/benchmarks/.

    python tests/benchmarks/document.py
    python tests/benchmarks/document.py --check

A table is between ``<!-- FILE TABLE: begin -->`` and ``... end -->``, after the command that made it.
"""

import argparse
import json
import re
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

ROOT: Final = Path(__file__).resolve().parents[2]
DOCUMENTS: Final = tuple(ROOT / "docs" / name for name in ("benchmarks.md", "benchmarks_further.md"))
SECTION: Final = re.compile(r"(<!-- (\w+) (\w+): begin -->\n)(.*?)(<!-- \2 \3: end -->)", re.DOTALL)


def rewritten(text: str) -> str:
    """The document with the tables as they are kept."""

    def section(match: re.Match[str]) -> str:
        begin, file, name, _, end = match.groups()
        kept = json.loads((ROOT / "docs" / "benchmarks" / f"{file}.json").read_text(encoding="utf-8"))
        return f"{begin}`{kept['command']}`\n\n{to_markdown(kept['tables'][name])}\n{end}"

    return SECTION.sub(section, text)


def to_markdown(table: dict[str, Any]) -> str:
    """A table in Markdown."""
    rows = [table["columns"], ["---"] * len(table["columns"]), *table["rows"]]
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--check", action="store_true", help="write nothing; exit code 1 if it would change")
    args = parser.parse_args(argv)
    changed = False
    for document in DOCUMENTS:
        before = document.read_text(encoding="utf-8")
        after = rewritten(before)
        changed |= after != before
        if not args.check:
            document.write_text(after, encoding="utf-8")
    return int(args.check and changed)


if __name__ == "__main__":
    sys.exit(main())
