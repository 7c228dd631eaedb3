"""Accuracy with known geometry, on recordings with true elements and the vertices of the object.

    python tests/benchmarks/known_geometry.py
    python tests/benchmarks/known_geometry.py FOLDER --set sequence --off exact 2mm,1deg

Given are, to the usual standard deviations: nothing; the elements of the surroundings that are touched, not
as a complete list; all faces, edges and vertices of the object; and both. With ``--off`` the elements of each
side are displaced and turned together, at random, by that much. Figures are means over the recordings, as in
field.py; ``warned`` is the share of the recordings for which what is given is reported as wrong.
"""

import sys
import zlib
from itertools import product
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from contact_tracker.arrays import Array
from contact_tracker.config.loading import load_model
from contact_tracker.config.quantities import deviations
from contact_tracker.geometry.elements import Element, Line, Plane, Point, shifted
from contact_tracker.geometry.polyhedron import convex
from contact_tracker.ground_truth import Truth
from contact_tracker.map.map import Accuracy, Map, NamedElement, elements_of, known_to, number_name
from contact_tracker.motion.poses import Poses
from contact_tracker.recording import need_truth, read_metadata
from contact_tracker.segmenting import segmented
from contact_tracker.tracking.belief import Detail
from contact_tracker.trajectory import Trajectory, vertices_from_metadata
from contact_tracker_lab.benchmark.runner import Table, find_sets, measured, parser_of, report
from contact_tracker_lab.evaluation.evaluate import Evaluation, evaluate
from contact_tracker_lab.evaluation.geometry_errors import is_same
from contact_tracker_lab.evaluation.tables import number
from shared_recordings import SHARED_RECORDINGS
from summaries import FIGURES, figures, read_gated

LEVELS: Final = ("nothing", "surroundings", "object", "both")
COLUMNS: Final = ("known", "off", *FIGURES, "warned")
EXACT: Final = "exact"


class Displacement(NamedTuple):
    """A rotation (3, 3) about the origin, then a shift by ``by_m`` (3,)."""

    rotation: Array
    by_m: Array

    @classmethod
    def random(cls, off: tuple[float, float], centre_m: Array, rng: np.random.Generator) -> "Displacement":
        """By ``off`` (m, rad) at ``centre_m`` (3,), in random directions."""
        shift, axis = (vector / np.linalg.norm(vector) for vector in rng.standard_normal((2, 3)))
        rotation = Rotation.from_rotvec(off[1] * axis).as_matrix()
        return cls(rotation, off[0] * shift + centre_m - rotation @ centre_m)

    def of(self, element: Element) -> Element:
        """The element, displaced."""
        match element:
            case Plane(normal, offset_m):
                turned: Element = Plane(self.rotation @ normal, offset_m)
            case Line(direction, point_m):
                turned = Line(self.rotation @ direction, self.rotation @ point_m)
            case Point(point_m):
                turned = Point(self.rotation @ point_m)
        return shifted(turned, self.by_m)


class Measured(NamedTuple):
    """One recording at one level of knowledge."""

    evaluation: Evaluation
    is_warned: bool


def touched(truth: Truth) -> list[Element]:
    """The elements of the surroundings that are touched, each once."""
    elements = list[Element]()
    for element in (one.geometry.environment for one in truth.intervals if one.geometry is not None):
        if not any(type(one) is type(element) and is_same(one, element) for one in elements):
            elements.append(element)
    return elements


def known(path: Path, level: str, poses: Poses, truth: Truth, off: tuple[float, float]) -> Map:
    """The map of ``level``, displaced by ``off`` (m, rad)."""
    rng, accuracy = np.random.default_rng(zlib.crc32(path.stem.encode())), Accuracy()
    middle_m = poses.position_m.mean(axis=0)
    around, body = Displacement.random(off, middle_m, rng), Displacement.random(off, np.zeros(3), rng)
    surroundings = tuple(
        NamedElement(f"element {number}", known_to(around.of(element), accuracy, middle_m))
        for number, element in enumerate(touched(truth), start=1)
    )
    vertices_m = vertices_from_metadata(read_metadata(str(path)))
    if vertices_m is None:
        raise SystemExit(f"{path}: its metadata have no vertices of the object")
    object = elements_of(convex(vertices_m), number_name, accuracy, body.rotation, body.by_m)
    return Map(
        listed_environment=surroundings if level in ("surroundings", "both") else (),
        listed_object=object if level in ("object", "both") else (),
        object_complete=level in ("object", "both"),
    )


def measure(path: Path, level: str, off: tuple[float, float]) -> Measured:
    """Track and evaluate one recording."""
    poses, truth = read_gated(path), need_truth(str(path))
    found = segmented(
        Trajectory(poses), load_model(), known(path, level, poses, truth, off), detail=Detail.GEOMETRY
    )
    is_warned = found.report is not None and any(one.kind == "knowledge" for one in found.report.findings)
    return Measured(evaluate(poses, truth, found.segmentation), is_warned)


def displacement(text: str) -> tuple[float, float]:
    """A distance (m) and an angle (rad)."""
    return (0.0, 0.0) if text == EXACT else deviations(text)


def main() -> int:
    parser = parser_of(__doc__, has_sets=True, folder=SHARED_RECORDINGS)
    parser.add_argument(
        "--off", nargs="+", default=[EXACT], metavar="MM,DEG", help=f"as 2mm,1deg; default: {EXACT}"
    )
    args = parser.parse_args()
    paths = [path for some in find_sets(args.folder, args.set).values() for path in some]
    jobs = {
        (level, off if level != LEVELS[0] else "-"): [(path, level, displacement(off)) for path in paths]
        for level, off in product(LEVELS, args.off)
    }
    rows = list[list[str]]()
    for case, found in measured(measure, jobs, args.processes):
        warned = number(float(np.mean([one.is_warned for one in found])))
        rows.append([*case, *figures([one.evaluation for one in found]), warned])
    return report(args, known=Table(COLUMNS, rows))


if __name__ == "__main__":
    sys.exit(main())
