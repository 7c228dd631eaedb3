// Update of all hypotheses of one contact by a tick. Reference: `bank_update.update_reference`.
#pragma once

#include "search/global_search.hpp"

namespace kernels {

// Reference: `births.Birth`. `words` are rows of hypotheses without data; `given` (n, S) marks the given
// entries of their geometry.
struct Birth {
    Table words;
    const bool* given;
    const double* turn;
    std::int64_t onset, onset_ns, number;
    double entry;
};

// Reference: `ContactModel.faced`, in place.
template <class F>
void face(const bool* given, const double* turn, double* x) {
    if constexpr (F::facing) {
        const bool first = given[F::d1], second = given[F::d2];
        const Vector m = at(x, F::d1), n = at(x, F::d2);
        if (first && !second) put(x, F::d2, turned(turn, 0, m));
        if (second && !first) put(x, F::d1, n.x * at(turn, 0) + n.y * at(turn, 3) + n.z * at(turn, 6));
    }
}

// Reference: `births.add`. Adds to a `table` (H + n, words) with `old` rows, and to `onsets`, of which the
// first `earlier` exist.
template <class F>
void add_births(const Kind& kind, int old, int earlier, const Birth& birth, const Table& table,
                const Table& onsets) {
    const BankLayout& where = kind.where;
    int best = 0;
    for (int b = 1; b < old; ++b) {
        if (log_weight_of(where, table.row(b)) > log_weight_of(where, table.row(best))) best = b;
    }
    std::copy_n(birth.words.data, static_cast<std::size_t>(birth.words.count) * table.words, table.row(old));
    for (int o = earlier; o < onsets.count; ++o) {
        std::fill_n(onsets.row(o), onsets.words, 0.0);
        put_whole(onsets.row(o), kind.since.onset, birth.onset);
        put_whole(onsets.row(o), kind.since.onset_ns, birth.onset_ns);
    }
    for (int i = 0; i < birth.words.count; ++i) {
        double *row = table.row(old + i), *x = row + where.x;
        put_whole(row, where.onset, birth.onset);
        put_whole(row, where.number, birth.number + i);
        row[where.log_birth_weight] = birth.entry;
        if (old) {
            std::copy_n(table.row(best) + where.x, F::S, x);
            std::copy_n(table.row(best) + where.row_weight, F::K, row + where.row_weight);
        } else {
            turn_world<F>(kind.body_in_1, birth.turn, x);
        }
        for (int s = 0; s < F::S; ++s) {
            if (birth.given[i * F::S + s]) x[s] = row[where.prior_mean + s];
        }
        face<F>(birth.given + i * F::S, birth.turn, x);
    }
}

// The group of a hypothesis in `global_search.select_for_search`; -1 if it does
// not search.
inline int group_of(const Kind& kind, const Hypothesis& one) {
    const BankLayout& where = kind.where;
    const double *row = one.own, effective_ticks = one.since[kind.since.effective_ticks];
    if (!is_near(where, row) && !in_burn_in(kind, one)) return -1;
    const int age =
        static_cast<int>(std::min(effective_ticks, static_cast<double>(settings.is_search_age.size() - 1)));
    if (!(settings.is_search_age[age] && row[where.rms] > settings.fitting_rms &&
          whole(row, where.needs_search) != 0))
        return -1;
    const auto passed =
        std::upper_bound(settings.search_ages.begin(), settings.search_ages.end(), effective_ticks) -
        settings.search_ages.begin();
    return 2 * static_cast<int>(passed) + (whole(row, where.prior_index) > 0);
}

// Reference: `global_search.select_for_search`.
inline std::vector<int> select_for_search(const Kind& kind, const Bank& bank) {
    std::vector<int> best(2 * (settings.search_ages.size() + 1), -1);
    for (int b = 0; b < bank.count(); ++b) {
        const int group = group_of(kind, bank[b]);
        if (group < 0) continue;
        int& rival = best[group];
        if (rival < 0) {
            rival = b;
            continue;
        }
        const double rival_weight = log_weight_of(kind.where, bank[rival].own);
        if (log_weight_of(kind.where, bank[b].own) > rival_weight || std::isnan(rival_weight)) rival = b;
    }
    best.erase(std::remove(best.begin(), best.end(), -1), best.end());
    return best;
}

// Update a `bank` of `old` hypotheses followed by the births of the tick. `expired` are the ticks that have
// left the window; with `directions` it also searches.
template <class F>
void advance(const Kind& kind, const Bank& bank, int old, const Ticks& ticks, const Ticks& expired,
             const EvidenceParameters& weights, double log_stay, const Directions* directions) {
    Work<F> work;
    RefitQueue queue;
    const double motion_ratio = ticks.motion_ratio();
    marginalise_expired_ticks<F>(kind, bank, old, expired, weights.lengths);
    accumulate<F>(kind, bank, ticks, weights.lengths, motion_ratio, log_stay);
    std::vector<double> was(bank.count());
    for (int b = 0; b < bank.count(); ++b) {
        was[b] = log_weight_of(kind.where, bank[b].own);
        if (is_near(kind.where, bank[b].own) || directions) queue.add(kind, bank[b], steps_of(kind, bank[b]));
    }
    queue.refit<F>(kind, ticks, weights, work);
    for (int b = 0; b < bank.count(); ++b) {  // reference: `refit.recover_fallen`
        const double* row = bank[b].own;
        const bool falls = log_weight_of(kind.where, row) < was[b] - settings.decisive;
        if (was[b] >= -settings.near_nats && falls && row[kind.where.rms] > settings.fitting_rms)
            queue.add(kind, bank[b], settings.recovery_steps);
    }
    queue.refit<F>(kind, ticks, weights, work);
    if (!directions || motion_ratio <= settings.rest_weight) return;
    for (int b : select_for_search(kind, bank)) search<F>(kind, bank, b, *directions, ticks, weights, work);
}

// Reference: `bank_update.fit_window`, of hypotheses whose ticks are accumulated.
template <class F>
void fit(const Kind& kind, const Bank& bank, const Ticks& ticks, const Directions& directions,
         const EvidenceParameters& weights) {
    Work<F> work;
    RefitQueue queue;
    for (int b = 0; b < bank.count(); ++b) queue.add(kind, bank[b], steps_of(kind, bank[b]));
    queue.refit<F>(kind, ticks, weights, work);
    for (int b = 0; b < bank.count(); ++b) {
        if (whole(bank[b].own, kind.where.needs_search) != 0)
            search<F>(kind, bank, b, directions, ticks, weights, work);
    }
}

}  // namespace kernels
