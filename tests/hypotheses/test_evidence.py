"""Evidence against free motion: the ratio of two normal densities, nothing at rest."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from scipy.special import logsumexp
from scipy.stats import norm

from contact_motions import every_cost, touching, x_of
from contact_tracker.contacts import CONTACT_MODELS
from contact_tracker.geometry.lifted_pose import lift
from contact_tracker.hypotheses import evidence, gauss_newton
from contact_tracker.hypotheses.evidence import EvidenceParameters
from contact_tracker.motion.window import Window

each_model = pytest.mark.parametrize("model", CONTACT_MODELS, ids=lambda model: model.contact.value)
SCALES = EvidenceParameters(
    reach_m=0.3, body_radius_m=0.1, prior_predictive_share=0.3, likelihood_exponent=1.0, tick_s=0.1
)
seeds = st.integers(0, 2**32 - 1)


def window(rng, model, ticks=12):
    """Ticks of random motion, noise and excess, and random hypotheses."""
    t = touching(model.contact, rng, ticks)
    zeta = lift(t.rotation, t.position_m - t.position_m[0])
    variance = np.exp(rng.normal(size=(ticks, 2))) * [1e-8, 1e-6]
    excess = np.exp(3.0 * rng.normal(size=(ticks, 2))) * [1e-6, 1e-4]
    x = model.family.normalise(rng.normal(size=(3, model.family.SIZE)), np.zeros(6))
    return Window(np.arange(ticks), zeta, variance, excess), x


@each_model
@given(seed=seeds, first=st.integers(1, 10))
@settings(max_examples=4, deadline=None)
def test_the_evidence_of_a_moving_window_is_kept(model, seed, first):
    seen, x = window(np.random.default_rng(seed), model)
    certain = np.array([True, False, True])
    whole = evidence.log_ratio(model, x, seen, SCALES, certain).log_ratio
    parts = [seen.cut(0, first), seen.cut(first, None).cut(-len(seen), -1), seen.cut(-1, None)]
    ratios = [evidence.log_ratio(model, x, part, SCALES, certain).log_ratio for part in parts]
    np.testing.assert_allclose(np.concatenate(ratios, axis=1), whole, atol=1e-9)


@given(seed=seeds, most=st.integers(1, 12))
@settings(max_examples=10, deadline=None)
def test_a_window_that_grows_tick_by_tick_is_the_one_of_all_ticks(seed, most):
    seen, _ = window(np.random.default_rng(seed), CONTACT_MODELS[0])
    uneven = np.tile(1e-9 * np.diag([1.0, 2.0, -3.0]), (len(seen), 1, 1))
    grown = Window(seen.index[:0], seen.zeta[:0], seen.variance[:0], seen.innovation_excess[:0])
    for row in range(len(seen)):
        rows = slice(max(row + 1 - most, 0), row + 1)
        variance = seen.variance[rows] * (row + 1)  # of all ticks anew
        grown = grown.append(row, seen.zeta[row], seen.innovation_excess[row], variance, uneven[rows])
        known = replace(seen, variance=seen.variance * (row + 1), position_anisotropy=uneven).cut(
            rows.start, rows.stop
        )
        names = (
            "index zeta variance innovation_excess position_anisotropy inverse displacement_variance travel"
        )
        for name in names.split():
            np.testing.assert_array_equal(getattr(grown, name), getattr(known, name), err_msg=name)
        assert grown.latest_motion_ratio == known.motion_ratio[-1]
        assert (grown.before is None) == (known.before is None)
    for name in ("inverse", "displacement_variance"):
        noisier = grown.with_error((1e-9, 1e-9))
        assert name in vars(noisier), "kept, not worked out anew"
        np.testing.assert_array_equal(getattr(noisier, name), getattr(grown, name))


def test_windows_are_cut_picked_and_joined():
    """The motion between distant ticks is unknown."""
    seen, _ = window(np.random.default_rng(6), CONTACT_MODELS[0])
    both = Window.join([seen.cut(0, 5), seen.cut(5, None)])
    for name, value in vars(seen).items():
        np.testing.assert_array_equal(vars(both)[name], value)
    some = seen.pick(np.array([2, 3, 7, 8]))
    np.testing.assert_array_equal(some.travel[[0, 2]], 0.0)
    np.testing.assert_array_equal(some.travel[[1, 3]], seen.travel[[3, 8]])
    for ticks in (1, 2, 7):
        usual = seen.cut(0, ticks).usual_variance
        np.testing.assert_array_equal(usual, np.median(seen.variance[:ticks], axis=0))


@each_model
@settings(max_examples=3, deadline=None)
@given(seed=seeds)
def test_the_evidence_of_a_tick_is_the_ratio_of_the_densities(model, seed):
    """Each row N(0, V) against N(0, S): the log ratio at the residual."""
    rng = np.random.default_rng(seed)
    seen, x = window(rng, model)
    found = evidence.log_ratio(model, x, seen, SCALES)
    measured = model.measure(x, seen.zeta)
    expected = np.zeros_like(found.log_ratio)
    for b in range(len(x)):
        for tick in range(len(seen)):
            position, rotation = seen.variance[tick]
            free_position, free_rotation = seen.innovation_excess[tick]
            lever_sq = measured.lever_sq[b, tick]
            for row in range(model.family.ROWS):
                held, moved = rotation, free_rotation
                if row == model.family.ROWS - 1:
                    held = position + rotation * lever_sq
                    moved = free_position + free_rotation * (lever_sq + SCALES.body_radius_m**2)
                r = measured.residual[b, row, tick]
                expected[b, tick] += norm.logpdf(r, scale=held**0.5) - norm.logpdf(
                    r, scale=(held + moved) ** 0.5
                )
                assert found.chi_sq[b, tick, row] == pytest.approx(r**2 / held)
                assert found.row_weight[b, tick, row] == pytest.approx(1.0 / held)
            # a touching point two reaches from the body costs half a nat per second
            stray = measured.reach_sq[b, tick] / (2.0 * SCALES.reach_m) ** 2
            expected[b, tick] -= 0.5 * stray * SCALES.tick_s
    np.testing.assert_allclose(found.log_ratio, expected, rtol=1e-8, atol=1e-8)
    assert (found.gain > 0.0).all()


@each_model
@pytest.mark.parametrize("cut", [0, 3])
def test_correlated_errors_count_by_their_innovation(model, cut):
    """A hypothesis that begins in the window has no residual before; nor has the first tick of the stream."""
    rho = 0.6
    whole, x = window(np.random.default_rng(8), model)
    seen, scales = whole.cut(cut, None), replace(SCALES, correlation=rho)
    assert (seen.before is None) == (cut == 0)
    measured = model.measure(x, whole.zeta)
    noise = evidence.residual_noise(measured, whole)
    for onset in (None, 0, cut, 5):
        onsets = None if onset is None else np.full(len(x), onset)
        chi_sq = evidence.log_ratio(model, x, seen, scales, None, onsets).chi_sq
        for tick in range(cut, len(whole)):
            now = measured.residual[:, :, tick]
            is_first = tick in (0, onset)
            new = now * np.sqrt(1.0 - rho**2) if is_first else now - rho * measured.residual[:, :, tick - 1]
            np.testing.assert_allclose(chi_sq[:, tick - cut], new**2 / noise[:, :, tick], rtol=1e-9)


@each_model
def test_anisotropic_noise_counts_by_its_direction(model):
    """As in the depth of a camera: residuals of noisy poses have the estimated variance."""
    rng = np.random.default_rng(5)
    t = touching(model.contact, rng, 3)
    shape = rng.normal(size=(3, 3))
    covariance_m2 = 1e-6 * shape @ shape.T + 1e-10 * np.eye(3)
    sigma_rad, draws = 1e-4, 4000
    shaken_m = rng.multivariate_normal(np.zeros(3), covariance_m2, (draws, 3))
    turned = Rotation.from_rotvec(rng.normal(scale=sigma_rad, size=(3 * draws, 3))).as_matrix()
    noisy = lift(t.rotation @ turned.reshape(draws, 3, 3, 3), t.position_m + shaken_m)
    x = x_of(model.contact, t.object, t.environment)[None]
    mean_m2 = np.trace(covariance_m2) / 3.0
    seen = Window(
        np.arange(3),
        lift(t.rotation, t.position_m),
        np.tile([mean_m2, sigma_rad**2], (3, 1)),
        np.zeros((3, 2)),
        np.tile(covariance_m2 - mean_m2 * np.eye(3), (3, 1, 1)),
    )
    estimated = evidence.residual_noise(model.measure(x, seen.zeta), seen)[0]
    scattered = model.measure(x, noisy.reshape(-1, 25)).residual[0].reshape(-1, draws, 3).var(axis=1)
    np.testing.assert_allclose(scattered, estimated, rtol=0.15)


@each_model
def test_a_tick_at_rest_has_no_evidence(model):
    seen, x = window(np.random.default_rng(1), model)
    still = Window(seen.index, seen.zeta, seen.variance, np.zeros_like(seen.innovation_excess))
    np.testing.assert_array_equal(evidence.log_ratio(model, x, still, SCALES).log_ratio, 0.0)


@cache
class Fitted:
    """One hypothesis fitted to ticks in contact, and the information of its first tick."""

    def __init__(self, model):
        rng, ticks, sigma = np.random.default_rng(0), 80, 1e-3
        t = touching(model.contact, rng, ticks)
        position = t.position_m - t.position_m.mean(axis=0) + rng.normal(size=(ticks, 3)) * sigma
        lifted = model.lifted(lift(t.rotation, position)) / sigma
        self.model, self.family = model, model.family
        self.anchors = model.anchors(position.mean(axis=0))[None]
        self.prior = evidence.weak_prior(self.family, self.anchors, SCALES.reach_m)
        self.weight = np.ones((1, self.family.ROWS))
        self.moments = (lifted.T @ lifted)[None]
        starts = self.family.normalise(self.family.starts(self.moments)[0], self.anchors)
        every = np.zeros(len(starts), int)
        found = gauss_newton.minimise(
            self.family,
            self.moments[every],
            self.weight[every],
            self.prior.pick(every),
            self.anchors[every],
            starts,
            iterations=200,
            tolerance=1e-9,
        )
        best = int(np.argmin(found.cost))
        self.x, self.cost, self.hessian = found.x[[best]], found.cost[best], found.hessian[[best]]
        self.first = self.information(lifted[:1])

    def information(self, lifted):
        squares = (lifted.T @ lifted)[None]
        return gauss_newton.information(self.family, squares, self.weight, self.moments, self.anchors, self.x)

    @property
    def pull(self):
        return float(self.prior.cost(self.x)[0])

    def complexity(self, hessian, given, predicted_share=0.0):
        """The complexity for rows' information (1, K, P, P), of which a share was predicted."""
        unit = np.full((1, self.family.ROWS), predicted_share)
        fitted = self.family, self.x, self.x, self.anchors
        return evidence.complexity(*fitted, hessian, given, unit, self.prior)[0]


@each_model
def test_the_complexity_is_that_of_the_integral_over_geometry(model):
    """Laplace against importance sampling: the mean likelihood under the prior, not the greatest one."""
    one, rng = Fitted(model), np.random.default_rng(0)
    family, size = model.family, 20_000
    tangent = family.tangent(one.x, one.anchors)[0]
    before = tangent.T @ (one.prior.precision[0] + np.diag(one.prior.flat)) @ tangent
    after = one.hessian[0].sum(axis=0) + before
    wide = 1.3 * np.linalg.inv(np.linalg.cholesky(after)).T
    raw = rng.normal(size=(size, family.PARAMETERS))
    x = family.normalise(one.x + raw @ wide.T @ tangent.T, one.anchors)
    cost = every_cost(family, one.moments, one.weight, one.prior, x)[:, 0]
    log_weight = -cost + 0.5 * np.sum(raw**2, axis=1) + np.linalg.slogdet(wide)[1]
    integral = logsumexp(log_weight) - np.log(size) + 0.5 * np.linalg.slogdet(before)[1]
    greatest = -(one.cost - one.pull)
    complexity = one.complexity(one.hessian, np.zeros_like(one.first))
    assert complexity > 5.0
    assert integral == pytest.approx(greatest - complexity, abs=0.5)


@each_model
def test_the_information_of_the_first_tick_is_free(model):
    one = Fitted(model)
    nothing = np.zeros_like(one.first)
    row_by_row = np.concatenate([one.first[:, None], np.zeros_like(one.hessian[:, 1:])], axis=1)
    assert one.complexity(row_by_row, one.first) == pytest.approx(one.pull, abs=1e-9)
    assert one.pull <= one.complexity(one.hessian, one.first) < one.complexity(one.hessian, nothing)


@each_model
def test_predicted_information_reduces_the_complexity(model):
    """If all of it is predicted, the complexity is at most half the logarithm of two per direction."""
    one = Fitted(model)
    nothing = np.zeros_like(one.first)
    complexities = [
        one.complexity(one.hessian, nothing, predicted_share) for predicted_share in (0.0, 1e-3, 0.1, 1.0)
    ]
    assert (np.diff(complexities) < 0.0).all()
    assert complexities[-1] - one.pull <= model.family.PARAMETERS * 0.5 * np.log(2.0)
