// What geometry costs that was fitted: the volume in `evidence.complexity`.
#pragma once

#include "fitting/gauss_newton.hpp"

namespace kernels {

// Half the logarithm of how many times the windows have narrowed the geometry
// down.
//
// `foretold` (K,) and the hessian as in `evidence.complexity`, where `given` is
// `gauss_newton.information` of the `first` lifted tick (C,). `work` is near x.
template <class F>
WIDE Lanes volume(const Lanes* first, const Lanes* foretold, Work<F>& work) {
    const Near<F>& near = work.near;
    Lanes before[F::P][F::P], after[F::P][F::P], told[F::P];
    for (int p = 0; p < F::P; ++p) {
        for (int q = p; q < F::P; ++q) {
            const int entry = F::upper(p, q);
            Lanes held = near.held[entry] + (p == q && F::flat_in(p) ? 1.0 : 0.0), gained = 0.0;
            for (int k = 0; k < F::K; ++k) {
                held += foretold[k] * near.hessian[k][entry];
                gained += near.hessian[k][entry];
            }
            before[p][q] = held;
            after[p][q] = held + gained;
        }
    }
    rows<F>(near.at, work.rows);
    each_row<F>([&](auto k) {
        const Lanes off = k == F::last ? pair<F, k>(work.rows[k], first) : Lanes(0.0);
        for (int p = 0; p < F::P; ++p) {
            told[p] = pair<F, k>(near.slopes[p][k], first) + near.leans[p] * off;
            for (int q = 0; q <= p; ++q) before[q][p] += near.weight[k] * told[p] * told[q];
        }
    });
    std::fill_n(told, F::P, Lanes(0.0));
    eliminate(after, told);
    eliminate(before, told);
    Lanes ratio = 1.0;
    for (int p = 0; p < F::P; ++p) ratio *= abs(after[p][p] / before[p][p]);
    return 0.5 * log(ratio);
}

}  // namespace kernels
