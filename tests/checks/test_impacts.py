"""Impacts on known geometry are told from fast motion in the free."""

from dataclasses import replace

import numpy as np
import pytest

from checked_stream import MODEL, stream_of, updated
from contact_tracker.checks import clearance
from contact_tracker.checks.clearance import Impacts
from contact_tracker.inspection.stream_checks import Finding
from contact_tracker.map.file import map_from
from contact_tracker.map.map import Map
from contact_tracker.motion.poses import Poses
from smooth_motion import unturned

TICK_S = 0.1
TABLE = {"name": "table", "normal": [0.0, 0.0, 1.0], "offset_m": 0.0}
BENCH = {"name": "bench", "size_m": [2.0, 2.0, 0.1], "position_m": [0.0, 0.0, -0.05]}
ON_TABLE_M = 0.05
CUBE = {"box": {"size_m": [2 * ON_TABLE_M] * 3}}
KNOWN = map_from({"environment": {"plane": [TABLE]}, "object": CUBE})
ON_BENCH = map_from({"environment": {"box": [BENCH]}, "object": CUBE})


def moving(path_m: np.ndarray, rate_hz: float, noise_m: float = 1e-4) -> Poses:
    """Poses without turns along ``path_m`` (N, 3)."""
    noise = np.random.default_rng(0).normal(scale=noise_m, size=path_m.shape)
    return unturned(path_m + noise, round(1e9 / rate_hz))


def heights(height_m: np.ndarray) -> np.ndarray:
    return np.column_stack([np.zeros((len(height_m), 2)), height_m])


def dropped(rate_hz: float, restitution: float) -> np.ndarray:
    """Path of a cube that falls from 10 cm on the table at 1.4 m/s."""
    time_s = np.arange(0.0, 1.0, 1.0 / rate_hz)
    hit_s = np.sqrt(2 * 0.1 / 9.81)
    after_s, speed = time_s - hit_s, restitution * 9.81 * hit_s
    fall, bounce = 0.1 - 0.5 * 9.81 * time_s**2, speed * after_s - 0.5 * 9.81 * after_s**2
    return heights(ON_TABLE_M + np.where(after_s < 0.0, fall, np.maximum(bounce, 0.0)))


def placed(rate_hz: float) -> np.ndarray:
    """Path of a cube that comes down at 1.5 m/s, slows down over 10 cm and is put on the table."""
    time_s = np.arange(0.0, 2.0, 1.0 / rate_hz)
    slow = 0.1 * np.exp(-15.0 * np.maximum(time_s - 0.5, 0.0))
    return heights(ON_TABLE_M + np.where(time_s < 0.5, 0.1 + 1.5 * (0.5 - time_s), slow))


def said(found: Impacts, tick_s: float) -> list[Finding]:
    return found.findings(stream_of(model=replace(MODEL, tick_s=tick_s)), [])


def found_in(poses: Poses, known_map: Map = KNOWN, batch: int = 50) -> Impacts:
    batches = (poses[first : first + batch] for first in range(0, len(poses), batch))
    return updated(Impacts(), batches, stream_of(known_map))


@pytest.mark.parametrize("rate_hz", [60.0, 148.0, 240.0, 1000.0])
@pytest.mark.parametrize("restitution", [0.0, 0.4])
def test_a_dropped_object_is_reported(rate_hz: float, restitution: float) -> None:
    poses = moving(dropped(rate_hz, restitution), rate_hz)
    assert said(found_in(poses, ON_BENCH), TICK_S), "a body of faces is hit like a single face"
    (finding,) = said(impacts := found_in(poses), TICK_S)
    assert finding.doubts_labels
    assert "--model impacts" in finding.text
    assert said(impacts, clearance.LONGEST_TICK_S) == [], "such ticks are short enough"


def turned_back_above() -> np.ndarray:
    return heights(0.3 + 0.2 * np.abs(((2.0 * np.arange(0.0, 3.0, 0.01)) % 2.0) - 1.0) * 2.0)


def slid_fast() -> np.ndarray:
    time_s = np.arange(0.0, 3.0, 0.01)
    return np.column_stack([0.6 * np.sin(3.0 * time_s), 0.0 * time_s, np.full_like(time_s, ON_TABLE_M)])


def beside_the_bench() -> np.ndarray:
    """It turns back in the air, half a metre over the bench, in the plane of its side."""
    along = 1.05 + np.abs(np.arange(0.0, 2.0, 0.01) - 1.0)
    return np.column_stack([along, np.zeros_like(along), np.full_like(along, 0.5)])


def with_outliers(poses: int) -> np.ndarray:
    path = heights(np.full(300, ON_TABLE_M))
    for first, off_m in ((40, 0.05), (100, -0.05), (160, 0.05), (220, -0.05)):
        path[first : first + poses, 2] += off_m
    return path


NO_IMPACTS = {
    **{f"put down, {rate_hz:g} Hz": moving(placed(rate_hz), rate_hz) for rate_hz in (30.0, 100.0, 1000.0)},
    "beside a body, where its faces end": moving(beside_the_bench(), 100.0),
    "slides fast": moving(slid_fast(), 100.0, 5e-4),
    "turns back high above": moving(turned_back_above(), 100.0),
    **{f"outliers of {count}": moving(with_outliers(count), 100.0) for count in (1, 2)},
    "speeds differ before and after a gap": moving(placed(100.0), 100.0)[np.r_[0:56, 96:200]],
}


@pytest.mark.parametrize("name", NO_IMPACTS)
def test_other_motion_is_no_impact(name: str) -> None:
    impacts = found_in(NO_IMPACTS[name], ON_BENCH if name.startswith("beside") else KNOWN)
    assert said(impacts, TICK_S) == []
    assert not (impacts.is_near and name.startswith("put down"))


def test_before_an_impact_the_labels_are_in_doubt() -> None:
    falling = moving(dropped(240.0, 0.0), 240.0)
    assert found_in(falling[:30]).is_near  # it hits after 34 poses
    assert not found_in(falling).is_near


def test_batches_make_no_difference_and_little_is_kept() -> None:
    poses = moving(dropped(148.0, 0.3), 148.0)
    whole = found_in(poses, batch=len(poses))
    for batch in (1, 7):
        impacts = found_in(poses, batch=batch)
        assert impacts.top_m_per_s == pytest.approx(whole.top_m_per_s)
    burst_ns = np.add.outer(np.arange(300) * 50_000_000, np.arange(10)).ravel()
    poses = moving(heights(np.full(3000, ON_TABLE_M)), 100.0)
    assert len(found_in(Poses(burst_ns, poses.position_m, poses.quat_xyzw)).recent) < 120
