"""Saved states of which one value is another, with a valid checksum."""

from collections.abc import Iterator
from pathlib import Path
from random import Random
from typing import Any

import numpy as np

from contact_tracker.saved_state import STREAM, Kind, packed, unpacked

VALUES = [None, -1, 0, 10**30, float("nan"), 1e308, "x", True, ["tuple"], ["list"], ["dict"], ["tuple", 0.0]]
ARRAYS = [
    lambda a: a[:0] if a.ndim else a,
    lambda a: np.zeros((), a.dtype),
    lambda a: a.reshape(-1)[:1],
    lambda a: np.concatenate([a, a]) if a.ndim else a.reshape(1),
    lambda a: a[None],
    lambda a: a.T[::-1] if a.ndim else a,
    lambda a: np.full(a.shape, np.nan),
    lambda a: np.full(a.shape, 1e308),
    lambda a: np.full(a.shape, -1),
    lambda a: np.full(a.shape, 2**40),
    lambda a: np.ones(a.shape, bool),
]


def leaves(tree: Any, path: tuple[int, ...] = ()) -> Iterator[tuple[tuple[int, ...], Any]]:
    """The values and references to arrays in a tree, with their places."""
    if not isinstance(tree, list) or tree[0] in ("array", "scalar"):
        yield path, tree
        return
    for i, part in enumerate(tree):
        if i or isinstance(part, list):
            yield from leaves(part, (*path, i))


def forge(path: Path, target: Path, random: Random, kind: Kind = STREAM) -> str:
    """Write a forged copy of a state; returns what is changed, in words."""
    tree, arrays = unpacked(path.read_bytes(), kind)
    place, old = random.choice(list(leaves(tree)))
    value = random.choice(VALUES)
    words = f"{value!r} for {old!r} at {place}"
    if isinstance(old, list) and random.random() < 0.9:
        change = random.randrange(len(ARRAYS))
        array = ARRAYS[change](arrays[old[1]])
        arrays.append(np.ascontiguousarray(array) if array.ndim else array)
        value, words = [old[0], len(arrays) - 1], f"change {change} of {old!r} at {place}"
    inner = tree
    for i in place[:-1]:
        inner = inner[i]
    inner[place[-1]] = value
    target.write_bytes(packed(tree, arrays, kind))
    return words
