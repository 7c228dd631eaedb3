"""Ground truth and metadata of a recording, and labels of users (spreadsheet, ELAN, Label Studio)."""

import csv
import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from itertools import pairwise
from typing import Any, Final

from mcap.records import Attachment, Metadata

from contact_tracker.config.quantities import NAMED_NS
from contact_tracker.config.table_reading import AS_NAMED, TableReading
from contact_tracker.errors import ChoiceError, NoTruth, printable
from contact_tracker.ground_truth import UNSCORED, CoarseLabel, Truth, TruthInterval
from contact_tracker.recording.bytestream import encoding_of, first_bytes, is_regular, is_text
from contact_tracker.recording.decoding import Undecodable
from contact_tracker.recording.items import RawMessage
from contact_tracker.recording.log import open_log
from contact_tracker.recording.mcap_file import summary_of
from contact_tracker.recording.reading import Reading, is_table_file, parts_of
from contact_tracker.recording.table_layouts import are_numbers
from contact_tracker.recording.table_times import exact_ns, stamp_of_date
from contact_tracker.states import CONTACTS, STATES, Contact
from contact_tracker.suggestions import near_file, suggestion

TRUTH_ATTACHMENT: Final = "truth.json"
TRUTH_TOPIC: Final = "/contact/truth"
TRUTH_TYPE: Final = "std_msgs/msg/String"


def read_truth(path: str) -> Truth | None:
    """The ground truth of a recording: attachment ``truth.json``, else messages on ``/contact/truth``; if the
    recording is damaged, the readable part. None for standard input or a FIFO, which can be read only once.

    Raises
    ------
    UnreadableRecording
        There is no such file, or it is no recording.
    NoTruth
        The truth is not in the documented form.
    """
    if not _is_rereadable(path) or is_table_file(path):
        return None
    stored = _stored(path)
    attached = [i.data for i in stored if isinstance(i, Attachment) and i.name == TRUTH_ATTACHMENT]
    if attached:
        return Truth(tuple(i for text in attached for i in Truth.from_json(text).intervals))
    summaries = [summary_of(part) for part in parts_of(path)]
    if not any(s is None or any(c.topic == TRUTH_TOPIC for c in s.channels.values()) for s in summaries):
        return None
    changes, end_ns, reading = list[tuple[int, str]](), 0, Reading(path, lambda channel: True)
    for message in (item for item in reading if isinstance(item, RawMessage)):
        end_ns = max(end_ns, message.log_time_ns)
        if (message.channel.topic, message.channel.type) == (TRUTH_TOPIC, TRUTH_TYPE):
            try:
                changes.append((message.log_time_ns, str(reading.decoder.decode(message).data)))
            except (Undecodable, AttributeError) as error:
                raise NoTruth(f"a truth message cannot be decoded: {error}") from error
    stamps, labels = zip(*sorted(changes), strict=True) if changes else ((), ())
    return Truth.from_changes(stamps, labels, end_ns) if changes else None


def need_truth(
    path: str, topic: str | None = None, frame: str | None = None, table: TableReading = AS_NAMED
) -> Truth:
    """The ground truth of a recording, which must have one; the other parameters are as for ``open_log``.

    Raises
    ------
    NoTruth
        There is no truth, or none of contacts.
    UnreadableRecording
        Poses cannot be read either; this error is raised instead.
    """
    if not _is_rereadable(path):
        raise NoTruth(f"{path}: it is not a regular file: a recording is read twice, once for its truth")
    truth = read_truth(path)
    if truth is None:
        next(iter(open_log(path, topic, frame, table=table)), None)
        raise NoTruth(
            f"{path}: no truth in it, neither {TRUTH_ATTACHMENT} nor {TRUTH_TOPIC}; "
            "labels of your own are given by --labels FILE (in Python: labels)"
        )
    if all(interval.contact is None for interval in truth.intervals):
        raise NoTruth(f"{path}: its truth names no contact, as that of a joint: there is nothing to compare")
    return truth


def read_metadata(path: str) -> dict[str, dict[str, str]]:
    """The metadata records by name, the last of each name; empty for a stream. Raises UnreadableRecording if
    there is no such file, or it is no recording."""
    if not _is_rereadable(path) or is_table_file(path):
        return {}
    return {item.name: item.metadata for item in _stored(path) if isinstance(item, Metadata)}


def _is_rereadable(path: str) -> bool:
    return all(map(is_regular, parts_of(path)))


def _stored(path: str) -> list[Attachment | Metadata]:
    """The attachments and the metadata; messages are skipped unread."""
    return [item for item in Reading(path, None) if isinstance(item, Attachment | Metadata)]


_START: Final = ("start", "begin", "begin_time", "start_time", "onset", "from", "tmin")
_END: Final = ("end", "stop", "end_time", "offset", "to", "tmax")
_DURATION: Final = ("duration", "dur", "length")
_LABEL: Final = ("contact", "label", "trial_type", "state", "annotation", "value", "timeserieslabels", "text")
_UNIT: Final = re.compile(r"(.+?)[\s_-]*(?:[\[(](\w+)[\])]|[_-](?:\s*)(s|sec|ss\.msec|ms|us|ns))")
_CLOCK: Final = re.compile(r"(?:(\d+) days? )?(?:(\d+):)?(\d{1,2}):(\d{1,2}(?:[.,]\d+)?)")
ANY: Final = "any"
"""Stands for all contact states: the object touches."""
_BYTES: Final = 2**26
_NAMED: Final = 8
"""Most labels that are named in an error."""
_SLACK_NS: Final = 60 * 10**9
"""Longest time (ns) by which labels may begin before, or end after, the poses."""


Table = Sequence[Sequence[str]]
_Row = tuple[int, int, str]
"""First and last time (ns) and name of a label."""


def read_labels(
    labels: str | Table,
    first_ns: int,
    last_ns: int,
    meanings: Mapping[str, str] | None = None,
    stating: Callable[[Sequence[str]], str] = lambda labels: f"meanings={dict.fromkeys(labels, ANY)}",
) -> tuple[Truth, str]:
    """The truth by the labels in a table, and one line on the origin of their times.

    Parameters
    ----------
    labels : a table with the columns ``start``, ``end`` (or ``duration``) and ``contact`` (or ``label``): its
        cells, the names first, or a file of them, separated by commas, semicolons or tabs; or JSON of Label
        Studio. Times are in seconds, unless the names of their columns have another unit, or as
        ``0:01:02.5``; since the first pose, or as the stamps of the recording.
    first_ns, last_ns : stamps of the first and last pose.
    meanings : states by label: ``e-f``, several as ``e-f|f-f``, ``any`` contact, or ``?`` if it is not
        scored. Labels that are names of states need none.
    stating : what the user writes to state that labels mean any contact, for messages.

    Raises
    ------
    NoTruth
        It is no table of labels, or its times do not fit the poses.
    ChoiceError
        The meaning of a label is not known.
    """
    path = labels if isinstance(labels, str) else "labels"
    rows = sorted(_rows_of_file(path) if isinstance(labels, str) else _rows_of_table(path, labels))
    if not rows:
        raise NoTruth(f"{path}: it has no label")
    first, last, length_ns = rows[0][0], rows[-1][0], last_ns - first_ns
    is_since = last <= length_ns + _SLACK_NS
    if not is_since and not first_ns - _SLACK_NS <= first <= last <= last_ns + _SLACK_NS:
        times = f"{first * 1e-9:.9g} to {rows[-1][1] * 1e-9:.9g} s"
        raise NoTruth(
            f"{path}: its times, {times}, are neither since the first pose (0 to {length_ns * 1e-9:.2f} s) "
            "nor its stamps: name their unit, as in start_ms"
        )
    offset_ns = first_ns if is_since else 0
    for (_, before_ns, before), (start_ns, _, after) in pairwise(rows):
        if start_ns < before_ns:
            raise NoTruth(f"{path}: {before} and {after} overlap at {start_ns * 1e-9:.9g} s")
    labelled = dict.fromkeys(name for _, _, name in rows)
    states_by_name = {name: _meaning(name, meanings or {}) for name in labelled}
    if unknown := [name for name, states in states_by_name.items() if states is None]:
        raise ChoiceError(f"{path}: {_no_states(unknown, stating)}")
    unused = [name for name in meanings or {} if name not in states_by_name]
    if unused:
        raise ChoiceError(f"{path}: no label {printable(unused[0])}{suggestion(unused[0], states_by_name)}")
    intervals = list[TruthInterval]()
    for start_ns, end_ns, name in rows:
        states = states_by_name[name] or ()
        contact = states[0] if len(states) == 1 else None
        coarse = CoarseLabel(name, states) if len(states) > 1 else None
        span = start_ns + offset_ns, end_ns + offset_ns - 1
        intervals.append(TruthInterval(*span, contact, None, coarse=coarse))
    how = "since the first pose" if is_since else "as stamps of the recording"
    count = f"{len(rows)} label{'s' if len(rows) != 1 else ''}"
    return Truth(tuple(intervals)), f"{path}: label times are taken {how} ({count})"


def meanings_of(texts: Sequence[str]) -> dict[str, str]:
    """The states by label of texts such as ``touch=any``; raises ChoiceError."""
    meanings = dict[str, str]()
    for text in texts:
        label, equals, states = text.rpartition("=")
        if not equals or not label.strip():
            raise ChoiceError(f"a label means states as in touch=any, not {text!r}")
        meanings[label.strip()] = states.strip()
    return meanings


def _meaning(name: str, meanings: Mapping[str, str]) -> tuple[Contact, ...] | None:
    """The possible states of a label; empty if it is not scored, None if it is not known."""
    stated = meanings.get(name, name)
    if stated == UNSCORED:
        return ()
    if stated == ANY:
        return CONTACTS
    with suppress(ValueError):
        return tuple(dict.fromkeys(Contact(part.strip()) for part in stated.split("|")))
    return None


def _no_states(unknown: Sequence[str], stating: Callable[[Sequence[str]], str]) -> str:
    """What to do about labels that are no states."""
    labels = [*map(printable, unknown[:_NAMED])]
    names, further = ", ".join(map(repr, labels)), ", ..." if len(unknown) > _NAMED else ""
    are_none = "the labels {} are no states" if len(unknown) > 1 else "the label {} is no state"
    which = "say which they are" if len(unknown) > 1 else "say which it is"
    return (
        f"{are_none.format(names + further)}: {which}, as in {stating(labels)}: {', '.join(STATES)}, several "
        f"as f-f|e-f, {ANY} of the six, or {UNSCORED} if it is not scored{suggestion(unknown[0], STATES)}"
    )


def _rows_of_file(path: str) -> Iterator[_Row]:
    try:
        with open(path, "rb") as file:
            data = file.read(_BYTES)
    except OSError as error:
        raise NoTruth(f"{path}: {error.strerror}{near_file(path)}") from error
    if data and not is_text(data, ".csv"):  # whatever its name and encoding
        raise NoTruth(f"{path}: it is no text: labels are a table in text, as CSV, or JSON of Label Studio")
    text = data.decode(encoding_of(data), errors="replace")
    if text.lstrip()[:1] in ("[", "{"):
        return _rows_of_json(path, text)
    table = _table_in(text)
    if not table:
        raise NoTruth(f"{path}: it is empty")
    return _rows_of_table(path, table)


def has_labels(path: str) -> bool:
    """Whether the first row of a file, or the keys where JSON begins, name the columns of labels, and are not
    those of segments, which have a probability."""
    begin = first_bytes(path)
    if not is_text(begin, ".csv"):
        return False
    text = begin.decode(encoding_of(begin), errors="replace")
    is_json = text.lstrip()[:1] in ("[", "{")
    names = re.findall(r'"(\w+)"\s*:', text) if is_json else next(iter(_table_in(text)), [])
    return len(_label_columns(names)) == 3 and "probability" not in names


def _table_in(text: str) -> list[list[str]]:
    """The cells of a table in text, without comments."""
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    mark = next((mark for mark in ("\t", ";") if mark in "".join(lines[:1])), ",")
    return list(csv.reader(lines, delimiter=mark))


def _label_columns(names: Sequence[str]) -> list[tuple[int, int]]:
    """The columns of start, end (or else duration) and label, as far as there are any."""
    end = _column(names, _END) or _column(names, _DURATION)
    return list(filter(None, (_column(names, _START), end, _column(names, _LABEL))))


def _rows_of_table(path: str, table: Table) -> Iterator[_Row]:
    names, *rows = table
    columns = _label_columns(names)
    if len(columns) < 3:
        if names[:1] and names[0].startswith("<"):
            raise NoTruth(f"{path}: it is XML: export it as tab-delimited text, as ELAN does")
        listed = ", ".join(names[:12])
        needed = f"{path}: its columns are {listed}: needed are start, end (or duration) and contact"
        has_names = not any(map(are_numbers, ([name] for name in names)))
        how = ": write the names of the columns above its rows, as start,end,contact"
        raise NoTruth(needed if has_names else needed + how)
    (start, start_ns), (end, end_ns), (label, _) = columns
    is_duration = _column(names, _END) is None
    for number, row in enumerate(rows, 2):
        if len(row) <= max(start, end, label):
            raise NoTruth(f"{path}: row {number} has {len(row)} values")
        yield _row(path, row[start], start_ns, row[end], end_ns, row[label], is_duration)


def _column(names: Sequence[str], choices: Sequence[str]) -> tuple[int, int] | None:
    """The index of the column with one of the ``choices`` as name, and its unit (ns); None without one."""
    for place, name in enumerate(names):
        plain = name.strip().lower()
        unit = _UNIT.fullmatch(plain)
        stem = (plain if unit is None else unit[1]).replace(" ", "_")
        if stem in choices:
            return place, NAMED_NS.get((unit[2] or unit[3]) if unit is not None else "s", NAMED_NS["s"])
    return None


def _rows_of_json(path: str, text: str) -> Iterator[_Row]:
    """The labels in JSON of Label Studio, at any depth."""
    try:
        waiting = [json.loads(text)]
    except (ValueError, RecursionError) as error:
        raise NoTruth(f"{path}: it is no JSON: {error}") from error
    while waiting:
        value = waiting.pop()
        if isinstance(value, list):
            waiting += value
        elif isinstance(value, dict):
            label = next((value[name] for name in _LABEL if isinstance(value.get(name), str | list)), None)
            if "start" in value and "end" in value and label:
                name = label if isinstance(label, str) else label[0]
                yield _row(path, value["start"], NAMED_NS["s"], value["end"], NAMED_NS["s"], str(name))
            else:
                waiting += value.values()


def _row(
    path: str,
    start: Any,
    start_unit_ns: int,
    end: Any,
    end_unit_ns: int,
    name: str,
    is_duration: bool = False,
) -> _Row:
    start_ns, end_ns = _time_ns(path, start, start_unit_ns), _time_ns(path, end, end_unit_ns)
    end_ns += start_ns if is_duration else 0
    if end_ns <= start_ns:
        raise NoTruth(f"{path}: {printable(name)} ends at {end}, before it starts at {start}")
    return start_ns, end_ns, name.strip()


def _time_ns(path: str, value: Any, unit_ns: int) -> int:
    text = str(value).strip()
    clock = _CLOCK.fullmatch(text)
    try:
        if clock is not None:
            days, hours, minutes = (int(part or 0) for part in clock.groups()[:3])
            whole_ns = (86_400 * days + 3600 * hours + 60 * minutes) * 10**9
            return whole_ns + exact_ns(clock[4], NAMED_NS["s"])
        stamp_ns = stamp_of_date(text)
        return exact_ns(text, unit_ns) if stamp_ns is None else stamp_ns
    except (ValueError, OverflowError) as error:
        raise NoTruth(f"{path}: {printable(text[:40])!r} is no time") from error
