"""Fuzz targets: each takes one input, and raises ``Violation`` if a property is violated."""

import io
import json
import random
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import NamedTuple

import corpus
import mutations
import numpy as np

import as_values
from command_line import run
from contact_tracker.config.loading import load_model
from contact_tracker.errors import ContactTrackerError
from contact_tracker.map.file import read_map
from contact_tracker.motion.pose_validation import gate
from contact_tracker.saved_state import load

CODES = {0, 1, 2, 3}


class Violation(Exception):
    """A property is violated."""


class Target(NamedTuple):
    """``make`` an input of some file name, and ``attack`` with the file."""

    suffix: str
    make: Callable[[random.Random], bytes]
    attack: Callable[[Path, random.Random], None]


def _command(*arguments: object) -> str:
    """Run a command; returns its output, and checks that stderr has lines of ours only."""
    done = run(*arguments)
    if done.returncode not in CODES:
        raise Violation(f"exit code {done.returncode}")
    for line in done.stderr.splitlines():
        if not line.startswith("contact-tracker: "):
            raise Violation(f"a line of somebody else on stderr: {line!r}")
    if done.returncode in (1, 2) and (done.stdout and arguments[0] != "info"):
        raise Violation("output in spite of an error")
    if done.returncode in (1, 2) and "contact-tracker: error: " not in done.stderr:
        raise Violation(f"an error without a word: {done.stderr!r}")
    for line in (done.stderr + done.stdout).split("\n"):
        if not line.isprintable():
            raise Violation(f"what steers a terminal: {line!r}")
    return done.stdout


def _recording(path: Path, rng: random.Random) -> None:
    command = rng.choice(["info", "info", "segment", "live", "evaluate"])
    if command == "evaluate":
        _command("evaluate", path)
    elif command == "live":
        _check_beliefs(_command("live", path, "--json"))
    elif command == "segment":
        _command("segment", path)
    else:
        if text := _command("info", path, "--json"):
            json.loads(text)


def _check_beliefs(text: str) -> None:
    for line in text.splitlines():
        probability = np.array(list(json.loads(line)["probability"].values()))
        if not (probability >= 0.0).all() or not abs(probability.sum() - 1.0) < 1e-9:
            raise Violation(f"not a distribution: {probability}")


def _model(path: Path, _: random.Random) -> None:
    _quietly(lambda: load_model(str(path)))


def _known(path: Path, rng: random.Random) -> None:
    path.with_name("part.stl").write_bytes(rng.choice(corpus.meshes()))
    _quietly(lambda: read_map(str(path)))


def _mesh(path: Path, rng: random.Random) -> None:
    mesh = path.rename(path.with_name("part.stl" if rng.random() < 0.6 else "part.obj"))
    known = path.with_name("known.toml")
    known.write_text(f'[object.mesh]\npath = "{mesh.name}"\n')
    _quietly(lambda: read_map(str(known)))


def _state(path: Path, _: random.Random) -> None:
    _quietly(lambda: load(path))


def _quietly(call: Callable[[], object]) -> None:
    """A call that may raise a one-line error of the package, without other output."""
    output = io.StringIO()
    try:
        with redirect_stdout(output), redirect_stderr(output):
            call()
    except ContactTrackerError as error:
        if not str(error).isprintable():
            raise Violation(f"an error of several lines: {error}") from error
    if output.getvalue():
        raise Violation(f"output {output.getvalue()!r}")


def _stream(path: Path, rng: random.Random) -> None:
    """Poses through the gate; without it they are refused or valid."""
    seed = int.from_bytes(path.read_bytes(), "little")
    poses = mutations.poses_of(rng.choice(corpus.streams()), random.Random(seed))
    model = load_model()
    try:
        as_values.advance(as_values.start(model), poses)
    except ContactTrackerError as error:
        if not str(error).isprintable():
            raise Violation(f"an error of several lines: {error}") from error
    state, beliefs = as_values.advance(as_values.start(model), gate(poses))
    for belief in [*beliefs, *as_values.finish(state)[1]]:
        total = belief.probability.sum()
        if not (belief.probability >= 0.0).all() or not abs(total - 1.0) < 1e-9:
            raise Violation(f"not a distribution: {belief.probability}")


def _of(seeds: Callable[[], tuple[bytes, ...]], *ways: Callable[[bytes, random.Random], bytes]):
    return lambda rng: rng.choice(ways)(rng.choice(seeds()), rng)


TARGETS = {
    "recording": Target(
        ".mcap",
        _of(corpus.recordings, mutations.bytes_of, mutations.records_of, mutations.records_of),
        _recording,
    ),
    "definition": Target(".mcap", _of(corpus.definitions, mutations.bytes_of, mutations.text_of), _recording),
    "bag": Target(".bag", _of(corpus.bags, mutations.bytes_of), _recording),
    "table": Target(".csv", _of(corpus.texts, mutations.bytes_of, mutations.text_of), _recording),
    "parquet": Target(".parquet", _of(corpus.compressed_tables, mutations.bytes_of), _recording),
    "arrays": Target(".npz", _of(corpus.arrays, mutations.bytes_of), _recording),
    "compressed": Target(".mcap.zst", _of(corpus.compressed_recordings, mutations.bytes_of), _recording),
    "model": Target(".toml", _of(corpus.models, mutations.text_of), _model),
    "known": Target(".toml", _of(corpus.known_files, mutations.text_of), _known),
    "mesh": Target(".mesh", _of(corpus.meshes, mutations.bytes_of, mutations.text_of), _mesh),
    "state": Target(".state", _of(corpus.states, mutations.bytes_of), _state),
    "stream": Target(".seed", lambda rng: rng.randbytes(8), _stream),
}
