"""Operations on quaternion arrays and direct calls of LAPACK, against scipy and numpy."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import eigh
from scipy.spatial.transform import Rotation

from contact_tracker.geometry import linalg

seeds = st.integers(0, 2**31)
exact = {"rtol": 0.0, "atol": 1e-14}


def same_rotation(found, expected):
    np.testing.assert_allclose(np.abs(np.einsum("...i,...i->...", found, expected)), 1.0, **exact)


@settings(max_examples=30, deadline=None)
@given(seed=seeds, norm=st.floats(0.96, 1.04))
def test_products_differences_and_matrices(seed, norm):
    a, b = Rotation.random(20, random_state=seed), Rotation.random(20, random_state=seed + 1)
    p, q = a.as_quat(), b.as_quat()
    same_rotation(linalg.product(p, q), (a * b).as_quat())
    same_rotation(linalg.between(p, q), (a.inv() * b).as_quat())
    np.testing.assert_allclose(linalg.matrices(norm * p), a.as_matrix(), **exact)
    np.testing.assert_allclose(linalg.matrices(p[0]), a[0].as_matrix(), **exact)


@settings(max_examples=60, deadline=None)
@given(seed=seeds, angle=st.one_of(st.just(0.0), st.floats(1e-300, 1e-3), st.floats(1e-3, np.pi - 1e-6)))
def test_rotation_vectors_there_and_back(seed, angle):
    axis = np.random.default_rng(seed).normal(size=(5, 3))
    vector = angle * axis / np.linalg.norm(axis, axis=1, keepdims=True)
    quat = linalg.from_rotation_vectors(vector)
    np.testing.assert_allclose(quat, Rotation.from_rotvec(vector).as_quat(), **exact)
    for sign in (1.0, -1.0):
        found = linalg.rotation_vectors(sign * quat)
        np.testing.assert_allclose(found, Rotation.from_quat(quat).as_rotvec(), rtol=1e-12, atol=1e-14)
        np.testing.assert_allclose(found, vector, rtol=1e-9, atol=1e-14)


@settings(max_examples=30, deadline=None)
@given(seed=seeds, spread=st.sampled_from([0.0, 1e-6, 0.1, 1.0]))
def test_the_nearest_rotation_of_a_mean(seed, spread):
    rng = np.random.default_rng(seed)
    turns = Rotation.random(random_state=rng) * Rotation.from_rotvec(spread * rng.normal(size=(20, 3)))
    same_rotation(linalg.nearest(turns.as_matrix().mean(axis=0)), turns.mean().as_quat())


@pytest.mark.parametrize("axis", range(3))
def test_half_a_turn_has_one_of_its_two_vectors(axis):
    quat = np.eye(4)[axis]
    np.testing.assert_allclose(linalg.rotation_vectors(quat), np.pi * quat[:3], **exact)


# --- direct calls of lapack, against numpy and scipy ---
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
