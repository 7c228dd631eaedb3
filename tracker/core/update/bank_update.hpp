// Update of all banks by one tick. Reference: `bank_update.update_reference`.
#pragma once

#include <limits>
#include <memory>
#include <optional>
#include <utility>
#include <vector>

#include "bank/pruning.hpp"
#include "python/numpy_views.hpp"

namespace kernels {

// View of the first rows of a table.
inline Floats front(const Floats& table, py::ssize_t count) {
    const auto size = static_cast<py::ssize_t>(sizeof(double));
    const std::vector<py::ssize_t> shape{count, table.shape(1)}, strides{table.shape(1) * size, size};
    return Floats(shape, strides, table.data(), table);
}

// The hypotheses of a contact and their onsets, in tables with room for births.
class GrowingBank {
public:
    // With room for `more` hypotheses and `more_onsets` onsets.
    GrowingBank(const Model& model, const Floats& words, const Floats& onsets, py::ssize_t more,
                py::ssize_t more_onsets)
        : words_({words.shape(0) + more, py::ssize_t(model.words)}),
          onsets_({onsets.shape(0) + more_onsets, py::ssize_t(model.onset_words)}),
          count_(table_of(words, model.words).count),
          since_(table_of(onsets, model.onset_words).count) {
        std::copy_n(words.data(), words.size(), words_.mutable_data());
        std::copy_n(onsets.data(), onsets.size(), onsets_.mutable_data());
    }

    // The tables, with `more` rows.
    Table own(int more = 0) { return rows_of_table(words_, count_ + more); }
    Table onsets(int more = 0) { return rows_of_table(onsets_, since_ + more); }
    int count() const { return count_; }
    int since() const { return since_; }
    // Keep the first rows only.
    void keep(int count, int since) {
        count_ = count;
        since_ = since;
    }
    std::pair<Floats, Floats> left() const { return {front(words_, count_), front(onsets_, since_)}; }

private:
    static Table rows_of_table(Floats& table, int count) {
        require(count <= table.shape(0), "there is no room for what begins");
        return {table.mutable_data(), count, static_cast<int>(table.shape(1))};
    }

    Floats words_, onsets_;
    int count_, since_;
};

// A contact's hypotheses after a tick: the `rows` of its table that are kept, the log of the sum of their
// weights, their residual, and the row of the best one, its onset, and the time of that (-1 without any).
struct KeptHypotheses {
    std::vector<std::int64_t> rows;
    double log_weight, residual;
    std::array<std::int64_t, 3> leader;
};

// Prune: move the rows kept to the front of the tables, with weights relative to `best`.
inline KeptHypotheses keep_best(const Kind& kind, const Bank& bank, std::int64_t now, double best,
                                double margin, GrowingBank& growing) {
    for (int b = 1; b < bank.count(); ++b)
        require(bank.window_of(b - 1) <= bank.window_of(b), "hypotheses are not in order of onset");
    const std::vector<std::int64_t> rows = rows_to_keep(kind, bank, now, best, margin);
    const int count = static_cast<int>(rows.size());
    double top = -std::numeric_limits<double>::infinity(), sum = 0.0;
    int leader = -1;
    int begun = 0;
    for (int i = 0, before = -1; i < count; ++i) {
        const int b = static_cast<int>(rows[i]), onset = bank.window_of(b);
        double* row = bank.own.row(i);
        if (b != i) std::copy_n(bank.own.row(b), bank.own.words, row);
        if (onset != before && onset != begun)
            std::copy_n(bank.onsets.row(onset), bank.onsets.words, bank.onsets.row(begun));
        begun += onset != before;
        before = onset;
        row[kind.where.log_birth_weight] -= best;
        if (i && !(log_weight_of(kind.where, row) > top)) continue;
        top = log_weight_of(kind.where, row);
        leader = i;
    }
    for (int i = 0; i < count; ++i) sum += std::exp(log_weight_of(kind.where, bank.own.row(i)) - top);
    growing.keep(count, begun);
    const Bank kept(kind, growing.own(), growing.onsets());
    std::array<std::int64_t, 3> first{-1, -1, -1};
    if (leader >= 0)
        first = {leader, whole(kept[leader].own, kind.where.onset),
                 whole(kept[leader].since, kind.since.onset_ns)};
    return {rows, rows.empty() ? top : top + std::log(sum), residual_of(kind, kept), first};
}

// Reference: the arguments of `bank_update.update_banks`. `assumed` are the births of each contact.
struct TickInput {
    std::vector<std::pair<Floats, Bools>> assumed;
    Floats turn;
    std::int64_t onset, onset_ns;
    std::shared_ptr<TickArrays> window, before;
    Floats log_stay;
};

// Input of the update of one contact's hypotheses by a tick.
struct ContactTask {
    const Model& model;
    int old;    // hypotheses before the tick
    Bank bank;  // with the births of the tick
    Ticks ticks, expired;
    double log_stay;
    std::optional<Directions> directions;
};

// Reference: `bank_update.LiveHypotheses`; free motion, with the onset `now`, is last.
inline py::tuple live_hypotheses(const std::vector<const Model*>& models, std::vector<GrowingBank>& growing,
                                 std::int64_t now) {
    py::ssize_t count = 1, b = 0;
    for (const GrowingBank& one : growing) count += one.count();
    Ints state(count), onset(count);
    Floats log_likelihood(count);
    std::int64_t *states = state.mutable_data(), *onsets = onset.mutable_data();
    double* values = log_likelihood.mutable_data();
    const auto put = [&](std::size_t of, std::int64_t since, double likelihood) {
        states[b] = static_cast<std::int64_t>(of);
        onsets[b] = since;
        values[b++] = likelihood;
    };
    for (std::size_t i = 0; i < growing.size(); ++i) {
        const BankLayout& where = models[i]->kind.where;
        const Table table = growing[i].own();
        for (int h = 0; h < table.count; ++h)
            put(i, whole(table.row(h), where.onset), table.row(h)[where.log_likelihood]);
    }
    put(growing.size(), now, 0.0);
    return py::make_tuple(state, onset, log_likelihood);
}

// Reference: `bank_update.TickWeights`, and the hypotheses kept of each contact.
struct BankUpdate {
    std::vector<KeptHypotheses> left;
    Floats entry, log_left, residual;
    Ints leaders;
};

// The input of a contact's update by a tick; adds the births to the bank `growing`.
inline ContactTask task_for(const Model& model, std::size_t i, const TickInput& input, std::int64_t number,
                            double entry, const Two& beyond, GrowingBank& growing) {
    const auto& [born, given] = input.assumed[i];
    const Table fresh = table_of(born, model.words);
    const int size = visit(model, [](auto family) { return decltype(family)::S; }), old = growing.count();
    require_shape(given, {fresh.count, size}, "what is given is not of these births");
    const Birth birth{fresh, given.data(), input.turn.data(), input.onset, input.onset_ns, number, entry};
    const Ticks ticks = input.window->ticks(model, beyond);
    Ticks expired = (input.before ? *input.before : *input.window).ticks(model, beyond);
    expired.count = input.before ? std::max(expired.count + 1 - ticks.count, 0) : 0;
    const Table rows = growing.own(fresh.count), onsets = growing.onsets(fresh.count > 0);
    visit(model, [&](auto family) {
        add_births<decltype(family)>(model.kind, old, growing.since(), birth, rows, onsets);
    });
    std::optional<Directions> directions;
    if (model.is_due(input.onset)) directions = model.directions(input.onset, input.turn);
    return {model, old, Bank(model.kind, rows, onsets), ticks, expired, input.log_stay.at(i), directions};
}

// Update all contacts by a tick. Births are numbered from `number` on, which is advanced. Pruning is
// relative to the best hypothesis of all contacts and of free motion, whose `entry` is the last.
inline BankUpdate update_banks(const std::vector<const Model*>& models, std::vector<GrowingBank>& growing,
                               const TickInput& input, std::int64_t& number, const Floats& entry,
                               const std::vector<Two>& beyond, const EvidenceParameters& weights,
                               double margin) {
    const std::size_t contacts = models.size();
    const auto states = static_cast<py::ssize_t>(contacts) + 1;
    require_finite(input.turn, {3, 3}, "a turn is a matrix of finite numbers");
    require_shape(input.log_stay, {states}, "states do not have one chance to stay each");
    std::vector<ContactTask> all;
    for (std::size_t i = 0; i < contacts; ++i) {
        all.push_back(task_for(*models[i], i, input, number, entry.at(i), beyond[i], growing[i]));
        number += input.assumed[i].first.shape(0);
    }
    double best = entry.at(contacts);
    for (ContactTask& one : all) {
        visit(one.model, [&](auto family) {
            py::gil_scoped_release release;
            advance<decltype(family)>(one.model.kind, one.bank, one.old, one.ticks, one.expired, weights,
                                      one.log_stay, one.directions ? &*one.directions : nullptr);
        });
        for (int b = 0; b < one.bank.count(); ++b)
            best = std::max(best, log_weight_of(one.model.kind.where, one.bank[b].own));
    }
    BankUpdate updated{{}, entry, Floats(states), Floats(states - 1), Ints({states - 1, py::ssize_t(3)})};
    for (std::size_t i = 0; i < contacts; ++i) {
        ContactTask& one = all[i];  // without a search, a poor hypothesis may only have lost its minimum
        const double least = one.directions ? margin : std::numeric_limits<double>::infinity();
        updated.left.push_back(keep_best(one.model.kind, one.bank, input.onset, best, least, growing[i]));
        updated.log_left.mutable_at(i) = updated.left[i].log_weight;
        updated.residual.mutable_at(i) = updated.left[i].residual;
        std::copy_n(updated.left[i].leader.data(), 3, updated.leaders.mutable_data(i, 0));
    }
    updated.log_left.mutable_at(contacts) = entry.at(contacts) - best;
    number += 1;  // of free motion
    return updated;
}

// Tables of the hypotheses of each contact and of their onsets.
using Tables = std::vector<std::pair<Floats, Floats>>;

// Update the tables by a tick. `entry` are the log birth weights of the states. Reference:
// `bank_update.update_reference`.
inline py::tuple update_tables(const std::vector<const Model*>& models, const Tables& words,
                               std::vector<std::pair<Floats, Bools>> assumed, Floats turn, std::int64_t onset,
                               std::int64_t onset_ns, std::int64_t number, const Floats& entry,
                               std::shared_ptr<TickArrays> window, std::shared_ptr<TickArrays> before,
                               Floats log_stay, const std::vector<Two>& beyond,
                               const EvidenceParameters& weights, double margin) {
    for (std::size_t size : {words.size(), beyond.size(), assumed.size()})
        require(size == models.size(), "an entry per contact is missing");
    require(std::count(models.begin(), models.end(), nullptr) == 0, "a contact is None");
    require(window != nullptr, "there is no window");
    require_shape(entry, {static_cast<py::ssize_t>(models.size()) + 1}, "states do not have one entry each");
    const TickInput input{std::move(assumed), std::move(turn),    onset, onset_ns, std::move(window),
                          std::move(before),  std::move(log_stay)};
    std::vector<GrowingBank> growing;  // copies of the tables, with room for all births
    for (std::size_t i = 0; i < models.size(); ++i) {
        const py::ssize_t many = input.assumed[i].first.shape(0);
        growing.emplace_back(*models[i], words[i].first, words[i].second, many, many > 0);
    }
    const BankUpdate updated = update_banks(models, growing, input, number, entry, beyond, weights, margin);
    py::list kept, rows;
    for (std::size_t i = 0; i < models.size(); ++i) {
        const std::vector<std::int64_t>& left = updated.left[i].rows;
        kept.append(growing[i].left());
        rows.append(Ints(left.size(), left.data()));
    }
    const auto weighed = py::make_tuple(updated.entry, updated.log_left, updated.residual, updated.leaders,
                                        live_hypotheses(models, growing, input.onset));
    return py::make_tuple(kept, rows, weighed);
}

}  // namespace kernels
