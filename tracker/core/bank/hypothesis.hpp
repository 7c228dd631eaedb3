// Layout of hypotheses: a row of a table for each, and a row shared by all of the same onset.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <cstring>
#include <stdexcept>
#include <vector>

#include "contacts/contact_models.hpp"

namespace kernels {

// First word of each column of `bank.Bank` in a row.
struct BankLayout {
    int onset, number, prior_index, known_pair_index, elements_known, needs_search, log_birth_weight,
        log_prior, llr_before_window, gain_before_window, log_likelihood, rms, prior_mean, prior_information,
        line_anchor, x, row_weight;
};

// First word of each column of `bank.Onsets` in a row.
struct OnsetLayout {
    int onset, onset_ns, weight, effective_ticks, weighted_position_sum, onset_row, second_moment;
};

// Reference: `contacts.ContactModel`. `needed` is the number of poses that determine the geometry,
// `lifted` (C,) the entries of a pose that the family uses, `pull` (S,) the precision of the weak prior,
// `relaxed` the number of starts from relaxed problems.
struct Kind {
    bool body_in_1;
    double needed, burn_in_ticks;
    std::vector<std::int64_t> lifted;
    std::vector<double> pull;
    int relaxed;
    BankLayout where;
    OnsetLayout since;
};

// `count` rows of `words` words of eight bytes: floating-point numbers or integers.
struct Table {
    double* data;
    int count, words;

    double* row(int b) const { return data + static_cast<std::size_t>(b) * words; }
};

inline std::int64_t whole(const double* row, int word) {
    std::int64_t value;
    std::memcpy(&value, row + word, sizeof value);
    return value;
}

inline void put_whole(double* row, int word, std::int64_t value) {
    std::memcpy(row + word, &value, sizeof value);
}

// Reference: `Bank.log_weight`.
inline double log_weight_of(const BankLayout& where, const double* row) {
    return row[where.log_birth_weight] + row[where.log_likelihood];
}

// Reference: `refit.are_near`.
inline bool is_near(const BankLayout& where, const double* row) {
    return log_weight_of(where, row) >= -settings.near_nats;
}

// The two rows of a hypothesis: its own, and that of its onset.
template <class Own, class Since>
struct Halves {
    Own own;
    Since since;
};

// Rows of one hypothesis, and of one hypothesis per lane.
using Hypothesis = Halves<double*, const double*>;
template <class Row>
using PerLane = std::array<Row*, lanes>;
using Rows = Halves<PerLane<double>, PerLane<const double>>;

// Rows of `hypothesis(i)` in lane i.
template <class Function>
Rows rows_of(Function&& hypothesis) {
    Rows rows;
    for (int i = 0; i < lanes; ++i) {
        const Hypothesis one = hypothesis(i);
        rows.own[i] = one.own;
        rows.since[i] = one.since;
    }
    return rows;
}

// Hypotheses of a contact in order of onset; onsets without hypotheses are allowed.
class Bank {
public:
    Table own, onsets;

    Bank(const Kind& kind, const Table& own, const Table& onsets)
        : own(own), onsets(onsets), since_(own.count) {
        for (int b = 0, o = 0; b < own.count; ++b) {
            if (b && whole(own.row(b), kind.where.onset) < whole(own.row(b - 1), kind.where.onset)) o = 0;
            while (o < onsets.count &&
                   whole(onsets.row(o), kind.since.onset) != whole(own.row(b), kind.where.onset))
                ++o;
            if (o == onsets.count) throw std::invalid_argument("a hypothesis without its onset");
            since_[b] = o;
        }
    }

    int count() const { return own.count; }
    Hypothesis operator[](int b) const { return {own.row(b), since(b)}; }
    const double* since(int b) const { return onsets.row(since_[b]); }
    int window_of(int b) const { return since_[b]; }

private:
    std::vector<int> since_;
};

// Reference: `global_search.in_burn_in`.
inline bool in_burn_in(const Kind& kind, const Hypothesis& one) {
    return one.since[kind.since.effective_ticks] <= kind.burn_in_ticks &&
           whole(one.own, kind.where.needs_search) != 0;
}

// Number at `word` of a row, or of each lane's row.
inline double read(const double* row, int word) { return row[word]; }
template <class Row>
Lanes read(const PerLane<Row>& rows, int word) {
    Lanes out;
    for (int i = 0; i < lanes; ++i) out.put(i, rows[i][word]);
    return out;
}

// `count` numbers from `word` on.
template <class R, class N>
void read(const R& rows, int word, int count, N* out) {
    for (int i = 0; i < count; ++i) out[i] = read(rows, word + i);
}

// Symmetric matrix (SIZE, SIZE) from its upper triangle in the rows.
template <int SIZE, class R, class N>
void read_symmetric(const R& rows, int word, N* out) {
    for (int i = 0; i < SIZE; ++i) {
        for (int j = i; j < SIZE; ++j) out[i * SIZE + j] = out[j * SIZE + i] = read(rows, word++);
    }
}

// Row `row(i)` of a table with `size` numbers a row, in lane i.
template <class Row>
void gather(const double* table, int size, Row&& row, Lanes* out) {
    for (int i = 0; i < lanes * size; ++i)
        out[i % size].put(i / size, table[row(i / size) * size + i % size]);
}

template <class Row>
void scatter(const Lanes* values, int size, Row&& row, double* table) {
    for (int i = 0; i < lanes * size; ++i)
        table[row(i / size) * size + i % size] = values[i % size][i / size];
}

inline void write(const PerLane<double>& rows, int word, const Lanes& values) {
    for (int i = 0; i < lanes; ++i) rows[i][word] = values[i];
}

inline void write(const PerLane<double>& rows, int word, int count, const Lanes* values) {
    for (int i = 0; i < count; ++i) write(rows, word + i, values[i]);
}

}  // namespace kernels
