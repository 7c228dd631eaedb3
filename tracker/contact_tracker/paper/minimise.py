"""Minimisation as the paper does it: SLSQP from random starts, on the Kronecker form, with unit constraints.

It is slow (docs/theory.md, fixed windows) and serves as the oracle of tests and benchmarks.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contact_tracker.paper.batched import SIZE, Form, Kind, form, random_starts
from contact_tracker.states import Contact

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Minimum:
    """The lowest minimum over all starts.

    Parameters
    ----------
    value : the objective function, summed over the frames of K.
    object, environment : its elements, as arrays (package docstring).
    converged : how many of the starts the optimiser ended with success.
    """

    value: float
    object: Array
    environment: Array
    converged: int


def minimise_slsqp(
    contact: Contact, k: Array, rng: np.random.Generator, starts: int = 3, offset_m: float = 0.5
) -> Minimum:
    """Minimise ``(x (x) y).T K (x (x) y)`` under ``|n| = 1``, ``|d| = 1``, ``d . m = 0``.

    Parameters
    ----------
    k : (n, n), from ``matrix``.
    starts : random starts; the paper takes 10 for one contact and 3 for each window.
    offset_m : standard deviation of the starts' offsets and points.
    """
    from scipy.optimize import minimize  # who only loads the package does not wait for it

    f = form(contact)
    size = SIZE[f.x]
    # A sum of 500 squares of metres is far above SLSQP's absolute tolerance; one frame's minimum is not.
    scale = 1.0 / max(float(np.trace(k)) / f.size, np.finfo(float).tiny)
    constraints = {"type": "eq", "fun": lambda z: _constraints(f, z), "jac": lambda z: _constraint_rows(f, z)}
    best, converged = None, 0
    for _ in range(starts):
        z0 = np.concatenate(random_starts(contact, 1, rng, offset_m), axis=1)[0]
        options = {"maxiter": 500, "ftol": 1e-15}
        found = minimize(
            _objective(k * scale, size),
            z0,
            jac=True,
            method="SLSQP",
            constraints=constraints,
            options=options,
        )
        converged += int(found.success)
        x, y = _onto_constraints(f.x, found.x[:size]), _onto_constraints(f.y, found.x[size:])
        v = np.kron(x, y)
        candidate = (float(v @ k @ v), x, y)
        if best is None or candidate[0] < best[0]:
            best = candidate
    if best is None:
        raise ValueError("at least one start is needed")
    return Minimum(best[0], *f.factors(best[1], best[2]), converged)


def _objective(k: Array, size: int) -> Callable[[Array], tuple[float, Array]]:
    def objective(z: Array) -> tuple[float, Array]:
        x, y = z[:size], z[size:]
        v = np.kron(x, y)
        kv = k @ v
        slope = 2.0 * kv.reshape(size, -1)
        return float(v @ kv), np.concatenate([slope @ y, x @ slope])

    return objective


def _constraints(f: Form, z: Array) -> Array:
    size = SIZE[f.x]
    return np.concatenate([_constraint(f.x, z[:size]), _constraint(f.y, z[size:])])


def _constraint_rows(f: Form, z: Array) -> Array:
    size = SIZE[f.x]
    first, second = _constraint_row(f.x, z[:size]), _constraint_row(f.y, z[size:])
    out = np.zeros((len(first) + len(second), len(z)))
    out[: len(first), :size] = first
    out[len(first) :, size:] = second
    return out


def _constraint(kind: Kind, e: Array) -> Array:
    match kind:
        case "plane":
            return np.array([e[:3] @ e[:3] - 1.0])
        case "line":
            return np.array([e[:3] @ e[:3] - 1.0, e[:3] @ e[3:]])
        case "point":
            return np.array([e[3] - 1.0])


def _constraint_row(kind: Kind, e: Array) -> Array:
    match kind:
        case "plane":
            return np.array([[*(2.0 * e[:3]), 0.0]])
        case "line":
            return np.array([[*(2.0 * e[:3]), 0.0, 0.0, 0.0], [*e[3:], *e[:3]]])
        case "point":
            return np.array([[0.0, 0.0, 0.0, 1.0]])


def _onto_constraints(kind: Kind, e: Array) -> Array:
    """SLSQP meets its constraints to a tolerance only: make them exact before comparing minima."""
    match kind:
        case "plane":
            return np.asarray(e / np.linalg.norm(e[:3]))
        case "line":
            e = e / np.linalg.norm(e[:3])
            return np.concatenate([e[:3], e[3:] - e[:3] * (e[:3] @ e[3:])])
        case "point":
            return np.asarray(e / e[3])
