"""Suggestions for misspelt commands and options."""

import argparse
from collections.abc import Iterable, Mapping
from difflib import get_close_matches


def suggestion(word: str, names: Iterable[str]) -> str:
    """``; did you mean NAME?``, or empty if no name is similar."""
    near = get_close_matches(word, list(names), 1)
    return f"; did you mean {near[0]}?" if near else ""


def option_suggestion(
    words: Iterable[str], parser: argparse.ArgumentParser, commands: Mapping[str, argparse.ArgumentParser]
) -> str:
    """The same for the first word that resembles an option of ``parser``, or is one of other commands."""
    for word in words:
        if word.startswith("-"):
            option = word.partition("=")[0]
            others = [name for name, other in commands.items() if option in _options(other)]
            if others:
                return f"; {option} is an option of {' and '.join(others)}"
            return suggestion(option, _options(parser))
    return ""


def _options(parser: argparse.ArgumentParser) -> list[str]:
    return [name for action in parser._actions for name in action.option_strings]
