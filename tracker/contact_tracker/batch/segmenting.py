"""Segmentation of one recording of a batch: settings, reading, writing, and its summary row."""

import errno
import os
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Final, NamedTuple

from contact_tracker import errors
from contact_tracker.batch import remote, rows
from contact_tracker.batch.finding import read_content, signature_of
from contact_tracker.batch.rows import Row, Settings, Tally
from contact_tracker.errors import ContactTrackerError, InputError, MissingExtra, NoPoses, UnreadableRecording
from contact_tracker.exports.columns import (
    BELIEF_COLUMNS,
    SEGMENT_COLUMNS,
    Columns,
    Kind,
    belief_columns,
    segment_columns,
)
from contact_tracker.exports.parquet import open_parquet
from contact_tracker.files import whole_file
from contact_tracker.motion.poses import Pose, Poses
from contact_tracker.outputs.adaptation import warnings
from contact_tracker.recording import PoseLog, open_log
from contact_tracker.recording.wrenches import RecordedEvidence, recorded_evidence
from contact_tracker.segmenting import OfflineTracker
from contact_tracker.tracking.belief import Detail

_RECORDING: Final[dict[str, Kind]] = {"recording": "text"}
SEGMENTS: Final = _RECORDING | SEGMENT_COLUMNS
TICKS: Final = _RECORDING | BELIEF_COLUMNS


class Known(NamedTuple):
    """A recording at the time of its existing result."""

    signature: str
    content_hash: str


class Answer(NamedTuple):
    """The new ``row`` of a recording, None if it is unchanged, and its current ``signature``."""

    name: str
    signature: str
    row: Row | None


def segment_recording(
    name: str, known: Known | None, settings: Settings, folder: str, within: str | None = None
) -> Answer:
    """Write the segments of a recording into the dataset in ``folder``, unless it is unchanged (``known``).

    The result depends on the recording's content, its name and the settings alone. Errors of a recording are
    reported in its row, not raised.

    Parameters
    ----------
    within : the remote folder in which it was found, as of ``remote.signature_of``.

    Raises
    ------
    OSError
        The dataset cannot be written.
    """
    try:
        signature = _signature_of(name, within)
        if known is not None and signature and signature == known.signature:
            return Answer(name, signature, None)
        if not remote.is_remote(name):
            answer = _answer(name, name, signature, known, settings, Path(folder))
        else:
            with remote.local_copy(name, within) as copy:
                answer = _answer(name, copy, signature, known, settings, Path(folder))
        if _signature_of(name, within) != signature:
            raise UnreadableRecording(f"{remote.shown(name)}: it changed while it was read")
    except ContactTrackerError as error:
        answer = Answer(name, "", rows.failure(name, settings, _code(error), str(error), None))
    if answer.row is not None and answer.row["segments_bytes"] is None:
        _remove(Path(folder), rows.file_of(name), "segments", "ticks")
    return answer


def _signature_of(name: str, within: str | None) -> str:
    return remote.signature_of(name, within) if remote.is_remote(name) else signature_of(name)


def _code(error: ContactTrackerError) -> int:
    return errors.INPUT if isinstance(error, InputError) else errors.USAGE


def _answer(
    name: str, path: str, signature: str, known: Known | None, settings: Settings, folder: Path
) -> Answer:
    """The answer for a recording at the local ``path``."""
    try:
        content = read_content(path)
    except OSError as error:
        raise UnreadableRecording(f"{name}: {error.strerror or error}") from error
    if known is not None and content.digits == known.content_hash:
        return Answer(name, signature, None)
    try:
        row = _segmented(name, path, settings, folder)
        return Answer(
            name, signature, row | {"content_hash": content.digits, "size_bytes": content.size_bytes}
        )
    except ContactTrackerError as error:
        code, text, is_lasting = _code(error), str(error), not isinstance(error, MissingExtra | _Unread)
    except MemoryError:
        code, text, is_lasting = errors.INPUT, "it takes more memory than there is", False
    except OSError:
        raise
    except Exception as error:
        place = _innermost(error)
        text = f"this should not happen, please report it: {type(error).__name__}: {error} ({place})"
        code, is_lasting = errors.UNEXPECTED, True
    shown = remote.shown(name)
    text = text.replace(path, shown)
    text = text if shown in text else f"{shown}: {text}"
    row = rows.failure(name, settings, code, text, content.digits if is_lasting else None)
    return Answer(name, signature, row | {"size_bytes": content.size_bytes})


def _segmented(name: str, path: str, settings: Settings, folder: Path) -> Row:
    """Write the files; returns the row."""
    log, wrenches = _open(path, settings), _wrenches(path, settings)
    stream, tally = _Counted(log), Tally()
    evidence = None if wrenches is None else wrenches.evidence
    tracker = OfflineTracker(
        settings.model, settings.known_map, wrenches=evidence, read_as=log.source.read_as
    )
    outliers, file, recording = 0, rows.file_of(name), rows.shown(name)
    targets = {"segments": SEGMENTS} | ({"ticks": TICKS} if settings.with_ticks else {})
    with ExitStack() as stack:
        append = {}
        for kind, columns in targets.items():
            target = folder / kind / file
            require_no_link(folder, f"{kind}/{file}")
            target.parent.mkdir(parents=True, exist_ok=True)
            temporary = stack.enter_context(whole_file(target))
            append[kind] = stack.enter_context(open_parquet(columns, temporary, kind == "segments"))
        for piece in tracker.pieces(stream, None, Detail.WEIGHTS):
            tally.add(piece.segments, len(piece.beliefs))
            outliers += piece.outliers
            append["segments"](_of(recording, segment_columns(piece.segments)))
            if settings.with_ticks:
                append["ticks"](_of(recording, belief_columns(piece.beliefs)))
        if not stream.poses:
            noted = rows.counts_text(log.counts)
            reason = "" if log.loss is None else f": {log.loss}"
            raise NoPoses(
                f"{name}: no pose that can be used{reason}{f'; noted: {noted}' if log.counts else ''}"
            )
    if not settings.with_ticks:
        _remove(folder, file, "ticks")
    adapted = tracker.report
    unused = () if wrenches is None else wrenches.warnings
    notes = [*filter(None, [log.note]), *log.remarks, *unused]
    notes += [] if adapted is None else warnings(adapted)
    return {
        **rows.base(name, settings),
        **tally.cells(),
        **rows.adapted_cells(adapted),
        "exit_code": errors.DONE if log.damage is None else errors.DAMAGED,
        "damage": log.damage,
        "warnings": "\n".join(notes) or None,
        "counts": rows.counts_text({**log.counts, "outlier": outliers}),
        "poses": stream.poses,
        "first_ns": stream.first_ns,
        "last_ns": stream.last_ns,
        "duration_s": (stream.last_ns - stream.first_ns) / 1e9,
        "topic": log.source.topic,
        "frame_id": log.source.frame_id,
        "child_frame_id": log.source.child_frame_id,
        "file": file,
        **{f"{kind}_bytes": (folder / kind / file).stat().st_size for kind in targets},
    }


def _open(path: str, settings: Settings) -> PoseLog:
    with _reading():
        return open_log(
            path,
            settings.topic,
            settings.frame,
            relative_to=settings.relative_to,
            table=settings.table,
        )


def _wrenches(path: str, settings: Settings) -> RecordedEvidence | None:
    if settings.wrench is None:
        return None
    log = _open(path, settings)
    with _reading():
        return recorded_evidence(
            path, settings.wrench.topic, log, settings.model, settings.known_map, settings.wrench.mass_kg
        )


class _Unread(UnreadableRecording):
    """The system failed to read a file."""


@contextmanager
def _reading() -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise _Unread(error.strerror or str(error)) from error


class _Counted:
    """Poses that are counted as they are read, as ``poses.Batched``."""

    def __init__(self, log: PoseLog) -> None:
        self._log = log
        self.poses = 0
        self.first_ns = 0
        self.last_ns = 0

    def batches(self) -> Iterator[Poses]:
        stream = self._log.batches()
        while True:
            with _reading():
                some = next(stream, None)
            if some is None:
                return
            if not self.poses:
                self.first_ns = int(some.stamp_ns[0])
            self.last_ns = int(some.stamp_ns[-1])
            self.poses += len(some)
            yield some

    def __iter__(self) -> Iterator[Pose]:
        return (pose for some in self.batches() for pose in some)


def _of(recording: str, columns: Columns) -> Columns:
    return {"recording": [recording] * len(columns["contact"]), **columns}


def require_no_link(folder: Path, name: str) -> None:
    """Raise OSError if a file of a dataset, or a folder below ``folder`` that it is in, is a link: what is
    written stays in the dataset."""
    path = folder / name
    for one in (path, *path.parents[: len(path.parts) - len(folder.parts) - 1]):
        if one.is_symlink():
            raise OSError(errno.ELOOP, "it is a link, and a dataset has none", str(one))


def _remove(folder: Path, file: str, *kinds: str) -> None:
    for kind in kinds:
        require_no_link(folder, f"{kind}/{file}")
        (folder / kind / file).unlink(missing_ok=True)


def _innermost(error: Exception) -> str:
    """The file and line where an error was raised."""
    step = error.__traceback__
    while step is not None and step.tb_next is not None:
        step = step.tb_next
    return "" if step is None else f"{os.path.basename(step.tb_frame.f_code.co_filename)}:{step.tb_lineno}"
