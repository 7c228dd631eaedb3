// What `following` does to a bank in every tick: its moments grow, and it learns from them.
#pragma once

#include "pricing.hpp"
#include "seeing.hpp"

namespace kernels {

// As in `evidence.Scales`.
struct Weights {
    Lengths lengths;
    double foreknowledge, independence;
};

// As `following._weighed`; `work` is at the hypothesis' x.
template <class F>
void weigh(const Kind& kind, double* row, const Weights& weights, const Sums<F>& sums, Work<F>& work) {
    const Where& where = kind.where;
    double *x = row + where.x, *row_weight = row + where.row_weight;
    const double ticks = std::max(sums.ticks, 1.0);
    const double share = weights.foreknowledge * kind.needed / std::max(row[where.told], 1.0);
    double earned = row[where.earned], foretold[F::K];
    for (int k = 0; k < F::K; ++k) {
        foretold[k] = share * std::exp(-2.0 * sums.gain[k] / std::max(sums.after, 1.0));
        earned += sums.gain[k];
        row_weight[k] = sums.precision[k] / ticks;
    }
    double price = volume<F>(x, row + where.first, foretold, row + where.hessian, work);
    work.prior.times(x, work.pull);
    price += 0.5 * dot<F::S>(x, work.pull) - dot<F::S>(x, work.prior.information) + work.prior.constant;
    const double told = sums.log_ratio + row[where.settled] - std::min(price, earned);
    row[where.log_likelihood] = row[where.lasted] + weights.independence * told;
    row[where.rms] = std::sqrt(sums.chi_sq / (ticks * F::K));
}

// As `following.grow` of one hypothesis, by the newest of `ticks`, in which so much motion is `heard`.
template <class F>
void grow(const Kind& kind, double* row, const Ticks& ticks, double heard, double log_stay) {
    const Where& where = kind.where;
    const double *pose = ticks.newest(), precision = 1.0 / ticks.variance[2 * (ticks.count - 1)];
    const bool begins = whole(row, where.onset) == ticks.number[ticks.count - 1];
    const double weight = precision * (begins ? 1.0 : std::max(heard, settings.at_rest));
    double lifted[F::C], *moments = row + where.moments, anchors[6];
    for (int c = 0; c < F::C; ++c) lifted[c] = pose[kind.lifted[c]];
    for (int c = 0; c < F::C; ++c) {
        if (begins) row[where.first + c] = lifted[c] * std::sqrt(precision);
        for (int d = 0; d < F::C; ++d) moments[c * F::C + d] += weight * lifted[c] * lifted[d];
    }
    const Vector place = kind.body_in_1 ? at(pose, T) : -at(pose, U);
    put(row, where.place_sum, at(row, where.place_sum) + weight * place);
    row[where.weight] += weight;
    row[where.told] += begins ? 1.0 : heard;
    row[where.lasted] += begins ? 0.0 : log_stay;
    anchor(kind, row, anchors);
    normalise<F>(row + where.x, anchors);
}

// As `following.learn` of one hypothesis.
template <class F>
void learn(const Kind& kind, double* row, const Ticks& ticks, int steps, const Weights& weights,
           Work<F>& work) {
    const Where& where = kind.where;
    double* x = row + where.x;
    know<F>(kind, row, work.prior);
    descend<F>(moments_of(kind, row), x, steps, row + where.hessian, work);
    const bool certain = whole(row, where.certain) != 0;
    weigh<F>(kind, row, weights, add_up<F>(kind, x, whole(row, where.onset), certain, ticks, weights.lengths),
             work);
}

// How many steps a hypothesis takes in every tick.
inline int steps_of(const Kind& kind, const double* row) {
    return row[kind.where.told] < settings.first_ticks ? settings.first_steps : settings.refine_steps;
}

}  // namespace kernels
