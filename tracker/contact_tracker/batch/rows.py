"""The settings of a run, and the summary row of a recording, also of a failed one (docs/batch.md)."""

import json
from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import PurePosixPath
from typing import Any, Final, NamedTuple

from contact_tracker import __version__, errors
from contact_tracker.batch import remote
from contact_tracker.config.parameters import Model
from contact_tracker.config.table_reading import AS_NAMED, TableReading
from contact_tracker.errors import printable
from contact_tracker.exports.columns import PROBABILITIES, Kind
from contact_tracker.map.map import Map
from contact_tracker.outputs.adaptation import report_json
from contact_tracker.outputs.text import is_open
from contact_tracker.saved_state import fingerprint
from contact_tracker.states import STATES
from contact_tracker.tracking.belief import Segment

Row = dict[str, Any]
"""Values by the names of ``SUMMARY_COLUMNS``."""

_STATES: Final = tuple(name.removeprefix("p_") for name in PROBABILITIES)
_OPEN: Final = "open"
"""For segments whose motion leaves the contact open among all states: their label means nothing."""
_KINDS: Final = (*_STATES, _OPEN)
SUMMARY_COLUMNS: Final[dict[str, Kind]] = {
    "recording": "text",
    "exit_code": "integer",
    "error": "text",
    "damage": "text",
    "warnings": "text",
    "counts": "text",
    "poses": "integer",
    "first_ns": "integer",
    "last_ns": "integer",
    "duration_s": "number",
    "ticks": "integer",
    "segments": "integer",
    **{f"segments_{state}": "integer" for state in _KINDS},
    **{f"time_{state}_s": "number" for state in _KINDS},
    "tick_s": "number",
    "sigma_position_m": "number",
    "sigma_rotation_rad": "number",
    "tick_sigma_position_m": "number",
    "tick_sigma_rotation_rad": "number",
    "topic": "text",
    "frame_id": "text",
    "child_frame_id": "text",
    "size_bytes": "integer",
    "content_hash": "text",
    "model": "text",
    "model_hash": "text",
    "settings_hash": "text",
    "version": "text",
    "file": "text",
    "segments_bytes": "integer",
    "ticks_bytes": "integer",
}


def shown(name: str) -> str:
    """The name of a recording as text for the column ``recording``, whatever bytes it has; a URL without its
    query, which may hold a token."""
    return remote.shown(name).encode("utf-8", "surrogateescape").decode("utf-8", "backslashreplace")


def file_of(name: str) -> str:
    """The path of a recording's Parquet files, below the folders ``segments`` and ``ticks``."""
    import hashlib

    digits = hashlib.blake2b(shown(name).encode(), digest_size=16).hexdigest()
    return str(PurePosixPath(digits[:2], f"{digits[2:]}.parquet"))


class WrenchSettings(NamedTuple):
    """The topic of measured wrenches, and the mass (kg) of the object if known."""

    topic: str
    mass_kg: float | None


@dataclass(frozen=True, eq=False)
class Settings:
    """All that determines a result besides the recording.

    Parameters
    ----------
    topic, frame, relative_to : selection of poses, as of ``recording.open_log``.
    table : what the columns of tables are, as of ``recording.open_log``.
    with_ticks : whether to write the beliefs of all ticks, too.
    wrench : measured wrenches, which decide between contacts that motion cannot distinguish.
    """

    model: Model
    known_map: Map
    topic: str | None = None
    frame: str | None = None
    relative_to: str | None = None
    with_ticks: bool = False
    table: TableReading = AS_NAMED
    wrench: WrenchSettings | None = None

    @cached_property
    def model_hash(self) -> str:
        """Hash of the model with its noise, and of the map."""
        return fingerprint((self.model, self.known_map))

    @cached_property
    def settings_hash(self) -> str:
        """Hash of all but ``with_ticks``, and of the version."""
        which = self.topic, self.frame, self.relative_to, tuple(self.table.words())
        return fingerprint((__version__, self.model_hash, which, tuple(self.wrench or ())))


@dataclass
class Tally:
    """Counts of the segments of one recording while they are written."""

    ticks: int = 0
    segments: dict[str, int] = field(default_factory=lambda: dict.fromkeys(_KINDS, 0))
    time_ns: dict[str, int] = field(default_factory=lambda: dict.fromkeys(_KINDS, 0))

    def add(self, segments: Iterable[Segment], ticks: int) -> None:
        self.ticks += ticks
        for one in segments:
            state = _OPEN if is_open(one) else _STATES[STATES.index(one.contact)]
            self.segments[state] += 1
            self.time_ns[state] += one.end_ns - one.start_ns

    def cells(self) -> Row:
        counts: Row = {"ticks": self.ticks, "segments": sum(self.segments.values())}
        counts |= {f"segments_{state}": count for state, count in self.segments.items()}
        return counts | {f"time_{state}_s": time / 1e9 for state, time in self.time_ns.items()}


def base(name: str, settings: Settings) -> Row:
    """A row with the recording and settings only."""
    return dict.fromkeys(SUMMARY_COLUMNS) | {
        "recording": shown(name),
        "exit_code": errors.DONE,
        "model": settings.model.name,
        "model_hash": settings.model_hash,
        "settings_hash": settings.settings_hash,
        "version": __version__,
    }


def failure(name: str, settings: Settings, exit_code: int, error: str, content_hash: str | None) -> Row:
    """The row of a recording without segments.

    ``content_hash`` is None if another run with the same content and settings may succeed.
    """
    text = printable(remote.without_secrets(error))
    found = {"exit_code": exit_code, "error": text, "content_hash": content_hash}
    return base(name, settings) | found


def adapted_cells(adapted: Any) -> Row:
    """The cells of the tracker's adaptation."""
    if adapted is None:
        return {}
    report = report_json(adapted)
    names = ("tick_s", "sigma_position_m", "sigma_rotation_rad")
    return {name: report[name] for name in (*names, "tick_sigma_position_m", "tick_sigma_rotation_rad")}


def counts_text(counts: Any) -> str:
    """JSON of the counts of dropped and repaired poses, by kind."""
    return json.dumps({kind: int(count) for kind, count in sorted(counts.items()) if count})
