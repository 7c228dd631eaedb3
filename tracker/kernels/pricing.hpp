// What geometry costs that was fitted: the volume in `evidence.complexity`.
#pragma once

#include "fitting.hpp"

namespace kernels {

// Half the logarithm of how many times the window has narrowed the geometry down.
//
// `foretold` (K,) and `hessian` (K, P, P) as in `evidence.complexity`, where `given` is `fit.information` of
// the `first` lifted tick (C,). `work` is at x (S,).
template <class F>
double volume(const double* x, const double* first, const double* foretold, double* hessian, Work<F>& work) {
    double before[F::P][F::P], after[F::P][F::P], told[F::P] = {};
    for (int p = 0; p < F::P; ++p) {
        for (int q = p; q < F::P; ++q) {
            double held = work.held[p][q] + (p == q && F::flat_in(p) ? 1.0 : 0.0), gained = 0.0;
            for (int k = 0; k < F::K; ++k) {
                held += foretold[k] * entry<F>(hessian, k, p, q);
                gained += entry<F>(hessian, k, p, q);
            }
            before[p][q] = held;
            after[p][q] = held + gained;
        }
    }
    rows<F>(x, work.rows);
    for (int k = 0; k < F::K; ++k) {
        const double off = k == F::last ? dot<F::C>(work.rows[k], first) : 0.0;
        for (int p = 0; p < F::P; ++p) {
            told[p] = dot<F::C>(work.slopes[p][k], first) + work.leans[p] * off;
            for (int q = 0; q <= p; ++q) before[q][p] += work.weight[k] * told[p] * told[q];
        }
    }
    std::fill_n(told, F::P, 0.0);
    eliminate(after, told);
    eliminate(before, told);
    double ratio = 1.0;
    for (int p = 0; p < F::P; ++p) ratio *= std::abs(after[p][p] / before[p][p]);
    return 0.5 * std::log(ratio);
}

}  // namespace kernels
