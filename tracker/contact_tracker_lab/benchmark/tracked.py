"""The tracker as a method: offline, offline with the map of an earlier take, online, and with a lag."""

from pathlib import Path
from typing import Final

import numpy as np

from contact_tracker.arrays import Ints
from contact_tracker.config.parameters import Model
from contact_tracker.map.elements import NOTHING_LEARNED
from contact_tracker.map.map import EMPTY_MAP, Map
from contact_tracker.motion.poses import Poses
from contact_tracker.recording import open_log
from contact_tracker.segmenting import segmented
from contact_tracker.tracking.segmentation import Beliefs
from contact_tracker.trajectory import Trajectory
from contact_tracker_lab.benchmark.scores import OFFLINE, Answer, Labelling, Method
from contact_tracker_lab.evaluation.evaluate import answers_to, gated
from contact_tracker_lab.evaluation.scoring import tick_containing, tick_in_force

NAME: Final = "tracker"
WITH_MAP: Final = "tracker with a map"
LAG_S: Final = 1.0


def methods(model: Model, earlier: Path | None = None) -> dict[Method, Labelling]:
    """The ways to use the tracker on poses alone, or the one with the map of an ``earlier`` take."""
    if earlier is not None:
        return {Method(WITH_MAP, OFFLINE): lambda poses: _with_map(poses, model, earlier)}
    return {
        Method(NAME, OFFLINE): lambda poses: _offline(poses, model)[0],
        Method(NAME, LAG_S): lambda poses: _with_lag(poses, model),
        Method(NAME, 0.0): lambda poses: _online(poses, model),
    }


def _offline(poses: Poses, model: Model, known_map: Map = EMPTY_MAP) -> tuple[Answer, Map]:
    """Labels of ``segment``, each frame with that of the tick that contains it, and the map."""
    found = segmented(Trajectory(poses), model, known_map)
    learned = NOTHING_LEARNED if found.touched is None else found.touched.learned
    tick = tick_containing(poses.stamp_ns, found.beliefs.stamp_ns)
    return _answer(tick, found.beliefs), Map(learned=learned)


def _with_map(poses: Poses, model: Model, earlier: Path) -> Answer:
    known_map = _offline(Poses.collect(open_log(str(earlier))), model)[1]
    return _offline(poses, model, known_map)[0]


def _online(poses: Poses, model: Model) -> Answer:
    """The latest answer of ``live`` at each frame."""
    answers = answers_to(gated(poses), model)
    return _answer(tick_in_force(poses.stamp_ns, answers.arrival_ns), answers.beliefs)


def _with_lag(poses: Poses, model: Model) -> Answer:
    """The answer of ``live --lag`` for each frame, given ``LAG_S`` later."""
    beliefs = answers_to(gated(poses), model, lag_s=LAG_S).beliefs
    return _answer(tick_containing(poses.stamp_ns, beliefs.stamp_ns), beliefs)


def _answer(tick: Ints, beliefs: Beliefs) -> Answer:
    return Answer(tick, beliefs.rows["contact"].astype(np.int64), beliefs.probability)
