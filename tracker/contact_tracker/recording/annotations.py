"""Ground truth and metadata of a recording."""

from collections.abc import Iterable
from typing import Final

from contact_tracker.config.table_reading import AS_NAMED, TableReading
from contact_tracker.errors import NoTruth
from contact_tracker.ground_truth import Truth
from contact_tracker.recording.bytestream import is_regular, open_stream
from contact_tracker.recording.decoding import MessageDecoder, Undecodable
from contact_tracker.recording.items import Attachment, Channel, Item, Metadata, RawMessage
from contact_tracker.recording.log import open_log
from contact_tracker.recording.mcap_file import RecordLoop, place_of, summary_of
from contact_tracker.recording.reading import Reading, is_table_file, parts_of

TRUTH_ATTACHMENT: Final = "truth.json"
TRUTH_TOPIC: Final = "/contact/truth"
TRUTH_TYPE: Final = "std_msgs/msg/String"


def read_truth(path: str) -> Truth | None:
    """The ground truth of a recording: attachment ``truth.json``, else messages on ``/contact/truth``.

    Of a damaged recording, the readable part. None for standard input or a FIFO, which can be read only once.

    Raises
    ------
    UnreadableRecording
        No such file, or not MCAP.
    NoTruth
        The truth is not in the documented form.
    """
    if not _is_rereadable(path) or is_table_file(path):
        return None
    stored = _stored(path)
    attached = [i.data for i in stored if isinstance(i, Attachment) and i.name == TRUTH_ATTACHMENT]
    if attached:
        return Truth(tuple(i for text in attached for i in Truth.from_json(text).intervals))
    return _from_messages(path)


def need_truth(
    path: str, topic: str | None = None, frame: str | None = None, table: TableReading = AS_NAMED
) -> Truth:
    """The ground truth of a recording, which must have one; the other parameters are those of ``open_log``.

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
        raise NoTruth(f"{path}: no truth in it, neither {TRUTH_ATTACHMENT} nor {TRUTH_TOPIC}")
    if all(interval.contact is None for interval in truth.intervals):
        raise NoTruth(f"{path}: its truth names no contact, as that of a joint: there is nothing to compare")
    return truth


def read_metadata(path: str) -> dict[str, dict[str, str]]:
    """The metadata records by name, the last of each name. Empty for a stream.

    Raises
    ------
    UnreadableRecording
        No such file, or not MCAP.
    """
    if not _is_rereadable(path) or is_table_file(path):
        return {}
    return {item.name: item.values for item in _stored(path) if isinstance(item, Metadata)}


def _is_rereadable(path: str) -> bool:
    return all(map(is_regular, parts_of(path)))


def _stored(path: str) -> list[Attachment | Metadata]:
    """The truth attachment and the metadata, by the index or by reading the whole file."""
    indexed = [_indexed(part) for part in parts_of(path)]
    items: Iterable[Item]
    if None in indexed:
        items = Reading(path, lambda channel: False)
    else:
        items = (item for part_items in indexed for item in part_items or ())
    return [item for item in items if isinstance(item, Attachment | Metadata)]


def _indexed(part: str) -> list[Item] | None:
    """Attachments and metadata by the index of a file; None where it is incomplete or wrong."""
    summary = summary_of(part)
    if summary is None or summary.statistics is None:
        return None
    counted = (summary.statistics.attachment_count, summary.statistics.metadata_count)
    if counted != (len(summary.attachment_indexes), len(summary.metadata_indexes)):
        return None
    places = [(a.name, place_of(a)) for a in summary.attachment_indexes if a.name == TRUTH_ATTACHMENT]
    places += [(m.name, place_of(m)) for m in summary.metadata_indexes]
    with open_stream(part) as stream:
        loop = RecordLoop(stream, lambda channel: False, summary)
        items = [item for _, place in places for item in loop.items_at(place)]
    found = [item.name for item in items if isinstance(item, Attachment | Metadata)]
    return items if found == [name for name, _ in places] else None


def _from_messages(path: str) -> Truth | None:
    if not any(map(_may_have_changes, parts_of(path))):
        return None
    changes: list[tuple[int, str]] = []
    reading = Reading(path, lambda channel: True)
    decoder = MessageDecoder(reading.budget)
    end_ns = 0
    for item in reading:
        if isinstance(item, RawMessage):
            end_ns = max(end_ns, item.log_time_ns)
            if _is_truth(item.channel):
                changes.append((item.log_time_ns, _label(decoder, item)))
    if not changes:
        return None
    stamps, labels = zip(*sorted(changes), strict=True)
    return Truth.from_changes(stamps, labels, end_ns)


def _may_have_changes(part: str) -> bool:
    summary = summary_of(part)
    return summary is None or any(c.topic == TRUTH_TOPIC for c in summary.channels.values())


def _is_truth(channel: Channel) -> bool:
    return channel.topic == TRUTH_TOPIC and channel.type == TRUTH_TYPE


def _label(decoder: MessageDecoder, message: RawMessage) -> str:
    try:
        return str(decoder.decode(message).data)
    except (Undecodable, AttributeError) as error:
        raise NoTruth(f"a truth message cannot be decoded: {error}") from error
