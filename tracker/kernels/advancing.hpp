// What `hypotheses.advance` does to all hypotheses of one contact in a tick.
#pragma once

#include "offering.hpp"
#include "searching.hpp"

namespace kernels {

// As `bank.Birth`: `words` of hypotheses that have seen nothing, what (n, S) is `told` of their geometry.
struct Birth {
    Table words;
    const bool* told;
    const double* turn;
    std::int64_t onset, onset_ns, number;
    double entry;
};

// As `ContactModel.faced`, in place.
template <class F>
void face(const bool* told, const double* turn, double* x) {
    if constexpr (!F::apart) {
        const bool first = told[F::d1], second = told[F::d2];
        const Vector m = at(x, F::d1), n = at(x, F::d2);
        if (first && !second) put(x, F::d2, turned(turn, 0, m));
        if (second && !first) put(x, F::d1, n.x * at(turn, 0) + n.y * at(turn, 3) + n.z * at(turn, 6));
    }
}

// As `bank.add`, into `table` (H + n, words).
template <class F>
void join(const Kind& kind, const Table& old, const Birth& birth, const Table& table) {
    const Where& where = kind.where;
    int best = 0;
    for (int b = 1; b < old.count; ++b) {
        if (joint(where, old.row(b)) > joint(where, old.row(best))) best = b;
    }
    std::copy_n(old.data, static_cast<std::size_t>(old.count) * old.words, table.data);
    std::copy_n(birth.words.data, static_cast<std::size_t>(birth.words.count) * old.words,
                table.row(old.count));
    for (int i = 0; i < birth.words.count; ++i) {
        double *row = table.row(old.count + i), *x = row + where.x;
        put_whole(row, where.onset, birth.onset);
        put_whole(row, where.onset_ns, birth.onset_ns);
        put_whole(row, where.number, birth.number + i);
        row[where.entry] = birth.entry;
        if (old.count) {
            std::copy_n(old.row(best) + where.x, F::S, x);
            std::copy_n(old.row(best) + where.row_weight, F::K, row + where.row_weight);
        } else {
            turn_world<F>(kind.body_in_1, birth.turn, x);
        }
        for (int s = 0; s < F::S; ++s) {
            if (birth.told[i * F::S + s]) x[s] = row[where.known_mean + s];
        }
        face<F>(birth.told + i * F::S, birth.turn, x);
    }
}

// Let hypotheses take geometry that others offer.
template <class F>
void adopt(const Kind& kind, const Table& table, const Ticks& ticks, const Weights& weights, Work<F>& work) {
    const std::vector<int> giver = givers<F>(kind, table);
    std::vector<double> offered(static_cast<std::size_t>(table.count) * F::S);
    for (int b = 0; b < table.count; ++b) std::copy_n(table.row(b) + kind.where.x, F::S, &offered[b * F::S]);
    Learners learners;
    for (int b = 0; b < table.count; ++b) {
        if (giver[b] == b) continue;
        double* row = table.row(b);
        std::copy_n(&offered[giver[b] * F::S], F::S, row + kind.where.x);
        learners.add(kind, row, steps_of(kind, row));
    }
    learners.learn<F>(kind, ticks, weights, work);
}

// Of a hypothesis, as in `search.lost`; -1 if it does not search.
inline int group_of(const Kind& kind, const double* row) {
    const Where& where = kind.where;
    if (!may_win(kind, row)) return -1;
    const double told = row[where.told];
    const int age = static_cast<int>(std::min(told, static_cast<double>(settings.due.size() - 1)));
    if (!(settings.due[age] && row[where.rms] > settings.at_the_noise && whole(row, where.searched) != 0))
        return -1;
    const auto passed =
        std::upper_bound(settings.ages.begin(), settings.ages.end(), told) - settings.ages.begin();
    return 2 * static_cast<int>(passed) + (whole(row, where.source) > 0);
}

// As `search.lost`.
inline std::vector<int> lost(const Kind& kind, const Table& table) {
    std::vector<int> best(2 * (settings.ages.size() + 1), -1);
    for (int b = 0; b < table.count; ++b) {
        const int group = group_of(kind, table.row(b));
        if (group < 0) continue;
        int& rival = best[group];
        if (rival < 0) {
            rival = b;
            continue;
        }
        const double held = joint(kind.where, table.row(rival));
        if (joint(kind.where, table.row(b)) > held || std::isnan(held)) rival = b;
    }
    best.erase(std::remove(best.begin(), best.end(), -1), best.end());
    return best;
}

// `table` (H + n, words) of the `old` hypotheses and those of a `birth`, whose window has lost some that are
// `gone`; with `directions` they search as well.
template <class F>
void advance(const Kind& kind, const Table& old, const Birth& birth, const Table& table, const Ticks& ticks,
             const Ticks& gone, const Weights& weights, double log_stay, const Directions* directions) {
    Work<F> work;
    Learners learners;
    const double heard = ticks.heard();
    std::vector<double> was(table.count);
    join<F>(kind, old, birth, table);
    settle<F>(kind, table, old.count, gone, weights.lengths);
    for (int b = 0; b < table.count; ++b) {
        double* row = table.row(b);
        const bool begins = b >= old.count;
        was[b] = joint(kind.where, row);
        // what assumes met elements begins with them: one tick, which is given, changes no weight
        const bool idle = (waits(kind, row) && !directions) || (begins && whole(row, kind.where.met) != 0);
        grow<F>(kind, row, ticks, heard, log_stay);
        if (!idle) learners.add(kind, row, steps_of(kind, row));
    }
    learners.learn<F>(kind, ticks, weights, work);
    for (int b = 0; b < table.count; ++b) {
        if (fell(kind, table.row(b), was[b])) learners.add(kind, table.row(b), settings.fallen_steps);
    }
    learners.learn<F>(kind, ticks, weights, work);
    if (!directions) return;
    adopt<F>(kind, table, ticks, weights, work);
    if (heard <= settings.at_rest) return;
    for (int b : lost(kind, table)) search<F>(kind, table, b, *directions, ticks, weights, work);
}

}  // namespace kernels
