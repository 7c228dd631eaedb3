// The algorithm of `fit.minimise` and `fit.complete`: one window after the other.
#pragma once

#include <limits>
#include <utility>

#include "table.hpp"

namespace kernels {

// What is read of a hypothesis' window: `moments` (C, C) and `row_weight` (K,).
struct Moments {
    const double *moments, *row_weight;
};

inline Moments moments_of(const Kind& kind, const double* row) {
    return {row + kind.where.moments, row + kind.where.row_weight};
}

// Call with each row's number, known to the compiler.
template <class F, class Function, int... K>
void each_row(Function&& function, std::integer_sequence<int, K...>) {
    (function(std::integral_constant<int, K>{}), ...);
}

template <class F, class Function>
void each_row(Function&& function) {
    each_row<F>(function, std::make_integer_sequence<int, F::K>{});
}

// The k-th row, or how it changes, times the moments; and with another one.
template <class F, int K>
void carry(const double* row, const Moments& window, double* out) {
    multiply<F::active_in(K), F::active_in(K), F::C>(row, window.moments, out);
}

template <class F, int K>
double pair(const double* row, const double* carried) {
    return dot<F::active_in(K)>(row, carried);
}

// Memory of one window: its `prior`; and at its x the `weight` (K,) of the rows, `slopes` (P, K, C) along the
// `free` directions (P, S), the share of the last row that is taken out of its own, since its scale changes,
// too, `leans` (P,), and what is `held` (P, P) by the prior.
//
// Where a trial of coordinates has come to: `rows` (K, C) and the same times the moments, `carried`, their
// `trial_weight` (K,), free directions before shifting, `axes`, slopes of the last row along the shifts,
// `design` (L, C), which times the moments are `moved`, and x times the prior's precision, `pull`.
template <class F>
struct Work {
    Prior<F> prior;
    double weight[F::K], slopes[F::P][F::K][F::C] = {}, free[F::P][F::S], leans[F::P] = {}, held[F::P][F::P];
    double rows[F::K][F::C], carried[F::K][F::C], trial_weight[F::K], axes[F::P][F::S];
    double design[F::L][F::C] = {}, moved[F::L][F::C], pull[F::S], turn[9];
    double gradient[F::P], step[F::P], trial[F::S];
};

// As `fit.complete` of one window, x in place; returns the cost.
template <class F>
double complete(const Moments& window, double* x, Work<F>& work) {
    const Prior<F>& prior = work.prior;
    unshift<F>(x);
    normalise<F>(x, prior.anchors);
    rows<F>(x, work.rows);
    free<F>(x, prior.anchors, work.axes);
    const double scale = scale_sq<F>(work.rows[F::last], window.moments, work.turn);
    each_row<F>([&](auto k) {
        carry<F, k>(work.rows[k], window, work.carried[k]);
        work.trial_weight[k] = window.row_weight[k] / (k == F::last ? scale : 1.0);
    });
    const double weight = work.trial_weight[F::last];
    prior.times(x, work.pull);
    for (int s = 0; s < F::S; ++s) work.pull[s] -= prior.information[s];
    double normal[F::L][F::L], shift[F::L], pulled[F::S], trace = 0.0;
    for (int i = 0; i < F::L; ++i) {
        const double* along = work.axes[F::shifts[i]];
        slope_of_last<F>(x, along, work.design[i]);
        carry<F, F::last>(work.design[i], window, work.moved[i]);
        prior.times(along, pulled);
        shift[i] =
            -weight * pair<F, F::last>(work.design[i], work.carried[F::last]) - dot<F::S>(along, work.pull);
        for (int j = 0; j <= i; ++j) {
            const int p = F::shifts[i], q = F::shifts[j];
            normal[j][i] = weight * pair<F, F::last>(work.design[j], work.moved[i]) +
                           prior.held(p, q, work.axes[q], pulled);
        }
        trace += normal[i][i];
    }
    for (int i = 0; i < F::L; ++i) {
        normal[i][i] += settings.fits.least_share * trace + settings.fits.least_curvature;
    }
    eliminate(normal, shift);
    for (int i = 0; i < F::L; ++i) {
        const double* along = work.axes[F::shifts[i]];
        for (int s = 0; s < F::S; ++s) x[s] += shift[i] * along[s];
        for (int c = 0; c < F::active_in(F::last); ++c) {
            work.rows[F::last][c] += shift[i] * work.design[i][c];
            work.carried[F::last][c] += shift[i] * work.moved[i][c];
        }
    }
    double squares = 0.0;
    each_row<F>([&](auto k) { squares += work.trial_weight[k] * pair<F, k>(work.rows[k], work.carried[k]); });
    prior.times(x, work.pull);
    return 0.5 * (squares + dot<F::S>(x, work.pull)) - dot<F::S>(x, prior.information) + prior.constant;
}

// A hessian (K, P, P) is symmetric.
template <class F>
double& entry(double* hessian, int k, int p, int q) {
    return hessian[(k * F::P + p) * F::P + q];
}

template <class F>
void put_both(double* hessian, int k, int p, int q, double value) {
    entry<F>(hessian, k, p, q) = entry<F>(hessian, k, q, p) = value;
}

// Of `equations`, what the prior holds, and the shifts.
template <class F>
void equations_of_shifts(double* hessian, Work<F>& work) {
    const double weight = work.weight[F::last];
    double pulled[F::S];
    for (int p = 0; p < F::P; ++p) {
        work.prior.times(work.free[p], pulled);
        work.gradient[p] = dot<F::S>(work.free[p], work.pull);
        for (int q = 0; q <= p; ++q) {
            work.held[p][q] = work.held[q][p] = work.prior.held(p, q, work.free[q], pulled);
        }
    }
    for (int i = 0; i < F::L; ++i) {
        const int p = F::shifts[i];
        std::copy_n(work.design[i], F::C, work.slopes[p][F::last]);
        work.gradient[p] += weight * pair<F, F::last>(work.design[i], work.carried[F::last]);
        for (int j = 0; j <= i; ++j) {
            put_both<F>(hessian, F::last, p, F::shifts[j],
                        weight * pair<F, F::last>(work.design[j], work.moved[i]));
        }
    }
}

// As `fit._normal_equations` of one window, at the x where `complete` has just come to: free directions,
// gradient, hessian (K, P, P) and held.
template <class F>
void equations(const Moments& window, const double* x, double* hessian, Work<F>& work) {
    free<F>(x, work.prior.anchors, work.free);
    std::fill_n(hessian, F::last * F::P * F::P, 0.0);
    std::copy_n(work.trial_weight, F::K, work.weight);
    for (int s = 0; s < F::S; ++s) work.pull[s] -= work.prior.information[s];
    equations_of_shifts<F>(hessian, work);
    for (int i = 0; i < F::T; ++i) {
        const int p = F::turns[i];
        double pushed[F::C];
        auto& slopes = work.slopes[p];
        slope<F>(x, work.free[p], slopes);
        if constexpr (F::crosses) {  // per metre: the scale changes with x as well
            work.leans[p] = 0.5 * dot<9>(work.turn, slopes[F::last] + 9);
            for (int c = 0; c < F::C; ++c) slopes[F::last][c] -= work.leans[p] * work.rows[F::last][c];
        }
        each_row<F>([&](auto k) {
            carry<F, k>(slopes[k], window, pushed);
            work.gradient[p] += work.weight[k] * pair<F, k>(slopes[k], work.carried[k]);
            for (int j = 0; j <= i; ++j) {
                const int q = F::turns[j];
                put_both<F>(hessian, k, p, q, work.weight[k] * pair<F, k>(work.slopes[q][k], pushed));
            }
        });
        for (int j = 0; j < F::L; ++j) {
            const double both = work.weight[F::last] * pair<F, F::last>(work.design[j], pushed);
            put_both<F>(hessian, F::last, p, F::shifts[j], both);
        }
    }
}

// As `fit._step`; returns by how much it would lower the cost.
template <class F>
double take_step(double* hessian, double damping, Work<F>& work) {
    double curvature[F::P][F::P];
    for (int p = 0; p < F::P; ++p) {
        work.step[p] = -work.gradient[p];
        for (int q = p; q < F::P; ++q) {
            curvature[p][q] = work.held[p][q];
            for (int k = 0; k < F::K; ++k) curvature[p][q] += entry<F>(hessian, k, p, q);
        }
        curvature[p][p] += settings.fits.least_curvature;
    }
    for (int p : F::turns) curvature[p][p] += damping;
    eliminate(curvature, work.step);
    return std::abs(dot<F::P>(work.gradient, work.step));
}

// `is_left` a step: it was not `converged` before the last one.
struct Descent {
    double cost, damping;
    bool is_left;
};

// As `fit.minimise` of one window, from x (S,), in place; what `work` holds at an x is at that one.
template <class F>
Descent descend(const Moments& window, double* x, int steps, double* hessian, Work<F>& work) {
    const Damping& fits = settings.fits;
    double damping = fits.first, cost = std::numeric_limits<double>::infinity();
    std::copy_n(x, F::S, work.trial);
    for (int left = steps;; --left) {
        const double proposed = complete<F>(window, work.trial, work);
        const bool better = proposed < cost;
        if (better || left == steps) {
            std::copy_n(work.trial, F::S, x);
            cost = proposed;
            equations<F>(window, x, hessian, work);
        }
        if (left < steps) {
            damping = std::min(std::max(damping * (better ? fits.less : fits.more), fits.least), fits.most);
        }
        if (left <= 0) return {cost, damping, true};
        if (take_step<F>(hessian, damping, work) < settings.tolerance) return {cost, damping, false};
        multiply<F::P, F::S>(work.step, work.free[0], work.trial);
        for (int s = 0; s < F::S; ++s) work.trial[s] += x[s];
    }
}

// Whether another step would lower the cost by next to nothing.
template <class F>
bool converged(const Descent& descent, double* hessian, Work<F>& work) {
    return !descent.is_left || take_step<F>(hessian, descent.damping, work) < settings.tolerance;
}

}  // namespace kernels
