"""LeRobot data sets (v2.1 and v3): the poses of their episodes, and a copy with the contacts of each frame.

A data set is a folder with ``meta/info.json`` and Parquet files in ``data/``, whose rows are frames with an
``episode_index`` and a ``timestamp`` (s). The copy has LeRobot's subtasks
(https://huggingface.co/docs/lerobot/dataset_subtask) and probabilities of contacts.
"""

import json
import os
import re
import shutil
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Executor
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow
from numpy.typing import NDArray
from pyarrow import compute
from pyarrow.parquet import ParquetFile, write_table

from contact_tracker.config.parameters import Model
from contact_tracker.config.table_reading import AS_NAMED, TableReading, reading_of
from contact_tracker.errors import ContactTrackerError, UnreadableRecording, UsageError
from contact_tracker.files import read_regular
from contact_tracker.map.map import EMPTY_MAP, Map
from contact_tracker.segmenting import evidence_as_given, segmented
from contact_tracker.states import STATES
from contact_tracker.trajectory import Trajectory
from contact_tracker.trajectory.arguments import ModelLike, model_from
from contact_tracker.wrenches.wrenches import Wrenches

INFO: Final = os.path.join("meta", "info.json")
VERSIONS: Final = ("v2.0", "v2.1", "v3.0")
SUBTASK, PROBABILITY = "subtask_index", "contact_probability"
NAMES: Final = (*(state.value for state in STATES), "open", "unknown")
"""Names of subtasks: a contact, ``open`` if the motion leaves it open, ``unknown`` in unusable episodes."""
_MOST_BYTES: Final = 20_000_000
"""Largest size of ``info.json`` and ``stats.json`` (bytes); real ones have some kilobytes."""
_MOST_BYTES_OF_EPISODES: Final = 1_000_000_000
"""Largest size of ``episodes_stats.jsonl`` (bytes); real ones have some kilobytes per episode."""
_WRENCH: Final = re.compile(r"([^\[\]]+)(?:\[(\d{1,4}):(\d{1,4})\])?")
"""A feature, or a range of its entries, as ``observation.state[7:13]``."""
_ERRORS: Final = (pyarrow.ArrowException, OSError, ValueError, KeyError)


_Labels = tuple[NDArray[np.int64], NDArray[np.float32]]
"""Labels of the N frames of an episode: indices of ``NAMES`` (N,), and probabilities (N, 7)."""


@dataclass(frozen=True)
class LeRobot:
    """A LeRobot data set on this machine.

    Parameters
    ----------
    folder, info : its path, and the content of ``meta/info.json``.
    files : the Parquet files of frames, relative to the folder.
    reading : the entries of features that are the pose, and the convention of angles; by default found by the
        names of the entries of observations in ``info``.
    """

    folder: Path
    info: Mapping[str, Any]
    files: tuple[str, ...]
    reading: TableReading = AS_NAMED

    @classmethod
    def open(cls, folder: str | os.PathLike[str], **reading: Any) -> "LeRobot":
        """Open a data set.

        Parameters
        ----------
        folder : path of the data set.
        reading : ``columns``, ``unit``, ``euler``, ``rotation_vector`` and ``matrix``, as of
            ``contact_tracker.read``: ``columns={"position": "observation.state[0:3]", ...}``.

        Raises
        ------
        UnreadableRecording : the folder is no data set of a known version.
        UsageError : an argument of the reading is invalid.
        """
        path = Path(folder)
        try:
            info = json.loads(read_regular(path / INFO, _MOST_BYTES))
        except (OSError, ValueError, RecursionError) as error:
            raise UnreadableRecording(f"{path / INFO} cannot be read: {error}") from error
        version = info.get("codebase_version") if isinstance(info, dict) else None
        if version not in VERSIONS or not isinstance(info.get("features"), dict):
            raise UnreadableRecording(
                f"{path}: LeRobot data sets of {', '.join(VERSIONS)} are read, not of {version}; LeRobot "
                "converts older ones"
            )
        files = sorted(file.relative_to(path).as_posix() for file in (path / "data").glob("*/*.parquet"))
        if not files:
            raise UnreadableRecording(f"{path}: there are no frames, data/*/*.parquet")
        try:
            return cls(path, info, tuple(files)).read_as(reading_of(**reading))
        except (TypeError, ValueError) as error:
            raise UsageError(f"{path}: {error}") from error

    def read_as(self, reading: TableReading) -> "LeRobot":
        """The data set with another reading of the features; raises UsageError if the reading sets the time,
        which is always ``timestamp``, in seconds."""
        if reading.time_unit is not None or "time" in dict(reading.columns):
            raise UsageError(f"{self.folder}: the time of a LeRobot data set is timestamp, in seconds")
        return replace(self, reading=reading)

    def episodes(self) -> Iterator[tuple[int, str]]:
        """The number of each episode, with the file of its frames."""
        for file in self.files:
            for number in _read(self.folder / file, ["episode_index"])["episode_index"].unique().to_pylist():
                yield int(number), file

    def trajectory(self, episode: int) -> Trajectory:
        """The poses of an episode.

        Raises
        ------
        UsageError : the episode does not exist, or the entries of the pose are not known.
        InputError : a file cannot be read, or has no usable pose.
        """
        frames = self._frames(episode, *self._observations())
        is_by_number = any("[" in name for _, name in self.reading.columns)
        table: dict[str, Any] = {"timestamp": frames["timestamp"].to_numpy().astype(float)}
        for feature in self._observations():
            values = self._numbers(frames, feature)
            names = _entries(feature, self.info["features"][feature], values.shape[1], is_by_number)
            table |= dict(zip(names, values.T, strict=True))
        how = {name: getattr(self.reading, name) for name in ("unit", "euler", "rotation_vector", "matrix")}
        try:
            columns = dict(self.reading.columns) or None
            poses = Trajectory.from_dataframe(table, time_unit="s", columns=columns, **how)
        except UsageError as error:
            entries = ", ".join(table)
            raise UsageError(
                f"{self.folder}: which entries are the pose is not known ({error}); say it as in --columns "
                f"position=observation.state[0:3],quaternion=observation.state[3:7]; there are {entries}"
            ) from error
        return replace(poses, name=f"{self.folder.name} episode {episode}")

    def wrenches(self, episode: int, entries: str) -> Wrenches:
        """The wrenches of the hand or robot on the object in an episode, for ``segment``.

        Parameters
        ----------
        entries : a feature, or a range of its entries, as ``observation.state[7:13]``, or several with commas
            between, six numbers in all: force (N), and moment (N m) about the origin of the body frame, in
            its axes.

        Raises
        ------
        UsageError : the episode does not exist, or the entries are not six numbers.
        UnreadableRecording : a file cannot be read.
        """
        parts = self._wrench_parts(entries)
        frames = self._frames(episode, *(name for name, _ in parts))
        values = np.concatenate([self._numbers(frames, name)[:, span] for name, span in parts], axis=1)
        if values.shape[1] != 6:
            raise UnreadableRecording(f"{self.folder}: {entries} has {values.shape[1]} numbers, not six")
        return Wrenches(_stamp_ns(frames), values[:, :3], values[:, 3:])

    @cached_property
    def _file_of(self) -> dict[int, str]:
        """The file of each episode's frames; raises UnreadableRecording for an episode in two files."""
        files = dict[int, str]()
        for number, file in self.episodes():
            if files.setdefault(number, file) != file:
                raise UnreadableRecording(f"{self.folder}: episode {number} is in two files")
        return files

    def _wrench_parts(self, entries: str) -> list[tuple[str, slice]]:
        """The features of a wrench, each with the slice of its numbers; raises UsageError."""
        names, matches = self._observations(), [_WRENCH.fullmatch(part) for part in entries.split(",")]
        if not all(match and match[1] in names for match in matches):
            raise UsageError(f"{self.folder}: a wrench is in {', '.join(names) or 'none'}, not in {entries}")
        parts = [(m[1], slice(int(m[2]), int(m[3])) if m[2] else slice(None)) for m in matches if m]
        count = sum(len(range(self.info["features"][name]["shape"][0])[span]) for name, span in parts)
        if count != 6:
            raise UsageError(
                f"{self.folder}: {entries} has {count} numbers: a wrench has six, force and moment, as "
                "observation.state[7:13]"
            )
        return parts

    def _numbers(self, frames: Any, feature: str) -> NDArray[np.float64]:
        """The numbers (N, D) of a feature; raises UnreadableRecording."""
        try:
            return np.array(frames[feature].to_pylist(), float).reshape(len(frames), -1)
        except (TypeError, ValueError) as error:
            missing = bool(frames[feature].null_count)
            fault = "missing values" if missing else "not as many numbers in each frame"
            raise UnreadableRecording(f"{self.folder}: {feature} has {fault}") from error

    def _frames(self, episode: int, *features: str) -> Any:
        """The table of an episode's frames, with ``timestamp`` and the named features."""
        if episode not in self._file_of:
            raise UsageError(f"{self.folder}: there is no episode {episode}")
        columns = list(dict.fromkeys(["episode_index", "timestamp", *features]))
        frames = _read(self.folder / self._file_of[episode], columns)
        return frames.filter(compute.equal(frames["episode_index"], episode))

    def _observations(self) -> list[str]:
        """Names of the features that are observations and lists of numbers."""
        return [
            name
            for name, feature in self.info["features"].items()
            if name.startswith("observation.")
            and isinstance(feature, dict)
            and str(feature.get("dtype")).startswith("float")
            and isinstance(feature.get("shape"), list)
            and len(feature["shape"]) == 1
            and isinstance(feature["shape"][0], int)
            and 0 < feature["shape"][0] < 2**31
        ]

    def annotate(
        self,
        out: str | os.PathLike[str],
        model: ModelLike = "default",
        known_map: Map = EMPTY_MAP,
        report: Callable[[str], None] = lambda _: None,
        executor: Executor | None = None,
        wrench: str | None = None,
    ) -> int:
        """Write a copy of the data set with the contacts of each frame into the new folder ``out``.

        The copy has the columns ``subtask_index`` and ``contact_probability`` (7, in the order of ``STATES``)
        in ``data``, these features in ``meta/info.json``, the names of subtasks in ``meta/subtasks.parquet``
        (v2: ``.jsonl``). An unusable episode is reported and ``unknown``. There is no folder after a failure.
        ``wrench`` is ``entries`` of ``wrenches``.

        Returns
        -------
        The number of unusable episodes.

        Raises
        ------
        UsageError : the folder exists or is inside the data set, or ``wrench`` is not in the data set.
        UnreadableRecording : there are no frames, or a file of frames or statistics cannot be read.
        OSError : the copy cannot be written.
        """
        target = Path(os.path.abspath(out))
        if target.exists() or Path(os.path.abspath(self.folder)) in target.parents:
            raise UsageError(f"cannot write {out}: a copy of a data set is a new folder beside it")
        bad, used = 0, model_from(model, None, None)
        jobs = [(self, number, used, known_map, wrench) for number in self._file_of]
        if not jobs:
            raise UnreadableRecording(f"{self.folder}: there are no frames")
        if wrench is not None:
            self._wrench_parts(wrench)  # once, as it holds for all episodes
        results = map(_labels_of, jobs) if executor is None else executor.map(_labels_of, jobs)
        with tempfile.TemporaryDirectory(prefix=".contact-tracker-", dir=target.parent) as folder:
            copy = Path(folder) / target.name
            for path in self.folder.rglob("*"):
                if path.is_symlink() and path.is_dir():
                    raise UsageError(f"{path} is a link to a folder, of which no copy is made: remove it")
            written = {self.folder / file for file in self.files}
            shutil.copytree(
                self.folder, copy, ignore=lambda at, names: [n for n in names if Path(at, n) in written]
            )
            labels = dict[str, dict[int, _Labels]]()
            files = self._file_of.items()
            for (number, file), (of_episode, is_bad, lines) in zip(files, results, strict=True):
                bad += is_bad
                for line in lines:
                    report(f"{self.folder}: episode {number}: {line}")
                labels.setdefault(file, {})[number] = of_episode
            for file, of_file in labels.items():
                try:
                    frames = ParquetFile(self.folder / file).read()
                except _ERRORS as error:
                    raise UnreadableRecording(f"{self.folder / file} cannot be read: {error}") from error
                (copy / file).parent.mkdir(parents=True, exist_ok=True)
                write_table(_with_labels(frames, of_file), copy / file)
            self._write_meta(copy)
            _drop_statistics(copy)
            copy.rename(target)
        return bad

    def _write_meta(self, copy: Path) -> None:
        features = dict(self.info["features"])
        features[SUBTASK] = {"dtype": "int64", "shape": [1], "names": None}
        features[PROBABILITY] = {"dtype": "float32", "shape": [len(STATES)], "names": list(STATES)}
        text = json.dumps({**self.info, "features": features}, indent=4)
        (copy / INFO).write_text(text + "\n", encoding="utf-8")
        if str(self.info["codebase_version"]).startswith("v2"):
            rows = (json.dumps({SUBTASK: k, "subtask": name}) for k, name in enumerate(NAMES))
            (copy / "meta" / "subtasks.jsonl").write_text("\n".join(rows) + "\n", encoding="utf-8")
            return
        kinds = {SUBTASK: ("int64", "int64"), "subtask": ("unicode", "object")}
        described = [
            {"name": name, "field_name": name, "pandas_type": kind, "numpy_type": type, "metadata": None}
            for name, (kind, type) in kinds.items()
        ]
        index = {"index_columns": ["subtask"], "column_indexes": [], "columns": described}
        table = pyarrow.table({SUBTASK: pyarrow.array(range(len(NAMES)), pyarrow.int64()), "subtask": NAMES})
        table = table.replace_schema_metadata({"pandas": json.dumps(index)})  # LeRobot looks names up in it
        write_table(table, copy / "meta" / "subtasks.parquet")


def _read(path: Path, columns: list[str]) -> Any:
    """Columns of a Parquet file; raises UnreadableRecording."""
    try:
        with ParquetFile(path) as file:
            missing = [name for name in columns if name not in file.schema_arrow.names]
            if missing:
                raise UnreadableRecording(f"{path}: there is no column {missing[0]}")
            return file.read(columns)
    except _ERRORS as error:
        raise UnreadableRecording(f"{path} cannot be read: {error}") from error


def _entries(feature: str, description: Mapping[str, Any], count: int, is_by_number: bool) -> list[str]:
    """Names of the ``count`` entries of a feature: those in ``info.json`` (a list, one under ``motors``, or
    keys), if there are as many; else their numbers."""
    names = description.get("names")
    if isinstance(names, dict):
        lists = [value for value in names.values() if isinstance(value, list)]
        names = lists[0] if lists else list(names)
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        names = []
    if is_by_number or len(names) != count:
        return [f"{feature}[{i}]" for i in range(count)]
    often = Counter(names)
    return [f"{feature}.{name}{i if often[name] > 1 else ''}" for i, name in enumerate(names)]


def _stamp_ns(frames: Any) -> NDArray[np.int64]:
    time_s: NDArray[np.float64] = frames["timestamp"].to_numpy().astype(float)
    return np.rint(1e9 * time_s).astype(np.int64)


def _labels_of(
    job: tuple[LeRobot, int, Model, Map, str | None],
) -> tuple[_Labels, bool, tuple[str, ...]]:
    """The labels of an episode's frames, whether the episode is unusable, and lines to report."""
    data, episode, model, known_map, wrench = job
    stamp_ns = _stamp_ns(data._frames(episode))
    unknown = np.full(len(stamp_ns), NAMES.index("unknown"))
    uniform = np.full((len(stamp_ns), len(STATES)), 1.0 / len(STATES), np.float32)
    evidence, lines = None, tuple[str, ...]()
    try:
        trajectory = data.trajectory(episode)
        if wrench is not None:
            wrenches = data.wrenches(episode, wrench)
            result = evidence_as_given(wrenches, wrench, trajectory.poses, model, known_map)
            evidence, _, lines = result
        outcome = segmented(trajectory, model, known_map, evidence)
    except ContactTrackerError as error:
        return (unknown, uniform), True, (str(error),)
    segments = outcome.segments
    starts = np.array([segment.start_ns for segment in segments])
    names = np.array([NAMES.index("open" if s.inseparable else s.contact) for s in segments])
    number = np.maximum(np.searchsorted(starts, stamp_ns, side="right") - 1, 0)
    tick = np.minimum(np.searchsorted(outcome.beliefs.stamp_ns, stamp_ns), len(outcome.beliefs) - 1)
    return (names[number], outcome.beliefs.probability[tick].astype(np.float32)), False, lines


def _with_labels(frames: Any, labels: Mapping[int, _Labels]) -> Any:
    """A table of frames with the columns of their labels, in place of earlier ones."""
    episode = frames["episode_index"].to_numpy()
    subtask, probability = np.zeros(len(frames), np.int64), np.zeros((len(frames), len(STATES)), np.float32)
    for number, (episode_subtask, episode_probability) in labels.items():
        subtask[episode == number], probability[episode == number] = episode_subtask, episode_probability
    frames = frames.drop_columns([name for name in (SUBTASK, PROBABILITY) if name in frames.column_names])
    rows = pyarrow.FixedSizeListArray.from_arrays(probability.ravel(), len(STATES))
    frames = frames.append_column(SUBTASK, pyarrow.array(subtask)).append_column(PROBABILITY, rows)
    metadata = frames.schema.metadata or {}
    with suppress(KeyError, TypeError, ValueError):  # "datasets" reads the columns that are named there
        described = json.loads(metadata[b"huggingface"])
        value = {"dtype": "float32", "_type": "Value"}
        described["info"]["features"] |= {
            SUBTASK: {"dtype": "int64", "_type": "Value"},
            PROBABILITY: {"feature": value, "length": len(STATES), "_type": "Sequence"},
        }
        frames = frames.replace_schema_metadata({**metadata, b"huggingface": json.dumps(described)})
    return frames


def _drop_statistics(copy: Path) -> None:
    """Remove statistics of earlier columns that were replaced. The new ones have none, as those that LeRobot
    adds to a data set."""
    meta, path = copy / "meta", copy
    try:
        if (path := meta / "stats.json").exists():
            statistics = _others(json.loads(read_regular(path, _MOST_BYTES)))
            path.write_text(json.dumps(statistics, indent=4) + "\n", encoding="utf-8")
        if (path := meta / "episodes_stats.jsonl").exists():
            lines = read_regular(path, _MOST_BYTES_OF_EPISODES).splitlines()
            rows = [json.loads(line) for line in lines if line.strip()]
            rows = [{**row, "stats": _others(row["stats"])} for row in rows]
            path.write_text("".join(json.dumps(row) + "\n" for row in rows), encoding="utf-8")
        for path in meta.glob("episodes/*/*.parquet"):
            episodes = ParquetFile(path).read()
            replaced = tuple(f"stats/{name}/" for name in (SUBTASK, PROBABILITY))
            if stale := [name for name in episodes.column_names if name.startswith(replaced)]:
                kept = episodes.drop_columns(stale)  # "datasets" finds the columns by itself
                metadata = {
                    key: text for key, text in (kept.schema.metadata or {}).items() if key != b"huggingface"
                }
                write_table(kept.replace_schema_metadata(metadata), path)
    except (*_ERRORS, AttributeError, TypeError, RecursionError) as error:
        name = path.relative_to(copy)
        raise UnreadableRecording(f"{name}: statistics cannot be read: {error!r}") from error


def _others(statistics: Mapping[str, Any]) -> dict[str, Any]:
    """The statistics of all features but the labels."""
    return {name: of for name, of in statistics.items() if name not in (SUBTASK, PROBABILITY)}
