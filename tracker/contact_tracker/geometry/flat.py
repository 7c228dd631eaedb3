"""Elements of all kinds in the same fields, so that tables have one schema (docs/conventions.md)."""

import json
from typing import Any, Final

import numpy as np

from contact_tracker.geometry.elements import Array, Element, Line, Plane, Point

NONE: Final = "none"
VERTEX: Final = "vertex"
TYPES: Final = (NONE, "face", "edge", VERTEX)


def flat(element: Element | None) -> dict[str, Any]:
    """``type``, ``name``, ``axis``, ``point_m``, their standard deviations and ``unobserved`` of an element.

    ``axis`` (3,) is the normal of a face, the direction of an edge, and zero of a vertex; ``point_m`` (3,)
    lies on the element: of a face the point nearest to the origin of its frame. ``unobserved`` is JSON text.
    All keys are always present, with values of one type, except unknown standard deviations (None).
    """
    zero, none = np.zeros(3), np.full(3, np.nan)
    axis, point_m, axis_sd, point_sd_m, kind = zero, zero, zero, zero, NONE
    match element:
        case Plane(normal, offset_m, covariance):
            jacobian = np.hstack([offset_m * np.eye(3), normal[:, None]])
            kind, axis, point_m = "face", normal, offset_m * normal
            axis_sd = none if covariance is None else _deviations(covariance[:3, :3])
            point_sd_m = none if covariance is None else _deviations(jacobian @ covariance @ jacobian.T)
        case Line(direction, place_m, covariance):
            kind, axis, point_m = "edge", direction, place_m
            axis_sd = none if covariance is None else _deviations(covariance[:3, :3])
            point_sd_m = none if covariance is None else _deviations(covariance[3:, 3:])
        case Point(place_m, covariance):
            kind, point_m = VERTEX, place_m
            point_sd_m = none if covariance is None else _deviations(covariance)
    return {
        "type": kind,
        "name": "" if element is None or element.name is None else element.name,
        "axis": _numbers(axis),
        "point_m": _numbers(point_m),
        "axis_sd": _numbers(axis_sd),
        "point_sd_m": _numbers(point_sd_m),
        "unobserved": json.dumps([way.to_json() for way in element.unobserved] if element else []),
    }


def _deviations(covariance: Array) -> Array:
    return np.asarray(np.sqrt(np.maximum(np.diag(covariance), 0.0)))


def _numbers(values: Array) -> list[float | None]:
    """JSON has no NaN."""
    return [float(value) if np.isfinite(value) else None for value in values]
