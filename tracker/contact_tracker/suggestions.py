"""Suggestions for misspelt names, also of files."""

import os
from collections.abc import Iterable
from itertools import islice
from typing import Final

_LEAST_SIMILARITY: Final = 0.65
"""Similarity (difflib ratio) from which on a name is suggested for a word: two of three letters."""
_BEGINNING: Final = 3
"""Letters from which on the one name that begins with them is suggested."""
_MARKS: Final = "-/"
"""What options and topics begin with does not make them alike."""
_MOST_FILES: Final = 10_000
"""Most files of a folder that are looked at for a similar name."""


def suggestion(word: str, names: Iterable[str]) -> str:
    """``; did you mean NAME?``, or empty if no other name is similar."""
    name = closest(word, names)
    return "" if name is None else f"; did you mean {name}?"


def closest(word: str, names: Iterable[str]) -> str | None:
    """The other name that is most similar to a word; None if none is."""
    from difflib import get_close_matches

    bare = {name.lstrip(_MARKS).casefold(): name for name in names if name != word}
    given = word.lstrip(_MARKS).casefold()
    words = [name for name in bare if len(name) > 1 or name == given]  # one letter is in many words
    longer = [name for name in bare if len(given) >= _BEGINNING and name.startswith(given)]
    near = longer if len(longer) == 1 else get_close_matches(given, words, 1, _LEAST_SIMILARITY)
    return bare[near[0]] if near else None


def near_file(path: str | os.PathLike[str]) -> str:
    """``; did you mean FILE?`` for a path at which nothing is, if there is a file of a similar name in its
    folder, or in a folder of a similar name; else empty."""
    folder, name = os.path.split(os.fspath(path))
    try:
        if name and not os.path.lexists(path):
            near = _near(folder, name)
            if near is None and folder and not os.path.isdir(folder):
                other = _near(*os.path.split(folder))
                near = None if other is None else os.path.join(other, name)
            return f"; did you mean {near}?" if near is not None and os.path.exists(near) else ""
    except (OSError, ValueError):  # the folder cannot be read, or the name is none
        pass
    return ""


def _near(folder: str, name: str) -> str | None:
    """The file or folder of a similar name, by the stems of those of the same suffix first: a common suffix
    does not make names alike."""
    if not os.path.isdir(folder or os.curdir):
        return None
    with os.scandir(folder or os.curdir) as entries:
        names = sorted(one.name for one in islice(entries, _MOST_FILES) if not one.name.startswith("."))
    stem, suffix = os.path.splitext(name)
    same = {os.path.splitext(one)[0]: one for one in names if os.path.splitext(one)[1] == suffix}
    others = {os.path.splitext(one)[0]: one for one in names}
    for stems in (same, others):
        if (near := stem if stem in stems else closest(stem, stems)) is not None:
            return os.path.join(folder, stems[near])
    return None
