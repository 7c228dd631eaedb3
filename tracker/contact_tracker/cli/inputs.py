"""What the arguments of a command name: models, maps, poses, labels, wrenches and files."""

import argparse
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from contact_tracker.batch import finding
from contact_tracker.cli.terminal import detail, fail, progress, say, warn
from contact_tracker.config.loading import model_file
from contact_tracker.config.parameters import Model
from contact_tracker.errors import INPUT, USAGE, ChoiceError, InputError, UsageError
from contact_tracker.exports.formats import check_output
from contact_tracker.ground_truth import Truth
from contact_tracker.hypotheses import compiled
from contact_tracker.map.elements import LearnedElements
from contact_tracker.map.file import files_named, map_from, merged, read_table, write_learned
from contact_tracker.map.map import Map
from contact_tracker.outputs.text import counted
from contact_tracker.recording import PoseLog, open_log, parts_of, read_labels
from contact_tracker.recording.annotations import meanings_of
from contact_tracker.segmenting import recorded_evidence
from contact_tracker.trajectory.arguments import model_from
from contact_tracker.wrenches.contact_evidence import WrenchEvidence


def load_model(args: argparse.Namespace) -> Model:
    """The model of ``--model``, ``--noise`` and ``--accuracy``; raises ModelError."""
    detail(f"model {model_file(args.model)}, {compiled.described()}")
    return model_from(args.model, args.noise, args.accuracy)


def load_map(args: argparse.Namespace, note: Callable[[str], None] = warn) -> Map:
    """The map of the options of ``add_known``; ``note`` is called with each doubt. Raises KnowledgeError."""
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


def open_poses(args: argparse.Namespace, log: str, *live: Any) -> PoseLog:
    """The poses that ``add_source`` selects in a recording; ``live`` is passed on to ``open_log``."""
    options = {"relative_to": args.relative_to, "table": args.table}
    return open_log(log, args.topic, args.frame, *live, **options)


def load_labels(args: argparse.Namespace, log: str) -> Truth:
    """The labels of ``--labels`` for the whole recording ``log``; raises NoTruth or ChoiceError."""
    poses = open_poses(args, log)
    for _ in poses.batches():
        pass
    if not poses.valid:
        raise poses.no_poses(log)
    stamps = poses.first_ns, poses.last_ns
    truth, text = read_labels(args.labels, *stamps, meanings_of(args.meaning), _options_of)
    say(text)
    return truth


def _options_of(labels: Sequence[str]) -> str:
    return " ".join(f"--meaning '{label}=any'" for label in labels)


def load_wrenches(
    name: str, args: argparse.Namespace, model: Model, known_map: Map, note: Callable[[str], None] = warn
) -> WrenchEvidence | None:
    """The evidence of the wrenches of ``--wrench``; None without the option, or if the wrenches have no
    evidence. ``note`` is called with each warning.

    Raises
    ------
    UsageError
        The topic does not exist or cannot be used, or the recording cannot be read twice.
    """
    if args.wrench is None:
        return None
    if name == "-":
        raise UsageError("--wrench reads the recording twice, which standard input does not allow")

    log = open_poses(args, name)
    with progress(f"{name}: load", "poses", log.source.messages) as set_done:
        evidence, load, warnings = recorded_evidence(name, args.wrench, log, model, known_map, set_done)
    if load:
        say(f"{name}: {load}")
    for line in warnings:
        note(f"{name}: {line}")
    return evidence


def check_map_out(args: argparse.Namespace, known_map: Map) -> None:
    """Raise UsageError if no map for ``--map-out`` is learned, or it would replace a recording."""
    if args.map_out is None:
        return
    if known_map.lists_elements:
        raise UsageError("--map-out cannot be combined with --up, --plane, --box or elements in --known")
    if getattr(args, "wrench", None) is not None:
        raise UsageError("--map-out learns from motion alone: leave --wrench out")
    if getattr(args, "state", None) is not None:
        raise UsageError("--map-out is written at the end of a stream: leave --state out (it has the map)")
    known_file = None if args.known is None else Path(args.known)
    read = [file for file in files_read([args.log], args.model, args.known) if Path(file) != known_file]
    check_output(args.map_out, True, read, written=[args.output])


def write_map(path: Path, learned: LearnedElements) -> None:
    """Write the learned elements of a map, and print their number."""
    if not learned:
        warn(f"{path} is not written: no contact is sure enough to learn from")
        return
    write_learned(path, learned)
    say(f"wrote {path}: {counted(len(learned.elements), 'element')}")


def files_read(logs: Iterable[str], model: str, known: str | None) -> list[str]:
    """The files that a command reads: all parts of ``logs``, the model, the map and its meshes.

    Raises
    ------
    UnreadableRecording, KnowledgeError
        A recording or the map file cannot be read.
    """
    parts = [part for log in logs for part in parts_of(log)]
    return [*parts, str(model_file(model)), *map(str, files_named(known) if known is not None else ())]


def recordings_in(logs: Iterable[str], command: str) -> list[str]:
    """The recordings that ``logs`` name, each once; a folder stands for the recordings in it."""
    if "-" in logs:
        raise UsageError(f"{command} reads a recording twice: name a file, not -")
    return list(dict.fromkeys(name for log in logs for name in finding.recordings_in(log)))


def run_each(works: Iterable[Callable[[], int]], is_only_one: bool = False) -> Iterator[int]:
    """The exit code of each piece of work. An error of the input is reported and the next piece follows, but
    it is raised if the piece ``is_only_one``."""
    for work in works:
        try:
            yield work()
        except (InputError, ChoiceError) as error:
            if is_only_one:
                raise
            fail(str(error))
            yield INPUT if isinstance(error, InputError) else USAGE
