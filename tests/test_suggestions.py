"""Suggestions are names that may have been meant."""

import os
from pathlib import Path

import pytest

from contact_tracker.suggestions import near_file, suggestion


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


@pytest.mark.parametrize(
    ("word", "meant"),
    [
        ("lables.csv", "labels.csv"),
        ("takes/cub.mcap", "takes/cube.mcap"),
        ("taks/cube.mcap", "takes/cube.mcap"),
        ("cube", None),  # in another folder
        ("labels", "labels.csv"),
        ("labels.txt", "labels.csv"),
        ("x.csv", None),  # a common suffix makes no names alike
        ("labels.csv", None),  # is there
        ("nowhere/deep/cube.mcap", None),
        ("", None),
        ("a\0b", None),
    ],
)
def test_a_file_of_a_similar_name_is_suggested_for_one_that_is_not_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, word: str, meant: str | None
) -> None:
    (tmp_path / "takes").mkdir()
    for name in ("labels.csv", "takes/cube.mcap", ".labels.csv"):
        (tmp_path / name).touch()
    monkeypatch.chdir(tmp_path)
    shown = None if meant is None else os.path.join(*meant.split("/"))
    assert near_file(word) == ("" if shown is None else f"; did you mean {shown}?")
