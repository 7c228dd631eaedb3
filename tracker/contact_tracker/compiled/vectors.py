"""Small linear algebra for kernels: vectors of three numbers, and arrays without temporaries."""

from typing import Final

from contact_tracker.compiled.jit import jit
from contact_tracker.contacts.base import Array

Vector = tuple[float, float, float]
NONE: Final = (0.0, 0.0, 0.0)


@jit
def at(x: Array, first: int) -> Vector:
    """The vector that begins at ``first``; zero where that is negative, for what a contact does not have."""
    return (x[first], x[first + 1], x[first + 2]) if first >= 0 else (0.0, 0.0, 0.0)


@jit
def put(out: Array, first: int, v: Vector) -> None:
    out[first], out[first + 1], out[first + 2] = v


@jit
def inner(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@jit
def mix(s: float, a: Vector, t: float, b: Vector) -> Vector:
    """``s a + t b``."""
    return s * a[0] + t * b[0], s * a[1] + t * b[1], s * a[2] + t * b[2]


@jit
def cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@jit
def across(n: Vector) -> tuple[Vector, Vector]:
    """As ``base.sphere_tangent``."""
    x, y, z = n
    sign = 1.0 if z >= 0 else -1.0
    a = -1.0 / (sign + z)
    b = x * y * a
    return (1.0 + sign * x * x * a, sign * b, -sign * x), (b, sign + y * y * a, -y)


@jit
def outers(out: Array, first: int, a: Vector, b: Vector, c: Vector, d: Vector) -> None:
    """vec(a b^T + c d^T) from ``first`` on."""
    put(out, first, mix(a[0], b, c[0], d))
    put(out, first + 3, mix(a[1], b, c[1], d))
    put(out, first + 6, mix(a[2], b, c[2], d))


@jit
def multiply(vector: Array, matrix: Array, out: Array) -> None:
    """``vector @ matrix``; most vectors here have many zeros."""
    columns = matrix.shape[1]
    for j in range(columns):
        out[j] = 0.0
    for i in range(len(vector)):
        v = vector[i]
        if v != 0.0:
            for j in range(columns):
                out[j] += v * matrix[i, j]


@jit
def copy(values: Array, out: Array) -> None:
    """Slices that are assigned would be copied twice, lest they overlap."""
    for i in range(len(values)):
        out[i] = values[i]


@jit
def dot(a: Array, b: Array) -> float:
    total = 0.0
    for i in range(len(a)):
        total += a[i] * b[i]
    return total


@jit
def eliminate(a: Array, b: Array) -> None:
    """Solve ``a y = b`` of a positive definite a, of which the upper triangle is read; y comes to stand where
    b was, and in a's diagonal what multiplies to its determinant."""
    n = len(b)
    for k in range(n):
        inverse = 1.0 / a[k, k]
        for i in range(k + 1, n):
            factor = a[k, i] * inverse
            for j in range(i, n):
                a[i, j] -= factor * a[k, j]
            b[i] -= factor * b[k]
    for k in range(n - 1, -1, -1):
        for j in range(k + 1, n):
            b[k] -= a[k, j] * b[j]
        b[k] /= a[k, k]
