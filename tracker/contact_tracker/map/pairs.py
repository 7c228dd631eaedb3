"""Pairs of the map that a new contact may touch, as Gaussian priors on its parameters."""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from contact_tracker.contacts import ContactModel, face_face
from contact_tracker.geometry.elements import Array
from contact_tracker.map.elements import MapElement, kinds_of, loose_variance, stacked
from contact_tracker.map.view import Key, MapView

_SOME_DIRECTION: Final = np.array([0.0, 0.0, 1.0])


class MapPair(NamedTuple):
    """A Gaussian prior on x: ``mean`` (S,), ``information`` (S, S), both zero where an element is new.

    ``line_points_m`` (6,) are points on the known lines in frames 1 and 2, NaN elsewhere; ``is_known`` says
    whether both elements are of the map, and ``log_share`` is the log prior probability of the pair.
    """

    mean: Array
    information: Array
    line_points_m: Array
    is_known: bool
    log_share: float


def map_pairs(view: MapView, model: ContactModel, near_m: Array) -> tuple[float, list[MapPair]]:
    """All pairs with an element of the map that a contact may touch, and the log probability of a new pair.

    ``near_m`` (3,) is the body's place in the world. Two faces of the map may face each other or look the
    same way, which their normals do not say.
    """
    ours, theirs = kinds_of(model)
    log_p_new, out = 0.0, list[MapPair]()
    for one, our_log_p in view.choices(0, ours):
        for other, their_log_p in view.choices(1, theirs):
            log_p = our_log_p + their_log_p
            if one is None and other is None:
                log_p_new = log_p
                continue
            if (one, other) == view.current:
                continue
            both = one is not None and other is not None
            ways = (1.0, -1.0) if both and model.family is face_face else (1.0,)
            log_p -= float(np.log(len(ways)))
            out += [_pair(view, model, (one, other), near_m, way, log_p) for way in ways]
    return log_p_new, out


def _pair(
    view: MapView,
    model: ContactModel,
    keys: tuple[Key | None, Key | None],
    near_m: Array,
    way: float,
    log_share: float,
) -> MapPair:
    kinds, anchors = kinds_of(model), model.anchors(near_m)
    # the element of the other side stands in for a new one, of which nothing is read
    elements = [
        _stand_in(kind) if key is None else view.elements[key] for key, kind in zip(keys, kinds, strict=True)
    ]
    x, derivative = stacked(model, (elements[0], elements[1]), anchors, np.array([way, 1.0]), 1.0)
    loose = [loose_variance(kind) for kind in kinds]
    covariance = view.joint(keys, kinds, 1.0) + np.diag(np.concatenate(loose))
    is_known = np.repeat([key is not None for key in keys], [len(part) for part in loose])
    by_known = derivative[:, is_known]
    mine = _entries(model, (keys[0] is not None, keys[1] is not None))
    tangent = model.family.tangent(x[None], anchors[None])[0]
    along = tangent[:, ~tangent[~mine].any(axis=0)]
    onto = np.linalg.pinv(along)
    within = onto @ by_known @ covariance[np.ix_(is_known, is_known)] @ by_known.T @ onto.T
    information = onto.T @ np.linalg.inv(0.5 * (within + within.T)) @ onto
    points_m, form = np.full(6, np.nan), model.family.FORM
    for i, point in enumerate((form.q1, form.q2)):
        side = i if model.body_in_1 else 1 - i
        if keys[side] is not None and kinds[side] == "e":
            points_m[3 * i : 3 * i + 3] = x[point : point + 3]
    return MapPair(np.where(mine, x, 0.0), information, points_m, None not in keys, log_share)


def _stand_in(kind: str) -> MapElement:
    return MapElement(kind, _SOME_DIRECTION, np.zeros(1 if kind == "f" else 3))


def _entries(model: ContactModel, is_known: tuple[bool, bool]) -> NDArray[np.bool_]:
    """(S,) which entries of x belong to known elements; the height of f-f belongs to both."""
    first, second = is_known if model.body_in_1 else is_known[::-1]
    form = model.family.FORM
    boundary = form.d2 if form.d2 >= 0 else form.h
    mine = np.repeat([first, second], [boundary, model.family.SIZE - boundary])
    if model.family is face_face:
        mine[face_face.H] = first and second
    return mine
