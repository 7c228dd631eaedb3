"""Poses in arrays of numbers in messages, such as ``O_T_EE`` of Franka's states or ``data`` of a
Float64MultiArray: the values of an array are read as the columns of a table are."""

import re
from collections.abc import Sequence
from typing import Final

import numpy as np

from contact_tracker.config.table_reading import TIME, TableReading, reading_of
from contact_tracker.errors import ChoiceError, UnreadableRecording
from contact_tracker.motion.poses import Pose, ReadAs
from contact_tracker.recording.table_layouts import MATRIX_SHAPES, Body
from contact_tracker.recording.table_proposals import layout_of_names
from contact_tracker.recording.table_units import doubt_angles

_OWN_TIMES: Final = "times of messages are their stamps: leave out --time-unit and the column of the time"


class ArrayPoses:
    """Reads the poses of one channel from an array of numbers in each message.

    Parameters
    ----------
    reading : meaning of the numbers, and the path to the array; the numbers of ``data`` are ``data[0]``, ...
    path : of the recording, for commands in messages.

    Attributes
    ----------
    read_as : how poses are read; known after the first message.
    """

    def __init__(self, reading: TableReading, path: str) -> None:
        self.read_as = ReadAs(False, reading, path)
        self._body: Body | None = None
        self._count = 0

    def read(self, stamp_ns: int, values: Sequence[float]) -> Pose:
        """The pose in the array of a message.

        Raises UnreadableRecording, with the command that reads the numbers if there is one, if their meaning
        is not known; ChoiceError if the reading does not fit; ValueError if there are other numbers of them
        than in the first message.
        """
        if self._body is None:
            self._body, self._count = self._body_of(values), len(values)
        if len(values) != self._count:
            raise ValueError(f"an array has {len(values)} instead of {self._count} numbers")
        _, table, path, *_ = self.read_as
        row = np.array([values], np.float64)[:, [column - 1 for column in self._body.columns]]
        if doubt := doubt_angles(row, self._body, table, path):
            raise UnreadableRecording(doubt)
        x, y, z, *quat_xyzw = self._body.poses(row)[0].tolist()
        return Pose(stamp_ns, (x, y, z), tuple(quat_xyzw))

    def _body_of(self, values: Sequence[float]) -> Body:
        _, reading, path, *_ = self.read_as
        if reading.time_unit or TIME in dict(reading.columns):
            raise ChoiceError(f"{path}: {_OWN_TIMES}")
        name = re.split(r"[.\]]", reading.field or "")[-1]
        if reading.matrix and not reading.columns and len(values) in MATRIX_SHAPES:
            reading = reading.with_(reading_of({"matrix": name}))
        names = [TIME, *(f"{name}[{i}]" for i in range(len(values)))]
        row = ["0", *map(str, values)]
        try:
            layout = layout_of_names(names, reading, path, rows=lambda: [row])
        except UnreadableRecording as error:  # also a ProposedReading
            raise UnreadableRecording(f"{path}: {error}") from error
        self.read_as = ReadAs(False, reading, path, layout.turn, layout.has_angles)
        return layout.bodies[0]
