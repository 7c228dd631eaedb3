// Pruning of hypotheses. Reference: `global_search.prune`.
#pragma once

#include <limits>

#include "bank/hypothesis.hpp"

namespace kernels {

// Span of onsets of which one hypothesis is kept: its length (ticks) and its index.
struct Span {
    std::int64_t ticks, which;

    bool operator==(const Span& other) const { return ticks == other.ticks && which == other.which; }
};

inline Span span_of(std::int64_t onset, std::int64_t now) {
    const std::int64_t age = now + 1 - onset;
    if (age <= settings.unthinned_ticks) return {1, onset};
    std::int64_t ticks = 2;
    while (age >= settings.unthinned_ticks * ticks) ticks *= 2;
    return {ticks, onset / ticks};
}

// Joint log weight of a hypothesis, and its span; hypotheses of one span are adjacent.
struct Rival {
    Span span;
    double joint;
};

inline std::vector<Rival> rivals_of(const BankLayout& where, const Table& table, std::int64_t now) {
    std::vector<Rival> rivals(table.count);
    for (int b = 0; b < table.count; ++b) {
        const std::int64_t onset = whole(table.row(b), where.onset);
        const bool again = b && onset == whole(table.row(b - 1), where.onset);
        rivals[b] = {again ? rivals[b - 1].span : span_of(onset, now), log_weight_of(where, table.row(b))};
    }
    return rivals;
}

// Whether row b is the best of its span; the first of equal ones.
inline bool is_best(const std::vector<Rival>& rivals, int b) {
    const auto& [span, own] = rivals[b];
    if (span.ticks == 1) return true;
    for (int c = b - 1; c >= 0 && rivals[c].span == span; --c) {
        if (rivals[c].joint >= own) return false;
    }
    for (int c = b + 1; c < static_cast<int>(rivals.size()) && rivals[c].span == span; ++c) {
        if (rivals[c].joint > own) return false;
    }
    return true;
}

// Rows to keep, given the `best` joint log weight of all states.
inline std::vector<std::int64_t> rows_to_keep(const Kind& kind, const Bank& bank, std::int64_t now,
                                              double best, double margin) {
    std::vector<std::int64_t> rows;
    const std::vector<Rival> rivals = rivals_of(kind.where, bank.own, now);
    for (int b = 0; b < bank.count(); ++b) {
        const bool near = rivals[b].joint > best - margin;
        if ((near || in_burn_in(kind, bank[b])) && is_best(rivals, b)) rows.push_back(b);
    }
    return rows;
}

// Reference: `global_search.residual`.
inline double residual_of(const Kind& kind, const Bank& bank) {
    double least = std::numeric_limits<double>::infinity(), rms = std::numeric_limits<double>::quiet_NaN();
    for (int b = 0; b < bank.count(); ++b) {
        const double ticks = bank.since(b)[kind.since.effective_ticks];
        if (!(ticks >= settings.unthinned_ticks && ticks < least)) continue;
        least = ticks;
        rms = bank[b].own[kind.where.rms];
    }
    return rms;
}

}  // namespace kernels
