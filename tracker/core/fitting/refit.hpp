// Update of a bank by a tick: accumulation of the moments, and refits.
#pragma once

#include "evidence/evidence.hpp"
#include "evidence/laplace_volume.hpp"

namespace kernels {

// Reference: `evidence.EvidenceParameters`.
struct EvidenceParameters {
    Lengths lengths;
    double prior_predictive_share, likelihood_exponent;
};

// Reference: `refit._with_evidence`; `work` is at the hypotheses' x (S,).
template <class F>
void weigh_evidence(const Kind& kind, const Rows& rows, const Lanes* x, const EvidenceParameters& weights,
                    const EvidenceSums<F>& sums, Work<F>& work) {
    const BankLayout& where = kind.where;
    const Lanes ticks = larger<Lanes>(sums.ticks, 1.0);
    const Lanes share = weights.prior_predictive_share * kind.needed /
                        larger<Lanes>(read(rows.since, kind.since.effective_ticks), 1.0);
    Lanes gain = read(rows.own, where.gain_before_window), predicted_share[F::K], first[F::C];
    for (int k = 0; k < F::K; ++k) {
        predicted_share[k] = share * exp(-2.0 * sums.gain[k] / larger<Lanes>(sums.after, 1.0));
        gain += sums.gain[k];
        write(rows.own, where.row_weight + k, sums.precision[k] / ticks);
    }
    read(rows.since, kind.since.onset_row, F::C, first);
    Lanes price = volume<F>(first, predicted_share, work);
    work.prior.times(x, work.pull);
    price += 0.5 * dot<F::S>(x, work.pull) - dot<F::S>(x, work.prior.information) + work.prior.constant;
    const Lanes evidence =
        sums.log_ratio + read(rows.own, where.llr_before_window) - smaller<Lanes>(gain, price);
    write(rows.own, where.log_likelihood,
          read(rows.own, where.log_prior) + weights.likelihood_exponent * evidence);
    write(rows.own, where.rms, sqrt(sums.chi_sq / (ticks * double(F::K))));
    write(rows.own, where.x, F::S, x);
}

// Reference: `refit.accumulate`, the rows of the onsets: add the newest of `ticks`, whose motion ratio is
// given.
template <class F>
WIDE void accumulate_onsets(const Kind& kind, const Table& onsets, const Ticks& ticks, const Lengths& lengths,
                            double motion_ratio) {
    const OnsetLayout& where = kind.since;
    const double *pose = ticks.newest_pose(), *before = ticks.before_newest(),
                 precision = 1.0 / ticks.noise(ticks.count - 1, 0);
    const Vector place = kind.body_in_1 ? at(pose, T) : -at(pose, U);
    const double alone = lengths.alone();
    double lifted[F::C], first[F::C], later[F::C];
    for (int c = 0; c < F::C; ++c) {
        lifted[c] = pose[kind.lifted[c]];
        first[c] = alone * lifted[c];
        later[c] = before ? lifted[c] - lengths.correlation * before[kind.lifted[c]] : first[c];
    }
    for (int o = 0; o < onsets.count; ++o) {
        double *row = onsets.row(o), *moments = row + where.second_moment;
        const bool begins = whole(row, where.onset) == ticks.newest();
        const double weight = precision * (begins ? 1.0 : std::max(motion_ratio, settings.rest_weight));
        const double* fresh = begins ? first : later;
        for (int c = 0; c < F::C; ++c) {  // edge-edge: the sine of the poses, not of innovations
            for (int d = c; d < F::C; ++d)
                *moments++ += weight * (F::crosses && d == F::C - 1 ? lifted[c] : fresh[c] * fresh[d]);
            if (begins) row[where.onset_row + c] = first[c] * std::sqrt(precision);
        }
        put(row, where.weighted_position_sum, at(row, where.weighted_position_sum) + weight * place);
        row[where.weight] += weight;
        row[where.effective_ticks] += begins ? 1.0 : motion_ratio;
    }
}

// Reference: `refit.accumulate`.
template <class F>
void accumulate(const Kind& kind, const Bank& bank, const Ticks& ticks, const Lengths& lengths,
                double motion_ratio, double log_stay) {
    accumulate_onsets<F>(kind, bank.onsets, ticks, lengths, motion_ratio);
    for (int b = 0; b < bank.count(); ++b) {
        const Hypothesis one = bank[b];
        double anchors[6];
        if (whole(one.own, kind.where.onset) != ticks.newest()) one.own[kind.where.log_prior] += log_stay;
        anchor(kind, one, anchors);
        normalise<F>(one.own + kind.where.x, anchors);
    }
}

// Onset of the hypothesis of each lane, and the lanes in which both elements are known.
struct Onsets {
    std::int64_t onset[lanes];
    Mask certain;

    Onsets(const Kind& kind, const Rows& rows) {
        for (int i = 0; i < lanes; ++i) {
            onset[i] = whole(rows.own[i], kind.where.onset);
            certain.put(i, whole(rows.own[i], kind.where.elements_known) != 0);
        }
    }
};

// Reference: `bank_update.marginalise_expired_ticks` of the first `count` hypotheses; `expired` are the ticks
// that have left the window.
template <class F>
void marginalise_expired_ticks(const Kind& kind, const Bank& bank, int count, const Ticks& expired,
                               const Lengths& lengths) {
    const BankLayout& where = kind.where;
    if (!expired.count) return;
    for (int first = 0; first < count; first += lanes) {  // they are in order of onset
        if (whole(bank.own.row(first), where.onset) > expired.newest()) return;
        const Rows rows = rows_of([&](int i) { return bank[std::min(first + i, count - 1)]; });
        Lanes x[F::S];
        read(rows.own, where.x, F::S, x);
        const Onsets begun(kind, rows);
        const EvidenceSums<F> sums = sum_evidence<F>(kind, x, begun.onset, begun.certain, expired, lengths);
        Lanes gain = read(rows.own, where.gain_before_window);
        for (int k = 0; k < F::K; ++k) gain += sums.gain[k];
        write(rows.own, where.llr_before_window, read(rows.own, where.llr_before_window) + sums.log_ratio);
        write(rows.own, where.gain_before_window, gain);
    }
}

// Gauss-Newton steps of a hypothesis per tick.
inline int steps_of(const Kind& kind, const Hypothesis& one) {
    return one.since[kind.since.effective_ticks] < settings.first_ticks ? settings.first_steps : 1;
}

// Reference: `refit.refit`, of hypotheses with this number of steps.
template <class F>
WIDE void refit(const Kind& kind, const Rows& rows, const Ticks& ticks, int steps,
                const EvidenceParameters& weights, Work<F>& work) {
    const BankLayout& where = kind.where;
    const Moments<F> window(kind, rows);
    const Onsets begun(kind, rows);
    Lanes x[F::S];
    read(rows.own, where.x, F::S, x);
    read_prior<F>(kind, rows, work.prior);
    descend<F>(window, x, steps, work);
    weigh_evidence<F>(kind, rows, x, weights,
                      sum_evidence<F>(kind, x, begun.onset, begun.certain, ticks, weights.lengths), work);
}

// Hypotheses to refit, grouped by the number of steps and by whether an element is known, as the lanes of a
// fit share both.
class RefitQueue {
public:
    void add(const Kind& kind, const Hypothesis& one, int steps) {
        const bool known = !is_nothing_known(kind, one.own);
        for (Group& group : groups_) {
            if (group.steps == steps && group.known == known) return group.all.push_back(one);
        }
        groups_.push_back({steps, known, {one}});
    }

    template <class F>
    void refit(const Kind& kind, const Ticks& ticks, const EvidenceParameters& weights, Work<F>& work) {
        for (Group& group : groups_) {
            for (std::size_t first = 0; first < group.all.size(); first += lanes) {
                const Rows rows = rows_of([&](int i) {  // the last one fills the remaining lanes
                    return group.all[std::min(first + i, group.all.size() - 1)];
                });
                kernels::refit<F>(kind, rows, ticks, group.steps, weights, work);
            }
        }
        groups_.clear();
    }

private:
    struct Group {
        int steps;
        bool known;
        std::vector<Hypothesis> all;
    };

    std::vector<Group> groups_;
};

}  // namespace kernels
