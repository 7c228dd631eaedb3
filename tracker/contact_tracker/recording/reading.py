"""One pass over a recording: a file, a folder of consecutive parts, or standard input."""

import os
import re
from collections.abc import Callable, Iterator, Sequence
from glob import has_magic
from itertools import pairwise
from typing import Final

from mcap.opcode import Opcode
from mcap.summary import Summary

from contact_tracker.config.table_reading import AS_NAMED, NO_TABLE, TableReading
from contact_tracker.errors import AmbiguousSource, ChoiceError, UnreadableRecording
from contact_tracker.recording.bytestream import (
    ZSTD_MAGIC,
    ByteStream,
    Follow,
    Notes,
    first_bytes,
    open_stream,
)
from contact_tracker.recording.decoding import MessageDecoder
from contact_tracker.recording.items import Channel, Item, in_log_order
from contact_tracker.recording.mcap_file import MAGIC, Entry, RecordLoop, summary_of
from contact_tracker.recording.tables import has_poses, is_table, read_table, refuse_other_formats
from contact_tracker.suggestions import near_file

STDIN: Final = "-"
_PATTERN: Final = "; it looks like a pattern: if it is in quotes, leave these out; if not, no file matches it"
_ENDINGS: Final = (".mcap", ".db3", ".mcap.zstd", ".mcap.zst")
_METADATA: Final = "metadata.yaml"
_OVERLAP_NS: Final = 1_000_000_000
_PAUSE_NS: Final = 10_000_000_000
"""Largest overlap, and largest gap, between parts of one recording (ns)."""
_NAMED: Final = 4
_BEGIN: Final = 64
"""Number of first bytes that identify a format."""
_BAGS: Final = (b"SQLite format 3\0", b"#ROSBAG V")
"""First bytes of ``.db3`` and ``.bag`` files."""


_FOLDERS: Final = {
    ".txt": ("a matrix", "numpy.loadtxt(one)", "numpy.save('poses.npy', {})"),
    ".npy": ("a matrix", "numpy.load(one)", "numpy.save('poses.npy', {})"),
    ".json": ("a pose", "json.load(open(one))", "json.dump({}, open('poses.json', 'w'))"),
}
"""Endings of files of a pose each: what they have, and code that reads one and saves all in a file."""


def parts_of(path: str) -> list[str]:
    """The files of a recording in order: ``path`` itself, or the parts in a rosbag2 folder. The
    ``metadata.yaml`` of a folder stands for the folder.

    Parts are ordered by name with numbers as numbers; uncompressed parts are preferred to compressed copies,
    .mcap to .db3. Raises UnreadableRecording if there is no such file, or the folder has no part.
    """
    path = recording_of(path)
    if path == STDIN or not os.path.isdir(path):
        if path != STDIN and not os.path.exists(path):
            hint = _PATTERN if has_magic(path) else ""
            raise UnreadableRecording(f"{path}: no such file{hint or near_file(path)}")
        return [path]
    try:
        entries = sorted(os.listdir(path))
    except OSError as error:
        raise UnreadableRecording(f"{path}: {error.strerror}") from error
    names = sorted((name for name in entries if name.lower().endswith(_ENDINGS)), key=_natural)
    if not names:
        packed = next((name for name in entries if re.search(r"\.(mcap|db3)\.\w+$", name.lower())), None)
        advice = "" if packed is None else f"; decompress {packed} first"
        for ending, (what, read, save) in _FOLDERS.items():
            if any(name.lower().endswith(ending) for name in entries):
                by_number = "key=lambda one: (len(one), one)"
                files = f"sorted(glob.glob({os.path.join(path, f'*{ending}')!r}), {by_number})"
                code = save.format(f"[{read} for one in {files}]")
                advice = f"; if each {ending} has {what}, {code} makes a file that is read"
        raise UnreadableRecording(f"{path}: this folder holds no .mcap or .db3 file{advice}")
    preferred = {n: f"{n[:-4]}.mcap" if n.lower().endswith(".db3") else _plain(n) for n in names}
    return [os.path.join(path, n) for n in names if preferred[n] == n or preferred[n] not in names]


def recording_of(path: str) -> str:
    """The path of the recording: the folder, if ``path`` is its ``metadata.yaml``."""
    return os.path.dirname(path) or "." if os.path.basename(path) == _METADATA else path


def may_be_recording(path: str) -> bool:
    """Whether a file begins like MCAP or a ROS bag, has unknown compressed content, or is a table of poses;
    raises OSError or UnreadableRecording if it cannot be read."""
    with open(path, "rb") as file:
        begin = file.read(_BEGIN)
    if begin.startswith(ZSTD_MAGIC):
        with open_stream(path) as stream:
            begin = stream.read(len(MAGIC))
        return begin == MAGIC or len(begin) < len(MAGIC)
    return begin.startswith((*_BAGS, MAGIC)) or has_poses(path)


def _refuse_unrelated(path: str, parts: Sequence[str]) -> None:
    """Raise AmbiguousSource if the files of a folder are separate recordings: parts of one have a
    metadata.yaml, are consecutive in log time, or, without an index, have names that differ only in numbers.
    """
    if len(parts) < 2 or os.path.exists(os.path.join(path, _METADATA)):
        return
    names = [os.path.basename(part) for part in parts]
    spans = [_interval_ns(part) for part in parts]
    for (name, before), (next_name, after) in pairwise(zip(names, spans, strict=True)):
        if before is None or after is None:
            follows = re.sub(r"\d+", "", _plain(name)) == re.sub(r"\d+", "", _plain(next_name))
        else:
            is_near = -_OVERLAP_NS <= after[0] - before[1] <= _PAUSE_NS
            follows = is_near and after[0] > before[0] and after[1] > before[1]
        if follows:
            continue
        formats = sorted({os.path.splitext(_plain(name))[1].lower() for name in names})
        several = f"of different formats ({', '.join(formats)})"
        how = several if len(formats) > 1 else "that do not follow each other"
        remainder = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
        raise AmbiguousSource(
            f"{path} holds recordings {how}: {', '.join(names[:_NAMED])}{remainder}; "
            f"name one of them (parts of one recording are taken together beside a {_METADATA})"
        )


def _interval_ns(part: str) -> tuple[int, int] | None:
    """First and last log time of a part, if its index has them."""
    summary = summary_of(part)
    if summary is None or (statistics := summary.statistics) is None or not statistics.message_count:
        return None
    return statistics.message_start_time, statistics.message_end_time


def is_table_file(path: str) -> bool:
    """Whether a recording is a table, which has poses and nothing else."""
    return not os.path.isdir(path) and path != STDIN and is_table(path, first_bytes(path, _BEGIN))


class Reading:
    """Iterate once for the items of all parts; afterwards ``notes`` has what could not be read.

    Parameters
    ----------
    path : file, folder or ``-``.
    is_wanted : accepts channels; messages of other channels are skipped unread. None skips all messages.
    follow : wait for more data; a folder is complete once it has a metadata.yaml.
    table : how the columns of a table are read, if their names do not say it.

    Attributes
    ----------
    notes : damage and assumptions so far.
    is_table : whether it is a table, which has poses and nothing else.
    decoder : decoder of the messages, whose work is bounded by the bytes read.

    Raises UnreadableRecording if there is no such file, or, while iterating, no part can be read; ChoiceError
    if the file cannot be followed, or ``table`` does not fit; AmbiguousSource if messages of a folder of
    separate recordings are wanted.
    """

    def __init__(
        self,
        path: str,
        is_wanted: Callable[[Channel], bool] | None,
        follow: Follow | None = None,
        table: TableReading = AS_NAMED,
    ) -> None:
        path = recording_of(path)
        if follow is None and is_wanted is not None:
            _refuse_unrelated(path, parts_of(path))
        self.is_table = is_table_file(path)
        is_empty = os.path.isfile(path) and not os.path.getsize(path)
        if table.is_of_table and table.field is None and not self.is_table and not is_empty:
            raise ChoiceError(f"{_shown(path)}: {NO_TABLE}")
        if table.field is not None and self.is_table:
            raise ChoiceError(
                f"{_shown(path)}: it is a table: say which columns the poses are in by --columns"
            )
        self.path, self._wanted, self._follow, self._table_reading = path, is_wanted, follow, table
        self.notes = Notes()
        self.decoder = MessageDecoder(self.notes.budget, table, path)

    @property
    def is_folder(self) -> bool:
        """Whether the recording is a folder of parts."""
        return os.path.isdir(self.path)

    def __iter__(self) -> Iterator[Item]:
        readable = False
        errors: list[UnreadableRecording] = []
        for part in self._parts():
            try:
                self.notes.part = os.path.basename(part) if self.is_folder else ""
                yield from self._part(part)
                readable = True
            except (UnreadableRecording, OSError) as error:
                kind = type(error) if isinstance(error, UnreadableRecording) else UnreadableRecording
                errors.append(kind(f"{_shown(part)}: {getattr(error, 'strerror', None) or error}"))
                errors[-1].__cause__ = error
                self.notes.part = ""
                self.notes.report(str(errors[-1]))
        if errors and not readable:
            raise errors[0]

    def _part(self, part: str) -> Iterator[Item]:
        begin, notes = first_bytes(part, _BEGIN), self.notes
        if (is_bag := begin.startswith(_BAGS)) or is_table(part, begin):
            if self._wanted is None:
                return
            if self._follow:
                raise ChoiceError(f"{_shown(part)}: only an MCAP file can be followed")
            if is_bag:
                from contact_tracker.recording.bags import read_bag

                yield from read_bag(part, self._wanted, notes)
            else:
                yield from read_table(part, self._wanted, notes, self._table_reading)
            return
        refuse_other_formats(part, begin)
        summary = None if self._follow else summary_of(part)
        with open_stream(part, self._follow, notes.budget) as stream:
            loop = RecordLoop(stream, notes.report, self._wanted, summary)
            try:
                if summary is None or self._wanted is None:
                    yield from loop
                else:
                    yield from self._by_log_time(summary, loop, stream)
            finally:
                loop.report_orphans()

    def _by_log_time(self, summary: Summary, loop: RecordLoop, stream: ByteStream) -> Iterator[Item]:
        """The items of a file with an index, messages by log time: overlapping chunks are read by the index;
        messages outside of chunks are buffered, as later ones may have earlier times."""
        statistics, chunks = summary.statistics, summary.chunk_indexes
        assert statistics is not None
        entries: list[Entry] = [*summary.attachment_indexes, *summary.metadata_indexes]
        if not statistics.chunk_count and not chunks:
            yield from in_log_order((0, [item]) for item in loop)
            return
        chunks = sorted(chunks, key=lambda chunk: chunk.chunk_start_offset)
        is_in_order = all(a.message_end_time <= b.message_start_time for a, b in pairwise(chunks))
        counts = statistics.chunk_count, statistics.attachment_count + statistics.metadata_count
        is_whole = counts == (len(chunks), len(entries))
        if is_in_order or not is_whole or any(loop.opcode_of(chunk) != Opcode.CHUNK for chunk in chunks):
            stream.seek(0)
            yield from loop
            return
        for entry in entries:
            yield from loop.items_of(entry)
        chunks.sort(key=lambda chunk: chunk.message_start_time)
        yield from in_log_order((chunk.message_start_time, loop.items_of(chunk)) for chunk in chunks)
        if loop.is_sound and (lost := statistics.message_count - loop.messages) > 0:
            self.notes.report(f"{lost} messages outside of chunks, which overlap in log time, are left out")

    def _parts(self) -> Iterator[str]:
        """Parts in order; when following, also new parts."""
        if self._follow is None:
            yield from parts_of(self.path)
            return
        done = set[str]()
        while self.is_folder or not done:
            new = [part for part in parts_of(self.path) if part not in done]
            if new:
                yield new[0]
                done.add(new[0])
            elif os.path.exists(os.path.join(self.path, _METADATA)) or not self._follow.wait():
                return


def _plain(name: str) -> str:
    """The name of a part without the suffix of compressed files, in any case."""
    return re.sub(r"\.zstd?$", "", name, flags=re.IGNORECASE)


def _natural(name: str) -> list[tuple[int, str]]:
    return [(int(digits or 0), text) for digits, text in re.findall(r"(\d*)(\D*)", name)]


def _shown(part: str) -> str:
    return "standard input" if part == STDIN else part
