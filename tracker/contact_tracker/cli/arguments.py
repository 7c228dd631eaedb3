"""Arguments shared by several commands. A bad value is a usage error before any work."""

import argparse
import math
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Final, TypeVar

from contact_tracker.config import preset_names
from contact_tracker.config.quantities import LENGTHS, deviations
from contact_tracker.config.table_reading import FRAMES, TIME_UNIT_HELP, reading_of
from contact_tracker.errors import UsageError
from contact_tracker.files import why_not_writable
from contact_tracker.states import states_from
from contact_tracker.suggestions import suggestion

T = TypeVar("T")
LOG_HELP: Final = "an MCAP file, a ROS bag, a table of poses, a folder of parts, or - for stdin"
PLACE: Final = "{}"
"""Placeholder for the name of a recording, and of an object, in an output's name."""
LOGS_HELP: Final = "recordings, or folders to search for MCAP files and ROS bags"
_MOST: Final = 1e9
"""Largest number of an argument, such as seconds (about 30 years); larger ones are mistakes."""


def recording(text: str) -> str:
    """The type of a recording; saved results are refused."""
    if text.lower().endswith(".contacts"):
        by_python = f"contact_tracker.Result.load({text!r}).save('FILE.png')"
        raise UsageError(f"{text} is a saved result: compare reads it, and in Python {by_python}")
    return text


def add_recording(parser: argparse.ArgumentParser, has_interval: bool = True) -> None:
    """Options of the source of poses, the interval, the model and the map."""
    add_source(parser)
    if has_interval:
        add_interval(parser)
    add_model(parser)
    add_known(parser)


def add_source(
    parser: argparse.ArgumentParser,
    topic: str = "take the poses of this topic: TOPIC or TOPIC:TYPE",
    frame: str = "take the poses of this frame: CHILD, or 'PARENT->CHILD' along all transforms between",
) -> None:
    """``--topic``, ``--field``, ``--frame``, ``--relative-to``, and options of the columns of a table."""
    parser.add_argument("--topic", help=topic)
    text = "take the poses in this field of messages: tracked.pose, results[0].pose, or . for the message"
    parser.add_argument("--field", metavar="PATH.TO.POSE", help=text)
    parser.add_argument("--frame", help=frame)
    text = "poses in this frame, or relative to the body of this topic or name, which may move"
    parser.add_argument("--relative-to", metavar="TOPIC|FRAME", help=text)
    _add_table_reading(parser, command_of(parser))


def _add_table_reading(parser: argparse.ArgumentParser, verb: str) -> None:
    """Options of the meaning of the columns of a table, for names that do not say it."""
    add = parser.add_argument_group(
        "columns of a table, if their names do not say what they are"
    ).add_argument
    add("--unit", metavar="UNIT", help=f"positions are in {', '.join(LENGTHS)}")
    add("--time-unit", metavar="UNIT", help=f"times are in {TIME_UNIT_HELP}")
    if verb != "live":  # where --rate is the speed of the replay
        text = "times are numbers of frames, at this rate: --time-unit frames --rate 200"
        add("--rate", dest="frame_rate", metavar="HZ", help=text)
    text = "rotations are angles in this order: xyz about fixed axes, XYZ about the body's; XYZ:deg"
    add("--euler", metavar="XYZ", help=text)
    text = "rotations are vectors along the axis, as long as the angle"
    add("--rotation-vector", action="store_true", help=text)
    text = "rotations are matrices, numbered along their rows or columns"
    add("--matrix", metavar="rows|columns", help=text)
    text = (
        "names of columns: x, qx, rx (angles), or groups of numbered ones: position=p[0:3],quaternion=p[3:7]"
    )
    add("--columns", action="append", metavar="time=NAME,...", help=text)


_OF_TABLE: Final = ("unit", "time_unit", "euler", "rotation_vector", "matrix", "field")
"""Arguments that are passed to ``reading_of`` under their own names."""
_READING: Final = frozenset({*_OF_TABLE, "frame_rate", "columns"})
"""All arguments about the meaning of columns and fields."""


def command_of(parser: argparse.ArgumentParser) -> str:
    """The name of a command."""
    return parser.prog.rpartition(" ")[2]


def set_table(args: argparse.Namespace, words: Sequence[str], parser: argparse.ArgumentParser) -> None:
    """Set ``args.table`` to the reading of columns and fields, which also has the other ``words`` of the
    command for its hints; raises ValueError."""
    if "euler" not in args or "table" in args:  # the parser of all commands comes after the command's own
        return
    rate, columns = getattr(args, "frame_rate", None), args.columns and ",".join(args.columns)
    if args.time_unit == FRAMES and rate is None:
        raise ValueError("--time-unit frames needs the rate of the frames: --time-unit 120Hz")
    command = command_of(parser), *without(words, _READING, parser)
    args.table = reading_of(columns, rate, given=command, **{name: getattr(args, name) for name in _OF_TABLE})


def without(words: Sequence[str], options: Collection[str], parser: argparse.ArgumentParser) -> Iterator[str]:
    """The words of a command without these ``options``, by the names of their values, and their values."""
    actions = {name: action for action in parser._actions for name in action.option_strings}
    remaining = iter(words)
    for word in remaining:
        option, equals, _ = word.partition("=")
        if word == "--":
            yield word
            yield from remaining
        elif option not in actions or actions[option].dest not in options:
            yield word
        elif not equals and actions[option].nargs != 0:
            next(remaining, None)


def add_labels(parser: argparse.ArgumentParser, text: str) -> None:
    """``--labels`` and ``--meaning``, which was ``--map``."""
    text = f"{text}: start, end and contact, in s since the first pose or as stamps"
    parser.add_argument("--labels", metavar="FILE", help=text)
    text = "states of a label: touch=any, flat='f-f|e-f', or ? for one that is not scored"
    options: dict[str, Any] = {"action": "append", "default": [], "metavar": "LABEL=STATES"}
    parser.add_argument("--meaning", help=text, **options)
    parser.add_argument("--map", dest="meaning", help=argparse.SUPPRESS, **options)


def add_interval(parser: argparse.ArgumentParser) -> None:
    """``--start`` and ``--duration``."""
    text = "skip the first S seconds (default: 0)"
    parser.add_argument("--start", type=seconds, default=0.0, metavar="S", help=text)
    parser.add_argument("--duration", type=positive, metavar="S", help="take S seconds (default: all)")


def add_model(parser: argparse.ArgumentParser) -> None:
    """``--model``, ``--noise`` and ``--accuracy``."""
    text = f"a TOML file or a shipped model: {', '.join(preset_names())} (default: %(default)s)"
    parser.add_argument("--model", default="default", metavar="NAME|FILE", help=text)
    text = (
        "standard deviations of a pose per axis, if you know them: 0.3mm,0.15deg (default: estimated from "
        "the stream)"
    )
    parser.add_argument("--noise", type=_typed(deviations), metavar="MM,DEG", help=text)
    parser.add_argument(
        "--accuracy",
        type=_typed(partial(deviations, may_be_zero=True)),
        metavar="MM,DEG",
        help="standard deviations of systematic errors of the poses, as by calibration: 0.5mm,0.1deg. They "
        "cannot be estimated from the stream, and increase the deviations of elements (default: the model's)",
    )


def _typed(parse: Callable[[str], T]) -> Callable[[str], T]:
    """The type of an argument that ``parse`` reads; its ValueErrors become errors of the argument."""

    def typed(text: str) -> T:
        try:
            return parse(text)
        except ValueError as error:
            raise argparse.ArgumentTypeError(str(error)) from error

    return typed


def add_known(parser: argparse.ArgumentParser) -> None:
    """``--known`` for a map, and options for its common parts."""
    group = parser.add_argument_group(
        "map of known elements",
        "in metres; a value that begins with a minus is written as --plane=-1,0,0,0.5",
    )
    group.add_argument("--known", metavar="FILE", help="a TOML file with known elements and their accuracy")
    text = "normals of faces of the surroundings have this direction, within DEG degrees (default: 2)"
    group.add_argument("--up", type=_numbers("0,0,1", 3, 4), metavar="X,Y,Z[,DEG]", help=text)
    group.add_argument(
        "--plane",
        type=_numbers("0,0,1,0.75", 4),
        action="append",
        default=[],
        metavar="NX,NY,NZ,H",
        help="a face n . x = H of the surroundings, its normal on the free side; may be repeated",
    )
    text = "the object is a box with edges of A, B and C metres about the body frame's origin"
    group.add_argument("--box", type=_numbers("0.2,0.1,0.1", 3), metavar="A,B,C", help=text)
    text = "the contacts that can occur (default: all); free motion always can"
    group.add_argument("--states", type=_typed(states_from), metavar="f-f,e-f,...", help=text)


def add_map_out(parser: argparse.ArgumentParser) -> None:
    """``--map-out``."""
    text = (
        "write the touched elements to FILE.toml, for --known with the next recording of the "
        "same object and place; it may be the file of --known"
    )
    parser.add_argument("--map-out", type=output_file(".toml"), metavar="FILE.toml", help=text)


def add_wrench(parser: argparse.ArgumentParser) -> None:
    """``--wrench``."""
    group = parser.add_argument_group("force")
    text = (
        "WrenchStamped messages on TOPIC are the wrench of the hand or robot on the object: they "
        "distinguish contacts that motion cannot; for a LeRobot data set, entries of its features"
    )
    group.add_argument("--wrench", metavar="TOPIC", help=text)


def add_output(parser: argparse._ActionsContainer, suffixes: Iterable[str], text: str, **extra: Any) -> None:
    """``--output`` with one of ``suffixes``, and ``--overwrite``."""
    parser.add_argument("-o", "--output", type=output_file(*suffixes), metavar="FILE", help=text, **extra)
    add_overwrite(parser)


def add_overwrite(parser: argparse._ActionsContainer) -> None:
    """``--overwrite``."""
    parser.add_argument(
        "--overwrite", action="store_true", help="replace FILE even if it is a recording or has labels"
    )


def output_file(*suffixes: str) -> Callable[[str], Path | None]:
    """The type of an output file with one of ``suffixes`` (in any case) in an existing folder; devices are
    refused. If ``-`` is one of the suffixes, the argument ``-`` is None (standard output)."""

    def check(text: str) -> Path | None:
        path = Path(text)
        if text == "-" and "-" in suffixes:
            return None
        if path.suffix.lower() not in suffixes:
            *others, last = (suffix for suffix in suffixes if suffix != "-")
            named = f"{', '.join(others)} or {last}" if others else last
            by_view = f"; contact-tracker view LOG --save {text} writes it" * (path.suffix.lower() == ".rrd")
            remedy = by_view or suggestion(path.suffix.lower(), suffixes)
            raise UsageError(f"cannot write {text}: its name must end in {named}{remedy}")
        if (refusal := why_not_writable(path)) is not None:
            raise UsageError(f"cannot write {text}: {refusal}")
        return path

    return check


def add_processes(parser: argparse._ActionsContainer, most: int, default: int | None, text: str) -> None:
    """``--processes``."""
    kind = partial(whole_number, least=1, most=most)
    parser.add_argument("--processes", type=kind, default=default, metavar="N", help=text)


def _within(is_within: Callable[[float], bool], fault: str) -> Callable[[str], float]:
    """The type of a finite number in a range; ``fault`` is the text for a number outside of it."""

    def parse(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        for is_fine, reason in (
            (math.isfinite(value), "is not a finite number"),
            (is_within(value), fault),
            (abs(value) <= _MOST, f"is beyond {_MOST:g}"),
        ):
            if not is_fine:
                raise argparse.ArgumentTypeError(f"{text!r} {reason}")
        return value

    return parse


seconds: Final = _within(lambda value: value >= 0, "is negative")
positive: Final = _within(lambda value: value > 0, "is not above zero")
share: Final = _within(lambda value: 0 < value < 1, "is not above zero and below one")


def whole_number(text: str, least: int, most: int) -> int:
    """The whole number of an argument, from ``least`` to ``most``."""
    if not text.isdecimal() or not least <= int(text) <= most:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from {least} to {most}")
    return int(text)


def _numbers(example: str, *counts: int) -> Callable[[str], list[float]]:
    """The type of a list of finite numbers, whose length is one of ``counts``; errors quote ``example``."""

    def parse(text: str) -> list[float]:
        try:
            values = [float(part) for part in text.split(",")]
        except ValueError:
            values = []
        if len(values) not in counts or not all(map(math.isfinite, values)):
            count = " or ".join(map(str, counts))
            raise argparse.ArgumentTypeError(f"{text!r} is not a list of {count} numbers, such as {example}")
        return values

    return parse
