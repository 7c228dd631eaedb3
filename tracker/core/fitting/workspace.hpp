// What fits of some windows look at and remember.
#pragma once

#include <utility>

#include "contacts/prior.hpp"

namespace kernels {

// What is read of hypotheses' windows: `moments` (C, C) and `row_weight` (K,).
template <class F>
struct Moments {
    Lanes moments[F::C * F::C], row_weight[F::K];

    Moments(const Kind& kind, const Rows& rows) {
        read_symmetric<F::C>(rows.since, kind.since.second_moment, moments);
        read(rows.own, kind.where.row_weight, F::K, row_weight);
    }
};

// Call with each number below COUNT, known to the compiler.
template <class Function, int... I>
void each_of(Function&& function, std::integer_sequence<int, I...>) {
    (function(std::integral_constant<int, I>{}), ...);
}

template <int COUNT, class Function>
void each_of(Function&& function) {
    each_of(function, std::make_integer_sequence<int, COUNT>{});
}

// With that of each row.
template <class F, class Function>
void each_row(Function&& function) {
    each_of<F::K>(function);
}

// What a fit is near some x: `weight` (K,) of the rows, `slopes` (P, K, C)
// along the `free` directions (P, S), the share of the last row that is taken
// out of its own, since its scale changes, too, `leans` (P,), the `gradient`
// (P,) and the `hessian` (K, U), and what is `held` (U,) by the prior; all that
// `at` (S,).
template <class F>
struct Near {
    Lanes weight[F::K], slopes[F::P][F::K][F::C], free[F::P][F::S], leans[F::P];
    Lanes gradient[F::P], hessian[F::K][F::U], held[F::U], at[F::S];

    // What was there `before`, of some.
    void keep(const Mask& some, const Near& before) {
        const auto restore = [&](Lanes* now, const Lanes* old, int count) {
            for (int i = 0; i < count; ++i) now[i] = where(some, old[i], now[i]);
        };
        restore(weight, before.weight, F::K);
        restore(slopes[0][0], before.slopes[0][0], F::P * F::K * F::C);
        restore(free[0], before.free[0], F::P * F::S);
        restore(leans, before.leans, F::P);
        restore(gradient, before.gradient, F::P);
        restore(hessian[0], before.hessian[0], F::K * F::U);
        restore(held, before.held, F::U);
        restore(at, before.at, F::S);
    }
};

// Memory of some windows: their `prior`, and what they are `near` their x.
//
// Where a trial of coordinates has come to: `rows` (K, C) and the same
// times the moments, `carried`, their `weight` (K,), free directions before
// shifting, `axes`, slopes of the last row along the shifts, `design` (L, C),
// which times the moments are `moved`, x times the prior's precision, `pull`,
// and the moments times vec(d2 b^T), but for b, `by_d2` (3, C).
template <class F>
struct Work {
    Prior<F, Lanes> prior;
    Near<F> near;
    Lanes rows[F::K][F::C], carried[F::K][F::C], weight[F::K], axes[F::P][F::S];
    Lanes design[F::L][F::C], moved[F::L][F::C], pull[F::S], turn[9];
    Lanes step[F::P], trial[F::S], by_d2[3][F::C];

    Work() {  // what no step writes
        std::fill_n(near.slopes[0][0], F::P * F::K * F::C, Lanes(0.0));
        std::fill_n(near.leans, F::P, Lanes(0.0));
        std::fill_n(design[0], F::L * F::C, Lanes(0.0));
    }
};

}  // namespace kernels
