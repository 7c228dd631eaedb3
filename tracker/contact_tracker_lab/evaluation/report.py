"""The report of ``evaluate``: text tables within 80 columns, or JSON; of a result and the user's labels."""

import json
import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial, reduce
from operator import add
from pathlib import Path
from typing import Any, Final

from contact_tracker.api.offline import Labels, Result
from contact_tracker.arrays import Array
from contact_tracker.errors import UsageError, printable
from contact_tracker.states import STATES
from contact_tracker.trajectory.arguments import ModelLike, model_from, with_known_arguments
from contact_tracker_lab.evaluation.evaluate import Evaluation, answers_to, gated
from contact_tracker_lab.evaluation.evaluate import evaluate as evaluate_segmentation
from contact_tracker_lab.evaluation.geometry_errors import GeometryErrors
from contact_tracker_lab.evaluation.metrics import Tally, quantile
from contact_tracker_lab.evaluation.scoring import Subset
from contact_tracker_lab.evaluation.tables import number, table

TOTAL: Final = "total"
WIDEST_NAME: Final = 20
"""Largest width of a recording's name beside its numbers; above them it may fill a line."""
WIDTH: Final = 80

ACCURACY_NOTE: Final = """\
Share of the time in which the label was right: over all scored frames; over
those more than 0.25 s from a true change (clear); over those whose motion
determines the contact (identifiable), and over the others, singular or at rest
before the first motion (ambiguous); without the rest at the start (moved). F1:
mean over the true states. Online: the latest belief up to the stamp of a pose;
by arrival: the latest that `live` has given out when the pose comes."""
LABELS_NOTE: Final = """\
Share of the time in which the label was right: over all scored frames; over
those more than 0.25 s from a true change (clear). The labels do not say how
the object moved. F1: mean over the true states. Online: the latest belief up
to the stamp of a pose; by arrival: the latest that `live` has given out when
the pose comes."""
BELIEF_NOTE: Final = """\
Log-loss in nats; Brier score 0 to 2; ECE: expected calibration error, 15 bins;
sure & wrong: share of the time with a probability above 0.9 on a wrong state;
open: share in which the motion leaves the contact open, whatever the label."""
CHANGE_NOTE: Final = """\
Boundary: from a true change to the nearest found one, median and 90 %; missed:
share without one. Delay: from a true onset until the label is right for 0.3 s;
never: share without such a time."""
GEOMETRY_NOTE: Final = """\
Found: true segments found with geometry. Angle of normals and directions,
distance of the true element from the found one where they touched, median and
90 %; share of the elements within 3 standard deviations (sd) of the found
covariance."""


@dataclass(frozen=True, eq=False)
class Report:
    """Evaluations by name of the recording, at least one, in the order of the tables."""

    recordings: Mapping[str, Evaluation]

    def __str__(self) -> str:
        return self.to_text()

    @property
    def total(self) -> Evaluation:
        return reduce(add, self.recordings.values())

    def to_text(self) -> str:
        """Tables per recording and in total, without a trailing newline."""
        total, subsets = self.total, self.total.offline.subsets
        entries = [*self.recordings.items()]
        entries += [(TOTAL, total)] if len(entries) > 1 else []
        blocks = [
            table(
                ("recording", "scored s", *(s.name.lower() for s in subsets), "F1"),
                _mode_rows(entries, partial(_accuracy_cells, subsets)),
            ),
            ACCURACY_NOTE if len(subsets) == len(Subset) else LABELS_NOTE,
            table(
                _BELIEF, _mode_rows(entries, lambda t: [number(getattr(t, name)) for name in _BELIEF_FIGURES])
            ),
            BELIEF_NOTE,
            table(_CHANGE, _mode_rows(entries, _change_cells)),
            CHANGE_NOTE,
            _confusion_text("offline", total.offline),
            _confusion_text("online", total.online),
        ]
        if total.geometry.true_segments:
            rows = [[_short(name, WIDEST_NAME), *_geometry_cells(value.geometry)] for name, value in entries]
            kinds = ("plane", "line", "point")
            rows += [[f"  {kind}s", *_geometry_cells(total.geometry.of_kind(kind), False)] for kind in kinds]
            blocks += [table(_GEOMETRY, rows), GEOMETRY_NOTE]
        return "\n\n".join(blocks)

    def to_json(self) -> str:
        """JSON object with ``recordings`` by name, ``total`` and ``states``; null for missing values."""
        values = {
            "states": STATES,
            "recordings": {name: _evaluation_json(value) for name, value in self.recordings.items()},
            "total": _evaluation_json(self.total),
        }
        return json.dumps(_without_nan(values), indent=1, allow_nan=False)


@with_known_arguments
def evaluate(
    result: Result,
    labels: Labels,
    meanings: Mapping[str, str] | None = None,
    by_arrival: bool = False,
    model: ModelLike = "default",
) -> Report:
    """Compare a result with your own labels.

    Parameters
    ----------
    labels : a file or a DataFrame with the columns ``start``, ``end`` and ``contact`` (docs/python.md).
    meanings : states by label: ``{"touch": "any", "flat": "f-f|e-f", "unclear": "?"}``. Names of states need
        none; coarse labels are right with each of their states.
    by_arrival : track the poses online as well, with ``model``, and score the answers by the time of arrival.

    Returns
    -------
    Report
        Its text has the tables of ``contact-tracker evaluate``; ``total.offline``, ``total.online`` and
        ``total.arrival`` have accuracy, confusion, errors of boundaries, and delays.

    Raises
    ------
    NoTruth
        The labels are not such a table.
    UsageError
        The meaning of a label is missing, or an argument is of the wrong type.
    """
    if not isinstance(result, Result):
        raise UsageError(f"a result is what segment returns, not {type(result).__name__}")
    poses, truth = result.trajectory.poses, result.truth_by(labels, meanings)
    answers = answers_to(gated(poses), model_from(model)) if by_arrival else None
    name = Path(result.trajectory.name).name
    return Report({name: evaluate_segmentation(poses, truth, result.segmentation, answers)})


_BELIEF: Final = ("recording", "log-loss", "Brier", "ECE", "sure & wrong", "open")
_BELIEF_FIGURES: Final = ("log_loss", "brier", "calibration_error", "sure_wrong", "open")
_CHANGE: Final = ("recording", "changes", "boundary s", "90 %", "missed", "delay s", "90 %", "never")
_GEOMETRY: Final = ("recording", "found", "angle deg", "90 %", "distance mm", "90 %", "within 3 sd")


def _short(name: str, widest: int = WIDTH) -> str:
    name = printable(name)
    return name if len(name) <= widest else "…" + name[1 - widest :]


def _mode_rows(entries: list[tuple[str, Evaluation]], cells: Callable[[Any], list[str]]) -> list[list[str]]:
    """The name of each entry, and below it a row for each mode."""
    rows = []
    for name, value in entries:
        rows.append([_short(name)])
        for mode in ("offline", "online", "by arrival"):
            scores = getattr(value, mode.removeprefix("by "))
            if scores is not None:
                rows.append([f"  {mode}", *cells(scores)])
    return rows


def _accuracy_cells(subsets: Iterable[Subset], tally: Tally) -> list[str]:
    accuracies = (number(tally.accuracy(subset)) for subset in subsets)
    return [number(tally.seconds(), 1), *accuracies, number(tally.macro_f1)]


def _median_and_most(values: Array) -> list[str]:
    """The median and the quantile of 90 %."""
    return [number(quantile(values, q), 2) for q in (0.5, 0.9)]


def _change_cells(tally: Tally) -> list[str]:
    return [
        str(len(tally.into)),
        *_median_and_most(tally.boundary_s),
        number(tally.missed_share, 2),
        *_median_and_most(tally.delay_s),
        number(tally.never_share, 2),
    ]


def _geometry_cells(errors: GeometryErrors, with_found: bool = True) -> list[str]:
    return [
        f"{errors.found_segments}/{errors.true_segments}" if with_found else "",
        *_median_and_most(errors.angle_deg),
        *_median_and_most(errors.distance_mm),
        number(errors.within_3_sd, 2),
    ]


def _confusion_text(mode: str, tally: Tally) -> str:
    cells = [
        [_short(name, WIDEST_NAME), *(number(s, 1) if s > 0 else "." for s in row)]
        for name, row in zip(tally.rows, tally.confusion_s[Subset.ALL], strict=True)
        if row.any() or not tally.coarse  # a state that no coarse label names has no row
    ]
    title = f"Confusion {mode}, seconds: true state by row, label by column\n"
    return title + table(["", *STATES, "none"], cells)


def _evaluation_json(value: Evaluation) -> dict[str, Any]:
    kinds = {kind: _geometry_json(value.geometry.of_kind(kind)) for kind in ("plane", "line", "point")}
    return {
        **{mode: _tally_json(getattr(value, mode)) for mode in ("offline", "online", "arrival")},
        "geometry": {
            "true_segments": value.geometry.true_segments,
            "found_segments": value.geometry.found_segments,
            **_geometry_json(value.geometry),
            **kinds,
        },
    }


def _tally_json(tally: Tally | None) -> dict[str, Any] | None:
    if tally is None:
        return None
    confusion, known = tally.confusion_s[Subset.ALL], tally.subsets
    return {
        "scored_s": tally.seconds(),
        "accuracy": {s.name.lower(): tally.accuracy(s) if s in known else math.nan for s in Subset},
        "subset_s": {s.name.lower(): tally.seconds(s) if s in known else math.nan for s in Subset},
        **{name: getattr(tally, name) for name in ("macro_f1", *_BELIEF_FIGURES)},
        "boundary_s": {**_quantiles(tally.boundary_s), "missed_share": tally.missed_share},
        "delay_s": {**_quantiles(tally.delay_s), "never_share": tally.never_share},
        "rows": tally.rows,
        "confusion_s": confusion[:, : len(STATES)].tolist(),
        "unanswered_s": confusion[:, len(STATES)].tolist(),
    }


def _geometry_json(errors: GeometryErrors) -> dict[str, Any]:
    return {
        "angle_deg": _quantiles(errors.angle_deg),
        "distance_mm": _quantiles(errors.distance_mm),
        "within_3_sd": errors.within_3_sd,
    }


def _quantiles(values: Array) -> dict[str, float]:
    return {"count": len(values), "median": quantile(values, 0.5), "p90": quantile(values, 0.9)}


def _without_nan(value: Any) -> Any:
    """The same value, with None for numbers that are not finite."""
    if isinstance(value, dict):
        return {key: _without_nan(item) for key, item in value.items()}
    return None if isinstance(value, float) and not math.isfinite(value) else value
