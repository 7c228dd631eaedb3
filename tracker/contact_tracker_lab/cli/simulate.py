"""``contact-tracker simulate``: labelled recordings with exact truth."""

import argparse
from functools import partial
from typing import Final

from contact_tracker.cli import arguments
from contact_tracker.cli.terminal import say, show
from contact_tracker.errors import DONE, UsageError
from contact_tracker.exports.formats import check_output

HELP: Final = "make a labelled recording"
DESCRIPTION: Final = """\
Simulate an object that moves in contact with its surroundings, measured with noise, and write its
poses with the true contacts. The same scenario and seed give the same recording."""
EXAMPLE: Final = "contact-tracker simulate all_states --seed 7 -o all_states.mcap"


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("scenario", nargs="?", metavar="SCENARIO", help="a name out of --list")
    parser.add_argument("--list", action="store_true", help="list the scenarios and exit")
    kind = partial(arguments.whole_number, least=0, most=2**64)
    text = "seed of all that is random (default: %(default)s)"
    parser.add_argument("--seed", type=kind, default=0, metavar="N", help=text)
    arguments.add_output(parser, (".mcap",), "write FILE.mcap")


def run(args: argparse.Namespace) -> int:
    if args.list:
        return _list(args.seed)
    if args.scenario is None or args.output is None:
        raise UsageError("simulate needs a SCENARIO and -o FILE.mcap, or --list")
    check = check_output(args.output, args.overwrite)

    from contact_tracker.recording import write_recording
    from contact_tracker_lab.simulate import simulate

    sim = simulate(args.scenario, args.seed)
    write_recording(str(args.output), sim.poses, sim.truth, sim.metadata, check, sim.wrenches)
    count = len(sim.truth.intervals)
    intervals = "interval" if count == 1 else "intervals"
    say(f"{len(sim.poses)} poses, {count} {intervals} of truth in {args.output}")
    return DONE


def _list(seed: int) -> int:
    from contact_tracker_lab.simulate import SCENARIOS, named_scenario

    for name in SCENARIOS:
        scenario = named_scenario(name, seed)
        contacts = " ".join(phase.contact.value for phase in scenario.phases)
        if scenario.further is not None:
            contact, start_s, end_s = scenario.further
            contacts += f" + {contact.value}"
            contacts += "" if start_s is None else f" from {start_s:g} s"
            contacts += "" if end_s is None else f" to {end_s:g} s"
        text = f"{scenario.object} on {scenario.surroundings}: {contacts}"
        text += ", with wrenches" if scenario.has_wrench else ""
        if scenario.joint is not None:
            text = f"{scenario.object} in a joint: {scenario.joint.value}"
        seconds = sum(phase.duration_s for phase in scenario.phases)
        size = f"{scenario.rate_hz:5.0f} Hz {seconds:5.0f} s"
        show(f"{name:<18}{size}  {text}")
    return DONE
