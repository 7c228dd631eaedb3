"""``evaluate``: a result against the user's own labels."""

import os
from collections.abc import Mapping
from pathlib import Path

from contact_tracker.api.given import ModelLike, model_from, path_from
from contact_tracker.api.offline import Result
from contact_tracker.errors import UsageError
from contact_tracker.recording import read_labels
from contact_tracker_lab.evaluation.answers import answers_to
from contact_tracker_lab.evaluation.evaluate import evaluate as evaluate_against
from contact_tracker_lab.evaluation.report import Report

__all__ = ["evaluate"]


def evaluate(
    result: Result,
    labels: str | os.PathLike[str],
    meanings: Mapping[str, str] | None = None,
    by_arrival: bool = False,
    model: ModelLike = "default",
) -> Report:
    """Compare a result with your own labels.

    Parameters
    ----------
    labels : a table with the columns ``start``, ``end`` and ``contact`` (docs/python.md).
    meanings : states by label: ``{"touch": "any", "flat": "f-f|e-f", "unclear": "?"}``. Names of states need
        none; coarse labels are right with each of their states.
    by_arrival : track the poses online as well, with ``model``, and score what had been answered when.

    Returns
    -------
    Report
        Its text has the tables of ``contact-tracker evaluate``; ``total.offline``, ``total.online`` and
        ``total.arrival`` have accuracy, confusion, errors of boundaries, and delays.

    Raises
    ------
    NoTruth
        The file is no such table.
    UsageError
        It is not said what a label means, or an argument is of the wrong type.
    """
    if not isinstance(result, Result):
        raise UsageError(f"a result is what segment returns, not {type(result).__name__}")
    path, poses = path_from(labels, "labels"), result.trajectory.poses
    truth, _ = read_labels(path, int(poses.stamp_ns[0]), int(poses.stamp_ns[-1]), meanings)
    answers = answers_to(poses, model_from(model)) if by_arrival else None
    name = Path(result.trajectory.name).name
    return Report({name: evaluate_against(poses, truth, result.segmentation, answers)})
