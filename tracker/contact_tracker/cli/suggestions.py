"""Suggestions for misspelt commands and options."""

import argparse
from collections.abc import Iterable, Mapping
from difflib import get_close_matches
from typing import Final

_CLOSE: Final = 0.7
"""Similarity of two words (difflib ratio) from which on one is suggested for the other."""


def suggestion(word: str, names: Iterable[str]) -> str:
    """``; did you mean NAME?``, or empty if no name is similar."""
    bare = {name.lstrip("-"): name for name in names}  # dashes are alike in all options
    near = get_close_matches(word.lstrip("-"), list(bare), 1, _CLOSE)
    return f"; did you mean {bare[near[0]]}?" if near else ""


def option_suggestion(
    words: Iterable[str], parser: argparse.ArgumentParser, commands: Mapping[str, argparse.ArgumentParser]
) -> str:
    """The same for the first word that resembles an option of ``parser``, or is one of other commands."""
    for word in words:
        if word.startswith("-"):
            option = word.partition("=")[0]
            others = [name for name, other in commands.items() if option in _options(other)]
            if others:
                *most, last = others
                named = f"{', '.join(most)} and {last}" if most else last
                return f"; {option} is an option of {named}"
            return suggestion(option, _options(parser))
    return ""


def _options(parser: argparse.ArgumentParser) -> list[str]:
    return [name for action in parser._actions for name in action.option_strings]
