"""Maps that were learned from recordings, as a part of a map file."""

import math
from pathlib import Path
from typing import Final

import numpy as np

from contact_tracker import __version__
from contact_tracker.errors import KnowledgeError
from contact_tracker.files import whole_file
from contact_tracker.geometry.elements import Array
from contact_tracker.map.elements import MapElement
from contact_tracker.map.keys import FARTHEST_M, Keys
from contact_tracker.map.learned import ANYWHERE_M, NOTHING_LEARNED, LearnedElements
from contact_tracker.map.map import KINDS
from contact_tracker.map.view import Key
from contact_tracker.map.world_map import MOST_LEARNED

SIDES: Final = ("object", "environment")
MOST_ELEMENTS: Final = MOST_LEARNED
_ROUNDING: Final = 1e-6
"""Largest share of an information matrix that rounding in a file makes asymmetric or negative."""


def learned_text(learned: LearnedElements) -> str:
    """The map as TOML, which ``learned_from`` reads."""
    lines = [
        f"# Learned by contact-tracker {__version__}: what contacts touched, for --known.",
        "# Lengths are in m. The information matrix is that of all elements together: do not edit it.",
        "[learned]",
        f"information = {_numbers(learned.information)}",
    ]
    variance = learned.covariance().diagonal()
    for (side, number), one in learned.elements.items():
        own = variance[learned.slots[side, number]]
        lengths = own if one.kind == "v" else own[2:]
        lines += [
            "",
            "[[learned.element]]",
            f'name = "{SIDES[side]} {KINDS[one.kind]} {number}"',
            f'side = "{SIDES[side]}"',
            f'kind = "{KINDS[one.kind]}"',
            f"touched = {learned.counts[side, number]}",
        ]
        if one.kind != "v":
            deg = math.degrees(math.sqrt(max(float(own[:2].max()), 0.0)))
            lines.append(f"direction = {_numbers(one.direction)}  # to {deg:.2g} deg")
        name = "offset_m" if one.kind == "f" else "point_m"
        place = one.place_m[0] if one.kind == "f" else one.place_m
        mm = 1e3 * math.sqrt(max(float(lengths.max()), 0.0))
        lines.append(f"{name} = {_numbers(place)}  # to {mm:.2g} mm")
    return "\n".join(lines) + "\n"


def write_learned(path: Path, learned: LearnedElements) -> None:
    """Write a map to a file, atomically; raises OSError."""
    with whole_file(path) as temporary:
        temporary.write_text(learned_text(learned), encoding="utf-8")


def learned_from(keys: Keys) -> LearnedElements:
    """The map of the table ``learned`` of a file; raises KnowledgeError."""
    rows, elements, counts = keys.tables("element"), dict[Key, MapElement](), dict[Key, int]()
    if len(rows) > MOST_ELEMENTS:
        raise keys.wrong("element", f"{len(rows)} elements are too many; {MOST_ELEMENTS} are allowed")
    for number, row in enumerate(rows, start=1):
        side, kind = _one_of(row, "side", SIDES), _one_of(row, "kind", tuple(KINDS.values()))
        row.text("name", "")
        key, short = (SIDES.index(side), number), next(k for k, name in KINDS.items() if name == kind)
        counts[key] = round(row.number("touched", None, 1, 1e6))
        direction = np.zeros(3) if short == "v" else row.direction("direction")
        if short == "f":
            place_m = np.array([row.number("offset_m", None, -FARTHEST_M, FARTHEST_M)])
        else:
            place_m = row.vector("point_m")
        row.finish()
        elements[key] = MapElement(short, direction, place_m)
    size = sum(one.size for one in elements.values())
    information = keys.matrix("information", size) if rows else np.zeros((0, 0))
    keys.finish()
    if not rows:
        return NOTHING_LEARNED
    found = _sound(LearnedElements(elements, counts, information))
    order = sorted(elements)
    taken = np.concatenate([np.arange(found.slots[key].start, found.slots[key].stop) for key in order])
    return LearnedElements(
        {key: elements[key] for key in order},
        {key: counts[key] for key in order},
        found.information[np.ix_(taken, taken)],
    )


def _one_of(keys: Keys, key: str, choices: tuple[str, ...]) -> str:
    value = keys.text(key, None)
    if value not in choices:
        raise keys.wrong(key, f"must be {' or '.join(choices)}")
    return value


def _sound(learned: LearnedElements) -> LearnedElements:
    """The map with a symmetric matrix; raises KnowledgeError if it is not the information of a Gaussian."""
    sd = np.sqrt(learned.weak(ANYWHERE_M))
    scaled = sd[:, None] * learned.information * sd
    largest = float(np.abs(scaled).max())
    values = np.linalg.eigvalsh(0.5 * (scaled + scaled.T))
    is_even = np.abs(scaled - scaled.T).max() <= _ROUNDING * largest
    if not (is_even and values[0] >= -_ROUNDING * max(largest, 1.0)):
        raise KnowledgeError("learned.information", "is not symmetric with positive eigenvalues")
    return learned.with_scaled(scaled, sd)


def _numbers(values: Array | float) -> str:
    return str(np.asarray(values, float).tolist())
