"""The viewer's recordings read back."""

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from rerun.chunk import Chunk, RrdReader

from contact_tracker.viewer import canvas


@cache
def _read(path: Path) -> list[Chunk]:
    return RrdReader(path).stream().to_chunks()


def chunks(path: Path, entity: str, static: bool = False) -> list[Chunk]:
    """The chunks of an entity at times, or at all times (``static``)."""
    return [c for c in _read(path) if c.entity_path == f"/{entity}" and c.is_static == static]


def rows(path: Path, entity: str, component: str, static: bool = False) -> list[tuple[int, Any]]:
    """(time since the first pose in ns, values) of each row that has the component, in order of time; the
    time is 0 in ``static`` rows."""
    found = []
    for batch in (c.to_record_batch() for c in chunks(path, entity, static)):
        if component in batch.schema.names:
            since_ns = np.zeros(batch.num_rows, np.int64)
            if not static:
                since_ns = batch.column(canvas.TIMELINE).to_numpy(zero_copy_only=False).astype(np.int64)
            found += zip(since_ns.tolist(), batch.column(component).to_pylist(), strict=True)
    return sorted(found, key=lambda row: row[0])


def column(reader: RrdReader, store: Any, name: str, entity: str | None = None) -> list[Any]:
    """All values of a component in a store of a file, of one entity or all."""
    parts = reader.stream(store=store).to_chunks()
    batches = [part.to_record_batch() for part in parts if entity in (None, part.entity_path)]
    return [value for b in batches if name in b.schema.names for value in b.column(name).to_pylist()]
