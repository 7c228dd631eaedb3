"""A family that the package does not have is fitted and weighed by its contract alone."""

import numpy as np
from scipy.spatial.transform import Rotation

from contact_tracker.contacts import ContactModel
from contact_tracker.contacts.family import Form, Measurement, outer
from contact_tracker.geometry import lifted_pose
from contact_tracker.geometry.elements import Plane, Point
from contact_tracker.hypotheses.bank_update import fit_window
from contact_tracker.hypotheses.births import with_prior
from contact_tracker.hypotheses.evidence import EvidenceParameters
from contact_tracker.map.pairs import PairPrior
from contact_tracker.motion.window import Window
from contact_tracker.states import Contact

SCALES = EvidenceParameters(0.3, 0.1, 0.03, 1.0, 0.1)
UP = np.array([0.0, 0.0, 1.0])


class VertexLevel:
    """A vertex q of the body keeps a level h over the origin: x = [q, h], residual up . (R q + t) - h."""

    SIZE, PARAMETERS, ROWS, RANDOM_STARTS = 4, 4, 1, 1
    COLUMNS = np.concatenate([lifted_pose.R, lifted_pose.T, lifted_pose.ONE])
    SPREAD = np.array([1.0, 1.0, 1.0, 0.0])
    FORM = Form(q1=0, h=3)

    @staticmethod
    def rows(x):
        q, h = x[..., :3], x[..., 3:]
        return np.concatenate([outer(UP, q), np.broadcast_to(UP, q.shape), -h], axis=-1)[..., None, :]

    @staticmethod
    def rows_derivative(x):
        out = np.zeros((*x.shape[:-1], 1, 4, 13))
        out[..., 0, [0, 1, 2], [6, 7, 8]] = 1.0
        out[..., 0, 3, 12] = -1.0
        return out

    @staticmethod
    def scale_sq(x, moments):
        return np.ones(x.shape[:-1])

    @staticmethod
    def log_scale_sq_derivative(x, moments):
        return np.zeros_like(x)

    @staticmethod
    def tangent(x, anchors):
        return np.broadcast_to(np.eye(4), (*x.shape, 4))

    @staticmethod
    def normalise(x, anchors):
        return np.array(x)

    @staticmethod
    def place(anchors):
        return np.concatenate([anchors[..., :3], np.zeros((*anchors.shape[:-1], 1))], axis=-1)

    @staticmethod
    def starts(moments):
        return np.zeros((*moments.shape[:-2], 1, 4))

    @staticmethod
    def measure(x, frames):
        q, h = x[:, :3], x[:, 3:]
        height = outer(UP, q) @ frames.rotation.T
        reach_sq = np.broadcast_to((q * q).sum(axis=1)[:, None], height.shape)
        along = np.broadcast_to(UP, (len(x), 1, 3))
        residual = (height + frames.t[:, 2] - h)[:, None]
        return Measurement(residual, np.maximum(reach_sq - height**2, 0.0), reach_sq, along)

    @staticmethod
    def elements(x, covariance, reach_m):
        return Point(x[:3], covariance[:3, :3]), Plane(UP, float(x[3]))


LEVEL = ContactModel(Contact.VF, VertexLevel)


def window(rng, q, h, ticks=60):
    """Ticks of a body that turns and moves, with its vertex ``q`` at the level ``h``, or anywhere."""
    rotation = Rotation.from_rotvec(np.cumsum(rng.normal(size=(ticks, 3)) * 0.1, axis=0)).as_matrix()
    position = np.cumsum(rng.normal(size=(ticks, 3)) * 0.01, axis=0)
    if q is not None:
        position[:, 2] = h - (rotation @ q)[:, 2]
    zeta = lifted_pose.lift(rotation, position + rng.normal(size=(ticks, 3)) * 1e-4)
    noise, excess = np.tile([1e-8, 1e-8], (ticks, 1)), np.tile([1e-4, 1e-2], (ticks, 1))
    return Window(np.arange(ticks), zeta, noise, excess)


def fitted(seen):
    nothing = PairPrior(np.zeros((1, 4)), np.zeros((1, 4, 4)), np.full((1, 6), np.nan))
    first, unknown = np.zeros(1), np.zeros(1, bool)
    proposals = with_prior(LEVEL, nothing, first, first.astype(np.int64), unknown, unknown)
    return fit_window(LEVEL, seen, SCALES, proposals)


def test_its_geometry_and_evidence_are_found():
    rng, q, h = np.random.default_rng(3), np.array([0.05, -0.02, 0.1]), 0.3
    fit = fitted(window(rng, q, h))
    np.testing.assert_allclose(fit.x[0], [*q, h], atol=1e-3)
    assert fit.rms[0] < 1.3
    assert fit.log_likelihood[0] > 50.0
    assert fitted(window(rng, None, 0.0)).log_likelihood[0] < -50.0
    point, plane = LEVEL.family.elements(fit.x[0], np.eye(4), 0.3)
    assert LEVEL.geometry(fit.x[0], np.eye(4), 0.3).object.point_m.tolist() == point.point_m.tolist()
    assert plane.offset_m == fit.x[0, 3]
