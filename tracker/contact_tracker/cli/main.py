"""Entry point: the parser, and the conversion of errors into messages and exit codes.

Commands import the tracker only when they run, so that ``--help`` and usage errors are fast.
"""

import argparse
import io
import os
import re
import sys
import threading
from collections.abc import Iterable, Mapping, Sequence
from importlib import import_module
from itertools import chain
from typing import Any, Final, NoReturn

import contact_tracker.viewer as viewer
from contact_tracker.cli.arguments import set_table
from contact_tracker.cli.commands import COMMANDS, Command
from contact_tracker.cli.terminal import QUIET, USUAL, VERBOSE, fail, set_verbosity, show, take_over_warnings
from contact_tracker.errors import (
    DAMAGED,
    DIFFERENT,
    DONE,
    INPUT,
    INTERRUPTED,
    USAGE,
    ContactTrackerError,
    UsageError,
    extra,
)
from contact_tracker.interrupts import end_in_order, exit_code_of
from contact_tracker.suggestions import suggestion
from contact_tracker.version import __version__

_ENDING: Final = ("SIGTERM", "SIGHUP")
_SIGNALLED: Final = "".join(f", {code} by {name}" for name in _ENDING if (code := exit_code_of(name)))
LAB_COMMANDS: Final = ("simulate", "evaluate", "calibrate")
"""Modules of ``contact_tracker_lab.cli``, imported by name, as that package imports this one."""
SHELLS: Final = ("bash", "zsh", "tcsh")
_FILES: Final = ("LOG", "A", "B", "FILE", "NAME|FILE", "PLAN.toml")
"""Metavariables of file arguments."""

DESCRIPTION: Final = """\
Estimate from the poses of a rigid object how it touches its surroundings: the principal contact
(f-f e-f f-e v-f f-v e-e, the object's face, edge or vertex first; or free), its probability, and
the touching plane, line or point. Shapes and surroundings need not be known."""

EPILOG: Final = f"""\
example:
  contact-tracker live recordings/paper_experiment.mcap

exit codes: {DONE} done, {INPUT} the input cannot be used, {USAGE} wrong usage,
  {DAMAGED} done with a truncated or damaged input, {DIFFERENT} done: takes differ, or a plan was left,
  {INTERRUPTED} ended by Ctrl-C{_SIGNALLED}"""


class Once(argparse.Action):
    """Stores the value of an option and refuses a second one, which argparse would store instead."""

    def __call__(self, _: Any, namespace: argparse.Namespace, value: Any, option: str | None = None) -> None:
        given = vars(namespace).setdefault("given", set())
        if option is not None and self.dest in given:
            raise argparse.ArgumentError(self, "give it once: it has one value")
        given.add(self.dest)
        setattr(namespace, self.dest, value)


class Parser(argparse.ArgumentParser):
    """A parser that raises its errors as UsageError, and refuses to replace the value of an option."""

    def __init__(self, **options: Any) -> None:
        super().__init__(formatter_class=argparse.RawDescriptionHelpFormatter, allow_abbrev=False, **options)
        for name in (None, "store"):
            self.register("action", name, Once)
        self.words = list[str]()

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """The known arguments, with the ``table`` that they describe, and the unknown words."""
        self.words = sys.argv[1:] if args is None else args
        known_args, unknown = super().parse_known_args(args, namespace)
        try:
            set_table(known_args, self.words, self)
        except ValueError as error:
            self.error(str(error))
        return known_args, unknown

    def error(self, message: str) -> NoReturn:
        mistyped = [word for word in self.words if re.match("--[a-z]", word)]
        mistyped = [word for word in mistyped if word.partition("=")[0] not in _options(self)]
        if mistyped and "are required" in message:  # which argparse notices first
            message = f"unrecognized arguments: {' '.join(mistyped)}{option_suggestion(mistyped, self, {})}"
        raise UsageError(f"{message} (see {self.prog} --help)")

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        if action.choices is not None and value not in action.choices:
            names = list(action.choices)
            text = f"{value!r} is none of {', '.join(names)}{suggestion(str(value), names)}"
            raise argparse.ArgumentError(action, text)


class Version(argparse.Action):
    """Shows the version, with the implementation of the update in use."""

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> NoReturn:
        from contact_tracker.hypotheses import compiled

        show(f"contact-tracker {__version__} ({compiled.described()})")
        parser.exit()


class PrintCompletion(argparse.Action):
    """Prints the completion of the whole parser and exits."""

    def __call__(self, parser: argparse.ArgumentParser, _: Any, shell: Any, *__: Any) -> NoReturn:
        with extra("completion", "completion"):
            import shtab

        (commands,) = (a for a in parser._actions if isinstance(a, argparse._SubParsersAction))
        for action in chain.from_iterable(command._actions for command in commands.choices.values()):
            if action.metavar in _FILES:
                action.complete = shtab.FILE
        show(shtab.complete(parser, shell=shell))
        parser.exit()


def option_suggestion(
    words: Iterable[str], parser: argparse.ArgumentParser, commands: Mapping[str, argparse.ArgumentParser]
) -> str:
    """A hint for the first of ``words`` that is an option: the commands that have this option, or
    ``; did you mean OPTION?`` if it resembles an option of ``parser``; else empty."""
    for word in words:
        if word.startswith("-"):
            option = word.partition("=")[0]
            names = [name for name, command in commands.items() if option in _options(command)]
            if names:
                listed = " and ".join(filter(None, (", ".join(names[:-1]), names[-1])))
                return f"; {option} is an option of {listed}"
            return suggestion(option, _options(parser))
    return ""


def _options(parser: argparse.ArgumentParser) -> list[str]:
    """Names of all options of a parser."""
    return [name for action in parser._actions for name in action.option_strings]


def build_parser() -> argparse.ArgumentParser:
    """The parser of all commands."""
    parser = Parser(prog="contact-tracker", description=DESCRIPTION, epilog=EPILOG)
    about_version = "show the version, and whether it runs compiled"
    parser.add_argument("--version", action=Version, nargs=0, help=about_version)
    about_completion = f"print the script that completes commands in a shell: {', '.join(SHELLS)}"
    parser.add_argument(
        "--print-completion", action=PrintCompletion, choices=SHELLS, metavar="SHELL", help=about_completion
    )
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", dest="command", required=True)
    for command in (*COMMANDS, *map(_lab_command, LAB_COMMANDS)):
        sub = commands.add_parser(
            command.name,
            help=command.help,
            description=command.description,
            epilog=f"example:\n  {command.example}",
        )
        command.configure(sub)
        _add_verbosity(sub)
        sub.set_defaults(run=command.run, parsers=(sub, commands.choices))
    return parser


def _lab_command(name: str) -> Command:
    of = import_module(f"contact_tracker_lab.cli.{name}")
    return Command(name, of.HELP, of.DESCRIPTION, of.EXAMPLE, of.configure, "contact_tracker_lab.cli")


def _add_verbosity(parser: argparse.ArgumentParser) -> None:
    text = "whole rows, even on a narrower terminal"
    parser.add_argument("--wide", action="store_true", help=text)
    group = parser.add_mutually_exclusive_group()
    text = "warnings and errors only on stderr, and no progress"
    group.add_argument(
        "-q", "--quiet", action="store_const", dest="verbosity", const=QUIET, default=USUAL, help=text
    )
    text = "say which poses, model and code are used"
    group.add_argument("-v", "--verbose", action="store_const", dest="verbosity", const=VERBOSE, help=text)


def run(argv: Sequence[str] | None = None) -> int:
    """Run the command line ``argv`` (without the program's name) and return its exit code."""
    _prepare_streams()
    # the matrices are too small for more threads
    for library in ("OMP", "OPENBLAS", "MKL"):
        os.environ.setdefault(f"{library}_NUM_THREADS", "1")
    os.environ.setdefault("RUST_LOG", viewer.SILENT)
    if threading.current_thread() is threading.main_thread():
        end_in_order(*_ENDING)
    code = _run(argv)
    try:
        sys.stdout.flush()
    except OSError as error:
        # The output is lost; without this, the interpreter would write it again at its exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if code == DONE and not isinstance(error, BrokenPipeError):
            fail(f"cannot write to stdout: {error.strerror}")
            return INPUT
    return code


def _run(argv: Sequence[str] | None) -> int:
    try:
        parser = build_parser()
        if not (sys.argv[1:] if argv is None else argv):
            parser.print_help(sys.stderr)
            return USAGE
        args, unknown = parser.parse_known_args(argv)
        if unknown:
            raise UsageError(
                f"unrecognized arguments: {' '.join(unknown)}{option_suggestion(unknown, *args.parsers)} "
                f"(see contact-tracker {args.command} --help)"
            )
        set_verbosity(args.verbosity, args.wide)
        take_over_warnings()
        code: int = args.run(args)
        return code
    except SystemExit as exit_:  # argparse after --help or --version; a signal
        return int(exit_.code or DONE)
    except BrokenPipeError:  # the reader has closed the pipe
        return DONE
    except KeyboardInterrupt:
        return INTERRUPTED
    except UsageError as error:
        text = str(error)
        words = sys.argv[1:] if argv is None else argv
        if "expected one argument" in text and any(re.match(r"-[\d.]", word) for word in words):
            text += "; a value that begins with a minus follows an equals sign: --option=-1,0,0"
        fail(text)
        return USAGE
    except ContactTrackerError as error:
        fail(str(error))
        return INPUT
    except OSError as error:
        fail(f"{error.filename or 'cannot write'}: {error.strerror or error}")
        return INPUT


def _prepare_streams() -> None:
    """Replace closed streams by empty ones, and make stdout escape characters that it cannot encode."""
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, mode))  # noqa: SIM115
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")
