"""The folder of a dataset: a file of segments per recording, and a summary of all (docs/batch.md).

Answers are appended to a journal at once and merged into the summary at intervals, so that none is lost if
the process is killed. A run segments the recordings without an up-to-date result.
"""

import json
import os
import re
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import IO, Any, Final, NamedTuple, Self

import contact_tracker.errors as errors
from contact_tracker.batch import segmenting
from contact_tracker.batch.finding import Recording
from contact_tracker.batch.segmenting import SUMMARY_COLUMNS, Answer, Content, Row, Settings, row_name
from contact_tracker.errors import StateError, UsageError
from contact_tracker.exports.columns import kinds_of
from contact_tracker.exports.parquet import read_rows, require_kind, write_merged
from contact_tracker.files import TEMPORARY, whole_file, why_not_writable
from contact_tracker.processes import Jobs

FORMAT: Final = {"format": "contact-tracker batch", "format_version": 2}
_NUMBER: Final = re.compile(r"\d[\d.]*(?:e[+-]?\d+)?")
_KIND: Final = re.compile(r": | \(|; ")
"""End of the beginning of a warning, which is the same in all recordings."""
_MARK: Final = "dataset.json"
_SUMMARY: Final = "summary.parquet"
_SIGNATURES: Final = "signatures.parquet"
_JOURNAL: Final = "journal.jsonl"
_SIGNATURE_COLUMNS: Final = kinds_of("text", "recording", "signature")
OWN_FILES: Final = (_MARK, _SUMMARY, _SIGNATURES, _JOURNAL)
"""The files of a dataset outside of its folders."""
_LINE_ERRORS: Final = (ValueError, TypeError, KeyError, AttributeError, RecursionError)
"""Errors in reading a line of the journal that is damaged or of another version."""
_SAVE_EVERY_S: Final = 60.0
_SAVE_SHARE: Final = 0.02
"""Largest share of the run's time that is spent on merging."""


class Entry(NamedTuple):
    """The values of a row that are kept in memory."""

    content_hash: str | None
    settings_hash: str
    exit_code: int
    segments_bytes: int | None
    ticks_bytes: int | None


class Dataset:
    """An open dataset, locked against other writers. Made by ``open_dataset``."""

    def __init__(self, folder: Path, journal: IO[bytes]) -> None:
        self.folder = folder
        self._journal = journal
        self._entries: dict[str, Entry] = {}
        self._signatures: dict[str, str] = {}
        self._new_rows: dict[str, Row] = {}
        self._new_signatures: dict[str, str] = {}
        self._next_save_s = time.monotonic() + _SAVE_EVERY_S
        self._read()

    def content_of(self, name: str, settings: Settings) -> Content | None:
        """Content from which a recording's result was made, if the dataset has one for these settings."""
        key = row_name(name)
        entry = self._entries.get(key)
        if entry is None or entry.content_hash is None or entry.settings_hash != settings.settings_hash:
            return None
        sizes = {"segments": entry.segments_bytes}
        if settings.with_ticks:
            sizes["ticks"] = entry.ticks_bytes
        try:
            files = {kind: self.folder / kind / segmenting.file_of(name) for kind in sizes}
            if entry.segments_bytes is not None and sizes != {k: f.stat().st_size for k, f in files.items()}:
                return None
        except OSError:
            return None
        return self._signatures.get(key, ""), entry.content_hash

    def exit_code(self, name: str) -> int:
        """Exit code of a recording with a result."""
        return self._entries[row_name(name)].exit_code

    def record(self, answer: Answer) -> None:
        """Append an answer to the journal, and save at intervals."""
        line = {"recording": row_name(answer.name), "signature": answer.signature, "row": answer.row}
        self._add(line)  # first: if an interrupt comes between, saving still writes the answer
        self._journal.write(json.dumps(line).encode() + b"\n")
        self._journal.flush()
        if time.monotonic() >= self._next_save_s:
            begin_s = time.monotonic()
            self.save()
            took_s = time.monotonic() - begin_s
            self._next_save_s = time.monotonic() + max(_SAVE_EVERY_S, took_s / _SAVE_SHARE)

    def save(self) -> None:
        """Merge new answers into the summary."""
        signatures = [{"recording": name, "signature": text} for name, text in self._new_signatures.items()]
        for name, columns, rows in (
            (_SUMMARY, SUMMARY_COLUMNS, [*self._new_rows.values()]),
            (_SIGNATURES, _SIGNATURE_COLUMNS, signatures),
        ):
            path = self.folder / name
            if rows or not path.exists():
                with whole_file(path) as temporary:
                    write_merged(columns, path, rows, "recording", temporary)
        self._journal.truncate(0)
        self._new_rows.clear()
        self._new_signatures.clear()

    def _read(self) -> None:
        names = ("recording", *Entry._fields)
        if (self.folder / _SUMMARY).exists():
            hashes: dict[str, str] = {}  # settings repeat: share their text
            kinds = {name: SUMMARY_COLUMNS[name] for name in names}
            for key, content, settings, *numbers in read_rows(self.folder / _SUMMARY, kinds):
                self._entries[key] = Entry(content, hashes.setdefault(settings, settings), *numbers)
        if (self.folder / _SIGNATURES).exists():
            self._signatures = dict(read_rows(self.folder / _SIGNATURES, _SIGNATURE_COLUMNS))
        for line in (self.folder / _JOURNAL).read_bytes().splitlines():
            with suppress(*_LINE_ERRORS):  # the last line may be incomplete
                self._add(json.loads(line))
        if self._new_rows or self._new_signatures:
            self.save()
        self._journal.truncate(0)

    def _add(self, line: dict[str, Any]) -> None:
        key, signature, row = str(line["recording"]), str(line["signature"]), line["row"]
        if row is not None:
            if row.keys() != SUMMARY_COLUMNS.keys():
                raise KeyError("a row of another version")
            for name, kind in SUMMARY_COLUMNS.items():
                require_kind(kind, row[name])
            self._entries[key] = Entry(*(row[name] for name in Entry._fields))
            self._new_rows[key] = row
        self._signatures[key] = signature
        self._new_signatures[key] = signature


@contextmanager
def open_dataset(folder: Path) -> Iterator[Dataset]:
    """Open or make the dataset in ``folder``; answers are saved at the end, also on errors.

    Raises
    ------
    UsageError : the folder has other content, or another process writes it.
    StateError : a file of the dataset is damaged.
    OSError : the dataset cannot be written.
    """
    _check(folder)
    for name in OWN_FILES:
        segmenting.require_no_link(folder, name)
    folder.mkdir(exist_ok=True)
    if not (folder / _MARK).exists():
        with whole_file(folder / _MARK) as temporary:
            temporary.write_text(json.dumps(FORMAT) + "\n", encoding="utf-8")
    with open(folder / _JOURNAL, "ab") as journal:
        _lock(journal, folder)
        for left_over in folder.rglob(f"{TEMPORARY}*.part"):  # by a process that was killed
            left_over.unlink()
        dataset = Dataset(folder, journal)
        try:
            yield dataset
        finally:
            dataset.save()


def _check(folder: Path) -> None:
    if not folder.exists():
        if folder.is_symlink():
            raise UsageError(f"cannot write {folder}: it is a link that leads to no folder")
        if (refusal := why_not_writable(folder)) is not None:
            raise UsageError(f"cannot write {folder}: {refusal}")
        return
    if not folder.is_dir():
        raise UsageError(f"cannot write {folder}: it is a file, a dataset is a folder")
    try:
        mark = json.loads((folder / _MARK).read_text(encoding="utf-8"))
    except FileNotFoundError:
        if any(not name.startswith(TEMPORARY) for name in os.listdir(folder)):
            raise UsageError(f"cannot write {folder}: it holds something else; name a new folder") from None
        return
    except (OSError, ValueError, RecursionError) as error:
        raise StateError(f"{folder / _MARK}: it is damaged ({error})") from error
    if mark != FORMAT:
        raise UsageError(f"cannot write {folder}: it is a dataset of another version; name a new folder")


def _lock(journal: IO[bytes], folder: Path) -> None:
    """Lock the dataset while the journal is open; does nothing on systems without such locks."""
    if os.name != "posix":
        return
    import fcntl

    try:
        fcntl.flock(journal, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise UsageError(f"cannot write {folder}: another process is writing it") from None
    except OSError:  # a file system without locks
        return


_ENDED: Final = "its process was ended, probably because memory ran out"


@dataclass(eq=False)
class Batch:
    """Updates a ``dataset``, and counts its recordings.

    Parameters
    ----------
    report : called with one line for each recording that cannot be used or is damaged.
    set_done : called with the number of recordings that are done.
    done, unchanged : numbers of recordings with a new row, and with an unchanged one.
    bad, damaged : numbers of recordings without a result, and with a partial one.
    warned : number of recordings with a new row that has warnings.
    warnings : number of these by kind of warning: its beginning, without its numbers.
    """

    settings: Settings
    dataset: Dataset
    report: Callable[[str], None]
    set_done: Callable[[int], None]
    done: int = 0
    unchanged: int = 0
    bad: int = 0
    damaged: int = 0
    warned: int = 0
    warnings: Counter[str] = field(default_factory=Counter)

    @property
    def total(self) -> int:
        """Number of recordings."""
        return self.done + self.unchanged

    def run(
        self, recordings: Iterable[Recording], workers: Callable[[], AbstractContextManager[Jobs]]
    ) -> Self:
        """Update the row of each recording; ``workers`` are opened if needed. Raises ContactTrackerError if
        workers are lost, OSError if the dataset cannot be written; answers up to then are saved."""
        jobs = self._jobs(recordings)
        first = next(jobs, None)
        if first is None:
            return self
        with workers() as call:
            for (name, *_), answer in call(segmenting.segment_recording, chain([first], jobs)):
                if answer is None:
                    error = f"{name}: {_ENDED}"
                    row = segmenting.failure(name, self.settings, errors.KILLED, error, None)
                    answer = Answer(name, "", row)
                self._add(answer)
        return self

    def _jobs(self, recordings: Iterable[Recording]) -> Iterator[tuple[Any, ...]]:
        """The arguments of ``segment_recording`` for recordings that may have changed."""
        folder = str(self.dataset.folder)
        for recording in recordings:
            content = self.dataset.content_of(recording.name, self.settings)
            if not recording.signature:  # there is no readable file
                self._add(segmenting.segment_recording(recording.name, content, self.settings, folder))
            elif content is not None and content[0] == recording.signature:
                self._count(recording.name, None)
            else:
                yield recording.name, content, self.settings, folder

    def _add(self, answer: Answer) -> None:
        self.dataset.record(answer)
        self._count(answer.name, answer.row)

    def _count(self, name: str, new: Row | None) -> None:
        """Count a recording with a ``new`` row, or an unchanged one, and report its faults."""
        code = self.dataset.exit_code(name)
        is_damaged = code == errors.DAMAGED
        self.done += new is not None
        self.unchanged += new is None
        self.damaged += is_damaged
        self.bad += code not in (errors.DONE, errors.DAMAGED)
        if code != errors.DONE and new is None:
            column = "damage" if is_damaged else "error"
            self.report(f"{row_name(name)}: as before: see the column {column} of the summary")
        elif code != errors.DONE and new is not None:
            self.report(new["error"] or f"{new['recording']}: {new['damage']}")
        lines = [] if new is None else (new["warnings"] or "").splitlines()
        self.warned += bool(lines)
        self.warnings.update({_KIND.split(_NUMBER.sub("...", line), maxsplit=1)[0] for line in lines})
        self.set_done(self.total)
