"""Saved states resume bit for bit; invalid ones are refused, and never executed."""

import pickle
from collections import Counter
from functools import reduce
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import as_values
import contact_tracker
from contact_tracker import saved_state
from contact_tracker.config.loading import load_model
from contact_tracker.errors import StateError
from contact_tracker.exports.formats import json_line
from contact_tracker.map.file import map_from
from contact_tracker.map.map import EMPTY_MAP
from contact_tracker.motion.pose_validation import PoseGate
from contact_tracker.motion.poses import Pose, Poses
from contact_tracker.saved_state import STREAM, Kind, fingerprint, load, packed, save, unpacked
from contact_tracker.tracker import Tracker
from forged_states import forge
from mcap_logs import smooth_poses
from short_recordings import MODEL, needs_kernels, shipped

TABLE = {
    "plane": [{"normal": [0, 0, 1], "offset_m": 0.0}],
    "line": [{"direction": [0, 1, 0], "point_m": [0, 0, 0]}],
}
KNOWN = map_from(
    {"up": {"direction": [0, 0, 1]}, "object": {"box": {"size_m": [0.1, 0.1, 0.1]}}, "environment": TABLE}
)


def lines(poses: Poses, cuts: set[int], path: Path, lag_s: float = 0.0, known: bool = False) -> list[str]:
    """All beliefs of a stream that is saved and restored before the poses ``cuts``."""
    state, lines_ = as_values.start(MODEL, lag_s, KNOWN if known else EMPTY_MAP), list[str]()
    gate = PoseGate()
    for i, pose in enumerate(poses):
        if i in cuts:
            save(path, (state, gate))
            state, gate = load(path)
        state, beliefs = as_values.take(state, gate.arrive(pose))
        lines_ += map(json_line, beliefs)
    return [*lines_, *map(json_line, as_values.finish(state)[1])]


@needs_kernels
@pytest.mark.parametrize(
    ("name", "count", "lag_s", "known"),
    [("vision_30hz", 150, 1.0, False), ("all_states", 300, 0.0, False), ("all_states", 200, 0.0, True)],
)
def test_a_restored_stream_goes_on_alike(
    tmp_path: Path, name: str, count: int, lag_s: float, known: bool
) -> None:
    poses = shipped(name)[:count]
    cuts = {1, 5, 11, 12, 13, 59, 60, 61, 100, 180}
    assert lines(poses, cuts, tmp_path / "s", lag_s, known) == lines(
        poses, set(), tmp_path / "s", lag_s, known
    )


ROUGH = st.lists(
    st.tuples(
        st.sampled_from([0, 1, 1, 1, 1, 3, 40, -5]), st.sampled_from([0.0, 0.0, 0.0, 0.5, float("nan")])
    ),
    min_size=5,
    max_size=120,
)


@given(rows=ROUGH, cut=st.integers(0, 120))
@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_the_gate_continues_after_a_restore(tmp_path: Path, rows: list[tuple[int, float]], cut: int) -> None:
    clean, stamp, poses = list(smooth_poses(len(rows))), 0, list[Pose]()
    for pose, (step, shift) in zip(clean, rows, strict=True):
        stamp += step * 5_000_000
        x, y, z = pose.position_m
        poses.append(Pose(stamp, (x + shift, y, z), pose.quat_xyzw))

    def admitted(restore: bool) -> tuple[list[Pose], Counter[str]]:
        counts = Counter[str]()
        gate, found = PoseGate(counts), list[Pose]()
        for i, pose in enumerate(poses):
            if restore and i == cut:
                save(tmp_path / "gate", gate)
                gate = load(tmp_path / "gate")
            found += gate.admit(pose)
        return [*found, *gate.finish()], gate.counts

    assert admitted(restore=True) == admitted(restore=False)


@pytest.fixture(scope="module")
def saved(tmp_path_factory: Any) -> tuple[Path, Tracker]:
    path = tmp_path_factory.mktemp("state") / "a.state"
    state, _ = as_values.advance(as_values.start(MODEL), smooth_poses(300))
    save(path, state)
    return path, state


def test_the_same_state_has_the_same_bytes(tmp_path: Path, saved: tuple[Path, Tracker]) -> None:
    path, state = saved
    save(tmp_path / "again", load(path))
    assert (tmp_path / "again").read_bytes() == path.read_bytes()
    assert fingerprint(load(path)) == fingerprint(state)
    assert fingerprint(state) != fingerprint(as_values.start(load_model("robot_1khz")))


@given(
    changes=st.lists(
        st.tuples(st.floats(0, 1, exclude_max=True), st.integers(0, 255)), min_size=1, max_size=4
    )
)
@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_a_damaged_state_is_refused_or_is_the_same(
    tmp_path: Path, saved: tuple[Path, Tracker], changes: list[tuple[float, int]]
) -> None:
    data = bytearray(saved[0].read_bytes())
    for at, byte in changes:
        data[int(at * len(data))] = byte
    path = tmp_path / "damaged"
    path.write_bytes(data)
    try:
        loaded = load(path)
    except StateError:
        return
    assert fingerprint(loaded) == fingerprint(saved[1])


def rewritten(path: Path, target: Path, tree: Any) -> Path:
    """A state with a valid checksum, but another tree."""
    target.write_bytes(packed(tree, unpacked(path.read_bytes())[1]))
    return target


@pytest.mark.parametrize(
    "tree",
    [
        ["object", "Popen", "true"],
        ["object", "PoseGate"],
        ["object", "Tracker", None],
        ["object", "Contact", "XX"],
        ["object", "PoseGate", "x"],
        ["scalar", 0],
        ["array", 10**6],
        ["array", -1],
        ["same", 0],
        ["layout", "Bank x"],
        ["dict", [["array", 0], 1]],
        ["unknown"],
        {},
        [],
        [["tuple"]],
        reduce(lambda tree, _: ["tuple", tree], range(500), 1),
    ],
)
def test_only_classes_of_a_state_are_built(tmp_path: Path, saved: tuple[Path, Tracker], tree: Any) -> None:
    with pytest.raises(StateError):
        load(rewritten(saved[0], tmp_path / "x", tree))


@needs_kernels
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_a_forged_state_is_refused_or_goes_on(tmp_path: Path) -> None:
    poses = list(shipped("vision_30hz")[:330])
    tracker = contact_tracker.Tracker(MODEL)
    for pose in poses[:300]:
        tracker.update(*pose)
    tracker.save(tmp_path / "a")
    refused = 0
    for seed in range(12):
        what = forge(tmp_path / "a", tmp_path / "b", Random(seed))
        try:
            restored = contact_tracker.Tracker.load(tmp_path / "b")
            for pose in poses[300:312]:
                restored.update(*pose)
            assert len(restored.finish()) in (0, 1), what
            assert all(restored.warnings)
        except StateError:
            refused += 1
    assert 3 < refused < 12


def test_pickles_and_other_files_are_refused(tmp_path: Path) -> None:
    (tmp_path / "pickle").write_bytes(pickle.dumps({"a": 1}))
    (tmp_path / "text").write_text("{}")
    np.savez(tmp_path / "a.npz", a=np.array([{}], object))
    for name in ("pickle", "text", "a.npz"):
        with pytest.raises(StateError, match="no saved state"):
            load(tmp_path / name)
    with pytest.raises(StateError, match="not a regular file"):
        load(Path("/dev/zero"))


class RunByPickle:
    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Any, ...]:
        return Path.touch, (self.path,)


def test_a_pickle_in_an_array_is_not_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, write = tmp_path / "a.state", np.lib.format.write_array
    with monkeypatch.context() as patch:
        patch.setattr(np.lib.format, "write_array", lambda file, array, **_: write(file, array))
        path.write_bytes(packed(["array", 0], [np.array([RunByPickle(tmp_path / "run")])]))
    with pytest.raises(StateError, match="no saved state"):
        load(path)
    assert list(tmp_path.iterdir()) == [path]


def test_another_version_is_named(
    tmp_path: Path, saved: tuple[Path, Tracker], monkeypatch: pytest.MonkeyPatch
) -> None:
    changed = {**STREAM.schema, "Tick": ["other"]}
    rows = np.dtype([("stamp_ns", np.int64), ("of_then", np.float64)])
    for holder, name, value in (
        (Kind, "schema", changed),
        (saved_state, "__version__", "9.9"),
        (saved_state, "BELIEF", rows),
    ):
        with monkeypatch.context() as patch:
            patch.setattr(holder, name, value)
            with pytest.raises(StateError, match="another version"):
                load(saved[0])


def test_other_classes_are_not_saved(tmp_path: Path) -> None:
    for value in (object(), {"a": Path()}, np.array(["text"]), lambda: None, [np.dtype("f8")]):
        with pytest.raises(TypeError, match="no part of a state"):
            save(tmp_path / "x", value)
    assert list(tmp_path.iterdir()) == []
