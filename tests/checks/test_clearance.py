"""Known geometry is compared with where the object is: inside a body, or behind all faces."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

import as_values
from checked_stream import stream_of, updated
from contact_tracker.checks.clearance import Clearance
from contact_tracker.config.loading import load_model
from contact_tracker.map.file import map_from
from contact_tracker.map.map import Map
from contact_tracker.motion.poses import Poses

SIGMA = {"sigma_position_m": 5e-4, "sigma_rotation_deg": 0.2}
TABLE = {"name": "table", "normal": [0.0, 0.0, 1.0], "offset_m": 0.0, **SIGMA}
BENCH = {"name": "bench", "size_m": [2.0, 1.0, 0.1], "position_m": [0.0, 0.0, -0.05], **SIGMA}
CUBE = {"size_m": [0.1, 0.1, 0.1], **SIGMA}


def at_rest(*position_m: float, turn: Rotation | None = None) -> Poses:
    """A hundred poses in one place."""
    quat = (turn or Rotation.identity()).as_quat()
    return Poses(np.arange(100) * 10_000_000, np.tile(position_m, (100, 1)), np.tile(quat, (100, 1)))


def known(**environment: Any) -> Map:
    return map_from({"environment": environment, "object": {"box": CUBE}})


def compared(known_map: Map, *poses: Poses) -> Clearance:
    return updated(Clearance(), poses, stream_of(known_map))


def said(found: Clearance) -> Sequence[str]:
    findings = found.findings(stream_of(), [])
    assert all(finding.doubts_labels for finding in findings)
    return [finding.text for finding in findings]


@pytest.mark.parametrize(("height_m", "is_said"), [(0.05, False), (0.048, False), (0.035, True)])
def test_a_body_that_the_object_passes_through_is_named(height_m: float, is_said: bool) -> None:
    known_map = known(box=[BENCH])
    texts = said(compared(known_map, at_rest(0.0, 0.0, height_m)))
    assert bool(texts) is is_said
    assert all("15 mm inside bench face +z" in text for text in texts)
    twice = compared(known(box=[BENCH, BENCH | {"name": "again"}]), at_rest(0.0, 0.0, height_m)[:2])
    assert said(twice) == [], "single poses may be wrong, and count once in several bodies"


SECOND = BENCH | {"name": "shelf", "position_m": [0.0, 3.0, 0.5]}
TURNED = BENCH | {"quat_xyzw": Rotation.from_euler("z", 90, degrees=True).as_quat().tolist()}
FAR = BENCH | {"position_m": [30.0, 20.0, -10.05]}
BOARD = BENCH | {"name": "board", "size_m": [0.6, 0.4, 0.02], "position_m": [0.0, 0.0, 0.99]}
BLOCK = BENCH | {"name": "block", "size_m": [0.2, 0.2, 0.2], "position_m": [0.0, 0.0, 1.1]}
STEP = TABLE | {"name": "step", "offset_m": 0.2}
OVER_THE_EDGE = at_rest(1.0, 0.0, 0.02, turn=Rotation.from_euler("y", 40, degrees=True))


@pytest.mark.parametrize(
    ("known_map", "poses", "is_said"),
    [
        *(
            (known(box=[BENCH, SECOND]), at_rest(*place_m), False)  # behind some of the faces of each body
            for place_m in ((0.3, 0.2, 0.05), (1.06, 0.0, -0.2), (0.0, -0.56, 0.02), (1.0, 0.0, 0.05))
        ),
        (known(box=[TURNED]), at_rest(0.8, 0.0, -0.02), False),
        (known(box=[TURNED]), at_rest(0.0, 0.8, -0.02), True),
        (known(box=[BOARD, BLOCK]), at_rest(0.0, 0.0, 0.5), False),  # the underside is covered, and ends
        (known(box=[FAR]), at_rest(30.0, 20.0, -9.965), True),
        (known(plane=[TABLE]), OVER_THE_EDGE, False),
        (known(plane=[TABLE, STEP]), at_rest(0.0, 0.0, 0.05), False),
    ],
)
def test_an_object_fits_unless_it_is_in_a_body(known_map: Map, poses: Poses, is_said: bool) -> None:
    assert bool(said(compared(known_map, poses))) is is_said


def test_an_object_in_a_hollow_body_fits(tmp_path: Path) -> None:
    bottom = trimesh.creation.box((0.4, 0.4, 0.02))
    wall = trimesh.creation.box((0.02, 0.4, 0.1)).apply_translation((0.19, 0.0, 0.04))
    trimesh.util.concatenate([bottom, wall]).export(tmp_path / "tray.stl")
    given = {"environment": {"mesh": [{"path": "tray.stl"}]}, "object": {"box": CUBE}}
    assert said(compared(map_from(given, tmp_path), at_rest(0.0, 0.0, 0.06))) == []


def test_an_object_that_stays_behind_all_faces_contradicts_them() -> None:
    """As with a normal of the wrong sign, or an offset in mm."""
    known_map = known(plane=[TABLE | {"offset_m": 0.71}])
    (text,) = said(compared(known_map, at_rest(0.0, 0.0, 0.05)))
    assert "behind every face" in text
    assert said(compared(known_map, at_rest(0.0, 0.0, 0.05)[:2])) == []
    later = compared(known_map, at_rest(0.0, 0.0, 0.05), at_rest(0.0, 0.0, 0.8), at_rest(0.0, 0.0, 0.05))
    assert said(later) == [], "it was lifted from below"


def test_no_label_is_certain_before_the_speed_of_a_known_object_is_known() -> None:
    known_map, poses = known(plane=[TABLE]), at_rest(0.0, 0.0, 0.05)
    noise = np.random.default_rng(3).normal(scale=1e-4, size=poses.position_m.shape)
    poses = replace(poses, position_m=poses.position_m + noise)
    for model, most in (("default", 0.6), ("impacts", 1.0)):
        state = as_values.start(load_model(model), known_map=known_map)
        state, beliefs = as_values.advance(state, poses[:40])
        assert beliefs
        sure = max(belief.probability.max() for belief in beliefs)
        assert sure <= most
        assert state.may_be_in_doubt is (model == "default")
        state, _ = as_values.advance(state, poses[40:90])  # a hundred that never turn are in doubt again
        assert not state.may_be_in_doubt
