"""``contact-tracker view``: everything about a recording in the rerun viewer."""

import argparse
from typing import Final

from contact_tracker.cli.arguments import add_model, add_recording, output_file

HELP: Final = "see a recording in the rerun viewer"
DESCRIPTION: Final = """\
Show a recording in rerun: the moving body with the touching plane, line or point, labels and
probabilities over time (online and smoothed, beside the truth where it is known), and the paper's
objective functions."""
EXAMPLE: Final = "contact-tracker view recordings/all_states.mcap --save all_states.rrd --no-open"


def configure(parser: argparse.ArgumentParser) -> None:
    add_recording(parser)
    add_model(parser)
    parser.add_argument("--save", type=output_file(".rrd"), metavar="FILE", help="write FILE.rrd")
    parser.add_argument("--no-open", action="store_true", help="do not open the viewer")


def run(args: argparse.Namespace) -> int:
    raise NotImplementedError
