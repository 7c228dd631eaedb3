"""Arguments for prior knowledge: ``--known FILE`` for all of it, and shortcuts for common parts."""

import argparse
import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from contact_tracker.cli.terminal import warn

if TYPE_CHECKING:
    from contact_tracker.landmarks.prior_map import PriorMap


def add_known(parser: argparse.ArgumentParser) -> None:
    """``--known`` and its shortcuts."""
    group = parser.add_argument_group(
        "what is known", "in metres; a value that begins with a minus is written as --plane=-1,0,0,0.5"
    )
    group.add_argument("--known", metavar="FILE", help="a TOML file that says what is known and how exactly")
    group.add_argument(
        "--up",
        type=_numbers("0,0,1", 3, 4),
        metavar="X,Y,Z[,DEG]",
        help="faces of the surroundings look along this direction, within DEG degrees (default: 2)",
    )
    group.add_argument(
        "--plane",
        type=_numbers("0,0,1,0.75", 4),
        action="append",
        default=[],
        metavar="NX,NY,NZ,H",
        help="a face n . x = H of the surroundings, its normal on the free side; may be repeated",
    )
    group.add_argument(
        "--box",
        type=_numbers("0.2,0.1,0.1", 3),
        metavar="A,B,C",
        help="the object is a box with edges of A, B and C metres about the body frame's origin",
    )


def knowledge_of(args: argparse.Namespace, note: Callable[[str], None] = warn) -> "PriorMap":
    """The prior map of the arguments, with a ``note`` of what is doubtful in it; raises KnowledgeError."""
    from contact_tracker.prior_map_files.loading import knowledge_from, merged, read_table

    folder = Path(args.known).parent if args.known is not None else Path()
    tables = [] if args.known is None else [read_table(args.known)]
    return knowledge_from(merged([*tables, *_shortcuts(args)]), folder, note)


def _shortcuts(args: argparse.Namespace) -> list[dict[str, Any]]:
    """The shortcuts as tables of the file."""
    tables: list[dict[str, Any]] = []
    if args.up is not None:
        spread = {"spread_deg": args.up[3]} if len(args.up) > 3 else {}
        tables.append({"up": {"direction": args.up[:3], **spread}})
    if args.plane:
        planes = [{"normal": plane[:3], "offset_m": plane[3]} for plane in args.plane]
        tables.append({"environment": {"plane": planes}})
    if args.box is not None:
        tables.append({"object": {"box": {"size_m": args.box}}})
    return tables


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
