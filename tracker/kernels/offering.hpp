// Whose geometry fits another hypothesis better than its own does.
#pragma once

#include <limits>

#include "fitting.hpp"

namespace kernels {

// So many windows stand side by side: their sums stay in registers.
constexpr int abreast = 8;

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
void ask(const Kind& kind, const double* row, int b, Block<F>& block) {
    constexpr int entries = F::C * (F::C + 1) / 2;
    const double* moments = row + kind.where.moments;
    Prior<F, double> prior{};
    know<F>(kind, row, prior);
    for (int i = 0; i < entries; ++i) block.moments[i][b] = moments[i];
    triangle<F::S>(prior.precision, b, block.precision);
    for (int s = 0; s < F::S; ++s) block.information[s][b] = prior.information[s];
    for (int k = 0; k < F::K; ++k) block.row_weight[k][b] = row[kind.where.row_weight + k];
    block.constant[b] = prior.constant;
    block.total[b] = moments[entries - 1];
}

// What `v M v` is made of: products of entries of v that are not zero, and where in M's triangle they belong.
template <int N>
struct Products {
    double factor[N * (N + 1) / 2];
    int place[N * (N + 1) / 2], count = 0;

    void of(const double* v) {
        count = 0;
        for (int a = 0, i = 0; a < N; ++a) {
            for (int b = a; b < N; ++b, ++i) {
                factor[count] = (a == b ? 1.0 : 2.0) * v[a] * v[b];
                place[count] = i;
                count += factor[count] != 0.0;
            }
        }
    }

    void squares(const double (*matrices)[abreast], double (&out)[abreast]) const {
        double sum[abreast] = {};
        for (int i = 0; i < count; ++i) {
            for (int b = 0; b < abreast; ++b) sum[b] += factor[i] * matrices[place[i]][b];
        }
        std::copy_n(sum, abreast, out);
    }
};

// A geometry that is offered: products of x (S,), of its rows, and of what their scale hangs on.
template <class F>
struct Offer {
    Products<F::S> prior;
    Products<F::C> data[F::K], cosine;
};

// As `fit.every_cost` of one geometry x (S,) in all `blocks`: `out` (N,).
template <class F>
WIDE void every_cost(const double* x, const std::vector<Block<F>>& blocks, Offer<F>& offer, double* out) {
    auto& [prior, data, cosine] = offer;
    double of_rows[F::K][F::C], squares[abreast], cosines[abreast], direction[F::C] = {};
    rows<F>(x, of_rows);
    std::copy_n(of_rows[F::last] + 9, F::crosses ? 9 : 0, direction);
    prior.of(x);
    cosine.of(direction);
    for (int k = 0; k < F::K; ++k) data[k].of(of_rows[k]);
    for (const Block<F>& block : blocks) {
        double cost[abreast];
        prior.squares(block.precision, squares);
        for (int b = 0; b < abreast; ++b) cost[b] = 0.5 * squares[b] + block.constant[b];
        for (int s = 0; s < F::S; ++s) {
            for (int b = 0; b < abreast; ++b) cost[b] -= x[s] * block.information[s][b];
        }
        for (int k = 0; k < F::K; ++k) {
            data[k].squares(block.moments, squares);
            if constexpr (F::crosses) {  // per metre, see edge_edge.scale_sq
                cosine.squares(block.moments, cosines);
                for (int b = 0; b < abreast; ++b) {
                    const double mean_sq = cosines[b] / std::max(block.total[b], settings.tiny);
                    squares[b] /= std::max(1.0 - mean_sq, settings.sine_sq_floor);
                }
            }
            for (int b = 0; b < abreast; ++b) cost[b] += 0.5 * block.row_weight[k][b] * squares[b];
        }
        for (double one : cost) *out++ = std::isnan(one) ? std::numeric_limits<double>::infinity() : one;
    }
}

// Of each hypothesis whose geometry it takes, as in `search.adopted`: its own where none is better.
template <class F>
std::vector<int> givers(const Kind& kind, const Table& table) {
    std::vector<int> giver(table.count), asking;
    for (int b = 0; b < table.count; ++b) {
        giver[b] = b;
        if (table.row(b)[kind.where.rms] > settings.at_the_noise) asking.push_back(b);
    }
    if (asking.empty()) return giver;
    const int takers = static_cast<int>(asking.size()), blocks = (takers + abreast - 1) / abreast;
    const int width = blocks * abreast;
    std::vector<Block<F>> asked(blocks);
    std::vector<double> cost(static_cast<std::size_t>(table.count) * width);
    for (int t = 0; t < takers; ++t) ask<F>(kind, table.row(asking[t]), t % abreast, asked[t / abreast]);
    Offer<F> offer;
    for (int n = 0; n < table.count; ++n)
        every_cost<F>(table.row(n) + kind.where.x, asked, offer, cost.data() + n * width);
    for (int t = 0; t < takers; ++t) {
        const auto of = [&](int n) { return cost[n * width + t]; };
        int best = asking[t];
        for (int n = 0; n < table.count; ++n) {
            if (of(n) < of(best)) best = n;
        }
        if (of(best) < of(asking[t]) - settings.least_gain) giver[asking[t]] = best;
    }
    return giver;
}

}  // namespace kernels
