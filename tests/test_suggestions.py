"""Suggestions are names that may have been meant."""

import pytest

from contact_tracker.suggestions import suggestion


@pytest.mark.parametrize(
    ("word", "names", "meant"),
    [
        ("/object/pse", ["/object/pose", "/tf"], "; did you mean /object/pose?"),
        ("--acc", ["--accuracy", "--frame"], "; did you mean --accuracy?"),
        ("base", ["base", "flange"], ""),
        ("base", ["base", "bases"], "; did you mean bases?"),
        ("camera", ["/tf", "world"], ""),
        ("--uo", ["-o", "--up"], ""),
        ("A", ["a"], "; did you mean a?"),
    ],
)
def test_another_name_that_is_similar_is_suggested(word: str, names: list[str], meant: str) -> None:
    assert suggestion(word, names) == meant
