"""Direct calls of LAPACK, against numpy and scipy."""

import numpy as np
import pytest
from scipy.linalg import eigh

from contact_tracker.geometry import linalg

RNG = np.random.default_rng(0)
ROOT = RNG.normal(size=(2, 6, 6))
SYMMETRIC, AGAINST = ROOT[0] + ROOT[0].T, ROOT[1] @ ROOT[1].T + np.eye(6)


def test_results_equal_those_of_numpy_and_scipy():
    right = RNG.normal(size=(6, 2))
    np.testing.assert_allclose(linalg.solve(ROOT[0], right), np.linalg.solve(ROOT[0], right), rtol=1e-9)
    np.testing.assert_allclose(linalg.eigenvalues(SYMMETRIC), np.linalg.eigvalsh(SYMMETRIC), rtol=1e-9)
    for against in (None, AGAINST):
        values, vectors = linalg.eigenvectors(SYMMETRIC, against)
        true_values, true = eigh(SYMMETRIC, against)
        np.testing.assert_allclose(values, true_values, rtol=1e-9)
        np.testing.assert_allclose(vectors * np.sign(vectors[0]), true * np.sign(true[0]), atol=1e-9)


def test_arguments_are_not_modified():
    given = SYMMETRIC.copy(order="F"), AGAINST.copy(order="F")
    linalg.solve(*given)
    linalg.eigenvalues(given[0])
    linalg.eigenvectors(given[0])
    linalg.eigenvectors(*given)
    np.testing.assert_array_equal(given, (SYMMETRIC, AGAINST))


def test_singular_systems_have_no_result():
    with pytest.raises(np.linalg.LinAlgError):
        linalg.solve(np.zeros((3, 3)), np.ones((3, 1)))
    with pytest.raises(np.linalg.LinAlgError):
        linalg.eigenvectors(SYMMETRIC, -AGAINST)
