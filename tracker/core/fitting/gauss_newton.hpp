// Reference: `gauss_newton.minimise` and `gauss_newton.complete`, a window per lane.
#pragma once

#include "fitting/moments.hpp"

namespace kernels {

// Reference: `gauss_newton.complete`, x in place; returns the costs.
template <class F>
WIDE Lanes complete(const Moments<F>& window, Lanes* x, Work<F>& work) {
    const Prior<F, Lanes>& prior = work.prior;
    unshift<F>(x);
    normalise<F>(x, prior.anchors);
    rows<F>(x, work.rows);
    free<F>(x, prior.anchors, work.axes);
    const Lanes scale = scale_sq<F>(work.rows[F::last], window.moments, work.turn);
    each_row<F>(
        [&](auto k) { work.weight[k] = k == F::last ? window.row_weight[k] / scale : window.row_weight[k]; });
    carry_rows<F>(x, window, work);
    const Lanes weight = work.weight[F::last];
    prior.times(x, work.pull);
    for (int s = 0; s < F::S; ++s) work.pull[s] -= prior.information[s];
    Lanes normal[F::L][F::L], shift[F::L], pulled[F::S], trace = 0.0;
    each_of<F::L>([&](auto i) {
        const int p = F::shifts[i];
        const Lanes* along = work.axes[p];
        slope_of_last<F>(x, along, work.design[i]);
        carry_shift<F, i>(along, window, work, work.moved[i]);
        prior.times(along, pulled);
        shift[i] = -weight * pair_shift<F, i>(work.design[i], work.row_moments[F::last]) -
                   dot<F::S>(along, work.pull);
        each_of<i + 1>([&](auto j) {
            const int q = F::shifts[j];
            normal[j][i] =
                weight * pair_shift<F, j>(work.design[j], work.moved[i]) + dot<F::S>(work.axes[q], pulled);
        });
        trace += normal[i][i];
    });
    for (int i = 0; i < F::L; ++i) {
        normal[i][i] += settings.damping.least_share * trace + settings.damping.least_curvature;
    }
    eliminate(normal, shift);
    each_of<F::L>([&](auto i) {
        constexpr Columns own = F::shifted_by(i);
        const Lanes* along = work.axes[F::shifts[i]];
        for (int s = 0; s < F::S; ++s) x[s] += shift[i] * along[s];
        for (int c = own.first; c < own.end; ++c) work.rows[F::last][c] += shift[i] * work.design[i][c];
        for (int c = 0; c < F::active_in(F::last); ++c)
            work.row_moments[F::last][c] += shift[i] * work.moved[i][c];
    });
    Lanes squares = 0.0;
    each_row<F>([&](auto k) { squares += work.weight[k] * pair<F, k>(work.rows[k], work.row_moments[k]); });
    prior.times(x, work.pull);
    return 0.5 * (squares + dot<F::S>(x, work.pull)) - dot<F::S>(x, prior.information) + prior.constant;
}

// The part of `equations` of the prior and of the shifts.
template <class F>
void equations_of_shifts(Work<F>& work) {
    Near<F>& near = work.near;
    const Lanes weight = near.weight[F::last];
    Lanes pulled[F::S];
    for (int p = 0; p < F::P; ++p) {
        work.prior.times(near.free[p], pulled);
        near.gradient[p] = dot<F::S>(near.free[p], work.pull);
        for (int q = 0; q <= p; ++q) {
            near.prior_hessian[F::upper(q, p)] = dot<F::S>(near.free[q], pulled);
        }
    }
    each_of<F::L>([&](auto i) {
        const int p = F::shifts[i];
        std::copy_n(work.design[i], F::C, near.slopes[p][F::last]);
        near.gradient[p] += weight * pair_shift<F, i>(work.design[i], work.row_moments[F::last]);
        each_of<i + 1>([&](auto j) {
            near.hessian[F::last][F::upper(F::shifts[j], p)] =
                weight * pair_shift<F, j>(work.design[j], work.moved[i]);
        });
    });
}

// Reference: `gauss_newton._normal_equations`, at the x that `complete` has just returned.
template <class F>
WIDE void equations(const Moments<F>& window, const Lanes* x, Work<F>& work) {
    Near<F>& near = work.near;
    free<F>(x, work.prior.anchors, near.free);
    std::copy_n(x, F::S, near.at);
    std::fill_n(near.hessian[0], F::last * F::U, Lanes(0.0));
    std::copy_n(work.weight, F::K, near.weight);
    for (int s = 0; s < F::S; ++s) work.pull[s] -= work.prior.information[s];
    equations_of_shifts<F>(work);
    for (int i = 0; i < F::T; ++i) {
        const int p = F::turns[i];
        Lanes pushed[F::C];
        auto& slopes = near.slopes[p];
        slope<F>(x, near.free[p], slopes);
        if constexpr (F::crosses) {  // per metre: the scale depends on x
            near.scale_slopes[p] = 0.5 * dot<9>(work.turn, slopes[F::last] + 9);
            for (int c = 0; c < F::C; ++c) slopes[F::last][c] -= near.scale_slopes[p] * work.rows[F::last][c];
        }
        each_row<F>([&](auto k) {
            carry<F, k>(slopes[k], window, pushed);
            near.gradient[p] += near.weight[k] * pair<F, k>(slopes[k], work.row_moments[k]);
            for (int j = 0; j <= i; ++j) {
                const int q = F::turns[j];
                near.hessian[k][F::upper(q, p)] = near.weight[k] * pair<F, k>(near.slopes[q][k], pushed);
            }
        });
        each_of<F::L>([&](auto j) {
            const Lanes both = near.weight[F::last] * pair_shift<F, j>(work.design[j], pushed);
            near.hessian[F::last][F::upper(p, F::shifts[j])] = both;
        });
    }
}

// Reference: `gauss_newton._step`; returns the predicted decrease of the costs.
template <class F>
WIDE Lanes take_step(const Lanes& damping, Work<F>& work) {
    const Near<F>& near = work.near;
    Lanes curvature[F::P][F::P];
    for (int p = 0; p < F::P; ++p) {
        work.step[p] = -near.gradient[p];
        for (int q = p; q < F::P; ++q) {
            curvature[p][q] = near.prior_hessian[F::upper(p, q)];
            for (int k = 0; k < F::K; ++k) curvature[p][q] += near.hessian[k][F::upper(p, q)];
        }
        curvature[p][p] += settings.damping.least_share * curvature[p][p] + settings.damping.least_curvature;
    }
    for (int p : F::turns) curvature[p][p] += damping;
    eliminate(curvature, work.step);
    return abs(dot<F::P>(near.gradient, work.step));
}

// State of the fits; `left` are those that had not converged before the last step.
struct Descent {
    Lanes cost, damping;
    Mask left;
};

// Move x to the trial, except in the lanes where it is `worse`.
template <class F>
WIDE void accept(const Moments<F>& window, const Mask& worse, Lanes* x, Work<F>& work) {
    if (!any(worse)) {
        std::copy_n(work.trial, F::S, x);
        return equations<F>(window, x, work);
    }
    const Near<F> before = work.near;
    equations<F>(window, work.trial, work);
    work.near.keep(worse, before);
    for (int s = 0; s < F::S; ++s) x[s] = where(worse, x[s], work.trial[s]);
}

// Reference: `gauss_newton.minimise` from x (S,), in place. Converged lanes keep their x until all have
// converged: no digit of a hypothesis depends on the others in its lanes.
template <class F>
Descent descend(const Moments<F>& window, Lanes* x, int steps, Work<F>& work) {
    const Damping& fits = settings.damping;
    std::copy_n(x, F::S, work.trial);
    Descent now{complete<F>(window, work.trial, work), fits.first, true};
    accept<F>(window, false, x, work);
    for (int left = steps; left > 0; --left) {
        now.left = now.left & !(take_step<F>(now.damping, work) < settings.tolerance);
        if (!any(now.left)) break;
        multiply<F::P, F::S>(work.step, work.near.free[0], work.trial);
        for (int s = 0; s < F::S; ++s) work.trial[s] = x[s] + where(now.left, work.trial[s], Lanes(0.0));
        const Lanes proposed = complete<F>(window, work.trial, work);
        const Mask better = now.left & (proposed < now.cost);
        if (left == 1) {
            for (int s = 0; s < F::S; ++s) x[s] = where(better, work.trial[s], x[s]);
        } else if (any(better)) {
            accept<F>(window, !better, x, work);
        }
        now.cost = where(better, proposed, now.cost);
        const Lanes changed = now.damping * where(better, Lanes(fits.decrease), Lanes(fits.increase));
        const Lanes within = smaller<Lanes>(larger<Lanes>(changed, fits.least), fits.most);
        now.damping = where(now.left, within, now.damping);
    }
    return now;
}

// Whether another step would lower the costs by less than the tolerance.
template <class F>
Mask converged(const Descent& descent, Work<F>& work) {
    return !descent.left | (take_step<F>(descent.damping, work) < settings.tolerance);
}

}  // namespace kernels
