// Hypotheses as kernels see them: a row of the table each, and what one knew before its window.
#pragma once

#include <cmath>
#include <cstdint>
#include <cstring>
#include <vector>

#include "families.hpp"

namespace kernels {

// At which word of a row the columns of `table.Bank` begin.
struct Where {
    int onset, onset_ns, number, source, certain, searched, met, entry, lasted, settled, earned, weight, told,
        log_likelihood, rms, known_mean, known, pivot, first, moments, place_sum, x, hessian, row_weight;
};

// What sort of contact it is, see `contacts`: where its body is, how many poses are `needed` and the
// `patience` that follows; which entries of a pose are `lifted` (C,); `pull` (S,) of the weak prior; how many
// starts are `relaxed`.
struct Kind {
    bool body_in_1;
    double needed, patience;
    std::vector<std::int64_t> lifted;
    std::vector<double> pull;
    int relaxed;
    Where where;
};

// So many rows of `words` of eight bytes, numbers or whole numbers.
struct Table {
    double* data;
    int count, words;

    double* row(int b) const { return data + static_cast<std::size_t>(b) * words; }
};

inline std::int64_t whole(const double* row, int word) {
    std::int64_t value;
    std::memcpy(&value, row + word, sizeof value);
    return value;
}

inline void put_whole(double* row, int word, std::int64_t value) {
    std::memcpy(row + word, &value, sizeof value);
}

// As `Bank.joint`.
inline double joint(const Where& where, const double* row) {
    return row[where.entry] + row[where.log_likelihood];
}

// As `fit.Prior` of one hypothesis, and its `anchors`; `mean` is that of the weak prior, zero but for points.
// The `precision` has a block of each element where these are `apart`; where nothing is known of them, it is
// diagonal.
template <class F>
struct Prior {
    double precision[F::S * F::S], information[F::S], constant, anchors[6];
    double mean[F::S] = {};
    bool is_diagonal = false;

    // `x @ precision`.
    void times(const double* x, double (&out)[F::S]) const {
        if (is_diagonal) {
            for (int s = 0; s < F::S; ++s) out[s] = x[s] * precision[s * F::S + s];
        } else if constexpr (!F::apart) {
            multiply<F::S, F::S>(x, precision, out);
        } else {
            constexpr int rest = F::S - F::d2;
            multiply<F::d2, F::d2, F::S>(x, precision, out);
            multiply<rest, rest, F::S>(x + F::d2, precision + F::d2 * (F::S + 1), out + F::d2);
        }
    }

    // `a @ precision @ b` of directions a and b = `pulled` in which the p-th and the q-th parameter are free.
    double held(int p, int q, const double* a, const double* pulled) const {
        if constexpr (!F::apart) return dot<F::S>(a, pulled);
        if ((p < F::of_1) != (q < F::of_1)) return 0.0;
        return p < F::of_1 ? dot<F::d2>(a, pulled) : dot<F::S - F::d2>(a + F::d2, pulled + F::d2);
    }
};

// As `bank.anchors_of`.
inline void anchor(const Kind& kind, const double* row, double* out) {
    std::fill_n(out, 6, 0.0);
    const double *place = row + kind.where.place_sum, *pivot = row + kind.where.pivot;
    for (int i = 0; i < 3; ++i) out[(kind.body_in_1 ? 3 : 0) + i] = place[i] / row[kind.where.weight];
    for (int i = 0; i < 6; ++i) {
        if (!std::isnan(pivot[i])) out[i] = pivot[i];
    }
}

// As `following.before`.
template <class F>
void know(const Kind& kind, const double* row, Prior<F>& prior) {
    const double *known = row + kind.where.known, *known_mean = row + kind.where.known_mean;
    anchor(kind, row, prior.anchors);
    if constexpr (F::q1 >= 0) put(prior.mean, F::q1, at(prior.anchors, 0));
    if constexpr (F::q2 >= 0) put(prior.mean, F::q2, at(prior.anchors, 3));
    multiply<F::S, F::S>(known_mean, known, prior.information);
    prior.constant = 0.5 * dot<F::S>(prior.information, known_mean);
    std::copy_n(known, F::S * F::S, prior.precision);
    prior.is_diagonal = whole(row, kind.where.source) == 0;
    for (int s = 0; s < F::S; ++s) {
        const double weak = kind.pull[s] * prior.mean[s];
        prior.precision[s * F::S + s] += kind.pull[s];
        prior.information[s] += weak;
        prior.constant += 0.5 * weak * prior.mean[s];
    }
}

}  // namespace kernels
