"""Faces of known bodies that lie on others cannot be touched."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from contact_tracker import Trajectory, segment
from contact_tracker.map.file import map_from
from contact_tracker.map.map import KINDS

TABLE = {"name": "table", "normal": [0.0, 0.0, 1.0], "offset_m": 0.71}
BLOCK = {"name": "block", "size_m": [0.2, 0.2, 0.08], "position_m": [0.35, 0.05, 0.75]}
UPPER = {"name": "upper", "size_m": [0.1, 0.1, 0.1], "position_m": [0.35, 0.05, 0.84]}
OBJECT_M = np.array([0.1, 0.06, 0.04])


def names(**environment) -> set[str]:
    """Of all elements that can be touched."""
    known = map_from({"environment": environment}).environment
    return {one.name for one in known if not one.is_covered}


def all_of(*boxes) -> set[str]:
    return names(box=list(boxes))


@pytest.mark.parametrize("lift_m", [0.0, 0.002, -0.002])
def test_the_underside_of_a_block_on_a_table_is_left_out(lift_m: float) -> None:
    lifted = BLOCK | {"position_m": [0.35, 0.05, 0.75 + lift_m]}
    assert names(plane=[TABLE], box=[lifted]) == {"table"} | {
        name for name in all_of(lifted) if "-z" not in name.split()
    }


@pytest.mark.parametrize(
    "place_m",
    [[0.35, 0.05, 0.65], [0.35, 0.05, 0.7599], [0.35, 0.05, 0.67]],
    ids=["through the table", "10 mm above it", "flush with it"],
)
def test_a_body_that_does_not_stand_on_the_table_is_complete(place_m: list[float]) -> None:
    elsewhere = BLOCK | {"position_m": place_m}
    assert names(plane=[TABLE], box=[elsewhere]) == {"table"} | all_of(elsewhere)


def test_of_stacked_bodies_the_upper_one_loses_its_underside() -> None:
    stacked = names(box=[BLOCK, UPPER])
    assert all_of(BLOCK) < stacked
    assert not any(name.startswith("upper") and "-z" in name.split() for name in stacked)


@pytest.mark.parametrize("place_m", [[0.45, 0.05, 0.84], [0.35, 0.55, 0.84]], ids=["overhanging", "beside"])
def test_a_face_that_is_not_within_the_other_stays(place_m: list[float]) -> None:
    upper = UPPER | {"position_m": place_m}
    assert names(box=[BLOCK, upper]) == all_of(BLOCK) | all_of(upper)


def test_turned_bodies_are_compared_where_they_are() -> None:
    turn = Rotation.from_rotvec([0.3, -0.5, 0.8])
    quat = turn.as_quat().tolist()
    turned = [
        box | {"position_m": turn.apply(box["position_m"]).tolist(), "quat_xyzw": quat}
        for box in (BLOCK, UPPER)
    ]
    assert names(box=turned) == names(box=[BLOCK, UPPER])


def test_a_mesh_with_rounded_numbers_loses_all_of_its_underside(tmp_path: Path) -> None:
    turn = Rotation.from_rotvec([0.3, -0.5, 0.8])
    corners_m = 0.05 * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    mesh = trimesh.convex.convex_hull(turn.apply(corners_m).round(5))
    mesh.export(tmp_path / "block.stl")
    table = {"name": "table", "normal": turn.apply([0, 0, 1]).tolist(), "offset_m": -0.05}
    known = map_from({"environment": {"plane": [table], "mesh": [{"path": "block.stl"}]}}, tmp_path)
    assert sum(one.is_covered for one in known.environment) == 1 + 4 + 4


def test_the_hull_of_a_hollow_body_neither_covers_nor_is_covered(tmp_path: Path) -> None:
    tray = trimesh.util.concatenate(
        [
            trimesh.creation.box((0.4, 0.4, 0.02)),
            trimesh.creation.box((0.02, 0.4, 0.1)).apply_translation((0.19, 0, 0.04)),
        ]
    )
    tray.export(tmp_path / "tray.stl")
    table = {"name": "table", "normal": [0.0, 0.0, 1.0], "offset_m": -0.01}
    known = map_from({"environment": {"plane": [table], "mesh": [{"path": "tray.stl"}]}}, tmp_path)
    assert not any(one.is_covered for one in known.environment)


def test_the_object_keeps_all_its_elements() -> None:
    known = map_from({"object": {"box": [BLOCK, UPPER]}}).object
    assert len(known) == 2 * (6 + 12 + 8)
    assert not any(one.is_covered for one in known)
    assert {one.name.split()[1] for one in known} == set(KINDS.values())


def on_the_table(seed: int) -> Trajectory:
    """A box that slides flat on the table for 7 s, and then tilted on an edge."""
    rng, time_s = np.random.default_rng(seed), np.arange(1400) / 100.0

    def wander(size: float) -> np.ndarray:
        rates, phases = rng.uniform(0.15, 0.7, 4), rng.uniform(0.0, 6.0, 4)
        return size * np.sin(2 * np.pi * rates * time_s[:, None] + phases).sum(axis=1) / 3.0

    tilt = np.clip((time_s - 7.0) / 0.4, 0.0, 1.0) * (0.45 + wander(0.2))
    turn = Rotation.from_euler("z", wander(0.6)[:, None]) * Rotation.from_euler("x", tilt[:, None])
    corners_m = 0.5 * OBJECT_M * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    lowest_m = (turn.as_matrix() @ corners_m.T)[:, 2].min(axis=1)
    place_m = np.column_stack([0.1 + wander(0.05), wander(0.05), 0.71 - lowest_m])
    noise = Rotation.from_rotvec(rng.normal(0.0, np.radians(0.15), (1400, 3)))
    return Trajectory.from_arrays(
        time_s, place_m + rng.normal(0.0, 3e-4, (1400, 3)), (turn * noise).as_quat()
    )


@pytest.mark.long
def test_a_block_beside_the_object_does_not_take_the_contacts_of_the_table() -> None:
    known = {
        "environment": {"plane": [TABLE], "box": [BLOCK]},
        "object": {"box": {"size_m": OBJECT_M.tolist()}},
    }
    found = segment(on_the_table(1), known=known)
    assert [one.contact.value for one in found.segments] == ["f-f", "e-f"]
    assert all(one.probability > 0.9 for one in found.segments)
    assert {one.geometry.environment.name for one in found.segments if one.geometry} == {"table"}
    assert not found.warnings
