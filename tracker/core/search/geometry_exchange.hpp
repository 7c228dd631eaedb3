// Exchange of geometry: hypotheses whose geometry fits the window of another better than its own.
#pragma once

#include "search/cost_matrix.hpp"

namespace kernels {

// Reference: `global_search.is_competitive`.
inline bool is_competitive(const Kind& kind, const Hypothesis& one) {
    return within_far_margin(kind.where, one.own) || in_burn_in(kind, one);
}

// Reference: `global_search.accepts_donor`.
inline bool accepts_donor(const Kind& kind, const Hypothesis& one) {
    const bool may_return = within_far_margin(kind.where, one.own) || is_protected(kind, one);
    return may_return && one.own[kind.where.rms] > settings.fitting_rms;
}

// Costs of geometries in the windows of some hypotheses of a bank, the recipients.
template <class F>
class DonorCosts {
public:
    DonorCosts(const Kind& kind, const Bank& bank, const std::vector<int>& recipients)
        : kind_(kind), bank_(bank), recipients_((recipients.size() + window_batch - 1) / window_batch) {
        int windows = 0, before = -1;
        for (std::size_t t = 0; t < recipients.size(); ++t) {
            const int b = recipients[t], onset = bank.window_of(b);
            if (onset != before) {
                if (windows % window_batch == 0) windows_.emplace_back();
                windows_.back().put(windows++ % window_batch, bank.since(b) + kind.since.second_moment);
            }
            before = onset;
            recipients_[t / window_batch].put(t % window_batch, kind, bank[b], windows - 1);
        }
        for (auto& row : squares_) {
            for (std::vector<double>& one : row) one.resize(windows_.size() * window_batch);
        }
    }

    // Costs of at most `geometry_batch` geometries, of `rows[0]` to `rows[count - 1]`: `costs()[g]` has those
    // of the g-th in the windows of all recipients.
    void weigh(const int* rows, int count) {
        Offer<F> offer;
        double* some[geometry_batch];
        for (int g = 0; g < geometry_batch; ++g) {
            offer.put(g, bank_[rows[std::min(g, count - 1)]].own + kind_.where.x);
            costs_[g].resize(recipients_.size() * window_batch);
            some[g] = costs_[g].data();
        }
        every_square<F>(windows_, offer, squares_);
        every_cost<F>(recipients_, offer, squares_, some);
    }

    const std::vector<double> (&costs() const)[geometry_batch] { return costs_; }

private:
    const Kind& kind_;
    const Bank& bank_;
    std::vector<Windows<F>> windows_;
    std::vector<RecipientBlock<F>> recipients_;
    Squares<F> squares_;
    std::vector<double> costs_[geometry_batch];
};

// Cost of a hypothesis's own geometry.
template <class F>
double own_cost(const Kind& kind, const Hypothesis& one) {
    Prior<F, double> prior{};
    double x[F::S], moments[F::C * F::C], of_rows[F::K][F::C], row_moments[F::C], weighted_x[F::S], turn[9];
    read_prior<F>(kind, one, prior);
    std::copy_n(one.own + kind.where.x, F::S, x);
    read_symmetric<F::C>(one.since, kind.since.second_moment, moments);
    rows<F>(x, of_rows);
    prior.times(x, weighted_x);
    double cost = 0.5 * dot<F::S>(x, weighted_x) - dot<F::S>(x, prior.information) + prior.constant;
    for (int k = 0; k < F::K; ++k) {
        multiply<F::C, F::C>(of_rows[k], moments, row_moments);
        const double scale = k == F::last ? scale_sq<F>(of_rows[k], moments, turn) : 1.0;
        cost += 0.5 * one.own[kind.where.row_weight + k] * dot<F::C>(of_rows[k], row_moments) / scale;
    }
    return without_nan(cost, std::numeric_limits<double>::infinity());
}

// Reference: `global_search.best_donors`, the row of each hypothesis's donor.
template <class F>
std::vector<int> best_donors(const Kind& kind, const Bank& bank) {
    std::vector<int> donor(bank.count()), recipients, donors;
    for (int b = 0; b < bank.count(); ++b) {
        donor[b] = b;
        if (is_competitive(kind, bank[b])) donors.push_back(b);
        if (accepts_donor(kind, bank[b])) recipients.push_back(b);
    }
    if (recipients.empty()) return donor;
    const double infinite = std::numeric_limits<double>::infinity();
    std::vector<double> present(recipients.size()), least(recipients.size(), infinite);
    std::vector<int> best = recipients;
    for (std::size_t t = 0; t < recipients.size(); ++t) {
        const Hypothesis own = bank[recipients[t]];
        present[t] = is_competitive(kind, own) ? infinite : own_cost<F>(kind, own);
    }
    DonorCosts<F> costs(kind, bank, recipients);
    for (std::size_t first = 0; first < donors.size(); first += geometry_batch) {
        const int count = static_cast<int>(std::min(donors.size() - first, std::size_t{geometry_batch}));
        costs.weigh(&donors[first], count);
        for (int g = 0; g < count; ++g) {
            const int of = donors[first + g];
            const std::vector<double>& cost = costs.costs()[g];
            for (std::size_t t = 0; t < recipients.size(); ++t) {
                if (of == recipients[t]) present[t] = cost[t];
                if (!(cost[t] < least[t])) continue;
                least[t] = cost[t];
                best[t] = of;
            }
        }
    }
    for (std::size_t t = 0; t < recipients.size(); ++t) {
        if (least[t] < present[t] - settings.least_gain) donor[recipients[t]] = best[t];
    }
    return donor;
}

}  // namespace kernels
