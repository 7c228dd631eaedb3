"""The object's convex hull, from vertices in a recording's metadata."""

import json
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from contact_tracker.geometry.elements import Array
from contact_tracker.viewer.scene import Extent

KEY = "object_vertices_m"


class Hull(NamedTuple):
    """``vertices`` (V, 3) in metres in the body frame, ``triangles`` (T, 3), ``edges`` (E, 2, 3)."""

    vertices: NDArray[np.float32]
    triangles: NDArray[np.uint32]
    edges: NDArray[np.float32]
    extent: Extent


def vertices_from_metadata(metadata: Mapping[str, Mapping[str, str]]) -> Array | None:
    """The object's vertices (V, 3) in the body frame; None if no record has a list of points."""
    for record in metadata.values():
        try:
            vertices = np.asarray(json.loads(record[KEY]), float)
        except (KeyError, TypeError, ValueError, OverflowError, RecursionError):
            continue
        if vertices.ndim == 2 and vertices.shape[1] == 3 and np.all(np.isfinite(vertices)):
            return vertices
    return None


def hull(vertices_m: Array) -> Hull | None:
    """The convex hull; None if ``vertices_m`` (V, 3) do not span a solid."""
    try:
        found = ConvexHull(vertices_m)
    except (QhullError, ValueError):
        return None
    centre = vertices_m[found.vertices].mean(axis=0)
    radius = float(np.max(np.linalg.norm(vertices_m[found.vertices] - centre, axis=1)))
    edges = [
        vertices_m[sorted(set(found.simplices[a]) & set(found.simplices[b]))]
        for a, row in enumerate(found.neighbors)
        for b in row
        if a < b and not np.allclose(found.equations[a], found.equations[b], atol=1e-6)
    ]
    return Hull(
        vertices_m.astype(np.float32),
        found.simplices.astype(np.uint32),
        np.array(edges, np.float32).reshape(-1, 2, 3),
        Extent(centre, radius, vertices_m),
    )
