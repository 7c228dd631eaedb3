// Costs of several geometries in many windows.
#pragma once

#include <limits>

#include "fitting/gauss_newton.hpp"

namespace kernels {

// Number of windows and of geometries processed at once: their sums stay in registers.
constexpr int window_batch = 8, geometry_batch = 4;

// `window_batch` windows, a column each: the upper triangle of the `moments`, and `total`, the moment of the
// lift's constant entry.
template <class F>
struct Windows {
    double moments[F::C * (F::C + 1) / 2][window_batch], total[window_batch];

    void put(int b, const double* upper) {
        constexpr int entries = F::C * (F::C + 1) / 2;
        for (int i = 0; i < entries; ++i) moments[i][b] = upper[i];
        total[b] = upper[entries - 1];
    }
};

// `window_batch` hypotheses, a column each: the prior (upper triangle of its `precision`, `information`,
// `constant`), `row_weight`, and the index of the `window`.
template <class F>
struct RecipientBlock {
    double precision[F::S * (F::S + 1) / 2][window_batch];
    double information[F::S][window_batch], constant[window_batch], row_weight[F::K][window_batch];
    int window[window_batch];

    void put(int b, const Kind& kind, const Hypothesis& one, int of) {
        Prior<F, double> prior{};
        read_prior<F>(kind, one, prior);
        for (int c = 0, i = 0; c < F::S; ++c) {
            for (int d = c; d < F::S; ++d, ++i) precision[i][b] = prior.precision[c * F::S + d];
        }
        for (int s = 0; s < F::S; ++s) information[s][b] = prior.information[s];
        for (int k = 0; k < F::K; ++k) row_weight[k][b] = one.own[kind.where.row_weight + k];
        constant[b] = prior.constant;
        window[b] = of;
    }
};

// Factors of `v M v` for `geometry_batch` vectors v that are zero beyond the first A of N entries: products
// of entries of v, for the part of M's upper triangle that they multiply.
template <int N, int A = N>
struct Products {
    double factor[A * (A + 1) / 2][geometry_batch];

    void of(int g, const double* v) {
        for (int a = 0, i = 0; a < A; ++a) {
            for (int b = a; b < A; ++b, ++i) factor[i][g] = (a == b ? 1.0 : 2.0) * v[a] * v[b];
        }
    }

    void squares(const double (*matrices)[window_batch], double (&out)[geometry_batch][window_batch]) const {
        double sum[geometry_batch][window_batch] = {};
        for (int a = 0, i = 0; a < A; ++a) {
            const double (*matrix)[window_batch] = matrices + a * N - a * (a - 1) / 2;
            for (int b = 0; b < A - a; ++b, ++i) {
                for (int g = 0; g < geometry_batch; ++g) {
                    for (int c = 0; c < window_batch; ++c) sum[g][c] += factor[i][g] * matrix[b][c];
                }
            }
        }
        std::copy_n(sum[0], geometry_batch * window_batch, out[0]);
    }
};

// `geometry_batch` geometries: x (S,), the products of x and of its rows, and the part of the last row that
// determines the scale.
template <class F>
struct Offer {
    double x[geometry_batch][F::S];
    Products<F::S> prior;
    Products<F::C, F::active_in(0)> first[F::K > 1 ? F::K - 1 : 1];
    Products<F::C, F::active_in(F::last)> last;
    double turns[geometry_batch][9];

    void put(int g, const double* geometry) {
        double of_rows[F::K][F::C];
        rows<F>(geometry, of_rows);
        std::copy_n(geometry, F::S, x[g]);
        prior.of(g, geometry);
        for (int k = 0; k < F::last; ++k) first[k].of(g, of_rows[k]);
        last.of(g, of_rows[F::last]);
        if constexpr (F::crosses) std::copy_n(of_rows[F::last] + 9, 9, turns[g]);
    }
};

// Sum of squares of each row over each window: `out[k][g]` (N,) of the k-th row of geometry g.
template <class F>
using Squares = std::vector<double>[F::K][geometry_batch];

template <class F>
WIDE void every_square(const std::vector<Windows<F>>& windows, const Offer<F>& offer, Squares<F>& out) {
    double squares[geometry_batch][window_batch];
    const auto write = [&](int k, std::size_t n) {
        for (int g = 0; g < geometry_batch; ++g)
            std::copy_n(squares[g], window_batch, &out[k][g][n * window_batch]);
    };
    for (std::size_t n = 0; n < windows.size(); ++n) {
        for (int k = 0; k < F::last; ++k) {
            offer.first[k].squares(windows[n].moments, squares);
            write(k, n);
        }
        offer.last.squares(windows[n].moments, squares);
        if constexpr (F::crosses) {  // per metre, see edge_edge.scale_sq
            for (int g = 0; g < geometry_batch; ++g) {
                double cosine[window_batch] = {};
                for (int i = 0, of = F::C - 1; i < 9; of += F::C - 1 - i++) {
                    for (int c = 0; c < window_batch; ++c)
                        cosine[c] += offer.turns[g][i] * windows[n].moments[of][c];
                }
                for (int c = 0; c < window_batch; ++c) {
                    const double mean = cosine[c] / std::max(windows[n].total[c], settings.tiny);
                    squares[g][c] /= std::max(1.0 - mean * mean, settings.sine_sq_floor);
                }
            }
        }
        write(F::last, n);
    }
}

// Reference: `gauss_newton.every_cost` of the geometries offered, given their `squares`: `out[g]` (N,) of
// geometry g for all recipients.
template <class F>
WIDE void every_cost(const std::vector<RecipientBlock<F>>& recipients, const Offer<F>& offer,
                     const Squares<F>& squares, double* const* out) {
    double prior_squares[geometry_batch][window_batch];
    for (std::size_t n = 0; n < recipients.size(); ++n) {
        const RecipientBlock<F>& of = recipients[n];
        offer.prior.squares(of.precision, prior_squares);
        for (int g = 0; g < geometry_batch; ++g) {
            double cost[window_batch];
            for (int c = 0; c < window_batch; ++c) cost[c] = 0.5 * prior_squares[g][c] + of.constant[c];
            for (int s = 0; s < F::S; ++s) {
                for (int c = 0; c < window_batch; ++c) cost[c] -= offer.x[g][s] * of.information[s][c];
            }
            for (int k = 0; k < F::K; ++k) {
                for (int c = 0; c < window_batch; ++c)
                    cost[c] += 0.5 * of.row_weight[k][c] * squares[k][g][of.window[c]];
            }
            for (int c = 0; c < window_batch; ++c) {
                const bool is_number = !std::isnan(cost[c]);
                out[g][n * window_batch + c] = is_number ? cost[c] : std::numeric_limits<double>::infinity();
            }
        }
    }
}

}  // namespace kernels
