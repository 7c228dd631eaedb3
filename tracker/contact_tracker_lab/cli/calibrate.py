"""``contact-tracker calibrate``: a model learned from recordings."""

import argparse
import os
import shlex
import textwrap
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import replace
from itertools import count, starmap
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from contact_tracker.cli import arguments
from contact_tracker.cli.terminal import progress, say, show, take_over_warnings, warn
from contact_tracker.config import preset_names
from contact_tracker.errors import DAMAGED, DONE, UsageError
from contact_tracker.exports.formats import check_output
from contact_tracker.version import __version__

if TYPE_CHECKING:
    from contact_tracker_lab.calibration.calibrate import Calibration, Source

HELP: Final = "learn a model from recordings"
DESCRIPTION: Final = """\
Learn a model's parameters from recordings: how contacts follow each other, and the sensor's noise.
Contacts are learned from recordings with ground truth. The report says what changed, and what that is worth
on recordings that were held out."""
EXAMPLE: Final = "contact-tracker calibrate recordings/ --only transitions --folds 0 -o mine.toml"
USUAL_FOLDS: Final = 5
WIDTH: Final = 108


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("logs", nargs="+", metavar="LOG", type=arguments.recording, help=arguments.LOGS_HELP)
    arguments.add_source(parser)
    arguments.add_known(parser)
    arguments.add_output(parser, (".toml",), "write FILE.toml, whole or not at all", required=True)
    text = f"start from a TOML file or a shipped model: {', '.join(preset_names())} (default: %(default)s)"
    parser.add_argument("--start", default="default", metavar="NAME|FILE", help=text)
    text = "learn only these parameters or tables (default: all)"
    parser.add_argument("--only", nargs="+", default=[], metavar="KEY", help=text)
    text = f"hold out each N-th recording in turn, 0 for none (default: {USUAL_FOLDS}, or one for each)"
    parser.add_argument("--folds", type=_folds, metavar="N", help=text)
    arguments.add_processes(
        parser, 1024, os.cpu_count() or 1, "recordings at once (default: as many as there are cores)"
    )


def _folds(text: str) -> int:
    if not text.isdecimal() or int(text) == 1:
        raise argparse.ArgumentTypeError(f"{text!r} is neither 0 nor a whole number above 1")
    return int(text)


def run(args: argparse.Namespace) -> int:
    from contact_tracker.cli import inputs
    from contact_tracker.config.loading import load_model
    from contact_tracker.files import whole_file
    from contact_tracker.processes import Workers
    from contact_tracker_lab.calibration.calibrate import Plan, calibrate, to_text
    from contact_tracker_lab.calibration.parameters import model_text, select

    names = inputs.recordings_in(args.logs, "calibrate")
    files = inputs.files_read(names, args.start, args.known)
    check = check_output(args.output, args.overwrite, files)
    keys, start, sources = select(args.only), load_model(args.start), _sources(args, names)
    plan = Plan(sources, start, keys, _how_many_folds(args.folds, len(sources)))
    processes = min(args.processes, len(sources))
    with (
        Workers(processes, take_over_warnings) if processes > 1 else nullcontext() as pool,
        progress("calibrate", "recordings") as set_done,
    ):
        done = count(1)

        def run_jobs(function: Callable[..., Any], jobs: Sequence[tuple[Any, ...]]) -> list[Any]:
            answers = list[Any]()
            for answer in (
                starmap(function, jobs) if pool is None else pool.map(function, *zip(*jobs, strict=True))
            ):
                answers.append(answer)
                set_done(next(done))
            return answers

        calibration = calibrate(plan, run_jobs)
    text = model_text(replace(calibration.model, name=args.output.stem), _header(calibration, args))
    with whole_file(args.output, check) as temporary:
        temporary.write_text(text, encoding="utf-8")
    say(f"wrote {args.output}")
    show(to_text(calibration))
    if calibration.log_loss is not None and calibration.log_loss[1] > calibration.log_loss[0]:
        loss = "{:.3f} before, {:.3f} after".format(*calibration.log_loss)
        warn(f"worse on recordings held out: log-loss {loss}; --only leaves out what does harm")
    damaged = [study for study in calibration.studies if study.damage is not None]
    for study in damaged:
        warn(f"{study.name}: {study.damage}")
    return DAMAGED if damaged else DONE


def _sources(args: argparse.Namespace, names: Sequence[str]) -> "tuple[Source, ...]":
    from contact_tracker.cli import inputs
    from contact_tracker_lab.calibration.calibrate import Source

    for name in names:
        if os.path.exists(name) and not (os.path.isfile(name) or os.path.isdir(name)):
            raise UsageError(f"calibrate reads a recording several times: {name} is not a regular file")
    known_map = inputs.load_map(args)
    options = args.topic, args.frame, known_map, args.relative_to, args.table
    return tuple(Source(name, *options) for name in names)


def _how_many_folds(folds: int | None, recordings: int) -> int:
    if folds is None:
        if recordings == 1:
            warn("one recording: nothing can be held out, so what the model is worth is not known")
        return min(USUAL_FOLDS, recordings) if recordings > 1 else 0
    if folds > recordings:
        raise UsageError(f"--folds {folds} of {recordings} recordings: there is not one for each")
    return folds


def _header(calibration: "Calibration", args: argparse.Namespace) -> list[str]:
    """The origin of the file as comment lines, without dates and absolute paths."""
    studies = calibration.studies
    names = " ".join(Path(study.name).name for study in studies)
    texts = (
        f"Made by contact-tracker {__version__}; docs/models.md says what each parameter does.",
        f"Learned: {', '.join(calibration.plan.keys)}. The rest is that of {calibration.plan.start.name}.",
        f"From {len(studies)} recordings, {sum(s.counts is not None for s in studies)} with truth: {names}",
    )
    lines = [line for text in texts for line in textwrap.wrap(text, WIDTH, break_on_hyphens=False)]
    return [lines[0], _command(args), *lines[1:]]


def _command(args: argparse.Namespace) -> str:
    """The command line, without options that do not change the result."""
    start = os.path.relpath(args.start) if Path(args.start).suffix else args.start
    output = os.path.relpath(args.output)
    words = ["contact-tracker", "calibrate", *map(os.path.relpath, args.logs)]
    words += ["--topic", args.topic] if args.topic else []
    words += ["--frame", args.frame] if args.frame else []
    words += ["--relative-to", args.relative_to] if args.relative_to else []
    words += args.table.words()
    words += ["--known", os.path.relpath(args.known)] if args.known else []
    words += ["--start", start] if args.start != "default" else []
    words += ["--only", *args.only] if args.only else []
    return shlex.join([*words, "-o", args.output.name if output.startswith(os.pardir) else output])
