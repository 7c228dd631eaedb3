"""What to move next: motions that one contact allows and another forbids, described as they are in space."""

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import contact_tracker
from command_line import run
from contact_tracker.config.loading import load_model
from contact_tracker.contacts import CONTACT_MODELS
from contact_tracker.motion.poses import Poses
from contact_tracker.motion.window import LEVER_M
from contact_tracker.states import Contact
from contact_tracker.tracking.informative_motion import SHIFT_M, informative_motions
from informative_motion import Held, poses_of, suggested
from pose_filter import PoseFilter

MODEL = load_model()


def held_in(contact: Contact, seconds: int, origin_m: np.ndarray) -> tuple[Held, PoseFilter]:
    """An object that is moved to and fro in one direction, which leaves the contact open; the world's origin
    is shifted."""
    rng = np.random.default_rng(4)
    held = Held.of(CONTACT_MODELS[contact.column], rng)
    filter_ = PoseFilter(MODEL)
    twist = held.allowed(np.random.default_rng(1).normal(size=6))
    for second in range(seconds):
        for pose in poses_of(held, twist[None], float(second), rng):
            moved = pose._replace(position_m=tuple((np.array(pose.position_m) + origin_m).tolist()))
            filter_.update(moved)
    return held, filter_


@pytest.mark.parametrize("contact", [Contact.EF, Contact.VF])
def test_each_motion_is_between_the_label_and_a_rival_and_the_same_in_both_frames(contact: Contact) -> None:
    origin_m = np.array([2.0, -1.0, 0.5])
    held, filter_ = held_in(contact, 4, origin_m)
    belief = filter_.state.belief
    assert belief.inseparable
    motions = informative_motions(filter_.state)
    assert motions
    evidence = [one.evidence_nats for one in motions]
    assert evidence == sorted(evidence, reverse=True)
    twists = []
    for one in motions:
        assert {one.allowed_by, one.forbidden_by} <= {belief.contact, *belief.inseparable}
        assert belief.contact in (one.allowed_by, one.forbidden_by)
        assert np.linalg.norm(one.turn_world_rad) * LEVER_M <= SHIFT_M * 1.2
        # the same in the world and in the body, about the same point
        pose = Rotation.from_quat(held.quat_xyzw)
        apart = np.linalg.norm(pose.apply(one.turn_body_rad) - one.turn_world_rad)
        assert apart <= 0.1 * np.linalg.norm(one.turn_world_rad)  # the newest tick is a little earlier
        point_m = pose.apply(one.point_body_m) + held.position_m + origin_m
        np.testing.assert_allclose(point_m, one.point_world_m, atol=0.02)
        arm = pose.apply(-one.point_body_m)
        shift_m = one.shift_world_m + Rotation.from_rotvec(one.turn_world_rad).apply(arm) - arm
        twists.append([*one.turn_body_rad * LEVER_M, *shift_m])
    # none repeats the direction of others
    sizes = np.linalg.svd(np.array(twists) / np.linalg.norm(twists, axis=1)[:, None])[1]
    assert (sizes > 0.5).all()


def test_following_the_suggestions_decides() -> None:
    """Two moves of a second are enough; where nothing is open there is nothing to suggest."""
    rng = np.random.default_rng(4)
    held, filter_ = held_in(Contact.EF, 4, np.zeros(3))
    for second in range(4, 12):
        twists = suggested(informative_motions(filter_.state), held)
        if not len(twists):
            break
        for pose in poses_of(held, twists, float(second), rng):
            filter_.update(pose)
    belief = filter_.state.belief
    assert (belief.contact, belief.inseparable, informative_motions(filter_.state)) == (Contact.EF, (), ())


def test_live_and_python_suggest(tmp_path) -> None:
    held, _ = held_in(Contact.EF, 0, np.zeros(3))
    rng = np.random.default_rng(4)
    twist = held.allowed(np.random.default_rng(1).normal(size=6))
    poses = Poses.collect(
        [pose for second in range(3) for pose in poses_of(held, twist[None], float(second), rng)]
    )
    tracker = contact_tracker.Tracker()
    rows = ["time,x,y,z,qx,qy,qz,qw"]
    for stamp_ns, position, quat in zip(poses.stamp_ns, poses.position_m, poses.quat_xyzw, strict=True):
        tracker.update(int(stamp_ns), position, quat)
        rows.append(",".join(map(str, (stamp_ns * 1e-9, *position, *quat))))
    assert tracker.suggestions
    (tmp_path / "poses.csv").write_text("\n".join(rows))
    done = run("live", "poses.csv", "--suggest", cwd=tmp_path)
    (line,) = (line for line in done.stdout.splitlines() if " to decide, turn about (" in line)
    assert line.count(" (world): ") > 1  # all motions in one line, not again, as nothing has changed
    lines = run("live", "poses.csv", "--suggest", "--json", cwd=tmp_path).stdout.splitlines()
    open_ones = [json.loads(line) for line in lines[-5:]]
    assert all(one["suggestions"] for one in open_ones if one["inseparable"])
    assert len(open_ones[-1]["suggestions"][0]["turn_body_rad"]) == 3
