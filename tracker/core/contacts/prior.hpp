// Priors on the geometry of hypotheses.
#pragma once

#include <cmath>

#include "bank/hypothesis.hpp"

namespace kernels {

inline bool is_nothing_known(const Kind& kind, const double* row) {
    return whole(row, kind.where.prior_index) == 0;
}
inline bool is_nothing_known(const Kind& kind, const PerLane<double>& rows) {
    return std::all_of(rows.begin(), rows.end(),
                       [&](const double* row) { return is_nothing_known(kind, row); });
}

// Reference: `gauss_newton.Prior` of hypotheses, and their `anchors`.
//
// If no element is known `precision` is diagonal, and only the diagonal is set.
template <class F, class N>
struct Prior {
    N precision[F::S * F::S], information[F::S], constant, anchors[6];
    bool is_diagonal = false;

    // `x @ precision`.
    void times(const N* x, N (&out)[F::S]) const {
        if (is_diagonal) {
            for (int s = 0; s < F::S; ++s) out[s] = x[s] * precision[s * F::S + s];
        } else {
            multiply<F::S, F::S>(x, precision, out);
        }
    }
};

inline double without_nan(double a, double otherwise) { return std::isnan(a) ? otherwise : a; }
inline Lanes without_nan(Lanes a, const Lanes& otherwise) {
    for (int i = 0; i < lanes; ++i) a.put(i, without_nan(a[i], otherwise[i]));
    return a;
}

// Reference: `refit.anchors_of`.
template <class H, class N>
void anchor(const Kind& kind, const H& some, N* out) {
    const int first = kind.body_in_1 ? 3 : 0;
    const N weight = read(some.since, kind.since.weight);
    for (int i = 0; i < 6; ++i) {
        const bool here = i >= first && i < first + 3;
        const N place =
            here ? read(some.since, kind.since.weighted_position_sum + i - first) / weight : N(0.0);
        out[i] = without_nan(read(some.own, kind.where.line_anchor + i), place);
    }
}

// Add the prior that touching points lie near the `anchors`. Reference: `evidence.weak_prior`.
template <class F, class N>
void add_weak_prior(const Kind& kind, Prior<F, N>& prior) {
    for (int s = 0; s < F::S; ++s) {
        const bool of_1 = F::q1 >= 0 && s >= F::q1 && s < F::q1 + 3, of_2 = F::q2 >= 0 && s >= F::q2;
        prior.precision[s * F::S + s] += kind.pull[s];
        if (!of_1 && !of_2) continue;  // the weak prior's mean is zero except for points
        const N mean = prior.anchors[of_1 ? s - F::q1 : 3 + s - F::q2], weak = kind.pull[s] * mean;
        prior.information[s] += weak;
        prior.constant += 0.5 * weak * mean;
    }
}

// Reference: `refit.prior_at_anchors`.
template <class F, class H, class N>
void read_prior(const Kind& kind, const H& some, Prior<F, N>& prior) {
    anchor(kind, some, prior.anchors);
    prior.is_diagonal = is_nothing_known(kind, some.own);
    prior.constant = 0.0;
    std::fill_n(prior.information, F::S, N(0.0));
    if (prior.is_diagonal) {
        for (int s = 0; s < F::S; ++s) prior.precision[s * F::S + s] = 0.0;
    } else {
        N mean[F::S];
        read(some.own, kind.where.prior_mean, F::S, mean);
        read_symmetric<F::S>(some.own, kind.where.prior_information, prior.precision);
        multiply<F::S, F::S>(mean, prior.precision, prior.information);
        prior.constant = 0.5 * dot<F::S>(prior.information, mean);
    }
    add_weak_prior<F>(kind, prior);
}

}  // namespace kernels
