"""What a misspelt command or option was probably meant to be."""

import argparse
from collections.abc import Iterable
from difflib import get_close_matches


def meant(word: str, names: Iterable[str]) -> str:
    """``; did you mean NAME?``, or nothing where no name is near."""
    near = get_close_matches(word, list(names), 1)
    return f"; did you mean {near[0]}?" if near else ""


def meant_option(words: Iterable[str], parser: argparse.ArgumentParser) -> str:
    """The same of the first word that looks like an option of ``parser``."""
    for word in words:
        if word.startswith("-"):
            options = [name for action in parser._actions for name in action.option_strings]
            return meant(word.partition("=")[0], options)
    return ""
