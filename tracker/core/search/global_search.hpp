// Global search: fits from many starts; the best replaces the geometry if it is better.
#pragma once

#include "contacts/initial_guess.hpp"
#include "fitting/refit.hpp"

namespace kernels {

// Random starts x (N, S), drawn in the body's frame; `turn` (3, 3) rotates them to the world.
struct Directions {
    const double *x, *turn;
    int count;

    template <class F>
    void write(bool body_in_1, double* out) const {
        std::copy_n(x, count * F::S, out);
        for (int i = 0; i < count; ++i) turn_world<F>(body_in_1, turn, out + i * F::S);
    }
};

// A geometry, and its cost.
template <class F>
struct Found {
    double cost, x[F::S];
};

// Keep the `many` geometries of least cost, sorted stably.
template <class F>
void best_first(std::vector<Found<F>>& found, int many) {
    std::stable_sort(found.begin(), found.end(), [](const Found<F>& a, const Found<F>& b) {
        return a.cost < b.cost || (std::isnan(b.cost) && !std::isnan(a.cost));
    });
    if (static_cast<int>(found.size()) > many) found.resize(many);
}

// Reference: `pairs.known_entries`.
template <class F>
void find_given(const Kind& kind, const double* row, bool (&given)[F::S]) {
    for (int s = 0, diagonal = kind.where.prior_information; s < F::S; diagonal += F::S - s++)
        given[s] = row[diagonal] > 0.0;
    for (int d : {F::d1, F::d2}) {
        if (d < 0) continue;
        const Vector v = at(row + kind.where.prior_mean, d);
        for (int i = 0; i < 3; ++i) given[d + i] = v.x != 0.0 || v.y != 0.0 || v.z != 0.0;
    }
}

// Fit geometries to one window by this number of steps, one per lane.
template <class F>
void follow(const Moments<F>& window, int steps, std::vector<Found<F>>& found, Work<F>& work) {
    for (std::size_t first = 0; first < found.size(); first += lanes) {
        const auto own = [&](int i) -> Found<F>& { return found[std::min(first + i, found.size() - 1)]; };
        Lanes x[F::S], cost;
        for (int i = 0; i < lanes; ++i) {
            for (int s = 0; s < F::S; ++s) x[s].put(i, own(i).x[s]);
        }
        cost = steps ? descend<F>(window, x, steps, work).cost : complete<F>(window, x, work);
        for (int i = 0; i < lanes; ++i) {
            own(i).cost = cost[i];
            for (int s = 0; s < F::S; ++s) own(i).x[s] = x[s][i];
        }
    }
}

// Reference: `global_search._search_rows` of one hypothesis: the best geometries, in order of cost.
template <class F>
std::vector<Found<F>> find(const Kind& kind, const Hypothesis& one, const Directions& directions,
                           Work<F>& work) {
    bool given[F::S];
    const Rows same = rows_of([&](int) { return one; });
    const Moments<F> window(kind, same);
    read_prior<F>(kind, same, work.prior);
    std::vector<double> starts(static_cast<std::size_t>(kind.relaxed + directions.count) * F::S);
    double moments[F::C * F::C];
    read_symmetric<F::C>(one.since, kind.since.second_moment, moments);
    const int few = relax<F>(moments, kind.relaxed, starts.data());
    directions.write<F>(kind.body_in_1, starts.data() + few * F::S);
    find_given<F>(kind, one.own, given);
    std::vector<Found<F>> found(few + directions.count);
    for (std::size_t i = 0; i < found.size(); ++i) {
        for (int s = 0; s < F::S; ++s) {
            found[i].x[s] = given[s] ? one.own[kind.where.prior_mean + s] : starts[i * F::S + s];
        }
    }
    follow<F>(window, 0, found, work);
    best_first<F>(found, settings.followed_starts);
    for (const Round& round : settings.rounds) {
        follow<F>(window, round.steps, found, work);
        best_first<F>(found, round.kept);
    }
    return found;
}

// Copy geometry and evidence of another row to a hypothesis, if its likelihood is higher.
template <class F>
void take(const BankLayout& where, const double* found, double* row) {
    if (!(found[where.log_likelihood] > row[where.log_likelihood])) return;
    std::copy_n(found + where.x, F::S, row + where.x);
    std::copy_n(found + where.row_weight, F::K, row + where.row_weight);
    row[where.log_likelihood] = found[where.log_likelihood];
    row[where.rms] = found[where.rms];
}

// Reference: `global_search.search` of one hypothesis.
template <class F>
void search(const Kind& kind, const Bank& bank, int b, const Directions& directions, const Ticks& ticks,
            const EvidenceParameters& weights, Work<F>& work) {
    const Hypothesis one = bank[b];
    const std::vector<Found<F>> found = find<F>(kind, one, directions, work);
    std::vector<double> memory(found.size() * bank.own.words);
    const Table weighed{memory.data(), static_cast<int>(found.size()), bank.own.words};
    for (int i = 0; i < weighed.count; ++i) {
        std::copy_n(one.own, weighed.words, weighed.row(i));
        std::copy_n(found[i].x, F::S, weighed.row(i) + kind.where.x);
    }
    RefitQueue queue;
    for (int i = 0; i < weighed.count; ++i) queue.add(kind, {weighed.row(i), one.since}, steps_of(kind, one));
    queue.refit<F>(kind, ticks, weights, work);
    int best = 0;
    for (int i = 1; i < weighed.count; ++i) {
        const int word = kind.where.log_likelihood;
        if (weighed.row(i)[word] > weighed.row(best)[word]) best = i;
    }
    if (weighed.count) take<F>(kind.where, weighed.row(best), one.own);
}

}  // namespace kernels
