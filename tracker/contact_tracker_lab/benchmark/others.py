"""Methods of others: a threshold on speed, a function that you write, and labels in files.

A function gets ``stamp_ns`` (N,), ``position_m`` (N, 3) and ``quat_xyzw`` (N, 4) of ``T_world_body`` and
returns for each pose a label ("f-f" ... "free", "" for none) or (N, 7) probabilities in the order of
``STATES``. It may use all poses for each, so it is scored as offline.
"""

from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from runpy import run_path
from typing import Any, Final

import numpy as np

from contact_tracker.arrays import Ints
from contact_tracker.errors import UsageError
from contact_tracker.motion.poses import Poses
from contact_tracker.recording.annotations import read_labels
from contact_tracker.states import STATES, Contact
from contact_tracker_lab.benchmark.scores import OFFLINE, Answer, Labelling, Method
from contact_tracker_lab.evaluation.scoring import scoring

STILL: Final = "speed threshold"
STILL_M_PER_S, STILL_RAD_PER_S = 0.01, 0.05
STILL_S: Final = 0.5
"""An object that moves less than these speeds within this time (s) is in f-f, else free. A trivial method to
compare with, in round numbers that were not chosen on any recording."""


def answer_by_speed(poses: Poses) -> Answer:
    """Online: f-f if the object has not left its place of half a second ago, else free."""
    earlier = np.searchsorted(poses.stamp_ns, poses.stamp_ns - round(STILL_S * 1e9)).clip(0)
    moved_m = np.linalg.norm(poses.position_m - poses.position_m[earlier], axis=1)
    cosine = np.abs(np.einsum("ni,ni->n", poses.quat_xyzw, poses.quat_xyzw[earlier])).clip(max=1.0)
    turned_rad = 2.0 * np.arccos(cosine)
    rests = (moved_m < STILL_M_PER_S * STILL_S) & (turned_rad < STILL_RAD_PER_S * STILL_S)
    label = np.where(rests, Contact.FF.column, Contact.FREE.column)
    return Answer.certain(np.arange(len(label)), label.astype(np.int64))


def load_function(name: str) -> tuple[Method, Labelling]:
    """The method ``module:function`` or ``file.py:function``; raises UsageError."""
    source, colon, function_name = name.rpartition(":")
    if not colon:
        raise UsageError(f"a method is module:function or file.py:function, not {name!r}")
    try:
        names = run_path(source) if source.endswith(".py") else vars(import_module(source))
    except (ImportError, OSError) as error:
        raise UsageError(f"{name}: {error}") from error
    if function_name not in names:
        raise UsageError(f"{name}: {source} has no {function_name}")
    function: Callable[..., Any] = names[function_name]

    def answer(poses: Poses) -> Answer:
        return answer_of(function(poses.stamp_ns, poses.position_m, poses.quat_xyzw), len(poses), name)

    return Method(name, OFFLINE), answer


def answer_of(values: Any, count: int, name: str) -> Answer:
    """The answer for ``count`` poses from a function's ``values``; raises UsageError."""
    array = np.asarray(values)
    if array.shape == (count, len(STATES)):
        probability = array.astype(float)
        if not (probability >= 0.0).all() or np.abs(probability.sum(axis=1) - 1.0).max() > 1e-6:
            raise UsageError(f"{name}: the probabilities of each pose have to be positive and add up to 1")
        return Answer.most_probable(np.arange(count), probability)
    if array.shape != (count,):
        raise UsageError(
            f"{name} returned {array.shape} for {count} poses: one label each, or ({count}, 7) probabilities"
        )
    columns = {"": -1, **{state.value: state.column for state in STATES}}
    unknown = next((text for text in map(str, values) if text not in columns), None)
    if unknown is not None:
        raise UsageError(f"{name}: no contact {unknown!r}; contacts are {', '.join(STATES)}")
    return _per_frame(np.array([columns[str(text)] for text in values], np.int64))


def answer_from_labels(poses: Poses, path: Path) -> Answer:
    """The labels in a file (``start``, ``end``, ``contact``), as ``evaluate --labels`` reads them."""
    truth = read_labels(str(path), int(poses.stamp_ns[0]), int(poses.stamp_ns[-1]))[0]
    return _per_frame(scoring(poses.stamp_ns, truth).truth.astype(np.int64))


def _per_frame(label: Ints) -> Answer:
    """An answer of one label for each frame, -1 for none."""
    return Answer.certain(np.where(label >= 0, np.arange(len(label)), -1), np.maximum(label, 0))
