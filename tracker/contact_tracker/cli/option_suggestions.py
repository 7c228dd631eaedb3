"""Suggestions for misspelt options."""

import argparse
from collections.abc import Iterable, Mapping

from contact_tracker.suggestions import suggestion


def option_suggestion(
    words: Iterable[str], parser: argparse.ArgumentParser, commands: Mapping[str, argparse.ArgumentParser]
) -> str:
    """``; did you mean OPTION?`` for the first word that resembles an option of ``parser``; or of which
    commands it is an option."""
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
