"""Joints: their identification, with and without a joint."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from io import StringIO

import numpy as np
import pytest
from benchmarks.joint_play import (
    NOISES,
    ON_TABLE,
    RATE_HZ,
    Case,
    all_fitted,
    fitted,
    motion,
    strokes,
    ticks_of,
    window_of,
)
from benchmarks.simulated_fits import with_systematic_errors
from scipy.spatial.transform import Rotation

from contact_tracker import segmenting
from contact_tracker.arrays import Array, Ints
from contact_tracker.config.loading import load_model
from contact_tracker.config.parameters import SystematicErrors
from contact_tracker.explanations.conditional_contact import ExplainedTicks, KnownContact
from contact_tracker.explanations.joint_evidence import FittedJoint, Joint, joint_of, likeliest_joint
from contact_tracker.explanations.joint_models import JointFrames, JointKind
from contact_tracker.explanations.joint_parts import find_joints, rests_in
from contact_tracker.exports.formats import open_text
from contact_tracker.geometry.elements import Line, Point
from contact_tracker.geometry.lifted_pose import T, lift
from contact_tracker.motion.poses import Poses
from contact_tracker.motion.window import Window, at_rest
from contact_tracker.states import Contact
from contact_tracker.tracking.segmentation import Segmentation
from contact_tracker.tracking.state import scales_of
from contact_tracker_lab.evaluation.geometry_errors import deviation
from contact_tracker_lab.simulate import Phase, named_scenario, simulate
from contact_tracker_lab.simulate.motion import band_limited
from short_recordings import needs_kernels
from smooth_motion import with_noise

MODEL = load_model()
SCALES = scales_of(MODEL)
SIGMA = (3e-4, np.radians(0.15))
PITCH_M = 0.02
EACH_KIND = [
    pytest.param(kind, marks=pytest.mark.long if kind in (JointKind.SLIDER, JointKind.BALL) else ())
    for kind in JointKind
]


def some_frames(rng: np.random.Generator, pitch_m: float = PITCH_M) -> JointFrames:
    body, world = Rotation.random(2, rng=rng).as_matrix()
    return JointFrames(body, rng.normal(0.0, 0.1, 3), world, rng.normal(0.0, 0.3, 3), pitch_m)


def poses_in(kind: JointKind, frames: JointFrames, rng: np.random.Generator, time_s: Array) -> tuple:
    """Rotations and positions of an object in a joint."""
    first, second, third = band_limited(rng, time_s, 3, 1.0).T
    turn, shift = np.zeros((2, len(time_s), 3))
    match kind:
        case JointKind.HINGE:
            turn[:, 2] = 0.4 * first
        case JointKind.SLIDER:
            shift[:, 2] = 0.1 * first
        case JointKind.SCREW:
            turn[:, 2], shift[:, 2] = 0.4 * first, frames.pitch_m * 0.4 * first
        case JointKind.BALL:
            turn = 0.3 * np.column_stack([first, second, third])
    world, body = Rotation.from_matrix(frames.world_axes), Rotation.from_matrix(frames.body_axes)
    rotation = world * Rotation.from_rotvec(turn) * body.inv()
    return rotation, frames.world_point_m + world.apply(shift) - rotation.apply(frames.body_point_m)


@cache
def moved(
    kind: JointKind, seed: int, seconds: float = 5.0, pitch_m: float = PITCH_M
) -> tuple[JointFrames, Poses]:
    rng = np.random.default_rng(seed)
    time_s = np.arange(0.0, seconds, 1.0 / 200.0)
    frames = some_frames(rng, pitch_m)
    rotation, position = poses_in(kind, frames, rng, time_s)
    return frames, with_noise(rng, time_s, position, rotation, *SIGMA)


@cache
def segmented(kind: JointKind, seed: int) -> Segmentation:
    return segmenting.segment(moved(kind, seed)[1], MODEL)


def joint_in(found: Segmentation) -> Joint:
    longest = max(found.segments, key=lambda one: one.end_ns - one.start_ns)
    assert longest.joint is not None
    return longest.joint


@needs_kernels
@pytest.mark.parametrize("kind", EACH_KIND)
def test_each_joint_is_named_with_its_place(kind: JointKind) -> None:
    found, (frames, _) = segmented(kind, 1), moved(kind, 1)
    joint = joint_in(found)
    assert joint.kind is kind
    assert joint.probability > 0.9
    for element, axes, point_m in (
        (joint.object, frames.body_axes, frames.body_point_m),
        (joint.environment, frames.world_axes, frames.world_point_m),
    ):
        if isinstance(element, Point):
            off, spread = element.point_m - point_m, element.covariance
        else:
            assert isinstance(element, Line)
            sign = np.sign(element.direction @ axes[:, 2])
            off = (sign * element.direction - axes[:, 2]) @ axes[:, :2]
            spread = axes[:, :2].T @ element.covariance[:3, :3] @ axes[:, :2]
        distance = np.sqrt(off @ np.linalg.solve(spread, off))
        assert distance < 4.5
    if kind is JointKind.SCREW:
        assert joint.pitch_sd_m_per_rad is not None
        assert joint.pitch_m_per_rad == pytest.approx(PITCH_M, abs=4.0 * joint.pitch_sd_m_per_rad)


PLAY = JointKind.HINGE, JointKind.SCREW
"""Play of a hinge follows the angle, as no freedom of a ball joint does; it may look like a small pitch."""
FITTED = [
    *((Case("hinge", *one, 0, 0), PLAY) for one in (("waves", 2e-3, 60.0, 0.15), ("sign", 5e-3, 90.0, 0.15))),
    (Case("hinge", "sides", 2e-3, 60.0, 0.3, 0, 0), PLAY),
    # where the play is as large as a small swing, no joint may be named
    (Case("hinge", "waves", 5e-3, 20.0, 0.15, 0, 0), (*PLAY, None)),
    (Case("hinge", "sign", 2e-3, 11.0, 0.15, 0, 0), (*PLAY, None)),
    (Case("hinge", "sign", 5e-3, 6.0, 0.15, 0, 0), (*PLAY, None)),
    (Case("hinge", "sides", 5e-3, 17.0, 0.3, 0, 0), (*PLAY, None)),
    # turned once by a part of a turn it shows no play: its path may be any that is near a circle
    (Case("hinge once", "waves", 5e-3, 60.0, 0.3, 1, 0), (None,)),
    (Case("hinge once", "waves", 5e-3, 800.0, 0.3, 1, 0), tuple(JointKind)),
    # of two turns, as large, that about the arm of a metre does not move the object's origin
    (Case("ball", "1 1 0", 0.0, 17.0, 1.0, 0, 0), (JointKind.BALL,)),
    # a lid with markers on its axis: only the pitch, 4 mm a turn, moves its origin
    (Case("screw", "", 0.64e-3, 57.0, 0.0, 0, 0), (JointKind.SCREW,)),
    # a bent curve, a turn and a slide of their own, and a slide by hand with a turn are no joint
    *((Case("curve", "", *one, 0.0, 0, 0), (None,)) for one in ((0.02, 34.0), (0.05, 70.0), (0.05, 0.0))),
    *(
        (Case("turn and slide", "", 0.0, *one, 0, 0), (None,))
        for one in ((45.0, 0.1), (5.0, 0.3), (25.0, 1.0))
    ),
    *((Case("slide", "", length_m, 60.0, 0.1, 0, 0), (None,)) for length_m in (0.1, 0.2)),
]


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("case", "kinds"), FITTED, ids=str)
def test_the_joint_of_a_motion_is_named(case: Case, kinds: tuple[JointKind | None, ...], seed: int) -> None:
    found = fitted(case._replace(seed=seed))
    assert (found and found.model.kind) in kinds
    if case.joint == "screw":
        assert found.frames.pitch_m == pytest.approx(case.play_m, abs=1e-4)
    elif found is not None and kinds[:2] == PLAY:
        assert abs(found.frames.pitch_m) < 0.005


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("swing_deg", "is_sure"), [(2.3, False), (45.0, True)])
def test_a_shift_along_the_axis_shows_a_screw_over_a_wide_swing_alone(
    swing_deg: float, is_sure: bool, seed: int
) -> None:
    """Over a small one the play of a hinge follows the angle as a pitch does: 1 mm at 0.02 rad."""
    found = fitted(Case("screw", "", 0.05, swing_deg, 0.3, 0, seed))
    assert found is not None
    assert found.model.kind in (JointKind.HINGE, JointKind.SCREW)
    assert (found.log_odds > 5.0) is is_sure
    assert is_sure or found.log_odds < 1.0


APART_M = 0.03
TUMBLE = Case("two axes", "", APART_M, 180.0, 0.1, 1, 0)
"""A box of this height is turned by 90 deg about one edge, rests, and is turned about the next one."""


@pytest.mark.parametrize("apart_m", [0.01, APART_M, 0.2])
@pytest.mark.parametrize("swing_deg", [90.0, 180.0])
@pytest.mark.parametrize("seed", range(3))
def test_turns_about_two_axes_are_two_hinges(apart_m: float, swing_deg: float, seed: int) -> None:
    """One hinge with play would explain both turns if they are near, but neither of them shows play."""
    found = all_fitted(TUMBLE._replace(play_m=apart_m, swing_deg=swing_deg, seed=seed))
    assert [part.model.kind for part in found] == [JointKind.HINGE] * 2
    first, second = found
    assert first.ticks.window.index[-1] + 1 == second.ticks.window.index[0]
    for part, y_m in ((first, 0.0), (second, apart_m)):
        assert np.linalg.norm(part.frames.world_point_m[:2] - [0.0, y_m]) < 1e-3
        assert part.log_odds > 0.0


def joints_in(window: Window, rests: Ints, contacts: Sequence[KnownContact] = ()) -> list[FittedJoint]:
    return find_joints(ExplainedTicks(window, SCALES), rests, contacts, 1)


def test_a_rest_divides_joints_also_if_its_ticks_are_left_out() -> None:
    """Of very long segments only the ticks with the most motion are fitted."""
    window = window_of(TUMBLE)
    resting = at_rest(window, MODEL.tick_s)
    rests, moving = rests_in(window.index, resting), window.pick(np.flatnonzero(~resting))
    found = joints_in(moving, rests)
    assert [part.model.kind for part in found] == [JointKind.HINGE] * 2
    assert len(found[0].ticks) == np.searchsorted(moving.index, rests[0, 0])
    assert sum(len(part.ticks) for part in found) == len(moving)
    for part, y_m in zip(found, (0.0, APART_M), strict=True):
        assert np.linalg.norm(part.frames.world_point_m[:2] - [0.0, y_m]) < 1e-3


@pytest.mark.parametrize("errors", ["none", "harmonics", "waves", "sign", "sides", "shift"])
@pytest.mark.parametrize("swing_deg", [90.0, 180.0])
@pytest.mark.parametrize("seed", range(3))
def test_a_hinge_with_play_that_rests_midway_is_one(errors: str, swing_deg: float, seed: int) -> None:
    """Each half of its swing alone fits better than both, but shows play as well."""
    case = Case("hinge in stages", errors, 2e-3, swing_deg, 0.3, 1, seed)
    assert len(all_fitted(case)) <= 1
    assert errors != "none" or fitted(case) is not None


def joints_between_rests(
    turn: Rotation, place: Array, noise: int, seed: int, contacts: Sequence[KnownContact] = ()
) -> list[FittedJoint]:
    window = ticks_of(turn, place, noise, seed)
    return joints_in(window, rests_in(window.index, at_rest(window, MODEL.tick_s)), contacts)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(
    ("kind", "drift_m"),
    [(JointKind.HINGE, 1e-4), (JointKind.HINGE, 5e-4), (JointKind.SLIDER, 5e-4), (JointKind.SLIDER, 1e-3)],
)
def test_a_joint_stays_one_while_the_tracker_drifts(kind: JointKind, drift_m: float, seed: int) -> None:
    """It is opened and shut with rests; also within a stroke its places drift."""
    time_s = np.arange(40 * RATE_HZ) / RATE_HZ
    opened = 1.0 - np.abs(1.0 - strokes(time_s, 12)[:, None] % 2.0)
    turn, place = Rotation.identity(len(time_s)), 0.3 * opened * [1.0, 0.0, 0.0]
    if kind is JointKind.HINGE:
        turn = Rotation.from_rotvec(opened * [0.0, 0.0, 1.0])
        place = turn.apply([0.3, 0.0, 0.0])
    drift = drift_m * band_limited(np.random.default_rng(seed), time_s, 3, 0.05)
    (found,) = joints_between_rests(turn, place + drift, 1, seed)
    assert found.model.kind is kind


@pytest.mark.parametrize("seed", range(3))
def test_a_slide_and_a_turn_after_it_are_two_joints(seed: int) -> None:
    """A drawer is pulled out and then tilted about its front edge."""
    way = strokes(np.arange(8 * RATE_HZ) / RATE_HZ, 2)[:, None]
    turn = Rotation.from_rotvec(np.maximum(way - 1.0, 0.0) * [0.0, 0.5, 0.0])
    place = 0.3 * np.minimum(way, 1.0) * [1.0, 0.0, 0.0] + turn.apply([-0.2, 0.0, 0.0])
    first, second = joints_between_rests(turn, place, 1, seed)
    assert [first.model.kind, second.model.kind] == [JointKind.SLIDER, JointKind.HINGE]
    assert abs(first.frames.world_axes[0, 2]) == pytest.approx(1.0, abs=1e-3)
    assert second.frames.world_point_m[[0, 2]] == pytest.approx([0.3, 0.0], abs=1e-3)


@pytest.mark.parametrize("arm_m", [0.1, 0.3])
def test_a_slide_by_hand_after_a_turn_is_no_hinge(arm_m: float) -> None:
    """It is near a turn about another axis, but has larger errors than a hinge that moves once."""
    way = strokes(np.arange(8 * RATE_HZ) / RATE_HZ, 2)[:, None]
    first, second = np.minimum(way, 1.0), np.maximum(way - 1.0, 0.0)
    turn = Rotation.from_rotvec((np.pi * first + np.radians(15.0) * second) * [0.0, 0.0, 1.0])
    place = turn.apply([arm_m, 0.0, 0.0]) + 0.05 * second * [0.0, 1.0, 0.0]
    assert not joints_between_rests(turn, place, 2, 0, [ON_TABLE])


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("length_m", [0.1, 0.2])
def test_slides_by_hand_one_after_another_are_no_joints(length_m: float, seed: int) -> None:
    way, rng = strokes(np.arange(8 * RATE_HZ) / RATE_HZ, 2)[:, None], np.random.default_rng(seed)
    angle, place = np.zeros_like(way), np.zeros((len(way), 3))
    for number, toward in enumerate(rng.uniform(0.0, 2.0 * np.pi, 2)):
        part = np.clip(way - number, 0.0, 1.0)
        angle += np.radians(rng.choice([-30.0, 30.0])) * part
        place += length_m * part * [np.cos(toward), np.sin(toward), 0.0]
    turn = Rotation.from_rotvec(angle * [0.0, 0.0, 1.0])
    assert not joints_between_rests(turn, place + turn.apply([0.1, 0.0, 0.0]), 0, seed, [ON_TABLE])


@needs_kernels
@pytest.mark.parametrize("apart_m", [APART_M, 0.2])
def test_segments_have_the_joint_of_their_turn(apart_m: float) -> None:
    turn, place = motion(TUMBLE._replace(play_m=apart_m))
    time_s = np.arange(len(place)) / RATE_HZ
    poses = with_noise(np.random.default_rng(3), time_s, place, turn, *NOISES[1])
    found = segmenting.segment(poses, MODEL)
    joints = [one.joint for one in found.segments if one.joint is not None]
    assert [joint.kind for joint in joints] == [JointKind.HINGE] * 2
    for joint, y_m in zip(joints, (0.0, apart_m), strict=True):
        assert isinstance(joint.environment, Line)
        assert joint.environment.point_m[:2] == pytest.approx([0.0, y_m], abs=1e-3)
    assert {id(one.joint) for one in found.beliefs if one.joint is not None} == {*map(id, joints)}


@needs_kernels
@pytest.mark.parametrize("kind", EACH_KIND)
def test_no_label_is_certain_with_a_joint(kind: JointKind) -> None:
    found = segmented(kind, 1)
    assert any(segment.joint for segment in found.segments)
    assert any(belief.joint for belief in found.beliefs)
    for segment in found.segments:
        if segment.joint is not None:
            assert segment.probability <= 0.9
            assert len(segment.inseparable) == 6
    for belief in found.beliefs:
        if belief.joint is not None:
            assert belief.probability.max() <= 0.9
            assert belief.to_json()["joint"]["kind"] == kind.value


@needs_kernels
def test_no_joint_is_sure_while_a_mistake_is_suspected() -> None:
    """Positions in millimetres open all labels; a joint that holds for any of them is no surer."""
    _, poses = moved(JointKind.HINGE, 0)
    found = segmenting.segment(replace(poses, position_m=1e3 * poses.position_m), MODEL)
    assert all(segment.inseparable for segment in found.segments)
    joints = [one.joint for one in (*found.segments, *found.beliefs) if one.joint is not None]
    assert joints
    assert max(joint.probability for joint in joints) <= 0.5


@needs_kernels
def test_a_slider_is_no_screw_of_metres_per_radian() -> None:
    """Such a screw would turn by the noise of its angle."""
    slider = replace(named_scenario("slider", 2), phases=(Phase(Contact.FREE, 5.0),))
    joint = joint_in(segmenting.segment(simulate(slider, 2).poses, MODEL))
    assert joint.kind is JointKind.SLIDER


@needs_kernels
def test_rows_of_a_table_contain_the_joint() -> None:
    found = segmented(JointKind.HINGE, 1)
    rows = StringIO(newline="")
    with open_text(".csv", rows, "segments", lambda: 0) as append:
        append(found.segments)
    header, *lines = rows.getvalue().splitlines()
    assert ",joint,decided," in header
    assert any('""kind"": ""hinge""' in line for line in lines)


def bent_window(poses: Poses, errors: SystematicErrors, seed: int) -> Window:
    """Every twentieth pose as a tick, with systematic errors."""
    some = with_systematic_errors(poses[::20], errors, seed)
    zeta = lift(some.rotation, some.position_m)
    variance = np.tile([SIGMA[0] ** 2, SIGMA[1] ** 2], (len(zeta), 1))
    return Window(np.arange(len(zeta)), zeta, variance, 100.0 * variance)


def test_a_pitch_that_systematic_errors_explain_makes_no_screw() -> None:
    """Errors of 0.5 mm that depend on the place shift an object on a hinge along its axis."""
    errors = MODEL.with_systematic_errors(0.5e-3, np.radians(0.1)).systematic
    hinges, screws = [], []
    for seed in range(6):
        bent = bent_window(moved(JointKind.HINGE, seed, 24.0)[1], errors, seed)
        found = [
            likeliest_joint(ExplainedTicks(bent, SCALES, one), [], 1) for one in (MODEL.systematic, errors)
        ]
        assert all(found)
        hinges.append([one.model.kind for one in found if one])
        bent = bent_window(moved(JointKind.SCREW, seed, 24.0)[1], errors, seed)
        screw = likeliest_joint(ExplainedTicks(bent, SCALES, errors), [], 1)
        assert screw
        screws.append(screw.model.kind)
    assert [known for _, known in hinges] == [JointKind.HINGE] * 6
    assert JointKind.SCREW in [unknown for unknown, _ in hinges]
    assert screws == [JointKind.SCREW] * 6


@pytest.mark.long
@needs_kernels
def test_a_screw_of_a_large_pitch_stays_one_with_large_systematic_errors() -> None:
    """Its hinge fits far worse than free motion, with which the screw has to compete."""
    model = MODEL.with_systematic_errors(2e-3, np.radians(0.5))
    _, poses = moved(JointKind.SCREW, 2, 7.0, pitch_m=0.1)
    poses = with_systematic_errors(poses, model.systematic, 2)
    found = segmenting.segment(poses, model)
    assert [one.joint.kind for one in found.segments if one.joint] == [JointKind.SCREW]
    assert found.segments[0].joint is not None
    assert found.segments[0].joint.probability > 0.9


@pytest.mark.parametrize("kind", [JointKind.HINGE, JointKind.BALL], ids=str)
def test_covariances_include_systematic_errors(kind: JointKind) -> None:
    """Errors of 0.5 mm and 0.1 deg that depend on the pose; by noise alone elements are far off."""
    errors = MODEL.with_systematic_errors(0.5e-3, np.radians(0.1)).systematic
    squared, freedom = np.zeros(2), 0
    for seed in range(6):
        frames, poses = moved(kind, seed, 8.0)
        window = bent_window(poses, errors, seed)
        place = window.zeta[:, T].mean(axis=0)
        for i, known in enumerate((MODEL.systematic, errors)):
            found = likeliest_joint(ExplainedTicks(window, SCALES, known), [], 1)
            joint = joint_of(found, 1.0)
            true_point = Point(frames.world_point_m)
            true_axis = Line(frames.world_axes[:, 2], frames.world_point_m)
            off = deviation(joint.environment, true_point if kind is JointKind.BALL else true_axis, place)
            squared[i] += off.squared
        freedom += off.freedom
    assert 0.2 < squared[1] / freedom < 4.0
    assert squared[0] / freedom > 5.0
