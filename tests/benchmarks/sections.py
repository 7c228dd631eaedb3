"""Sections of a document that a command writes, between ``<!-- name: begin -->`` and ``... end -->``."""

from pathlib import Path


def find(path: Path, name: str) -> tuple[str, str]:
    """What stands before and after a section's text; exits where there are no markers."""
    text = path.read_text(encoding="utf-8") if path.is_file() else ""
    before, begin, rest = text.partition(f"<!-- {name}: begin -->\n")
    _, end, after = rest.partition(f"<!-- {name}: end -->")
    if not (begin and end):
        raise SystemExit(
            f"{path}: there is no <!-- {name}: begin --> ... <!-- {name}: end --> to write between"
        )
    return before + begin, end + after


def write(path: Path, name: str, text: str) -> None:
    """Replace a section's text."""
    before, after = find(path, name)
    path.write_text(f"{before}{text}\n{after}", encoding="utf-8")
