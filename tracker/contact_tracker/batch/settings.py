"""Settings of a run for all its recordings, with a hash that identifies results."""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

from contact_tracker import __version__
from contact_tracker.config.parameters import Model
from contact_tracker.config.table_reading import AS_NAMED, TableReading
from contact_tracker.map.map import Map
from contact_tracker.saved_state import fingerprint


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
