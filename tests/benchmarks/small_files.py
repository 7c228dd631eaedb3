"""CPU time and memory that files of at most 1 MB cost: odd tables, known geometry of many elements, and sound
recordings of long motion.

    python tests/benchmarks/small_files.py
    python tests/benchmarks/small_files.py --only sound --poses 800

The odd ones are read by ``info`` and by ``segment``, which may refuse them. Known geometry is given for some
seconds of a shipped recording, which it need not fit. The sound recordings are segmented; the last column is
the time for as many poses as 1 MB of text holds.
"""

import argparse
import os
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from speed import Ran, run

Array = NDArray[np.float64]

MOST_BYTES: Final = 1_000_000
POSES_PER_MB: Final = 60_000
KNOWN_S: Final = 20
"""Duration of the recording for which geometry is known."""
RECORDINGS: Final = Path(__file__).parents[2] / "recordings"
HEADER: Final = "t,x,y,z,qx,qy,qz,qw\n"
FIRST_POSES: Final = 14
"""Number of poses at the usual rate before the first gap, so that ticks are short."""
NOISE: Final = 2e-4
"""Of position (m) and orientation (rad)."""


def periods(first_s: float, then_s: Sequence[float], count: int) -> Array:
    """Times between poses: those at the start, then the others over and over."""
    later = np.resize(np.array(then_s), max(count - FIRST_POSES, 0))
    return np.concatenate([np.full(FIRST_POSES, first_s), later])[:count]


def pose_rows(period_s: Array, moves: bool = True, noise: float = NOISE) -> Array:
    """Rows (N, 8) of time (s), position (m) and quaternion, of smooth motion or of rest."""
    rng, time_s = np.random.default_rng(0), np.cumsum(period_s)
    zero = np.zeros_like(time_s)
    position = np.array([0.1 * np.sin(0.5 * time_s), 0.1 * np.cos(0.3 * time_s), 0.02 * np.sin(0.2 * time_s)])
    turn = np.array([zero, 0.2 * np.sin(0.4 * time_s), 0.3 * np.sin(0.3 * time_s)])
    off = noise * rng.standard_normal((2, len(time_s), 3))
    quat = Rotation.from_rotvec(moves * turn.T) * Rotation.from_rotvec(off[1])
    return np.column_stack([time_s, moves * position.T + off[0], quat.as_quat()])


SOUND: Final[Mapping[str, Callable[[int], Array]]] = {
    "100 a second, at rest": lambda n: pose_rows(np.full(n, 0.01), moves=False),
    "100 a second, that jump": lambda n: pose_rows(np.full(n, 0.01), noise=0.05),
    "100 a second": lambda n: pose_rows(np.full(n, 0.01)),
    "10 a second": lambda n: pose_rows(np.full(n, 0.1)),
    "1 a second": lambda n: pose_rows(np.full(n, 1.0)),
    "every third after 1 s": lambda n: pose_rows(periods(0.05, (0.05, 0.05, 1.0), n)),
    "each after 1 s": lambda n: pose_rows(periods(0.05, (1.0,), n)),
    "each after 5 s": lambda n: pose_rows(periods(0.05, (5.0,), n)),
    "each after an hour": lambda n: pose_rows(periods(0.05, (3600.0,), n)),
}


def taken_by_six(moves: bool) -> str:
    """A table of six bodies at 12 poses a second, in motion or jumping."""
    rows = pose_rows(np.full(350, 0.0864), noise=NOISE if moves else 0.05)
    names = [f"{body}_{column}" for body in "abcdef" for column in HEADER.strip().split(",")[1:]]
    lines = [",".join(f"{v:.6f}" for v in (row[0], *np.tile(row[1:], 6))) for row in rows]
    return "\n".join([",".join(["time [s]", *names]), *lines, ""])


def repeated(row: str, header: str = "") -> str:
    """A row as often as 1 MB holds it."""
    return header + row * ((MOST_BYTES - len(header)) // len(row))


def counted(row: str) -> str:
    """Rows with a number in place of ``#``, as many as 1 MB holds."""
    return "".join(row.replace("#", str(i)) for i in range(MOST_BYTES // (len(row) + 6)))


ODD: Final[Mapping[str, Callable[[], str]]] = {
    "columns.csv": lambda: ",".join([HEADER.strip(), *["a"] * 400_000]) + "\n" + "0," * 50_000 + "\n",
    "long_rows.csv": lambda: HEADER + "0," * 490_000 + "\n",
    "quotes.csv": lambda: HEADER + '"' + "a," * 490_000,
    "bodies.csv": lambda: repeated(
        "0" + ",0" * 4340 + "\n",
        "time," + ",".join(f"{i}_{c}" for i in range(620) for c in HEADER.strip().split(",")[1:]) + "\n",
    ),
    "six_move.csv": lambda: taken_by_six(moves=True),
    "six_jump.csv": lambda: taken_by_six(moves=False),
    "zeros.csv": lambda: "\0" * MOST_BYTES,
    "digits.tum": lambda: "9" * 300_000 + " 0 0 0 0 0 0 1\n",
    "decimals.tum": lambda: "0." + "0" * 990_000 + " 0 0 0 0 0 0 1\n",
    "long_row.tum": lambda: "0 0 0 0 0 0 0 1" + " 0" * 490_000 + "\n",
    "blank.tum": lambda: "\n" * MOST_BYTES,
    "comments.tum": lambda: repeated("#\n"),
    "same.tum": lambda: repeated("0 0 0 0 0 0 0 1\n"),
    "far_apart.tum": lambda: counted("#000000 0 0 0 0 0 0 1\n"),
    "still.tum": lambda: counted("# 0 0 0 0 0 0 1\n"),
}


def box(side: str, name: str, size_m: float, x_m: float = 0.0) -> str:
    """A known box, a section of TOML."""
    keys = f'name = "{name}"\nsize_m = [{size_m}, {size_m}, {size_m}]\nposition_m = [{x_m}, 0, 0]\n'
    return f"[[{side}.box]]\n{keys}"


def elements(count: int, *kinds: str) -> str:
    """As many known elements of each of these kinds on both sides, within 0.1 m."""
    rng, sections = np.random.default_rng(0), list[str]()
    for side in ("object", "environment"):
        for kind in kinds:
            for _ in range(count):
                turn, place = rng.standard_normal((2, 3)).round(4)
                direction = (turn / np.linalg.norm(turn)).tolist()
                named = {
                    "plane": f"normal = {direction}\n",
                    "line": f"direction = {direction}\n",
                    "point": "",
                }
                sections.append(f"[[{side}.{kind}]]\n{named[kind]}point_m = {(0.1 * place).tolist()}\n")
    return "".join(sections)


TABLE: Final = "[[environment.plane]]\nnormal = [0, 0, 1]\noffset_m = 0\n"
KNOWN: Final[Mapping[str, str]] = {
    "nothing": "",
    "table": TABLE,
    "table and box": TABLE + box("object", "cube", 0.1),
    "box beside box": box("object", "cube", 0.1) + box("environment", "wall", 0.5),
    "box beside 7 boxes": box("object", "cube", 0.1)
    + "".join(box("environment", f"wall {i}", 0.2, 0.5 * i) for i in range(7)),
    "32 lines each": elements(32, "line"),
    "21 of each kind": elements(21, "plane", "line", "point"),
}


def known_lines(folder: Path) -> Iterator[str]:
    """One for each known geometry."""
    path, recording = folder / "known.toml", str(RECORDINGS / "all_states.mcap")
    yield f"{'known':22}{'bytes':>8}{'CPU s':>8}{'peak MB':>9}"
    for name, text in KNOWN.items():
        path.write_text(text)
        given = ("--known", str(path)) if text else ()
        output = ("-o", str(folder / "known.csv"), "--overwrite")
        ran = run("segment", recording, "--duration", str(KNOWN_S), *given, *output)
        yield f"{name:22}{len(text):8}{ran.cpu_s:8.1f}{ran.peak_mb:9.0f}"


def sound_lines(folder: Path, count: int) -> Iterator[str]:
    """One for each kind of recording."""
    last = f"{POSES_PER_MB} poses, min"
    yield f"{'poses':26}{'count':>8}{'CPU s':>8}{'ms a pose':>11}{'peak MB':>9}{last:>20}"
    for name, rows in SOUND.items():
        path, poses = folder / "sound.csv", rows(count)
        started, ran = (segment(path, poses[:n]) for n in (FIRST_POSES, count))
        each_s = (ran.cpu_s - started.cpu_s) / (count - FIRST_POSES)
        figures = f"{count:8}{ran.cpu_s:8.1f}{1e3 * each_s:11.1f}{ran.peak_mb:9.0f}"
        yield f"{name:26}{figures}{each_s * POSES_PER_MB / 60.0:20.1f}"


def segment(path: Path, rows: Array) -> Ran:
    """``segment`` of these poses."""
    np.savetxt(path, rows, fmt="%.6f", delimiter=",", header=HEADER.strip(), comments="")
    return run(
        "segment", str(path), "--time-unit", "s", "-o", str(path.with_suffix(".out.csv")), "--overwrite"
    )


def odd_lines(folder: Path) -> Iterator[str]:
    """One for each file; what is refused ends with another exit code."""
    figures = f"{'CPU s':>8}{'MB':>6}{'exit':>6}"
    yield f"{'file':18}{'bytes':>9}  info:{figures}  segment:{figures}"
    for name, text in ODD.items():
        path = folder / name
        path.write_text(text())
        info, segmented = (run(command, str(path), may_fail=True) for command in ("info", "segment"))
        yield f"{name:18}{path.stat().st_size:9}       {shown(info)}          {shown(segmented)}"


def shown(ran: Ran) -> str:
    """CPU time (s), peak memory (MB), exit code."""
    return f"{ran.cpu_s:8.1f}{ran.peak_mb:6.0f}{ran.exit_code:6}"


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", choices=("odd", "known", "sound"))
    parser.add_argument("--poses", type=int, default=400, help="of each sound recording")
    args = parser.parse_args(argv)
    if args.poses <= FIRST_POSES:
        parser.error(f"--poses: more than {FIRST_POSES}")
    for library in ("OMP", "OPENBLAS", "MKL"):
        os.environ[f"{library}_NUM_THREADS"] = "1"
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        tables = {
            "odd": odd_lines(folder),
            "known": known_lines(folder),
            "sound": sound_lines(folder, args.poses),
        }
        for name, lines in tables.items():
            for line in lines if args.only in (name, None) else ():
                print(line, flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
