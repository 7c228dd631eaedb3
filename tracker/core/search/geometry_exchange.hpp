// Whose geometry fits another hypothesis better than its own does.
#pragma once

#include "search/cost_matrix.hpp"

namespace kernels {

// Reference: `global_search.is_competitive`.
inline bool may_win(const Kind& kind, const Hypothesis& one) {
    return within_far_margin(kind.where, one.own) || in_burn_in(kind, one);
}

// Reference: `global_search.accepts_donor`.
inline bool asks(const Kind& kind, const Hypothesis& one) {
    const bool may_return = within_far_margin(kind.where, one.own) || is_protected(kind, one);
    return may_return && one.own[kind.where.rms] > settings.fitting_rms;
}

// What geometries cost some hypotheses of a bank.
template <class F>
class Askers {
public:
    Askers(const Kind& kind, const Bank& bank, const std::vector<int>& asking)
        : kind_(kind), bank_(bank), asked_((asking.size() + abreast - 1) / abreast) {
        int windows = 0, before = -1;
        for (std::size_t t = 0; t < asking.size(); ++t) {
            const int b = asking[t], onset = bank.window_of(b);
            if (onset != before) {
                if (windows % abreast == 0) windows_.emplace_back();
                windows_.back().put(windows++ % abreast, bank.since(b) + kind.since.second_moment);
            }
            before = onset;
            asked_[t / abreast].put(t % abreast, kind, bank[b], windows - 1);
        }
        for (auto& row : squares_) {
            for (std::vector<double>& one : row) one.resize(windows_.size() * abreast);
        }
    }

    std::size_t width() const { return asked_.size() * abreast; }

    // Costs of the geometries of some `rows`: of row h from `out` + h * `width`
    // on.
    void weigh(const std::vector<int>& rows, double* out) {
        Offer<F> offer;
        for (std::size_t first = 0; first < rows.size(); first += together) {
            double* some[together];
            for (int g = 0; g < together; ++g) {
                const int h = rows[std::min(first + g, rows.size() - 1)];
                offer.put(g, bank_[h].own + kind_.where.x);
                some[g] = out + h * width();
            }
            every_square<F>(windows_, offer, squares_);
            every_cost<F>(asked_, offer, squares_, some);
        }
    }

private:
    const Kind& kind_;
    const Bank& bank_;
    std::vector<Windows<F>> windows_;
    std::vector<Asked<F>> asked_;
    Squares<F> squares_;
};

// What its own geometry costs a hypothesis.
template <class F>
double own_cost(const Kind& kind, const Hypothesis& one) {
    Prior<F, double> prior{};
    double x[F::S], moments[F::C * F::C], of_rows[F::K][F::C], carried[F::C], held[F::S], turn[9];
    read_prior<F>(kind, one, prior);
    std::copy_n(one.own + kind.where.x, F::S, x);
    read_symmetric<F::C>(one.since, kind.since.second_moment, moments);
    rows<F>(x, of_rows);
    prior.times(x, held);
    double cost = 0.5 * dot<F::S>(x, held) - dot<F::S>(x, prior.information) + prior.constant;
    for (int k = 0; k < F::K; ++k) {
        multiply<F::C, F::C>(of_rows[k], moments, carried);
        const double scale = k == F::last ? scale_sq<F>(of_rows[k], moments, turn) : 1.0;
        cost += 0.5 * one.own[kind.where.row_weight + k] * dot<F::C>(of_rows[k], carried) / scale;
    }
    return without_nan(cost, std::numeric_limits<double>::infinity());
}

// Of each hypothesis whose geometry it takes, as in
// `global_search.best_donors`.
template <class F>
std::vector<int> best_donors(const Kind& kind, const Bank& bank) {
    std::vector<int> giver(bank.count()), asking, offering;
    for (int b = 0; b < bank.count(); ++b) {
        giver[b] = b;
        if (may_win(kind, bank[b])) offering.push_back(b);
        if (asks(kind, bank[b])) asking.push_back(b);
    }
    if (asking.empty()) return giver;
    Askers<F> askers(kind, bank, asking);
    std::vector<double> cost(bank.count() * askers.width());
    askers.weigh(offering, cost.data());
    for (std::size_t t = 0; t < asking.size(); ++t) {
        const int own = asking[t];
        const auto of = [&](int b) { return cost[b * askers.width() + t]; };
        const double present = may_win(kind, bank[own]) ? of(own) : own_cost<F>(kind, bank[own]);
        double least = present;
        for (int b : offering) {
            if (!(of(b) < least)) continue;
            least = of(b);
            giver[own] = b;
        }
        if (!(least < present - settings.least_gain)) giver[own] = own;
    }
    return giver;
}

}  // namespace kernels
