"""Poses that were recorded in another convention are found out, and none that were not."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from contact_tracker import adaptation
from contact_tracker.adaptation import conventions, online
from contact_tracker.adaptation.conventions import READINGS
from contact_tracker.hypotheses import compiled
from contact_tracker.motion.poses import Poses
from contact_tracker.recording import open_log
from contact_tracker.tracking.segmentation import Segmentation
from short_recordings import MODEL
from smooth_motion import slid_and_tilted

RECORDINGS = Path(__file__).parents[2] / "recordings"
SIGMA = {"sigma_position_m": 5e-4, "sigma_rotation_deg": 0.2}
needs_kernels = pytest.mark.skipif(not compiled.in_use(), reason="too slow in numpy")


def with_quaternions(poses: Poses, order: list[int], sign: float = 1.0) -> Poses:
    return replace(poses, quat_xyzw=(poses.quat_xyzw * [sign, sign, sign, 1.0])[:, order])


def inverse(poses: Poses) -> Poses:
    turn = Rotation.from_quat(poses.quat_xyzw).inv()
    return replace(poses, position_m=-turn.apply(poses.position_m), quat_xyzw=turn.as_quat())


MISTAKES: dict[str, tuple[str, Callable[[Poses], Poses]]] = {
    "w first": ("w x y z", lambda poses: with_quaternions(poses, [3, 0, 1, 2])),
    "inverted": ("inverted", lambda poses: with_quaternions(poses, [0, 1, 2, 3], -1.0)),
    "w first and inverted": (
        "reorder and conjugate",
        lambda poses: with_quaternions(with_quaternions(poses, [0, 1, 2, 3], -1.0), [3, 0, 1, 2]),
    ),
    "w last in fields of w first": (
        "x y z w in fields that are w x y z",
        lambda poses: with_quaternions(poses, [1, 2, 3, 0]),
    ),
    "w last in fields of w first, and inverted": (
        "x y z w in fields that are w x y z, and inverted",
        lambda poses: with_quaternions(with_quaternions(poses, [0, 1, 2, 3], -1.0), [1, 2, 3, 0]),
    ),
    "inverse": ("inverse, of the world", inverse),
}


def tracked(poses: Poses) -> tuple[list[str], Segmentation]:
    tracker = adaptation.OfflineTracker(MODEL)
    found = Segmentation.join(list(tracker.pieces(poses)))
    assert tracker.report is not None
    return [finding.text for finding in tracker.report.findings], found


@pytest.mark.long
@needs_kernels
@pytest.mark.parametrize("mistake", ["w first", "w last in fields of w first"])
def test_orders_of_quaternions_that_explain_the_motion_alike_are_all_named(mistake: str) -> None:
    """Turns about few axes are alike but for half turns, which put a face or an edge on the wrong side."""
    right = slid_and_tilted(np.random.default_rng(1), np.array([0.2, 0.12, 0.08]))
    (text,), _ = tracked(MISTAKES[mistake][1](right))
    assert text.startswith("quaternions look like w x y z in fields that are x y z w: reorder them; or ")
    assert "x y z w in fields that are w x y z: reorder them" in text


@needs_kernels
@pytest.mark.parametrize(
    ("name", "mistake"),
    [
        ("robot_1khz", "w first"),
        ("robot_1khz", "inverse"),
        pytest.param("paper_experiment", "inverted", marks=pytest.mark.long),
        *(
            pytest.param("robot_1khz", mistake, marks=pytest.mark.long)
            for mistake in MISTAKES
            if mistake not in ("w first", "inverse", "inverted")
        ),
    ],
)
def test_mistakes_of_convention_are_reported_and_no_label_is_certain(name: str, mistake: str) -> None:
    said, wrong = MISTAKES[mistake]
    texts, found = tracked(wrong(Poses.collect(open_log(str(RECORDINGS / f"{name}.mcap")))))
    assert len(texts) == 1
    assert said in texts[0]
    assert max(belief.probability.max() for belief in found.beliefs) < 0.9


@pytest.mark.long
@needs_kernels
@pytest.mark.parametrize("frame_moves", [False, True])
def test_poses_that_were_asked_for_in_a_moving_frame_are_not_inverse(frame_moves: bool) -> None:
    """Those of a table in the cup's frame are the inverse of the cup's poses."""
    poses = inverse(Poses.collect(open_log(str(RECORDINGS / "paper_experiment.mcap")))[:4000])
    state, _ = online.advance(online.start(MODEL, frame_moves=frame_moves), poses)
    assert ["inverse" in finding.text for finding in state.findings] == ([] if frame_moves else [True])
    assert state.is_in_doubt is not frame_moves
    tracker = adaptation.OfflineTracker(MODEL, frame_moves=frame_moves)
    found = Segmentation.join(list(tracker.pieces(poses)))
    is_certain = max(belief.probability.max() for belief in found.beliefs) > 0.9
    assert bool(is_certain) is frame_moves


def slow_vertex_on_a_table() -> Poses:
    """60 s at 100 Hz with 0.3 mm and 0.1 deg, in turns and shifts of 7 to 16 s."""
    rng, t = np.random.default_rng(1), np.arange(6000) * 0.01
    turns = np.stack([0.35 * np.sin(0.9 * t), 0.3 * np.sin(0.7 * t + 1.0), 0.6 * np.sin(0.5 * t)], axis=1)
    turn = Rotation.from_rotvec(turns) * Rotation.from_rotvec([-1.5, 1.5, 0.0])
    foot_m = np.stack([0.4 + 0.12 * np.sin(0.4 * t), 0.1 * np.cos(0.55 * t), np.full_like(t, 0.75)], axis=1)
    position_m = foot_m - turn.apply([0.05, 0.05, 0.05]) + rng.normal(0.0, 3e-4, (6000, 3))
    noisy = turn * Rotation.from_rotvec(rng.normal(0.0, np.radians(0.1), (6000, 3)))
    quat = noisy.as_quat()
    quat *= np.cumprod(np.sign(np.r_[1.0, (quat[1:] * quat[:-1]).sum(axis=1)]))[:, None]
    return Poses(np.arange(6000) * 10_000_000, position_m, quat)


@pytest.mark.long
@needs_kernels
def test_a_mistake_that_slow_motion_shows_late_is_reported() -> None:
    said, wrong = MISTAKES["w first"]
    right = slow_vertex_on_a_table()
    assert tracked(right)[0] == []
    assert [said in text for text in tracked(wrong(right))[0]] == [True]


@pytest.mark.parametrize("reading", range(len(READINGS)))
def test_each_reading_undoes_its_mistake(reading: int) -> None:
    rng = np.random.default_rng(1)
    clean = Poses(np.arange(5), rng.normal(size=(5, 3)), Rotation.random(5, random_state=2).as_quat())
    _, order, sign = READINGS[reading]
    stored = with_quaternions(clean, list(np.argsort(order)), sign)
    np.testing.assert_array_equal(conventions.read(stored, reading).quat_xyzw, clean.quat_xyzw)
