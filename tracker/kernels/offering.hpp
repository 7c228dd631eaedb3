// Whose geometry fits another hypothesis better than its own does.
#pragma once

#include <limits>

#include "fitting.hpp"

namespace kernels {

// So many windows stand side by side, and so many geometries are offered together: their sums stay in
// registers.
constexpr int abreast = 8, together = 4;

// What N hypotheses ask of a geometry, `abreast` columns at a time: the upper triangles of their `moments`
// and of the `precision` of what they knew before, `information`, `constant`, `row_weight`, and the square of
// the lift's 1, `total`.
template <class F>
struct Block {
    double moments[F::C * (F::C + 1) / 2][abreast], precision[F::S * (F::S + 1) / 2][abreast];
    double information[F::S][abreast], constant[abreast], row_weight[F::K][abreast], total[abreast];
};

template <int N>
void triangle(const double* matrix, int b, double (*out)[abreast]) {
    for (int c = 0, i = 0; c < N; ++c) {
        for (int d = c; d < N; ++d, ++i) out[i][b] = matrix[c * N + d];
    }
}

// Write down what a hypothesis asks, in column b.
template <class F>
void ask(const Kind& kind, const Hypothesis& one, int b, Block<F>& block) {
    constexpr int entries = F::C * (F::C + 1) / 2;
    const double* moments = one.since + kind.since.moments;
    Prior<F, double> prior{};
    know<F>(kind, one, prior);
    for (int i = 0; i < entries; ++i) block.moments[i][b] = moments[i];
    triangle<F::S>(prior.precision, b, block.precision);
    for (int s = 0; s < F::S; ++s) block.information[s][b] = prior.information[s];
    for (int k = 0; k < F::K; ++k) block.row_weight[k][b] = one.own[kind.where.row_weight + k];
    block.constant[b] = prior.constant;
    block.total[b] = moments[entries - 1];
}

// What `v M v` is made of, of `together` vectors v that are zero beyond the first A of N columns: products of
// their entries, for all of M's triangle that these meet.
template <int N, int A = N>
struct Products {
    double factor[A * (A + 1) / 2][together];

    void of(int g, const double* v) {
        for (int a = 0, i = 0; a < A; ++a) {
            for (int b = a; b < A; ++b, ++i) factor[i][g] = (a == b ? 1.0 : 2.0) * v[a] * v[b];
        }
    }

    void squares(const double (*matrices)[abreast], double (&out)[together][abreast]) const {
        double sum[together][abreast] = {};
        for (int a = 0, i = 0; a < A; ++a) {
            const double (*matrix)[abreast] = matrices + a * N - a * (a - 1) / 2;
            for (int b = 0; b < A - a; ++b, ++i) {
                for (int g = 0; g < together; ++g) {
                    for (int c = 0; c < abreast; ++c) sum[g][c] += factor[i][g] * matrix[b][c];
                }
            }
        }
        std::copy_n(sum[0], together * abreast, out[0]);
    }
};

// Geometries that are offered: products of x (S,), of its rows, and of what their scale hangs on.
template <class F>
struct Offer {
    double x[together][F::S];
    Products<F::S> prior;
    Products<F::C, F::active_in(0)> first[F::K > 1 ? F::K - 1 : 1];
    Products<F::C, F::active_in(F::last)> last;
    Products<F::C, F::crosses ? 9 : 1> cosine;

    void put(int g, const double* geometry) {
        double of_rows[F::K][F::C];
        rows<F>(geometry, of_rows);
        std::copy_n(geometry, F::S, x[g]);
        prior.of(g, geometry);
        for (int k = 0; k < F::last; ++k) first[k].of(g, of_rows[k]);
        last.of(g, of_rows[F::last]);
        if constexpr (F::crosses) cosine.of(g, of_rows[F::last] + 9);
    }
};

// As `fit.every_cost` of what is offered in all `blocks`: each `out` (N,).
template <class F>
WIDE void every_cost(const std::vector<Block<F>>& blocks, const Offer<F>& offer, double* const* out) {
    double squares[together][abreast], cosines[together][abreast], cost[together][abreast];
    const auto each = [](auto&& function) {
        for (int g = 0; g < together; ++g) {
            for (int c = 0; c < abreast; ++c) function(g, c);
        }
    };
    for (std::size_t n = 0; n < blocks.size(); ++n) {
        const Block<F>& block = blocks[n];
        offer.prior.squares(block.precision, squares);
        each([&](int g, int c) { cost[g][c] = 0.5 * squares[g][c] + block.constant[c]; });
        for (int s = 0; s < F::S; ++s)
            each([&](int g, int c) { cost[g][c] -= offer.x[g][s] * block.information[s][c]; });
        for (int k = 0; k < F::last; ++k) {
            offer.first[k].squares(block.moments, squares);
            each([&](int g, int c) { cost[g][c] += 0.5 * block.row_weight[k][c] * squares[g][c]; });
        }
        offer.last.squares(block.moments, squares);
        if constexpr (F::crosses) {  // per metre, see edge_edge.scale_sq
            offer.cosine.squares(block.moments, cosines);
            each([&](int g, int c) {
                const double mean_sq = cosines[g][c] / std::max(block.total[c], settings.tiny);
                squares[g][c] /= std::max(1.0 - mean_sq, settings.sine_sq_floor);
            });
        }
        each([&](int g, int c) {
            const double one = cost[g][c] + 0.5 * block.row_weight[F::last][c] * squares[g][c];
            out[g][n * abreast + c] = std::isnan(one) ? std::numeric_limits<double>::infinity() : one;
        });
    }
}

// As `search._may_win`.
inline bool may_win(const Kind& kind, const Hypothesis& one) {
    return joint(kind.where, one.own) >= -settings.far_nats || patient(kind, one);
}

// Costs of the geometries of some `rows` on the windows of blocks: of row h from `out` + h * `width` on.
template <class F>
void weigh(const Kind& kind, const Bank& bank, const std::vector<int>& rows,
           const std::vector<Block<F>>& blocks, double* out, int width) {
    Offer<F> offer;
    for (std::size_t first = 0; first < rows.size(); first += together) {
        double* some[together];
        for (int g = 0; g < together; ++g) {
            const int h = rows[std::min(first + g, rows.size() - 1)];
            offer.put(g, bank[h].own + kind.where.x);
            some[g] = out + h * width;
        }
        every_cost<F>(blocks, offer, some);
    }
}

// Of each hypothesis whose geometry it takes, as in `search.givers`.
template <class F>
std::vector<int> givers(const Kind& kind, const Bank& bank) {
    std::vector<int> giver(bank.count()), asking, offering;
    for (int b = 0; b < bank.count(); ++b) {
        giver[b] = b;
        if (may_win(kind, bank[b])) offering.push_back(b);
        if (bank[b].own[kind.where.rms] > settings.at_the_noise) asking.push_back(b);
    }
    if (asking.empty()) return giver;
    const int takers = static_cast<int>(asking.size()), blocks = (takers + abreast - 1) / abreast;
    const int width = blocks * abreast;
    std::vector<Block<F>> asked(blocks);
    std::vector<double> cost(static_cast<std::size_t>(bank.count()) * width);
    for (int t = 0; t < takers; ++t) ask<F>(kind, bank[asking[t]], t % abreast, asked[t / abreast]);
    weigh<F>(kind, bank, offering, asked, cost.data(), width);
    for (int n = 0; n < blocks; ++n) {  // who offers nothing is weighed for itself
        std::vector<int> own;
        for (int t = n * abreast; t < std::min(takers, (n + 1) * abreast); ++t) {
            if (!may_win(kind, bank[asking[t]])) own.push_back(asking[t]);
        }
        if (!own.empty()) weigh<F>(kind, bank, own, {asked[n]}, cost.data() + n * abreast, width);
    }
    for (int t = 0; t < takers; ++t) {
        const auto of = [&](int n) { return cost[n * width + t]; };
        int best = asking[t];
        for (int n : offering) {
            if (of(n) < of(best)) best = n;
        }
        if (of(best) < of(asking[t]) - settings.least_gain) giver[asking[t]] = best;
    }
    return giver;
}

}  // namespace kernels
