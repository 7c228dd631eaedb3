"""Writes docs/gallery.md and its pictures from extracts of public recordings in a folder:

    python docs/examples/gallery.py FOLDER

gallery.toml lists the recordings. Each is searched in and below FOLDER by its name and its digest; TOML files
that its command names are beside it, with any content. If a file is absent, a line says so, and the page says
that the recording was not run.
"""

import hashlib
import shlex
import subprocess
import sys
import tomllib
from bisect import bisect_right
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

from contact_tracker import Result
from contact_tracker.cli.terminal import say
from contact_tracker.exports.columns import decided
from contact_tracker.tracking.belief import Segment

DOCS: Final = Path(__file__).parents[1]


def accuracy(result: Result) -> str:
    """The share of the poses, of those with a true contact in the file, that segments label with it."""
    truth, stamp_ns = result.truth, result.trajectory.stamp_ns
    assert truth is not None
    true = [None if i < 0 else truth.intervals[i].contact for i in truth.at(stamp_ns)]
    starts = [segment.start_ns for segment in result.segments]
    labels = [result.segments[max(bisect_right(starts, ns) - 1, 0)].contact for ns in stamp_ns]
    right = [a is b for a, b in zip(true, labels, strict=True) if a is not None]
    return f"right in {sum(right) / len(right):.2f} of {len(right)} poses"


def joints(result: Result) -> str:
    """The joints that are named, and where."""
    return spans([(s, s.joint.kind if s.joint else "no joint") for s in result.segments], result)


def contacts(result: Result) -> str:
    """The contacts that are decided, and where."""
    return spans([(s, decided(s)) for s in result.segments], result)


FIGURES: Final = {"accuracy": accuracy, "joints": joints, "contacts": contacts}


def spans(named: list[tuple[Segment, str]], result: Result) -> str:
    """The names with their times; neighbours of one name are one span."""
    joined = list[tuple[str, int, int]]()
    for segment, name in named:
        start_ns = joined.pop()[1] if joined and joined[-1][0] == name else segment.start_ns
        joined.append((name, start_ns, segment.end_ns))
    times = [
        (name, *((ns - result.origin_ns) * 1e-9 for ns in (first, last))) for name, first, last in joined
    ]
    return ", ".join(f"{name} from {first:.1f} to {last:.1f} s" for name, first, last in times)


def recording(entry: dict[str, Any], folder: Path) -> tuple[Path | None, str]:
    """The path of an entry's recording, or None and what is absent."""
    _, _, file, *options = shlex.split(entry["command"])
    paths = sorted(folder.rglob(file)) if "sha256" in entry else []
    path = next(
        (path for path in paths if hashlib.sha256(path.read_bytes()).hexdigest() == entry["sha256"]), None
    )
    if path is None:
        return None, f"{folder} has no {file}" + (" of the known content" if paths else "")
    for option in options:
        if option.endswith(".toml") and not path.with_name(option).is_file():
            return None, f"{path.with_name(option)} is absent"
    return path, ""


def segmented(command: str, path: Path) -> Result:
    """The result of a command for the recording at a path, beside which are other files that it names."""
    _, verb, _, *options = shlex.split(command)
    options = [str(path.with_name(option)) if option.endswith(".toml") else option for option in options]
    with TemporaryDirectory() as scratch:
        output = f"{scratch}/result.contacts"
        words = [sys.executable, "-m", "contact_tracker", verb, "-q", str(path), *options, "-o", output]
        if code := subprocess.run(words).returncode:
            raise SystemExit(f"{command}: exit code {code}")
        return Result.load(output)


def section(number: int, entry: dict[str, Any], folder: Path) -> str:
    """The part of the page on a recording, run if it is there."""
    name, command = entry["name"], entry["command"]
    head = f"## {name}\n\nFrom {entry['source']}. {entry['asks']}\n\n```sh\n{command}\n```\n\n"
    path, absent = recording(entry, folder)
    if path is None:
        say(f"{name}: left out, {absent}")
        return head + "Not run here.\n"
    result = segmented(command, path)
    picture = f"images/gallery_{number}.png"
    result.plot().savefig(DOCS / picture, dpi=60)
    figures = FIGURES[entry.get("figure", "contacts")](result)
    image = f"![{name}: segments, probabilities, and what is known of the elements, over time.]({picture})"
    return f"{head}{image}\n\nResult: {figures}.\n\nWhere it is wrong: {entry['wrong']}\n"


def main() -> None:
    if len(sys.argv) != 2 or not Path(sys.argv[1]).is_dir():
        raise SystemExit("usage: python docs/examples/gallery.py FOLDER, in which the recordings are")
    content = tomllib.loads((DOCS / "examples" / "gallery.toml").read_text(encoding="utf-8"))
    sections = [
        section(number, entry, Path(sys.argv[1])) for number, entry in enumerate(content["recording"], 1)
    ]
    (DOCS / "gallery.md").write_text("\n".join([content["head"], *sections]), encoding="utf-8")


if __name__ == "__main__":
    main()
