// Inputs and working memory of the fits, a window per lane.
#pragma once

#include <utility>

#include "contacts/prior.hpp"

namespace kernels {

// Data of a fit: `moments` (C, C) of the window and `row_weight` (K,).
template <class F>
struct Moments {
    Lanes moments[F::C * F::C], row_weight[F::K];

    Moments(const Kind& kind, const Rows& rows) {
        read_symmetric<F::C>(rows.since, kind.since.second_moment, moments);
        read(rows.own, kind.where.row_weight, F::K, row_weight);
    }
};

// Call with each number below COUNT, as a compile-time constant.
template <class Function, int... I>
void each_of(Function&& function, std::integer_sequence<int, I...>) {
    (function(std::integral_constant<int, I>{}), ...);
}

template <int COUNT, class Function>
void each_of(Function&& function) {
    each_of(function, std::make_integer_sequence<int, COUNT>{});
}

// Call with the index of each row, as a compile-time constant.
template <class F, class Function>
void each_row(Function&& function) {
    each_of<F::K>(function);
}

// Linearisation of the fit at the geometry `at` (S,): `weight` (K,) of the rows, their derivatives `slopes`
// (P, K, C) along the `free` directions (P, S), `gradient` (P,), `hessian` (K, U) of each row, and
// `prior_hessian` (U,). As the last row's scale depends on x, its slopes are reduced by `scale_slopes` (P,)
// times the row.
template <class F>
struct Near {
    Lanes weight[F::K], slopes[F::P][F::K][F::C], free[F::P][F::S], scale_slopes[F::P];
    Lanes gradient[F::P], hessian[F::K][F::U], prior_hessian[F::U], at[F::S];

    // Restore `before` in some lanes.
    void keep(const Mask& some, const Near& before) {
        const auto restore = [&](Lanes* now, const Lanes* old, int count) {
            for (int i = 0; i < count; ++i) now[i] = where(some, old[i], now[i]);
        };
        restore(weight, before.weight, F::K);
        restore(slopes[0][0], before.slopes[0][0], F::P * F::K * F::C);
        restore(free[0], before.free[0], F::P * F::S);
        restore(scale_slopes, before.scale_slopes, F::P);
        restore(gradient, before.gradient, F::P);
        restore(hessian[0], before.hessian[0], F::K * F::U);
        restore(prior_hessian, before.prior_hessian, F::U);
        restore(at, before.at, F::S);
    }
};

// Working memory: the `prior`, the linearisation `near` x, and the state of a trial.
//
// Of a trial: `rows` (K, C), `row_moments` (rows times the moments), their `weight` (K,), `axes` (P, S) (free
// directions before shifting), `design` (L, C) (derivatives of the last row by the shifts), `moved` (design
// times the moments), `pull` (S,) (x times the prior's precision), and `by_d2` (3, C) (the moments times
// vec(d2 b^T) without b).
template <class F>
struct Work {
    Prior<F, Lanes> prior;
    Near<F> near;
    Lanes rows[F::K][F::C], row_moments[F::K][F::C], weight[F::K], axes[F::P][F::S];
    Lanes design[F::L][F::C], moved[F::L][F::C], pull[F::S], turn[9];
    Lanes step[F::P], trial[F::S], by_d2[3][F::C];

    Work() {  // entries that no step writes
        std::fill_n(near.slopes[0][0], F::P * F::K * F::C, Lanes(0.0));
        std::fill_n(near.scale_slopes, F::P, Lanes(0.0));
        std::fill_n(design[0], F::L * F::C, Lanes(0.0));
    }
};

}  // namespace kernels
