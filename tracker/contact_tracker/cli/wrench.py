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
        "--mass", type=positive, metavar="KG", help="of the object, if known (default: from free motion)"
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
    if args.wrench is None:
        if args.mass is not None:
            raise UsageError("--mass is of use with --wrench only")
        return None
    if name == "-":
        raise UsageError("--wrench reads the recording twice, which standard input does not allow")
    from contact_tracker.adaptation.with_wrenches import NoLoad, wrench_evidence
    from contact_tracker.motion.poses import Poses
    from contact_tracker.recording import open_log
    from contact_tracker.recording.wrenches import read_wrenches

    log = open_log(name, args.topic, args.frame, relative_to=args.relative_to, time_unit=args.time_unit)
    poses = Poses.join(list(log.batches()))
    if not len(poses):
        return None  # the command itself says so
    found = read_wrenches(name, args.wrench, log.source, poses, log.stamping.by_log_time)
    noted = f"; dropped {found.dropped}" if found.dropped else ""
    try:
        with progress(f"{name}: load", "poses", len(poses)) as set_done:
            evidence, load = wrench_evidence(poses, found.wrenches, model, knowledge, args.mass, set_done)
    except NoLoad as reason:
        warn(f"{name}: {args.wrench} is not used: {reason}")
        return None
    say(
        f"{name}: {len(found.wrenches)} wrenches in the frame {found.frame_id or '(none)'}{noted}; "
        f"the hand carries {load.mass_kg:.3f} kg, by {load.ticks:.0f} ticks of free motion"
    )
    return evidence
