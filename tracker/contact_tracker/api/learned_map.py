"""A map of elements that was learned from a recording."""

import os
from dataclasses import dataclass
from pathlib import Path

from contact_tracker.api.given import errors_as, path_from
from contact_tracker.errors import OutputError, UsageError
from contact_tracker.geometry.elements import Element
from contact_tracker.map.file import load_knowledge
from contact_tracker.map.learned import MapPrior
from contact_tracker.map.learned_file import write_learned


@dataclass(frozen=True, eq=False)
class Map:
    """Elements that the contacts of a recording have touched, for ``known`` with the next one of the same
    object and place (docs/knowledge.md).

    ``learned`` is the Gaussian on all elements together.
    """

    learned: MapPrior

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> "Map":
        """The map in a file; raises KnowledgeError."""
        return cls(load_knowledge(path_from(path)).learned)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the map to a TOML file, atomically; raises OutputError, and UsageError for another suffix."""
        name = Path(path_from(path))
        if name.suffix.lower() != ".toml":
            raise UsageError(f"cannot write {name}: its name must end in .toml")
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
        covariance = self.learned.covariance()
        slots = self.learned.slots
        return tuple(
            one.with_covariance(covariance[slots[key], slots[key]])
            for key, one in self.learned.elements.items()
            if key[0] == side
        )

    def __len__(self) -> int:
        return len(self.learned.elements)

    def __repr__(self) -> str:
        return (
            f"<Map of {len(self.object)} elements of the object, {len(self.environment)} of the surroundings>"
        )
