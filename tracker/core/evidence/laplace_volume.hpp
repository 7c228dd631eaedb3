// The volume ratio in `evidence.complexity`.
#pragma once

#include "fitting/gauss_newton.hpp"

namespace kernels {

// Half the logarithm of the volume ratio of prior and posterior.
//
// `predicted_share` (K,) and the hessian are as in `evidence.complexity`; `first` (C,) is the first lifted
// tick, whose `gauss_newton.information` is its `given`. `work.near` is at the geometry x.
template <class F>
WIDE Lanes volume(const Lanes* first, const Lanes* predicted_share, Work<F>& work) {
    const Near<F>& near = work.near;
    Lanes before[F::P][F::P], after[F::P][F::P], slope[F::P];
    for (int p = 0; p < F::P; ++p) {
        for (int q = p; q < F::P; ++q) {
            const int entry = F::upper(p, q);
            Lanes prior_part = near.prior_hessian[entry] + (p == q && F::flat_in(p) ? 1.0 : 0.0),
                  gained = 0.0;
            for (int k = 0; k < F::K; ++k) {
                prior_part += predicted_share[k] * near.hessian[k][entry];
                gained += near.hessian[k][entry];
            }
            before[p][q] = prior_part;
            after[p][q] = prior_part + gained;
        }
    }
    rows<F>(near.at, work.rows);
    each_row<F>([&](auto k) {
        const Lanes off = k == F::last ? pair<F, k>(work.rows[k], first) : Lanes(0.0);
        for (int p = 0; p < F::P; ++p) {
            slope[p] = pair<F, k>(near.slopes[p][k], first) + near.scale_slopes[p] * off;
            for (int q = 0; q <= p; ++q) before[q][p] += near.weight[k] * slope[p] * slope[q];
        }
    });
    std::fill_n(slope, F::P, Lanes(0.0));
    eliminate(after, slope);
    eliminate(before, slope);
    Lanes ratio = 1.0;
    for (int p = 0; p < F::P; ++p) ratio *= abs(after[p][p] / before[p][p]);
    return 0.5 * log(ratio);
}

}  // namespace kernels
