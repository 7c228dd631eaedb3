// Which hypotheses are dropped: as `bank.prune`.
#pragma once

#include <limits>

#include "table.hpp"

namespace kernels {

// Of so many ticks' onsets one is kept, and which span of them an onset is in.
struct Span {
    std::int64_t ticks, which;

    bool operator==(const Span& other) const { return ticks == other.ticks && which == other.which; }
};

inline Span span_of(std::int64_t onset, std::int64_t now) {
    const std::int64_t age = now + 1 - onset;
    if (age <= settings.young) return {1, onset};
    std::int64_t ticks = 2;
    while (age >= settings.young * ticks) ticks *= 2;
    return {ticks, onset / ticks};
}

// Of those whose onsets share a span, which stand beside each other; of equally good ones the first.
inline bool is_best(const Where& where, const Table& table, int b, std::int64_t now) {
    const auto span = [&](int c) { return span_of(whole(table.row(c), where.onset), now); };
    const double own = joint(where, table.row(b));
    if (span(b).ticks == 1) return true;
    for (int c = b - 1; c >= 0 && span(c) == span(b); --c) {
        if (joint(where, table.row(c)) >= own) return false;
    }
    for (int c = b + 1; c < table.count && span(c) == span(b); ++c) {
        if (joint(where, table.row(c)) > own) return false;
    }
    return true;
}

// Rows that are kept against the `best` joint log weight.
inline std::vector<std::int64_t> kept(const Kind& kind, const Bank& bank, std::int64_t now, double best,
                                      double margin) {
    std::vector<std::int64_t> rows;
    for (int b = 0; b < bank.count(); ++b) {
        const bool near = joint(kind.where, bank[b].own) > best - margin;
        if ((near || has_grace(kind, bank[b])) && is_best(kind.where, bank.own, b, now)) rows.push_back(b);
    }
    return rows;
}

// As `bank.residual`.
inline double residual_of(const Kind& kind, const Bank& bank) {
    double least = std::numeric_limits<double>::infinity(), rms = std::numeric_limits<double>::quiet_NaN();
    for (int b = 0; b < bank.count(); ++b) {
        const double told = bank.since(b)[kind.since.told];
        if (!(told >= settings.residual_ticks && told < least)) continue;
        least = told;
        rms = bank[b].own[kind.where.rms];
    }
    return rms;
}

}  // namespace kernels
