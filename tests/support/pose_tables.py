"""Tables of the same poses in any columns, and what is read of them by options of the command line."""

import re
import shlex
from collections.abc import Iterable, Sequence
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from contact_tracker.cli.main import build_parser
from contact_tracker.errors import UnreadableRecording
from contact_tracker.motion.poses import Poses
from contact_tracker.recording import open_log
from mcap_logs import smooth_poses

POSES = smooth_poses(120)
SINCE_NS = POSES.stamp_ns - POSES.stamp_ns[0]
T, P, Q = SINCE_NS / 1e9, POSES.position_m, POSES.quat_xyzw
TURN = Rotation.from_quat(Q)
VECTORS, MATRICES = TURN.as_rotvec(), TURN.as_matrix()
ANGLES = np.linalg.norm(VECTORS, axis=1)
POSE = np.column_stack([P, Q])
NAMES = "x,y,z,qx,qy,qz,qw"
WHOLE = np.tile(np.eye(4), (len(T), 1, 1))
WHOLE[:, :3, :3], WHOLE[:, :3, 3] = MATRICES, P


def rows(*columns: np.ndarray | Sequence[str]) -> list[list[str]]:
    """The cells of columns, of text or of numbers (N,) or (N, k)."""
    cells = [
        [[repr(value) for value in row] for row in np.reshape(column, (len(column), -1)).tolist()]
        if isinstance(column, np.ndarray)
        else [[text] for text in column]
        for column in columns
    ]
    return [[cell for part in parts for cell in part] for parts in zip(*cells, strict=True)]


def write(path: Path, head: Sequence[str], lines: Iterable[Sequence[str]], separator: str = ",") -> Path:
    path.write_text("\n".join([*head, *(separator.join(line) for line in lines), ""]))
    return path


def assert_read(path: Path, *options: str, frame: str | None = None) -> None:
    """The file is read as the poses; stamps from the first on."""
    table = build_parser().parse_args(["segment", str(path), *options]).table
    log = open_log(str(path), frame=frame, table=table)
    result = Poses.collect(log)
    np.testing.assert_allclose(result.stamp_ns - result.stamp_ns[0], SINCE_NS, rtol=0, atol=600)
    np.testing.assert_allclose(result.position_m, P, rtol=0, atol=1e-9)
    turned = np.abs(np.sum(result.quat_xyzw * Q, axis=1))
    np.testing.assert_allclose(turned, 1.0, rtol=0, atol=1e-9)
    assert log.damage is None


def commands(path: Path, *words: str) -> list[str]:
    """The commands that the refusal of a file proposes; ``words`` are those of the user."""
    with pytest.raises(UnreadableRecording) as raised:
        open_log(str(path), table=build_parser().parse_args(["segment", str(path), *words]).table)
    return re.findall(r"contact-tracker (segment .*?)(?= or\b|, with|\. Orders|$)", str(raised.value))


def proposed(path: Path) -> list[str]:
    """The options of the first command that a refusal names."""
    words = shlex.split(commands(path)[0])
    assert words[:2] == ["segment", str(path)]
    return words[2:]


def names(separator: str) -> str:
    """``NAMES`` by another separator."""
    return NAMES.replace(",", separator)


def xyz(name: str) -> str:
    return ",".join(f"{name}{axis}" for axis in "xyz")


def numbered(form: str, *counts: int) -> str:
    """Names of columns with one number, or with two."""
    return ",".join(form.format(*numbers) for numbers in product(*map(range, counts)))


REAL_FIRST, P_MM, DEGREES = np.roll(Q, 1, axis=1), 1e3 * P, TURN.as_euler("xyz", degrees=True)
