"""``--print-completion``: shell completion of commands, options and files, by shtab (extra
``completion``).
"""

import argparse
from collections.abc import Iterator
from typing import Any, Final, NoReturn

from contact_tracker.cli.terminal import show
from contact_tracker.extras import extra

SHELLS: Final = ("bash", "zsh", "tcsh")
_FILES: Final = ("LOG", "FILE", "NAME|FILE")
"""Metavariables of file arguments."""


class PrintCompletion(argparse.Action):
    """Prints the completion of the whole parser and exits."""

    def __call__(self, parser: argparse.ArgumentParser, _: Any, shell: Any, *__: Any) -> NoReturn:
        with extra("completion", "completion"):
            import shtab

        for action in _actions(parser):
            if action.metavar in _FILES:
                action.complete = shtab.FILE  # type: ignore[attr-defined]
        show(shtab.complete(parser, shell=shell))
        parser.exit()


def _actions(parser: argparse.ArgumentParser) -> Iterator[argparse.Action]:
    """Actions of the parser and of its commands' parsers."""
    for action in parser._actions:
        yield action
        if isinstance(action, argparse._SubParsersAction):
            for command in action.choices.values():
                yield from _actions(command)
