"""One pass over a recording: a file, a folder of parts that follow each other, or standard input."""

import os
import re
from collections.abc import Callable, Iterator
from typing import Final

from mcap.reader import SeekingReader
from mcap.summary import Summary

from contact_tracker.errors import UnreadableRecording
from contact_tracker.recording.bytestream import ZSTD_MAGIC, Follow, is_regular, open_stream
from contact_tracker.recording.container import MAGIC, RecordLoop
from contact_tracker.recording.damage import DamageReport
from contact_tracker.recording.items import PARSE_ERRORS, RECORD_LIMIT, Channel, Item

STDIN: Final = "-"
_COMPRESSED: Final = ".zstd"
_ENDINGS: Final = (".mcap", f".mcap{_COMPRESSED}")


def parts_of(path: str) -> list[str]:
    """The files of a recording in their order: ``path`` itself, or what a rosbag2 folder holds.

    Parts are ordered by name with numbers as numbers; of a part that is there both plain and compressed
    the plain one is taken.

    Raises
    ------
    UnreadableRecording
        If there is no such file, or the folder holds no part.
    """
    if path == STDIN or not os.path.isdir(path):
        if path != STDIN and not os.path.exists(path):
            raise UnreadableRecording(f"{path}: no such file")
        return [path]
    try:
        names = sorted((n for n in os.listdir(path) if n.lower().endswith(_ENDINGS)), key=_natural)
    except OSError as error:
        raise UnreadableRecording(f"{path}: {error.strerror}") from error
    if not names:
        raise UnreadableRecording(f"{path}: this folder holds no .mcap file")
    return [os.path.join(path, n) for n in names if (plain := _plain(n)) == n or plain not in names]


def may_be_recording(path: str) -> bool:
    """Whether a file begins as an MCAP file does, or is compressed and what is in it cannot be told.

    Raises
    ------
    OSError, UnreadableRecording
        If it cannot be read.
    """
    with open(path, "rb") as file:
        begin = file.read(len(MAGIC))
    if begin.startswith(ZSTD_MAGIC):
        with open_stream(path) as stream:
            begin = stream.read(len(MAGIC))
        return begin == MAGIC or len(begin) < len(MAGIC)
    return begin == MAGIC


def summary_of(part: str) -> Summary | None:
    """The index at the end of a file, or None where there is none that describes all its channels."""
    if not is_regular(part):
        return None
    try:
        with open(part, "rb") as file:
            summary = SeekingReader(file, record_size_limit=RECORD_LIMIT).get_summary()
    except (*PARSE_ERRORS, OSError):
        return None
    if summary is None or summary.statistics is None:
        return None
    complete = summary.channels.keys() >= summary.statistics.channel_message_counts.keys()
    return summary if complete else None


class Reading:
    """Iterate once for the items of all parts; then ``damage`` tells what could not be read.

    Parameters
    ----------
    path : file, folder or ``-``.
    wanted : messages of other channels are skipped unread.
    follow : wait for what is still being written; a folder is complete once it has a metadata.yaml.

    Raises
    ------
    UnreadableRecording
        While iterating, if nothing of it is MCAP.
    """

    def __init__(self, path: str, wanted: Callable[[Channel], bool], follow: Follow | None = None) -> None:
        self.path = path
        self._wanted = wanted
        self._follow = follow
        self._damage = DamageReport()

    @property
    def damage(self) -> str | None:
        """One line, or None as long as all is well."""
        return self._damage.text

    def __iter__(self) -> Iterator[Item]:
        readable = False
        errors: list[UnreadableRecording] = []
        for part, single in self._parts():
            try:
                yield from self._part(part, single)
                readable = True
            except UnreadableRecording as error:
                named = UnreadableRecording(f"{_shown(part)}: {error}")
                errors.append(named)
                self._damage.add(str(named))
        if errors and not readable:
            raise errors[0]

    def _part(self, part: str, single: bool) -> Iterator[Item]:
        with open_stream(part, self._follow) as stream:
            loop = RecordLoop(stream, self._wanted, None if self._follow else summary_of(part))
            try:
                yield from loop
            finally:
                self._damage.add_all(loop.damage, "" if single else f"{os.path.basename(part)}: ")

    def _parts(self) -> Iterator[tuple[str, bool]]:
        """Parts in order, and whether there is only the one; when following, those to come too."""
        single = not os.path.isdir(self.path)
        done: list[str] = []
        while True:
            new = [part for part in parts_of(self.path) if part not in done]
            if new:
                yield new[0], single
                done.append(new[0])
            elif single or self._follow is None or self._is_finished() or not self._follow.wait():
                return

    def _is_finished(self) -> bool:
        return os.path.exists(os.path.join(self.path, "metadata.yaml"))


def _plain(name: str) -> str:
    """The name of a part without the ending of compressed files, in whatever case."""
    return name[: -len(_COMPRESSED)] if name.lower().endswith(_COMPRESSED) else name


def _natural(name: str) -> list[tuple[int, str]]:
    return [(int(digits or 0), text) for digits, text in re.findall(r"(\d*)(\D*)", name)]


def _shown(part: str) -> str:
    return "standard input" if part == STDIN else part
