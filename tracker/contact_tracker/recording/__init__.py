"""Recordings: MCAP logs in and out. The only part of the package that knows mcap."""

from contact_tracker.recording.annotations import need_truth, read_labels, read_metadata, read_truth
from contact_tracker.recording.bytestream import Follow
from contact_tracker.recording.items import (
    BELIEF_TOPIC,
    FRAMES_TOPIC,
    MAP_TOPIC,
    SCENE_TOPIC,
    TASK_TOPIC,
    Channel,
    PoseSource,
    RawMessage,
)
from contact_tracker.recording.log import (
    PoseLog,
    RecordingSummary,
    SourceSummary,
    list_sources,
    open_log,
    summarise,
    summarise_log,
)
from contact_tracker.recording.reading import may_be_recording, parts_of
from contact_tracker.recording.wrenches import WRENCH_TYPE, WrenchLog, read_wrenches
from contact_tracker.recording.writing import write_beside, write_recording

__all__ = [
    "BELIEF_TOPIC",
    "FRAMES_TOPIC",
    "MAP_TOPIC",
    "SCENE_TOPIC",
    "TASK_TOPIC",
    "WRENCH_TYPE",
    "Channel",
    "Follow",
    "PoseLog",
    "PoseSource",
    "RawMessage",
    "RecordingSummary",
    "SourceSummary",
    "WrenchLog",
    "list_sources",
    "may_be_recording",
    "need_truth",
    "open_log",
    "parts_of",
    "read_labels",
    "read_metadata",
    "read_truth",
    "read_wrenches",
    "summarise",
    "summarise_log",
    "write_beside",
    "write_recording",
]
