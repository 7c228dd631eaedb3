"""Arguments that let measured wrenches decide, and what these say."""

import argparse
from typing import TYPE_CHECKING

from contact_tracker.cli.arguments import positive
from contact_tracker.cli.terminal import progress, say, warn
from contact_tracker.errors import UsageError

if TYPE_CHECKING:
    from contact_tracker.config.parameters import Model
    from contact_tracker.landmarks.prior_map import PriorMap
    from contact_tracker.wrenches.contact_evidence import WrenchEvidence


def add_wrench(parser: argparse.ArgumentParser) -> None:
    """``--wrench`` and ``--mass``."""
    group = parser.add_argument_group("force")
    group.add_argument(
        "--wrench",
        metavar="TOPIC",
        help="WrenchStamped messages on TOPIC are the wrench of the hand or robot on the object: they "
        "decide where motion cannot tell contacts apart",
    )
    group.add_argument(
        "--mass", type=positive, metavar="KG", help="mass of the object, if known (default: from free motion)"
    )


def evidence_of(
    name: str, args: argparse.Namespace, model: "Model", knowledge: "PriorMap"
) -> "WrenchEvidence | None":
    """What the wrenches say that ``--wrench`` names; None without, or, with a warning, where they say
    nothing.

    Raises
    ------
    UsageError
        The topic is not there or cannot be used, or the recording cannot be read twice.
    """
    if not asked_for_wrenches(args):
        return None
    if name == "-":
        raise UsageError("--wrench reads the recording twice, which standard input does not allow")
    from contact_tracker.recording import open_log
    from contact_tracker.recording.wrench_evidence import recorded_evidence

    chosen = args.topic, args.frame
    log = open_log(name, *chosen, relative_to=args.relative_to, table=args.table)
    with progress(f"{name}: load", "poses", log.source.messages) as set_done:
        found = recorded_evidence(name, args.wrench, log, model, knowledge, args.mass, set_done)
    if found is None:
        return None  # the command itself says so
    if not found.is_warning:
        say(f"{name}: {found.text}")
    for line in found.warnings:
        warn(f"{name}: {line}")
    return found.evidence


def asked_for_wrenches(args: argparse.Namespace) -> bool:
    """Whether ``--wrench`` is there; raises UsageError where ``--mass`` is without it."""
    if args.wrench is None and args.mass is not None:
        raise UsageError("--mass is of use with --wrench only")
    return args.wrench is not None
