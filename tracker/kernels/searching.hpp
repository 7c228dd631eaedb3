// How hypotheses search from scratch: where many starts lead to, and whether that is better.
#pragma once

#include "following.hpp"
#include "relaxing.hpp"

namespace kernels {

// Random x (N, S) to start from.
struct Directions {
    const double* x;
    int count;
};

// A geometry, and its cost.
template <class F>
struct Found {
    double cost, x[F::S];
};

// Bring the `many` that cost least to the front, in order; equal ones stay in theirs.
template <class F>
void best_first(std::vector<Found<F>>& found, int many) {
    std::stable_sort(found.begin(), found.end(), [](const Found<F>& a, const Found<F>& b) {
        return a.cost < b.cost || (std::isnan(b.cost) && !std::isnan(a.cost));
    });
    if (static_cast<int>(found.size()) > many) found.resize(many);
}

// As `Given.told`.
template <class F>
void tell(const Kind& kind, const double* row, bool (&told)[F::S]) {
    for (int s = 0; s < F::S; ++s) told[s] = row[kind.where.known + s * F::S + s] > 0.0;
    for (int d : {F::d1, F::d2}) {
        if (d < 0) continue;
        const Vector v = at(row + kind.where.known_mean, d);
        for (int i = 0; i < 3; ++i) told[d + i] = v.x != 0.0 || v.y != 0.0 || v.z != 0.0;
    }
}

// As `search._found` of one hypothesis: the best geometries, in order.
template <class F>
std::vector<Found<F>> find(const Kind& kind, const double* row, const Directions& directions, Work<F>& work) {
    bool told[F::S];
    double hessian[F::K * F::P * F::P];
    const Moments window = moments_of(kind, row);
    std::vector<double> starts(static_cast<std::size_t>(kind.relaxed + directions.count) * F::S);
    const int few = relax<F>(window.moments, kind.relaxed, starts.data());
    std::copy_n(directions.x, directions.count * F::S, starts.data() + few * F::S);
    tell<F>(kind, row, told);
    std::vector<Found<F>> found(few + directions.count);
    for (std::size_t i = 0; i < found.size(); ++i) {
        for (int s = 0; s < F::S; ++s) {
            found[i].x[s] = told[s] ? row[kind.where.known_mean + s] : starts[i * F::S + s];
        }
        found[i].cost = complete<F>(window, found[i].x, work);
    }
    best_first<F>(found, settings.screened);
    for (const Round& round : settings.rounds) {
        for (Found<F>& one : found) one.cost = descend<F>(window, one.x, round.steps, hessian, work).cost;
        best_first<F>(found, round.kept);
    }
    return found;
}

// Give a hypothesis the geometry and evidence of another row, if that is better.
template <class F>
void take(const Where& where, const double* found, double* row) {
    if (!(found[where.log_likelihood] > row[where.log_likelihood])) return;
    std::copy_n(found + where.x, F::S, row + where.x);
    std::copy_n(found + where.hessian, F::K * F::P * F::P, row + where.hessian);
    std::copy_n(found + where.row_weight, F::K, row + where.row_weight);
    row[where.log_likelihood] = found[where.log_likelihood];
    row[where.rms] = found[where.rms];
}

// As `search.searched` of one hypothesis.
template <class F>
void search(const Kind& kind, const Table& table, int b, const Directions& directions, const Ticks& ticks,
            const Weights& weights, Work<F>& work) {
    double* row = table.row(b);
    know<F>(kind, row, work.prior);
    std::vector<double> best, weighed(table.words);
    for (const Found<F>& one : find<F>(kind, row, directions, work)) {
        std::copy_n(row, table.words, weighed.data());
        std::copy_n(one.x, F::S, weighed.data() + kind.where.x);
        for (int i = 0; i < settings.weighed; ++i) {
            learn<F>(kind, weighed.data(), ticks, steps_of(kind, row), weights, work);
        }
        const int word = kind.where.log_likelihood;
        if (best.empty() || weighed[word] > best[word]) best = weighed;
    }
    if (!best.empty()) take<F>(kind.where, best.data(), row);
}

}  // namespace kernels
