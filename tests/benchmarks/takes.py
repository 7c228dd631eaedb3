"""How many differences between takes ``compare`` finds, and how many false ones (docs/assembly.md).

    python tests/benchmarks/takes.py FOLDER

Takes TASK_NUMBER.mcap of one task differ by their hands only. In each take, one step at a time is cut
out, made twice as long or moved by 2 cm along the table's normal; or the whole take is moved by 5 cm.
"""

import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from itertools import groupby
from operator import attrgetter
from pathlib import Path

import numpy as np

from contact_tracker import Result, Trajectory, read, segment
from contact_tracker.arrays import Array
from contact_tracker.geometry.elements import Plane
from contact_tracker.ground_truth import TruthInterval
from contact_tracker.recording import need_truth
from contact_tracker.sequences.comparison import Comparison, Verdict, compare_outcomes
from contact_tracker.states import Contact

TASKS = ("book", "mug", "wedge")
"""Tasks with steps of some seconds."""
LONG_S = 3.5
PAUSE_NS = 100_000_000
SHIFT_M, WORLD_M = 0.02, np.array([0.03, 0.0, 0.04])


def long_contacts(log: str) -> Iterator[TruthInterval]:
    """True contacts of some seconds, without the parts of a tenth of a second between."""
    for contact, group in groupby(need_truth(log).intervals, attrgetter("contact")):
        parts = list(group)
        whole = replace(parts[0], end_ns=parts[-1].end_ns)
        if contact not in (None, Contact.FREE) and whole.end_ns - whole.start_ns > LONG_S * 1e9:
            yield whole


def changed(take: Trajectory, what: str, at: TruthInterval, normal: Array) -> Trajectory:
    """A take with one step changed."""
    stamp_ns, position_m, quat_xyzw = take.stamp_ns.copy(), take.position_m.copy(), take.quat_xyzw
    inside = (stamp_ns >= at.start_ns) & (stamp_ns <= at.end_ns)
    if what == "missing":
        stamp_ns[stamp_ns > at.end_ns] -= at.end_ns - at.start_ns - PAUSE_NS
        stamp_ns, position_m, quat_xyzw = stamp_ns[~inside], position_m[~inside], quat_xyzw[~inside]
    elif what == "longer":
        stamp_ns += np.clip(stamp_ns - at.start_ns, 0, at.end_ns - at.start_ns)
    elif what == "elsewhere":
        position_m[inside] += SHIFT_M * normal
    else:
        position_m += WORLD_M
    return Trajectory.from_arrays(stamp_ns, position_m, quat_xyzw, time_unit="ns")


def verdict_at(found: Comparison, at: TruthInterval, origin_ns: int) -> tuple[str, int]:
    """What is said of the step of the first take around the middle of an interval, and the number of other
    differences."""
    middle_s = (0.5 * (at.start_ns + at.end_ns) - origin_ns) * 1e-9
    steps = [
        one for one in found.steps if one.first and one.first[0].start_s <= middle_s <= one.first[-1].end_s
    ]
    false = sum(one not in steps for one in found.differences)
    return (steps[0].verdict.value if steps else "open"), false


def main(folder: Path) -> None:
    """Print a row per kind of change, over pairs of one take and the next."""
    rows = Counter[tuple[str, str]]()
    for task in TASKS:
        logs = [str(path) for path in sorted(folder.glob(f"{task}_*.mcap"))]
        results: list[Result] = [segment(log) for log in logs] if len(logs) > 1 else []
        for i, second in enumerate(results):
            before, log, first = logs[i - 1], logs[i], results[i - 1]
            found = unchanged = compare_outcomes(first, second)
            rows["no change", "pairs"] += 1
            rows["no change", "false"] += len(found.differences)
            rows["no change", "same"] += sum(one.verdict is Verdict.SAME for one in found.steps)
            rows["no change", "open"] += sum(one.verdict is Verdict.OPEN for one in found.steps)
            own = list(long_contacts(before))
            other = list(long_contacts(log))
            pairs = list(zip(own[::-1], other[::-1], strict=False))  # a "?" may cut the first
            faces = (s.geometry.environment for s in first.segments if s.contact is Contact.FF and s.geometry)
            normal = next(one.normal for one in faces if isinstance(one, Plane) and not one.unobserved)
            for kind, count in (("missing", 9), ("longer", 9), ("elsewhere", 9), ("world", 1)):
                for mine, at in pairs[:count]:
                    if kind != "world" and verdict_at(unchanged, mine, first.origin_ns)[0] != "same":
                        rows[kind, "not told in takes without change"] += 1
                        continue
                    if kind == "elsewhere" and at.contact is not Contact.FF:
                        continue
                    found = compare_outcomes(first, segment(changed(read(log), kind, at, normal)))
                    said, false = verdict_at(found, mine, first.origin_ns)
                    rows[kind, "of"] += 1
                    rows[kind, said if kind != "world" else f"{len(found.notes)} notes"] += 1
                    rows[kind, "false"] += false
                    print(task, Path(log).stem, kind, at.contact, said, false, found.notes, flush=True)
    if not rows:
        raise SystemExit(f"{folder}: no two takes TASK_NUMBER.mcap of {', '.join(TASKS)}")
    for key, count in sorted(rows.items()):
        print(*key, count)


if __name__ == "__main__":
    if len(sys.argv) != 2:
        raise SystemExit("usage: python tests/benchmarks/takes.py FOLDER, in which the takes are")
    main(Path(sys.argv[1]))
