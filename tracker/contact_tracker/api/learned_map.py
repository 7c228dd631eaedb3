"""The map of the Python interface, read from a file or learned from a recording."""

import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, Self

from contact_tracker.errors import OutputError, UsageError, shown
from contact_tracker.map import map
from contact_tracker.map.file import map_from, read_map, write_learned
from contact_tracker.states import states_from
from contact_tracker.trajectory.arguments import errors_as, path_from, with_known_arguments_of_methods


@with_known_arguments_of_methods
class Map(map.Map):
    """Elements that the contacts of a recording have touched, for ``known`` with a further recording of the
    same object and place, and named elements that a file lists (docs/map.md).

    ``learned`` is the joint Gaussian of the touched elements.
    """

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Self:
        """The map in a file; raises KnowledgeError."""
        return cls(**_fields(read_map(path_from(path))))

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the touched elements to a TOML file, atomically; raises OutputError, and UsageError for
        another suffix, or if the map has listed elements, which are in their own file."""
        name = Path(path_from(path))
        if name.suffix.lower() != ".toml":
            raise UsageError(f"cannot write {name}: its name must end in .toml")
        if self.lists_elements:
            raise UsageError(f"cannot write {name}: the map has elements that a file lists; keep that file")
        with errors_as(OutputError, str(name)):
            write_learned(name, self.learned)


def _fields(source: map.Map) -> dict[str, Any]:
    return {field.name: getattr(source, field.name) for field in fields(source)}


Known = str | os.PathLike[str] | Mapping[str, Any] | map.Map | None


def map_of(known: Known, note: Callable[[str], None], states: Iterable[str] | None = None) -> map.Map:
    """The map from a TOML file, a table of the same keys, or a map; raises KnowledgeError.

    ``note`` is called with one line per warning. ``states`` are the contacts that can occur; raises
    UsageError if they are invalid.
    """
    if known is None:
        known_map = map.EMPTY_MAP
    elif isinstance(known, map.Map):
        known_map = map.Map(**_fields(known))
    elif isinstance(known, Mapping):
        known_map = map_from(known, Path(), note)
    elif isinstance(known, str | os.PathLike):
        known_map = read_map(path_from(known, "known"), note)
    else:
        raise UsageError(f"known is a file, a table of its keys or a Map, not {shown(known)}")
    try:
        return known_map if states is None else replace(known_map, states=states_from(states))
    except (TypeError, ValueError) as error:
        raise UsageError(f"states: {error}") from error
