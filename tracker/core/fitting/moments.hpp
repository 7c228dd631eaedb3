// Rows times moments.
//
// Where element 2 is a plane, all rows and their derivatives by shifts of points begin with vec(d2 b^T):
// d2 is multiplied once.
#pragma once

#include "fitting/workspace.hpp"

namespace kernels {

// The k-th row or its derivative times the moments, and the product of that with another row.
template <class F, int K>
void carry(const Lanes* row, const Moments<F>& window, Lanes* out) {
    multiply<F::active_in(K), F::active_in(K), F::C>(row, window.moments, out);
}

template <class F, int K>
Lanes pair(const Lanes* row, const Lanes* row_moments) {
    return dot<F::active_in(K)>(row, row_moments);
}

// Product of the last row's derivative by the I-th shift with another row: some columns are zero.
template <class F, int I>
Lanes pair_shift(const Lanes* row, const Lanes* row_moments) {
    constexpr Columns own = F::shifted_by(I);
    return dot<own.end - own.first>(row + own.first, row_moments + own.first);
}

// Sum, weighted by v, of three rows of a matrix that are `STRIDE` apart.
template <int COLUMNS, int STRIDE>
void weighted(const Vec<Lanes>& v, const Lanes* rows, Lanes* out) {
    for (int c = 0; c < COLUMNS; ++c)
        out[c] = v.x * rows[c] + v.y * rows[STRIDE + c] + v.z * rows[2 * STRIDE + c];
}

// The b of each row except the last.
template <class F>
std::array<Vec<Lanes>, 2> seconds(const Lanes* x) {
    if constexpr (F::last == 0) return {};
    if constexpr (F::last == 1) return {at(x, F::d1), {}};
    const auto [b1, b2] = across(at(x, F::d1));
    return {b1, b2};
}

// All rows times the moments, at an x that is not shifted yet: only lines have coordinates, those of
// their anchors.
template <class F>
void carry_rows(const Lanes* x, const Moments<F>& window, Work<F>& work) {
    if constexpr (F::crosses) {
        carry<F, F::last>(work.rows[F::last], window, work.row_moments[F::last]);
    } else {
        Lanes* last = work.row_moments[F::last];
        const Vec<Lanes> d2 = at(x, F::d2);
        for (int i = 0; i < 3; ++i) weighted<F::C, 3 * F::C>(d2, window.moments + i * F::C, work.by_d2[i]);
        weighted<F::C, F::C>(d2, window.moments + 9 * F::C, last);
        if constexpr (F::last == 1) {
            Lanes of_line[F::C];
            weighted<F::C, F::C>(at(x, F::q1), work.by_d2[0], of_line);
            for (int c = 0; c < F::C; ++c) last[c] += of_line[c];
        }
        const auto b = seconds<F>(x);
        for (int k = 0; k < F::last; ++k) weighted<9, F::C>(b[k], work.by_d2[0], work.row_moments[k]);
    }
}

// Derivative of the last row by the I-th shift, in the direction `along`, times the moments.
template <class F, int I>
void carry_shift(const Lanes* along, const Moments<F>& window, const Work<F>& work, Lanes* out) {
    constexpr Columns own = F::shifted_by(I);
    if constexpr (F::crosses) {
        multiply<own.end - own.first, F::active_in(F::last), F::C>(work.design[I] + own.first,
                                                                   window.moments + own.first * F::C, out);
    } else if constexpr (own.first > 0) {
        for (int c = 0; c < F::C; ++c) out[c] = -window.moments[own.first * F::C + c];
    } else {
        weighted<F::C, F::C>(at(along, F::q1), work.by_d2[0], out);
    }
}

}  // namespace kernels
