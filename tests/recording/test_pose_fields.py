"""Poses at a path in decoded messages, and the names of their bodies."""

from types import SimpleNamespace as Message

from contact_tracker.recording.decoding import poses_at


def detection(name: str, x: float) -> Message:
    pose = Message(position=Message(x=x, y=0.0, z=0.0), orientation=Message(x=0.0, y=0.0, z=0.0, w=1.0))
    result = Message(hypothesis=Message(class_id=name, score=1.0), pose=Message(pose=pose))
    return Message(results=[result], id="")


def test_two_bodies_of_one_name_in_a_message_are_two_sources() -> None:
    message = Message(detections=[detection("cup", 0.0), detection("cup", 1.0), detection("box", 2.0)])
    found = [one for one in poses_at("detections.results[0].pose", message) if one is not None]
    assert [(child.partition("#")[0], pose.position_m[0]) for _, child, pose in found] == [
        ("cup", 0.0),
        ("cup", 1.0),
        ("box", 2.0),
    ]
    assert len({child for _, child, _ in found}) == 3


def test_a_part_with_a_namespace_alone_is_no_marker() -> None:
    pose = detection("cup", 0.5).results[0].pose.pose
    ((_, _, found),) = filter(None, poses_at("part.pose", Message(part=Message(ns="a", pose=pose))))
    assert found.position_m == (0.5, 0.0, 0.0)
