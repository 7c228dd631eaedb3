"""One recording of a batch: settings, reading, writing, and its row of the summary (docs/batch.md)."""

import errno
import json
import os
import traceback
from collections.abc import Iterable
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path, PurePosixPath
from typing import Any, Final, NamedTuple

import contact_tracker.errors as errors
from contact_tracker.batch.finding import read_content, signature_of
from contact_tracker.config.parameters import Model
from contact_tracker.config.table_reading import AS_NAMED, TableReading
from contact_tracker.errors import ContactTrackerError, MissingExtra, UnreadableRecording, printable
from contact_tracker.exports.columns import COLUMNS, PROBABILITIES, Rows, columns_of, kinds_of
from contact_tracker.exports.parquet import open_parquet
from contact_tracker.files import whole_file
from contact_tracker.map.map import Map
from contact_tracker.outputs.adaptation import report_json
from contact_tracker.outputs.text import is_open
from contact_tracker.recording import PoseLog, open_log
from contact_tracker.saved_state import fingerprint
from contact_tracker.segmenting import OfflineTracker, recorded_evidence
from contact_tracker.tracking.belief import Detail, Segment
from contact_tracker.version import __version__

Row = dict[str, Any]
"""A row of the summary: values by the names of ``SUMMARY_COLUMNS``."""

_STATES: Final = tuple(name.removeprefix("p_") for name in PROBABILITIES)
_OPEN: Final = "open"
"""Label of segments whose contact the motion leaves open among all states."""
_KINDS: Final = (*_STATES, _OPEN)
NO_SEGMENTS: Final[Row] = {
    **dict.fromkeys(("segments", *(f"segments_{state}" for state in _KINDS)), 0),
    **dict.fromkeys((f"time_{state}_s" for state in _KINDS), 0.0),
}
SUMMARY_COLUMNS: Final = {
    **kinds_of("text", "recording"),
    **kinds_of("integer", "exit_code"),
    **kinds_of("text", "error", "damage", "warnings", "counts"),
    **kinds_of("integer", "poses", "first_ns", "last_ns"),
    **kinds_of("number", "duration_s"),
    **kinds_of("integer", "ticks", "segments", *(f"segments_{state}" for state in _KINDS)),
    **kinds_of("number", *(f"time_{state}_s" for state in _KINDS)),
    **kinds_of("number", "tick_s", "sigma_position_m", "sigma_rotation_rad"),
    **kinds_of("number", "tick_sigma_position_m", "tick_sigma_rotation_rad"),
    **kinds_of("text", "topic", "frame_id", "child_frame_id"),
    **kinds_of("integer", "size_bytes"),
    **kinds_of("text", "content_hash", "model", "model_hash", "settings_hash", "version", "file"),
    **kinds_of("integer", "segments_bytes", "ticks_bytes"),
}


def row_name(name: str) -> str:
    """The name of a recording as valid text for the column ``recording``."""
    return name.encode("utf-8", "surrogateescape").decode("utf-8", "backslashreplace")


def file_of(name: str) -> str:
    """The path of a recording's Parquet files, below the folders ``segments`` and ``ticks``."""
    import hashlib

    digits = hashlib.blake2b(row_name(name).encode(), digest_size=16).hexdigest()
    return str(PurePosixPath(digits[:2], f"{digits[2:]}.parquet"))


@dataclass(frozen=True, eq=False)
class Settings:
    """All settings that determine the result of a recording.

    Parameters
    ----------
    topic, frame, relative_to : selection of poses, as in ``recording.open_log``.
    table : what the columns of tables are, as in ``recording.open_log``; the words of the command in it are
        without recordings.
    with_ticks : whether to write the beliefs of all ticks, too.
    wrench : topic of measured wrenches, which decide between contacts that motion cannot distinguish.
    """

    model: Model
    known_map: Map
    topic: str | None = None
    frame: str | None = None
    relative_to: str | None = None
    with_ticks: bool = False
    table: TableReading = AS_NAMED
    wrench: str | None = None

    @cached_property
    def model_hash(self) -> str:
        """Hash of the model with its noise, and of the map."""
        return fingerprint((self.model, self.known_map))

    @cached_property
    def settings_hash(self) -> str:
        """Hash of all but ``with_ticks``, and of the version."""
        which = self.topic, self.frame, self.relative_to, tuple(self.table.words())
        return fingerprint((__version__, self.model_hash, which, self.wrench or ""))


def count(segments: Iterable[Segment], cells: Row) -> None:
    """Add segments to the cells of a row: their number, and number and duration (s) of each state."""
    for segment in segments:
        state = _OPEN if is_open(segment) else _STATES[segment.contact.column]
        cells["segments"] += 1
        cells[f"segments_{state}"] += 1
        lasted_s = cells[f"time_{state}_s"] + (segment.end_ns - segment.start_ns) * 1e-9
        cells[f"time_{state}_s"] = round(lasted_s, 9)


def base(name: str, settings: Settings) -> Row:
    """A row with the recording and settings only."""
    return dict.fromkeys(SUMMARY_COLUMNS) | {
        "recording": row_name(name),
        "exit_code": errors.DONE,
        "model": settings.model.name,
        "model_hash": settings.model_hash,
        "settings_hash": settings.settings_hash,
        "version": __version__,
    }


def failure(name: str, settings: Settings, exit_code: int, error: str, content_hash: str | None) -> Row:
    """The row of a recording without segments.

    ``content_hash`` is None if a further run with the same content and settings may succeed.
    """
    row = base(name, settings)
    return row | {"exit_code": exit_code, "error": printable(error), "content_hash": content_hash}


Content = tuple[str, str]
"""Signature and hash of the content of a recording, from which its existing result was made."""


class Answer(NamedTuple):
    """The new ``row`` of a recording, None if it is unchanged, and its current ``signature``."""

    name: str
    signature: str
    row: Row | None


def segment_recording(name: str, previous: Content | None, settings: Settings, folder: str) -> Answer:
    """Write the segments of a recording into the dataset in ``folder``, if it differs from ``previous``.

    The result depends only on the recording's content, its name and the settings. Errors of a recording are
    reported in its row, not raised; raises OSError if the dataset cannot be written.
    """
    try:
        signature = signature_of(name)
        if previous is not None and signature and signature == previous[0]:
            return Answer(name, signature, None)
        answer = _answer(name, signature, previous, settings, Path(folder))
        if signature_of(name) != signature:
            raise UnreadableRecording(f"{name}: it changed while it was read")
    except ContactTrackerError as error:
        answer = Answer(name, "", failure(name, settings, _code(error), str(error), None))
    if answer.row is not None and answer.row["segments_bytes"] is None:
        _remove(Path(folder), file_of(name), "segments", "ticks")
    return answer


def _code(error: ContactTrackerError) -> int:
    return errors.INPUT if isinstance(error, errors.InputError) else errors.USAGE


def _answer(name: str, signature: str, previous: Content | None, settings: Settings, folder: Path) -> Answer:
    try:
        content_hash, size_bytes = read_content(name)
    except OSError as error:
        raise UnreadableRecording(f"{name}: {error.strerror or error}") from error
    if previous is not None and content_hash == previous[1]:
        return Answer(name, signature, None)
    try:
        row = _segmented(name, settings, folder)
        return Answer(name, signature, row | {"content_hash": content_hash, "size_bytes": size_bytes})
    except ContactTrackerError as error:
        code, text = _code(error), str(error)
        is_lasting = not isinstance(error, MissingExtra) and not isinstance(error.__cause__, OSError)
    except MemoryError:
        code, text, is_lasting = errors.INPUT, "it takes more memory than there is", False
    except OSError:
        raise
    except Exception as error:
        frame = traceback.extract_tb(error.__traceback__)[-1]
        place = f"{os.path.basename(frame.filename)}:{frame.lineno}"
        text = f"this should not happen, please report it: {type(error).__name__}: {error} ({place})"
        code, is_lasting = errors.UNEXPECTED, True
    text = text if name in text else f"{name}: {text}"
    row = failure(name, settings, code, text, content_hash if is_lasting else None)
    return Answer(name, signature, row | {"size_bytes": size_bytes})


def _segmented(name: str, settings: Settings, folder: Path) -> Row:
    """Write the files of a recording; returns its row."""
    model, known_map, evidence, unused = settings.model, settings.known_map, None, tuple[str, ...]()
    if settings.wrench is not None:
        poses = _open(name, settings)
        evidence, _, unused = recorded_evidence(name, settings.wrench, poses, model, known_map)
    log = _open(name, settings)
    tracker = OfflineTracker(model, known_map, wrenches=evidence, read_as=log.source.read_as)
    cells, ticks, file, recording = dict(NO_SEGMENTS), 0, file_of(name), row_name(name)
    targets: list[Rows] = ["segments", "ticks"] if settings.with_ticks else ["segments"]
    with ExitStack() as stack:
        appends = {}
        for rows in targets:
            target = folder / rows / file
            require_no_link(folder, f"{rows}/{file}")
            target.parent.mkdir(parents=True, exist_ok=True)
            temporary = stack.enter_context(whole_file(target))
            columns = kinds_of("text", "recording") | COLUMNS[rows]
            appends[rows] = stack.enter_context(open_parquet(columns, temporary, rows == "segments"))
        for piece in tracker.pieces(log, None, Detail.WEIGHTS):
            count(piece.segments, cells)
            ticks += len(piece.beliefs)
            for rows, append in appends.items():
                entries: Any = piece.beliefs if rows == "ticks" else piece.segments
                append({"recording": [recording] * len(entries), **columns_of(rows, entries)})
        if not log.valid:
            raise log.no_poses(name)
    if not settings.with_ticks:
        _remove(folder, file, "ticks")
    noted = {**log.counts, "outlier": tracker.outliers.total}
    report = {} if tracker.report is None else report_json(tracker.report)
    notes = [*filter(None, [log.note]), *log.remarks, *unused, *report.pop("warnings", [])]
    return {
        **base(name, settings),
        "ticks": ticks,
        **cells,
        **{name: cell for name, cell in report.items() if name in SUMMARY_COLUMNS},
        "exit_code": errors.DONE if log.damage is None else errors.DAMAGED,
        "damage": log.damage,
        "warnings": "\n".join(notes) or None,
        "counts": json.dumps({kind: count for kind, count in sorted(noted.items()) if count}),
        "poses": log.valid,
        "first_ns": log.first_ns,
        "last_ns": log.last_ns,
        "duration_s": (log.last_ns - log.first_ns) / 1e9,
        "topic": log.source.topic,
        "frame_id": log.source.frame_id,
        "child_frame_id": log.source.child_frame_id,
        "file": file,
        **{f"{kind}_bytes": (folder / kind / file).stat().st_size for kind in targets},
    }


def _open(path: str, settings: Settings) -> PoseLog:
    frame, relative_to, given = settings.frame, settings.relative_to, settings.table.given
    table = replace(settings.table, given=given and (*given, path))  # a proposed command has this file alone
    return open_log(path, settings.topic, frame, relative_to=relative_to, table=table)


def require_no_link(folder: Path, name: str) -> None:
    """Raise OSError if a file of the dataset in ``folder``, or a folder on the way to it, is a link: it might
    lead out of the dataset."""
    path = folder / name
    for component in (path, *path.parents[: len(path.parts) - len(folder.parts) - 1]):
        if component.is_symlink():
            raise OSError(errno.ELOOP, "it is a link, and a dataset has none", str(component))


def _remove(folder: Path, file: str, *kinds: str) -> None:
    for kind in kinds:
        require_no_link(folder, f"{kind}/{file}")
        (folder / kind / file).unlink(missing_ok=True)
