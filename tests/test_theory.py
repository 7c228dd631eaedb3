"""docs/theory.md is consistent: equations are numbered once, in order; citations exist."""

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = [ROOT / "tracker" / name for name in ("contact_tracker", "contact_tracker_lab")]
THEORY = (ROOT / "docs" / "theory.md").read_text(encoding="utf-8")
NUMBERS = [int(n) for n in re.findall(r"\\text\{\(T(\d+)\)\}", THEORY)]
CITED = re.compile(r"\(T(\d+)\)|\bT(\d+)\b(?=[,;.)\s-])")


def cited(text: str) -> set[int]:
    return {int(a or b) for a, b in CITED.findall(text)}


def test_equations_are_numbered_once_and_in_order() -> None:
    assert list(range(1, len(NUMBERS) + 1)) == NUMBERS
    assert len(NUMBERS) > 10


def test_equations_cited_in_the_text_exist() -> None:
    assert cited(THEORY) <= set(NUMBERS)


def test_the_models_page_cites_equations_of_the_sections_it_names() -> None:
    models = (ROOT / "docs" / "models.md").read_text(encoding="utf-8")
    assert {int(n) for n in re.findall(r"\bT(\d+)", models)} <= set(NUMBERS)
    parts = re.split(r"^## (\d+)\.", THEORY, flags=re.MULTILINE)
    sections = dict(zip(parts[1::2], parts[2::2], strict=True))
    cited_there = re.findall(r"\bsection (\d+)(?:,[^|T]*T(\d+))?", models)
    assert len(cited_there) > 10
    for section, equation in cited_there:
        assert section in sections
        assert not equation or f"(T{equation})" in sections[section], f"section {section} has no T{equation}"


def test_equations_cited_in_docstrings_exist() -> None:
    wrong = {
        path.name: unknown
        for package in PACKAGES
        for path in package.rglob("*.py")
        if (
            unknown := {int(n) for n in re.findall(r"theory\.md,? \(?T(\d+)", path.read_text("utf-8"))}
            - set(NUMBERS)
        )
    }
    assert not wrong


def test_every_equation_has_its_place_in_the_code() -> None:
    table = THEORY.partition("Where in the code")[2].partition("## References")[0]
    placed = {int(n) for n in re.findall(r"\bT(\d+)", table)}
    for first, last in re.findall(r"T(\d+)-T(\d+)", table):
        placed |= set(range(int(first), int(last) + 1))
    assert placed == set(NUMBERS)


def test_errata_name_what_the_tests_show() -> None:
    rows = re.findall(r"^\| \((\d+)\)", THEORY.partition("### Errata")[2].partition("###")[0], re.MULTILINE)
    tests = re.findall(
        r"def test_erratum_(\d+)_", (ROOT / "tests" / "paper" / "test_objectives.py").read_text("utf-8")
    )
    assert rows == tests
