"""Arguments shared by several commands, and what they name.

A bad value is a usage error before any work.
"""

import argparse
import math
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeVar

from contact_tracker.cli.terminal import detail, fail, progress, say, warn
from contact_tracker.config import preset_names
from contact_tracker.config.quantities import LENGTHS, deviations
from contact_tracker.config.table_reading import FRAMES, TIME_UNIT_HELP, reading_of
from contact_tracker.errors import INPUT, USAGE, ChoiceError, InputError, UsageError
from contact_tracker.files import why_not_replaceable
from contact_tracker.states import states_from

if TYPE_CHECKING:
    from contact_tracker.config.parameters import Model
    from contact_tracker.ground_truth import Truth
    from contact_tracker.map.map import Map
    from contact_tracker.map.world_map import GrowingMap
    from contact_tracker.recording import PoseLog
    from contact_tracker.wrenches.contact_evidence import WrenchEvidence

T = TypeVar("T")
LOG_HELP: Final = "an MCAP file, a ROS bag, a table of poses, a folder of parts, or - for stdin"
LOGS_HELP: Final = "recordings, or folders to search for MCAP files and ROS bags"
_MOST: Final = 1e9
"""Longest time in seconds, about 30 years; more is taken for a mistake."""


def add_recording(parser: argparse.ArgumentParser, has_interval: bool = True) -> None:
    """What is read of a recording, by which model, and what is known of it."""
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
    """``--topic``, ``--field``, ``--frame`` and ``--relative-to``, and what the columns of a table are."""
    parser.add_argument("--topic", help=topic)
    text = "take the poses in this field of messages: tracked.pose, results[0].pose, or . for the message"
    parser.add_argument("--field", metavar="PATH.TO.POSE", help=text)
    parser.add_argument("--frame", help=frame)
    text = "poses in this frame, or relative to the body of this topic or name, which may move"
    parser.add_argument("--relative-to", metavar="TOPIC|FRAME", help=text)
    _add_table_reading(parser, command_of(parser))


def _add_table_reading(parser: argparse.ArgumentParser, verb: str) -> None:
    """What the columns of a table are, where their names do not say it."""
    add = parser.add_argument_group(
        "columns of a table, where their names do not say what they are"
    ).add_argument
    add("--unit", metavar="UNIT", help=f"positions are in {', '.join(LENGTHS)}")
    add("--time-unit", metavar="UNIT", help=f"times are in {TIME_UNIT_HELP}")
    if verb != "live":  # where it is the speed of the replay
        text = "times are numbers of frames, so many a second: --time-unit frames --rate 200"
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
_READING: Final = frozenset({*_OF_TABLE, "frame_rate", "columns"})


def command_of(parser: argparse.ArgumentParser) -> str:
    """The name of a command."""
    return parser.prog.rpartition(" ")[2]


def set_table(args: argparse.Namespace, words: Sequence[str], parser: argparse.ArgumentParser) -> None:
    """Set ``table`` to what the options say of columns and fields, and to the other ``words`` of the command;
    raises ValueError."""
    if "euler" not in args or "table" in args:  # the whole parser comes after that of the command
        return
    rate, columns = getattr(args, "frame_rate", None), args.columns and ",".join(args.columns)
    if args.time_unit == FRAMES and rate is None:
        raise ValueError("--time-unit frames needs the rate of the frames: --time-unit 120Hz")
    given = () if command_of(parser) == "batch" else (command_of(parser), *_without_reading(words, parser))
    args.table = reading_of(columns, rate, given=given, **{name: getattr(args, name) for name in _OF_TABLE})


def _without_reading(words: Sequence[str], parser: argparse.ArgumentParser) -> Iterator[str]:
    """The words of a command without the options that say what columns and fields are."""
    actions = {name: one for one in parser._actions for name in one.option_strings}
    rest = iter(words)
    for word in rest:
        option, equals, _ = word.partition("=")
        if word == "--":
            yield word
            yield from rest
        elif option not in actions or actions[option].dest not in _READING:
            yield word
        elif not equals and actions[option].nargs != 0:
            next(rest, None)


def add_labels(parser: argparse.ArgumentParser, text: str) -> None:
    """``--labels`` and ``--map``."""
    text = f"{text}: start, end and contact, in s since the first pose or as stamps"
    parser.add_argument("--labels", metavar="FILE", help=text)
    text = "what a label means: touch=any, flat='f-f|e-f', or ? for what is not scored"
    parser.add_argument("--map", action="append", default=[], metavar="LABEL=STATES", help=text)


def load_labels(args: argparse.Namespace, log: str) -> "Truth":
    """The labels of ``--labels``, which are of the whole recording ``log``; raises NoTruth or ChoiceError."""
    from contact_tracker.recording import read_labels
    from contact_tracker.recording.annotations import meanings_of

    poses = open_poses(args, log)
    for _ in poses.batches():
        pass
    if not poses.valid:
        raise poses.no_poses(log)
    truth, text = read_labels(args.labels, poses.first_ns, poses.last_ns, meanings_of(args.map))
    say(text)
    return truth


def add_interval(parser: argparse.ArgumentParser) -> None:
    """``--start`` and ``--duration``."""
    text = "skip the first S seconds (default: 0)"
    parser.add_argument("--start", type=seconds, default=0.0, metavar="S", help=text)
    parser.add_argument("--duration", type=positive, metavar="S", help="take S seconds (default: all)")


def open_poses(args: argparse.Namespace, log: str, *live: Any) -> "PoseLog":
    """The poses that ``add_source`` selects in a recording; ``live`` as of ``recording.open_log``."""
    from contact_tracker.recording import open_log

    chosen = {"relative_to": args.relative_to, "table": args.table}
    return open_log(log, args.topic, args.frame, *live, **chosen)


def add_model(parser: argparse.ArgumentParser) -> None:
    """``--model``, ``--noise`` and ``--accuracy``."""
    text = f"a TOML file or a shipped model: {', '.join(preset_names())} (default: %(default)s)"
    parser.add_argument("--model", default="default", metavar="NAME|FILE", help=text)
    text = (
        "standard deviations of a pose per axis, where you know them: 0.3mm,0.15deg (default: as the "
        "stream shows)"
    )
    parser.add_argument("--noise", type=_typed(deviations), metavar="MM,DEG", help=text)
    parser.add_argument(
        "--accuracy",
        type=_typed(partial(deviations, may_be_zero=True)),
        metavar="MM,DEG",
        help="standard deviations of systematic errors of the poses, as of calibration: 0.5mm,0.1deg. They "
        "do not show in the stream, and increase the deviations of elements (default: those of the model)",
    )


def load_model(args: argparse.Namespace) -> "Model":
    """The model of ``--model``, ``--noise`` and ``--accuracy``; raises ModelError."""
    from contact_tracker.config.loading import model_file
    from contact_tracker.hypotheses import compiled
    from contact_tracker.trajectory.arguments import model_from

    detail(f"model {model_file(args.model)}, {compiled.described()}")
    return model_from(args.model, args.noise, args.accuracy)


def _typed(parse: Callable[[str], T]) -> Callable[[str], T]:
    """The type of an argument whose errors are those of ``parse``, in its words."""

    def typed(text: str) -> T:
        try:
            return parse(text)
        except ValueError as error:
            raise argparse.ArgumentTypeError(str(error)) from error

    return typed


def add_known(parser: argparse.ArgumentParser) -> None:
    """``--known`` for a map, and shortcuts for common parts."""
    group = parser.add_argument_group(
        "what is known", "in metres; a value that begins with a minus is written as --plane=-1,0,0,0.5"
    )
    group.add_argument("--known", metavar="FILE", help="a TOML file that says what is known and how exactly")
    text = "faces of the surroundings look along this direction, within DEG degrees (default: 2)"
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


def load_map(args: argparse.Namespace, note: Callable[[str], None] = warn) -> "Map":
    """The map of ``add_known``, with a ``note`` of what is doubtful in it; raises KnowledgeError."""
    from contact_tracker.map.file import map_from, merged, read_table

    tables: list[dict[str, Any]] = [] if args.known is None else [read_table(args.known)]
    if args.up is not None:
        spread = {"spread_deg": args.up[3]} if len(args.up) > 3 else {}
        tables.append({"up": {"direction": args.up[:3], **spread}})
    if args.plane:
        planes = [{"normal": plane[:3], "offset_m": plane[3]} for plane in args.plane]
        tables.append({"environment": {"plane": planes}})
    if args.box is not None:
        tables.append({"object": {"box": {"size_m": args.box}}})
    return replace(map_from(merged(tables), Path(args.known or "").parent, note), states=args.states)


def add_map_out(parser: argparse.ArgumentParser) -> None:
    """``--map-out``."""
    text = (
        "write what the contacts have touched to FILE.toml, for --known with the next recording of the "
        "same object and place; it may be the file of --known"
    )
    parser.add_argument("--map-out", type=output_file(".toml"), metavar="FILE.toml", help=text)


def check_map_out(args: argparse.Namespace, known_map: "Map") -> None:
    """Refuse ``--map-out`` where no map is learned, or over a recording; raises UsageError."""
    from contact_tracker.exports.formats import check_output

    if args.map_out is None:
        return
    if known_map.lists_elements:
        raise UsageError("--map-out cannot be combined with --up, --plane, --box or elements in --known")
    if getattr(args, "wrench", None) is not None:
        raise UsageError("--map-out learns from the motion: without --wrench")
    if getattr(args, "state", None) is not None:
        raise UsageError("--map-out is of a stream that ends: without --state, which has the map as well")
    known = None if args.known is None else Path(args.known)
    read = [one for one in files_read([args.log], args.model, args.known) if Path(one) != known]
    check_output(args.map_out, True, read, written=[args.output])


def write_map(path: Path, world: "GrowingMap | None") -> None:
    """Write a learned map, and say how many elements it has."""
    from contact_tracker.map.elements import NOTHING_LEARNED
    from contact_tracker.map.file import write_learned

    learned = NOTHING_LEARNED if world is None else world.learned
    if not learned:
        warn(f"{path} is not written: no contact is sure enough to learn from")
        return
    write_learned(path, learned)
    say(f"wrote {path}: {len(learned.elements)} elements")


def add_wrench(parser: argparse.ArgumentParser) -> None:
    """``--wrench`` and ``--mass``."""
    group = parser.add_argument_group("force")
    text = (
        "WrenchStamped messages on TOPIC are the wrench of the hand or robot on the object: they "
        "decide where motion cannot tell contacts apart; of a LeRobot data set, entries of its features"
    )
    group.add_argument("--wrench", metavar="TOPIC", help=text)
    text = "mass of the object, if known (default: from free motion)"
    group.add_argument("--mass", type=positive, metavar="KG", help=text)


def require_wrench_for_mass(args: argparse.Namespace) -> None:
    """Raise UsageError where ``--mass`` is without ``--wrench``."""
    if args.wrench is None and args.mass is not None:
        raise UsageError("--mass is of use with --wrench only")


def load_wrenches(
    name: str,
    args: argparse.Namespace,
    model: "Model",
    known_map: "Map",
    note: Callable[[str], None] = warn,
) -> "WrenchEvidence | None":
    """What the wrenches say that ``--wrench`` names; None without, or where they say nothing, with a
    ``note``.

    Raises
    ------
    UsageError
        The topic is not there or cannot be used, or the recording cannot be read twice.
    """
    require_wrench_for_mass(args)
    if args.wrench is None:
        return None
    if name == "-":
        raise UsageError("--wrench reads the recording twice, which standard input does not allow")
    from contact_tracker.offline import recorded_evidence

    log = open_poses(args, name)
    with progress(f"{name}: load", "poses", log.source.messages) as set_done:
        found = recorded_evidence(name, args.wrench, log, model, known_map, args.mass, set_done)
    evidence, load, warnings = found
    if load:
        say(f"{name}: {load}")
    for line in warnings:
        note(f"{name}: {line}")
    return evidence


def add_output(parser: argparse._ActionsContainer, suffixes: Iterable[str], text: str, **more: Any) -> None:
    """``--output`` with one of ``suffixes``, and ``--overwrite``."""
    parser.add_argument(
        "-o", "--output", type=output_file(*suffixes), action=Once, metavar="FILE", help=text, **more
    )
    add_overwrite(parser)


class Once(argparse.Action):
    """Stores an argument that is given once: of two outputs only the last one would be written."""

    def __call__(self, _: Any, namespace: argparse.Namespace, value: Any, option: str | None = None) -> None:
        if getattr(namespace, self.dest, None) is not None:
            raise argparse.ArgumentError(self, "give it once: a command has one output")
        setattr(namespace, self.dest, value)


def add_overwrite(parser: argparse._ActionsContainer) -> None:
    """``--overwrite``."""
    parser.add_argument("--overwrite", action="store_true", help="replace FILE even if it is a recording")


def output_file(*suffixes: str) -> Callable[[str], Path | None]:
    """The type of an output file with one of ``suffixes`` (in any case) in an existing folder; devices are
    refused. With ``-`` among the suffixes that is None, standard output."""

    def check(text: str) -> Path | None:
        path = Path(text)
        if text == "-" and "-" in suffixes:
            return None
        if path.suffix.lower() not in suffixes:
            named = " or ".join(suffix for suffix in suffixes if suffix != "-")
            raise UsageError(f"cannot write {text}: its name must end in {named}")
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


def files_read(logs: Iterable[str], model: str, known: str | None) -> list[str]:
    """The files that a command reads: all parts of ``logs``, the model, the map with its meshes.

    Raises
    ------
    UnreadableRecording, KnowledgeError
        A recording or the map file cannot be read.
    """
    from contact_tracker.config.loading import model_file
    from contact_tracker.map.file import files_named
    from contact_tracker.recording import parts_of

    parts = [part for log in logs for part in parts_of(log)]
    return [*parts, str(model_file(model)), *map(str, files_named(known) if known is not None else ())]


def add_processes(parser: argparse._ActionsContainer, most: int, default: int | None, text: str) -> None:
    """``--processes``."""
    kind = partial(whole_number, least=1, most=most)
    parser.add_argument("--processes", type=kind, default=default, metavar="N", help=text)


def recordings_in(logs: Iterable[str], command: str) -> list[str]:
    """Files as given, folders replaced by the recordings in them; each once."""
    from contact_tracker.batch import finding

    if "-" in logs:
        raise UsageError(f"{command} reads a recording twice: name a file, not -")
    return list(dict.fromkeys(name for log in logs for name in finding.recordings_in(log)))


def run_each(works: Iterable[Callable[[], int]], is_only_one: bool = False) -> Iterator[int]:
    """The exit code of each piece of work; one that cannot be done is reported, and the others go on, unless
    it ``is_only_one``."""
    for work in works:
        try:
            yield work()
        except (InputError, ChoiceError) as error:
            if is_only_one:
                raise
            fail(str(error))
            yield INPUT if isinstance(error, InputError) else USAGE


def _within(is_within: Callable[[float], bool], fault: str) -> Callable[[str], float]:
    """The type of a finite number in a range."""

    def parse(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        for is_fine, why in (
            (math.isfinite(value), "is not a finite number"),
            (is_within(value), fault),
            (abs(value) <= _MOST, f"is beyond {_MOST:g}"),
        ):
            if not is_fine:
                raise argparse.ArgumentTypeError(f"{text!r} {why}")
        return value

    return parse


seconds: Final = _within(lambda value: value >= 0, "is negative")
positive: Final = _within(lambda value: value > 0, "is not above zero")
share: Final = _within(lambda value: 0 < value < 1, "is not above zero and below one")


def whole_number(text: str, least: int, most: int) -> int:
    """A whole number in a range."""
    if not text.isdecimal() or not least <= int(text) <= most:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from {least} to {most}")
    return int(text)


def _numbers(example: str, *counts: int) -> Callable[[str], list[float]]:
    """The type of a list of finite numbers, one of ``counts`` of them, as in ``example``."""

    def parse(text: str) -> list[float]:
        try:
            values = [float(part) for part in text.split(",")]
        except ValueError:
            values = []
        if len(values) not in counts or not all(map(math.isfinite, values)):
            wanted = " or ".join(map(str, counts))
            raise argparse.ArgumentTypeError(f"{text!r} is not a list of {wanted} numbers, such as {example}")
        return values

    return parse
