"""What a misspelt command or option was probably meant to be."""

import argparse
from collections.abc import Iterable, Mapping
from difflib import get_close_matches
from typing import Final

_CLOSE: Final = 0.7
"""Similarity of two words (difflib ratio) from which on one may be meant by the other."""


def meant(word: str, names: Iterable[str]) -> str:
    """``; did you mean NAME?``, or nothing where no name is near."""
    bare = {name.lstrip("-"): name for name in names}  # dashes are alike in all options
    near = get_close_matches(word.lstrip("-"), list(bare), 1, _CLOSE)
    return f"; did you mean {bare[near[0]]}?" if near else ""


def meant_option(
    words: Iterable[str], parser: argparse.ArgumentParser, commands: Mapping[str, argparse.ArgumentParser]
) -> str:
    """The same of the first word that looks like an option of ``parser``, or is one of other commands."""
    for word in words:
        if word.startswith("-"):
            option = word.partition("=")[0]
            others = [name for name, other in commands.items() if option in _options(other)]
            if others:
                return f"; {option} is an option of {' and '.join(others)}"
            return meant(option, _options(parser))
    return ""


def _options(parser: argparse.ArgumentParser) -> list[str]:
    return [name for action in parser._actions for name in action.option_strings]
