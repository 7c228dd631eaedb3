"""Arguments shared by several commands, and their types; a bad value is a usage error before any work."""

import argparse
import math
import os
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from contact_tracker.atomic_file import why_not_replaceable
from contact_tracker.config.quantities import LENGTHS
from contact_tracker.config.shipped import preset_names
from contact_tracker.config.table_reading import AS_NAMED, TIME_UNIT_HELP, reading_of
from contact_tracker.errors import UsageError

if TYPE_CHECKING:
    from contact_tracker.config.parameters import Model

LOG_HELP: Final = "an MCAP file, a ROS bag, a table of poses, a folder of parts, or - for stdin"
LOGS_HELP: Final = "recordings, or folders to search for MCAP files and ROS bags"
_MOST: Final = 1e9
"""Longest time in seconds, about 30 years; more is taken for a mistake."""


def add_recording(parser: argparse.ArgumentParser) -> None:
    """``LOG`` and the selection of its poses."""
    parser.add_argument("log", metavar="LOG", help=LOG_HELP)
    _add_choice(parser)


def add_recordings(parser: argparse.ArgumentParser) -> None:
    """``LOG...`` and the selection of their poses."""
    parser.add_argument("logs", metavar="LOG", nargs="+", help=LOG_HELP)
    _add_choice(parser)


def _add_choice(parser: argparse.ArgumentParser) -> None:
    add_source(parser)
    add_interval(parser)


def add_interval(parser: argparse.ArgumentParser) -> None:
    """``--start`` and ``--duration``."""
    parser.add_argument(
        "--start", type=seconds, default=0.0, metavar="S", help="skip the first S seconds (default: 0)"
    )
    parser.add_argument("--duration", type=positive, metavar="S", help="take S seconds (default: all)")


def add_source(parser: argparse.ArgumentParser) -> None:
    """``--topic``, ``--frame`` and ``--relative-to``, and what the columns of a table are."""
    parser.add_argument("--topic", help="take the poses of this topic: TOPIC or TOPIC:TYPE")
    parser.add_argument(
        "--frame",
        help="take the poses of this frame: CHILD, or 'PARENT->CHILD' along all transforms between",
    )
    add_relative_to(parser)
    add_table_reading(parser)


def add_relative_to(parser: argparse.ArgumentParser) -> None:
    """``--relative-to``."""
    parser.add_argument(
        "--relative-to",
        metavar="TOPIC|FRAME",
        help="poses in this frame, or relative to the body of this topic or name, which may move",
    )


class _Stated(argparse.Action):
    """Adds what an option says of the columns of a table to the ``TableReading`` of all of them."""

    def __call__(self, _: Any, namespace: argparse.Namespace, value: Any, __: str | None = None) -> None:
        name = self.option_strings[0].lstrip("-").replace("-", "_")
        given: dict[str, Any] = {name: True if self.nargs == 0 else value}
        try:
            stated = reading_of(**given)
            namespace.table = namespace.table.with_(stated)
        except ValueError as error:
            raise argparse.ArgumentError(self, str(error)) from error


def add_table_reading(parser: argparse.ArgumentParser) -> None:
    """What the columns of a table are, where their names do not say it."""
    group = parser.add_argument_group("columns of a table, where their names do not say what they are")

    def add(name: str, text: str, metavar: str | None = None) -> None:
        words: dict[str, Any] = {"nargs": 0} if metavar is None else {"metavar": metavar}
        group.add_argument(name, action=_Stated, dest="table", default=AS_NAMED, help=text, **words)

    add("--unit", f"positions are in {', '.join(LENGTHS)}", "UNIT")
    add("--time-unit", f"times are in {TIME_UNIT_HELP}", "UNIT")
    add(
        "--euler",
        "rotations are angles in this order: xyz about fixed axes, XYZ about the body's; XYZ:deg",
        "XYZ",
    )
    add("--rotation-vector", "rotations are vectors along the axis, as long as the angle")
    add("--matrix", "rotations are matrices, numbered along their rows or columns", "rows|columns")
    add(
        "--columns",
        "names of columns: x, qx, rx (angles), or groups of numbered ones: position=p[0:3],quaternion=p[3:7]",
        "time=NAME,...",
    )


def add_model(parser: argparse.ArgumentParser) -> None:
    """``--model``."""
    parser.add_argument(
        "--model",
        default="default",
        metavar="NAME|FILE",
        help=f"a TOML file or a shipped model: {', '.join(preset_names())} (default: %(default)s)",
    )
    parser.add_argument(
        "--noise",
        type=_deviations,
        metavar="MM,DEG",
        help="standard deviations of a pose per axis, where you know them: 0.3mm,0.15deg (default: as the "
        "stream shows)",
    )
    parser.add_argument(
        "--accuracy",
        type=partial(_deviations, may_be_zero=True),
        metavar="MM,DEG",
        help="standard deviations of systematic errors of the poses, as of calibration: 0.5mm,0.1deg. They "
        "do not show in the stream, and increase the deviations of elements (default: those of the model)",
    )


def model_of(args: argparse.Namespace) -> "Model":
    """The model of ``--model``, ``--noise`` and ``--accuracy``; raises ModelError."""
    from contact_tracker.cli.terminal import detail
    from contact_tracker.config.loading import load_model, model_file
    from contact_tracker.hypotheses import compiled

    detail(f"model {model_file(args.model)}, {compiled.described()}")
    model = load_model(args.model)
    if args.noise is not None:
        model = model.with_noise(*args.noise)
    return model if args.accuracy is None else model.with_systematic_errors(*args.accuracy)


def _deviations(text: str, may_be_zero: bool = False) -> tuple[float, float]:
    """A length and an angle with their units, in metres and radians."""
    from contact_tracker.config.quantities import deviations

    try:
        return deviations(text, may_be_zero)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from error


def seconds(text: str) -> float:
    """A finite number of seconds, zero or more."""
    value = _number(text)
    if value < 0:
        raise argparse.ArgumentTypeError(f"{text!r} is negative")
    return value


def positive(text: str) -> float:
    """A finite number above zero."""
    value = _number(text)
    if value <= 0:
        raise argparse.ArgumentTypeError(f"{text!r} is not above zero")
    return value


def _number(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"{text!r} is not a finite number")
    if abs(value) > _MOST:
        raise argparse.ArgumentTypeError(f"{text!r} is beyond {_MOST:g}")
    return value


def output_file(*suffixes: str) -> Callable[[str], Path]:
    """The type of an output file with one of ``suffixes`` (in any case) in an existing folder; devices are
    refused."""

    def check(text: str) -> Path:
        path = Path(text)
        if path.suffix.lower() not in suffixes:
            raise UsageError(f"cannot write {text}: its name must end in {' or '.join(suffixes)}")
        refusal = why_not_replaceable(path)
        folder = (Path(os.path.realpath(path)) if path.is_symlink() else path).parent
        if not os.path.isdir(folder):
            refusal = f"there is no folder {folder}"
        elif refusal is None and not os.access(folder, os.W_OK | os.X_OK):
            refusal = f"the folder {folder} is not writable"
        if refusal is not None:
            raise UsageError(f"cannot write {text}: {refusal}")
        return path

    return check
