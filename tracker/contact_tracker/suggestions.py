"""Suggestions for misspelt names."""

from collections.abc import Iterable
from typing import Final

_LEAST_SIMILARITY: Final = 0.65
"""Similarity (difflib ratio) from which on a name is suggested for a word: two of three letters."""
_BEGINNING: Final = 3
"""Letters from which on the one name that begins with them is suggested."""
_MARKS: Final = "-/"
"""What options and topics begin with does not make them alike."""


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
