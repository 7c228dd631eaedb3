// Whose geometry fits another hypothesis better than its own does.
#pragma once

#include <limits>

#include "fitting.hpp"

namespace kernels {

// What N hypotheses ask of a geometry, a column each: the upper triangles of their `moments` and of the
// `precision` of what they knew before, `information`, `constant` and `row_weight`.
template <class F>
struct Costs {
    static constexpr int of_moments = F::C * (F::C + 1) / 2, of_prior = F::S * (F::S + 1) / 2;

    explicit Costs(int count)
        : count(count), moments(of_moments * count), precision(of_prior * count), information(F::S * count),
          constant(count), row_weight(F::K * count), squares(count), cosines(count) {}

    int count;
    std::vector<double> moments, precision, information, constant, row_weight, squares, cosines;
};

template <int N>
void triangle(const double* matrix, int b, int count, std::vector<double>& out) {
    for (int c = 0, i = 0; c < N; ++c) {
        for (int d = c; d < N; ++d, ++i) out[i * count + b] = matrix[c * N + d];
    }
}

// Write down what hypothesis b asks.
template <class F>
void ask(const Kind& kind, const double* row, int b, Costs<F>& costs, Prior<F>& prior) {
    know<F>(kind, row, prior);
    triangle<F::C>(row + kind.where.moments, b, costs.count, costs.moments);
    triangle<F::S>(prior.precision, b, costs.count, costs.precision);
    for (int s = 0; s < F::S; ++s) costs.information[s * costs.count + b] = prior.information[s];
    for (int k = 0; k < F::K; ++k) costs.row_weight[k * costs.count + b] = row[kind.where.row_weight + k];
    costs.constant[b] = prior.constant;
}

// `v M v` (N,) of symmetric matrices, a column of upper triangles each.
template <int M>
void squares_of(const double* v, const std::vector<double>& matrices, std::vector<double>& out) {
    const int count = static_cast<int>(out.size());
    std::fill(out.begin(), out.end(), 0.0);
    for (int a = 0, i = 0; a < M; ++a) {
        for (int b = a; b < M; ++b, ++i) {
            const double factor = (a == b ? 1.0 : 2.0) * v[a] * v[b];
            if (factor != 0.0) {
                for (int n = 0; n < count; ++n) out[n] += factor * matrices[i * count + n];
            }
        }
    }
}

// As `fit.every_cost` of one geometry x (S,): `out` (N,).
template <class F>
void every_cost(const double* x, Costs<F>& costs, double* out) {
    const int count = costs.count;
    std::vector<double>& squares = costs.squares;
    double of_rows[F::K][F::C];
    rows<F>(x, of_rows);
    squares_of<F::S>(x, costs.precision, squares);
    for (int b = 0; b < count; ++b) out[b] = 0.5 * squares[b] + costs.constant[b];
    for (int s = 0; s < F::S; ++s) {
        for (int b = 0; b < count; ++b) out[b] -= x[s] * costs.information[s * count + b];
    }
    for (int k = 0; k < F::K; ++k) {
        squares_of<F::C>(of_rows[k], costs.moments, squares);
        if constexpr (F::crosses) {  // per metre, see edge_edge.scale_sq
            const double* total = costs.moments.data() + (Costs<F>::of_moments - 1) * count;  // of the lift's 1
            double direction[F::C] = {};
            std::copy_n(of_rows[k] + 9, 9, direction);
            squares_of<F::C>(direction, costs.moments, costs.cosines);
            for (int b = 0; b < count; ++b) {
                const double mean_sq = costs.cosines[b] / std::max(total[b], settings.tiny);
                squares[b] /= std::max(1.0 - mean_sq, settings.sine_sq_floor);
            }
        }
        for (int b = 0; b < count; ++b) out[b] += 0.5 * costs.row_weight[k * count + b] * squares[b];
    }
    for (int b = 0; b < count; ++b) {
        if (std::isnan(out[b])) out[b] = std::numeric_limits<double>::infinity();
    }
}

// Of each hypothesis whose geometry it takes, as in `search.adopted`: its own where none is better.
template <class F>
std::vector<int> givers(const Kind& kind, const Table& table, Prior<F>& prior) {
    const int count = table.count;
    Costs<F> costs(count);
    std::vector<double> cost(static_cast<std::size_t>(count) * count);
    for (int b = 0; b < count; ++b) ask<F>(kind, table.row(b), b, costs, prior);
    for (int n = 0; n < count; ++n) every_cost<F>(table.row(n) + kind.where.x, costs, cost.data() + n * count);
    std::vector<int> giver(count);
    for (int b = 0; b < count; ++b) {
        int best = b;
        for (int n = 0; n < count; ++n) {
            if (cost[n * count + b] < cost[best * count + b]) best = n;
        }
        giver[b] = cost[best * count + b] < cost[b * count + b] - settings.least_gain ? best : b;
    }
    return giver;
}

}  // namespace kernels
