"""A map for users: of a file, or learned from a recording."""

import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from reprlib import repr
from typing import Any

from contact_tracker.errors import OutputError, UsageError
from contact_tracker.geometry.elements import Element
from contact_tracker.map.elements import NOTHING_LEARNED, LearnedElements
from contact_tracker.map.file import map_from, read_map, write_learned
from contact_tracker.map.map import EMPTY_MAP
from contact_tracker.map.map import Map as KnownMap
from contact_tracker.states import states_from
from contact_tracker.trajectory.arguments import errors_as, path_from


@dataclass(frozen=True, eq=False)
class Map:
    """Elements that the contacts of a recording have touched, for ``known`` with the next one of the same
    object and place, and those with names that a file lists (docs/map.md).

    ``learned`` is the Gaussian on all elements together that were touched, ``listed`` has those with names.
    """

    learned: LearnedElements
    listed: KnownMap = EMPTY_MAP

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> "Map":
        """The map in a file; raises KnowledgeError."""
        known = read_map(path_from(path))
        return cls(known.learned, replace(known, learned=NOTHING_LEARNED))

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write what was touched to a TOML file, atomically; raises OutputError, and UsageError for another
        suffix, or if elements are listed, which their own file has."""
        name = Path(path_from(path))
        if name.suffix.lower() != ".toml":
            raise UsageError(f"cannot write {name}: its name must end in .toml")
        if self.listed:
            raise UsageError(f"cannot write {name}: the map has elements that a file lists; keep that file")
        with errors_as(OutputError, str(name)):
            write_learned(name, self.learned)

    @property
    def object(self) -> tuple[Element, ...]:
        """Faces, edges and vertices of the object, in the body frame, with covariances."""
        return self._elements(0)

    @property
    def environment(self) -> tuple[Element, ...]:
        """Faces, edges and vertices of the surroundings, in the world frame, with covariances."""
        return self._elements(1)

    def _elements(self, side: int) -> tuple[Element, ...]:
        learned = (one for key, one in self.learned.known.items() if key[0] == side)
        listed = self.listed.environment if side else self.listed.object
        return *(replace(one.element, name=one.name) for one in listed), *learned

    def __len__(self) -> int:
        return len(self.object) + len(self.environment)

    def __repr__(self) -> str:
        return (
            f"<Map of {len(self.object)} elements of the object, {len(self.environment)} of the surroundings>"
        )


Known = str | os.PathLike[str] | Mapping[str, Any] | KnownMap | Map | None


def map_of(known: Known, note: Callable[[str], None], states: Iterable[str] | None = None) -> KnownMap:
    """The map from a TOML file, a table of the same keys, or a value; raises KnowledgeError.

    ``note`` is called with one line for each warning. ``states`` are the contacts that can occur; raises
    UsageError.
    """
    found = _map_of(known, note)
    if states is None:
        return found
    try:
        return replace(found, states=states_from(states))
    except (TypeError, ValueError) as error:
        raise UsageError(f"states: {error}") from error


def _map_of(known: Known, note: Callable[[str], None]) -> KnownMap:
    if known is None:
        return EMPTY_MAP
    if isinstance(known, KnownMap):
        return known
    if isinstance(known, Map):
        return replace(known.listed, learned=known.learned)
    if isinstance(known, Mapping):
        return map_from(known, Path(), note)
    if not isinstance(known, str | os.PathLike):
        raise UsageError(f"known is a file, a table of its keys or a Map, not {repr(known)}")
    return read_map(path_from(known, "known"), note)
