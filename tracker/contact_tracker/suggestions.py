"""Suggestions for misspelt names, also of files."""

import os
from collections.abc import Iterable
from itertools import islice
from typing import Final

_LEAST_SIMILARITY: Final = 0.65
"""Least similarity (difflib ratio) of a suggested name: two of three letters."""
_BEGINNING: Final = 3
"""Least number of letters of a word that suggests the only name that begins with it."""
_MARKS: Final = "-/"
"""Characters at the beginning of options and topics, which do not make them alike."""
_MOST_FILES: Final = 10_000
"""Largest number of files of a folder that are compared with a misspelt name."""


def suggestion(word: str, names: Iterable[str]) -> str:
    """``; did you mean NAME?``, or empty if no name is similar to ``word``."""
    name = closest(word, names)
    return "" if name is None else f"; did you mean {name}?"


def closest(word: str, names: Iterable[str]) -> str | None:
    """The name that is most similar to ``word``, but not equal; None if no name is similar."""
    from difflib import get_close_matches

    bare = {name.lstrip(_MARKS).casefold(): name for name in names if name != word}
    stem = word.lstrip(_MARKS).casefold()
    words = [name for name in bare if len(name) > 1 or name == stem]  # a single letter is in many words
    longer = [name for name in bare if len(stem) >= _BEGINNING and name.startswith(stem)]
    near = longer if len(longer) == 1 else get_close_matches(stem, words, 1, _LEAST_SIMILARITY)
    return bare[near[0]] if near else None


def near_file(path: str | os.PathLike[str]) -> str:
    """``; did you mean FILE?`` if nothing is at ``path``, but a file of a similar name is in its folder or in
    a folder of a similar name; else empty."""
    folder, name = os.path.split(os.fspath(path))
    try:
        if name and not os.path.lexists(path):
            near = _near(folder, name)
            if near is None and folder and not os.path.isdir(folder):
                parent = _near(*os.path.split(folder))
                near = None if parent is None else os.path.join(parent, name)
            return f"; did you mean {near}?" if near is not None and os.path.exists(near) else ""
    except (OSError, ValueError):  # the folder cannot be read, or the name is impossible
        pass
    return ""


def _near(folder: str, name: str) -> str | None:
    """The path of a file or folder of a similar name, or None. Stems are compared, as a common suffix does
    not make names alike; files of the same suffix come first."""
    if not os.path.isdir(folder or os.curdir):
        return None
    with os.scandir(folder or os.curdir) as entries:
        files = sorted(file.name for file in islice(entries, _MOST_FILES) if not file.name.startswith("."))
    stem, suffix = os.path.splitext(name)
    by_stem = {os.path.splitext(file)[0]: file for file in files}
    of_suffix = {os.path.splitext(file)[0]: file for file in files if os.path.splitext(file)[1] == suffix}
    for stems in (of_suffix, by_stem):
        if (near := stem if stem in stems else closest(stem, stems)) is not None:
            return os.path.join(folder, stems[near])
    return None
