"""From a fitted hypothesis to the elements a user reads: planes, lines and points with covariance."""

import numpy as np
from numpy.typing import NDArray

from contact_tracker.bank import Bank
from contact_tracker.contacts import ContactModel
from contact_tracker.evidence import Scales, weak_prior
from contact_tracker.geometry import ContactGeometry, Element, Line, Plane, Point

Array = NDArray[np.float64]


def geometry_of(
    bank: Bank, row: int, model: ContactModel, scales: Scales, origin_m: Array
) -> ContactGeometry:
    """Elements of hypothesis ``row``; ``origin_m`` is the world's origin in which the bank works."""
    one = bank.pick(np.array([row]))
    anchors = model.anchors(one.place_sum / one.weight[:, None])
    prior = weak_prior(model.family, anchors, scales.reach_m)
    tangent = model.family.tangent(one.x, anchors)[0]
    before = tangent.T @ (prior.precision[0] + np.diag(prior.flat)) @ tangent
    covariance = tangent @ np.linalg.inv(one.hessian[0].sum(axis=0) + before) @ tangent.T
    found = model.geometry(one.x[0], covariance, scales.reach_m)
    return ContactGeometry(found.object, shifted(found.environment, origin_m))


def shifted(element: Element, origin_m: Array) -> Element:
    """The element as seen from a frame in which its present origin stands at ``origin_m``."""
    match element:
        case Plane(normal, offset_m, covariance):
            jacobian = np.eye(4)
            jacobian[3, :3] = origin_m
            moved = None if covariance is None else jacobian @ covariance @ jacobian.T
            return Plane(normal, float(offset_m + normal @ origin_m), moved)
        case Line(direction, point_m, covariance):
            return Line(direction, point_m + origin_m, covariance)
        case Point(point_m, covariance):
            return Point(point_m + origin_m, covariance)
