"""Where searches start: ``Family.starts``, the solutions of relaxed problems, compiled."""

from math import sqrt
from typing import NamedTuple

import numpy as np

from contact_tracker.compiled.hypothesis import Kind
from contact_tracker.compiled.jit import jit, memory, part
from contact_tracker.compiled.vectors import NONE, Vector, at, copy, inner, mix, put
from contact_tracker.contacts import edge_edge, vertex_face
from contact_tracker.contacts.base import Array
from contact_tracker.pace import LIFT

SWEEPS = 12
"""Jacobi's rotations converge quadratically: this is more than it takes."""
LEAST = 1e-36
"""Of the squares of a matrix, what may be left beside its diagonal."""
FREE = 10.0
"""Up to so many times what is added to the moments, a direction is told by no pose."""


class Relaxed(NamedTuple):
    """Memory: ``moments`` (C, C); matrices (9, 9) and (3, 3) with their eigenvectors, a row each; the
    ``pair`` (3, 3) whose singular vectors are asked for."""

    moments: Array
    large: Array
    large_axes: Array
    small: Array
    small_axes: Array
    pair: Array


@memory
def relaxed_for(kind: Kind) -> Relaxed:
    count = kind.columns
    return Relaxed(
        np.empty((count, count)),
        np.empty((9, 9)),
        np.empty((9, 9)),
        np.empty((3, 3)),
        np.empty((3, 3)),
        np.empty((3, 3)),
    )


@part
def eigen(a: Array, axes: Array) -> None:
    """Eigenvectors of a symmetric a (n, n), the rows of ``axes``, in ascending order of the eigenvalues,
    which come to stand in a's diagonal (Jacobi's method)."""
    n = len(a)
    for i in range(n):
        for j in range(n):
            axes[i, j] = 1.0 if i == j else 0.0
    for _ in range(SWEEPS):
        on, off = 0.0, 0.0
        for i in range(n):
            on += a[i, i] * a[i, i]
            for j in range(i + 1, n):
                off += a[i, j] * a[i, j]
        if off <= LEAST * on:
            break
        for p in range(n - 1):
            for q in range(p + 1, n):
                _rotate(a, axes, p, q)
    for i in range(n - 1):
        least = i
        for j in range(i + 1, n):
            if a[j, j] < a[least, least]:
                least = j
        a[i, i], a[least, least] = a[least, least], a[i, i]
        for k in range(n):
            axes[i, k], axes[least, k] = axes[least, k], axes[i, k]


@jit
def _rotate(a: Array, axes: Array, p: int, q: int) -> None:
    """Turn the axes p and q until a[p, q] vanishes."""
    if a[p, q] == 0.0:
        return
    theta = 0.5 * (a[q, q] - a[p, p]) / a[p, q]
    tangent = (1.0 if theta >= 0.0 else -1.0) / (abs(theta) + sqrt(theta * theta + 1.0))
    cosine = 1.0 / sqrt(tangent * tangent + 1.0)
    sine = tangent * cosine
    for k in range(len(a)):
        a[k, p], a[k, q] = cosine * a[k, p] - sine * a[k, q], sine * a[k, p] + cosine * a[k, q]
    for k in range(len(a)):
        a[p, k], a[q, k] = cosine * a[p, k] - sine * a[q, k], sine * a[p, k] + cosine * a[q, k]
        axes[p, k], axes[q, k] = (
            cosine * axes[p, k] - sine * axes[q, k],
            sine * axes[p, k] + cosine * axes[q, k],
        )


@jit
def _smallest_directions(
    moments: Array, first: int, count: int, ridge: float, out: Array, axes: Array
) -> None:
    """As ``base.smallest_directions``, what is kept of it; ``moments`` are lost."""
    n, trace = len(moments), 0.0
    for c in range(n):
        trace += moments[c, c]
    for c in range(n):
        if c < first or c >= first + count:
            moments[c, c] += ridge * trace
    for c in range(n):
        if c < first or c >= first + count:  # is eliminated
            inverse = 1.0 / moments[c, c]
            for i in range(n):
                if i > c or first <= i < first + count:
                    factor = moments[i, c] * inverse
                    for j in range(n):
                        if j > c or first <= j < first + count:
                            moments[i, j] -= factor * moments[c, j]
    for i in range(count):
        for j in range(count):
            out[i, j] = 0.5 * (moments[first + i, first + j] + moments[first + j, first + i])
    eigen(out, axes)


@jit
def _times(matrix: Array, v: Vector) -> Vector:
    return inner(at(matrix[0], 0), v), inner(at(matrix[1], 0), v), inner(at(matrix[2], 0), v)


@jit
def _image(matrix: Array, v: Vector) -> Vector:
    """Direction to which the matrix (3, 3) brings a unit vector, which is that itself if to none."""
    image = _times(matrix, v)
    length = sqrt(inner(image, image))
    return mix(1.0 / length, image, 0.0, NONE) if length > 0.0 else v


@jit
def _singular(work: Relaxed) -> None:
    """Right singular vectors of ``work.pair``, the rows of ``work.small_axes``, the largest last."""
    for i in range(3):
        for j in range(3):
            work.small[i, j] = 0.0
            for k in range(3):
                work.small[i, j] += work.pair[k, i] * work.pair[k, j]
    eigen(work.small, work.small_axes)


@jit
def _edge_in(moments: Array, n: Vector, work: Relaxed) -> Vector:
    """The direction of frame 1 that leaves a face with the normal n the least."""
    for j in range(3):
        for m in range(3):
            work.small[j, m] = 0.0
            for i in range(3):
                for k in range(3):
                    work.small[j, m] += n[i] * n[k] * moments[3 * i + j, 3 * k + m]
    eigen(work.small, work.small_axes)
    return at(work.small_axes[0], 0)


@part
def relax(kind: Kind, moments: Array, out: Array, work: Relaxed) -> int:
    """As ``Family.starts`` of one window's moments (C, C), into ``out`` (N, S); returns how many there are.

    Less than N where poses are too few to tell one smallest direction of coefficients: any other would do as
    well, and which it is would hang on how the frames are turned, since Jacobi's method prefers their axes.
    """
    form, n, trace, count = kind.form, len(moments), 0.0, 0
    for c in range(n):
        trace += moments[c, c]
    out[:] = 0.0
    for c in range(n):
        copy(moments[c], work.moments[c])
        work.moments[c, c] += LIFT * trace
    if form.q2 >= 0:
        _smallest_directions(work.moments, 9, 9, edge_edge.RIDGE, work.large, work.large_axes)
        if not work.large[1, 1] > FREE * LIFT * trace:
            return 0
        for k in range(len(out)):
            for i in range(3):
                for j in range(3):
                    work.pair[i, j] = work.large_axes[k, 3 * i + j]
            _singular(work)
            d1 = at(work.small_axes[2], 0)
            put(out[k], form.d1, d1)
            put(out[k], form.d2, _image(work.pair, d1))
        return len(out)
    if form.q1 >= 0:
        _smallest_directions(work.moments, 9, 3, vertex_face.RIDGE, work.small, work.small_axes)
        if work.small[1, 1] > FREE * LIFT * trace:
            for k in range(3):
                put(out[k], form.d2, at(work.small_axes[k], 0))
            count = 3
    if form.d1 >= 0:
        for i in range(3):
            for j in range(3):
                work.pair[i, j] = moments[3 * i + j, n - 1]
        _singular(work)
        for k in range(3):
            m = at(work.small_axes[2 - k], 0)
            put(out[count + k], form.d2, _image(work.pair, m))
            put(out[count + k], form.d1, m)
        count += 3
    if form.d1 >= 0 and form.q1 >= 0:
        for k in range(count):
            put(out[k], form.d1, _edge_in(moments, at(out[k], form.d2), work))
    return count
