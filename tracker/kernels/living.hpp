// What lives on after a tick: as `hypotheses.advance`.
#pragma once

#include <limits>
#include <memory>
#include <optional>
#include <utility>
#include <vector>

#include "bindings.hpp"
#include "dropping.hpp"

namespace kernels {

// What is left of a contact after a tick: which `rows` of its table are kept, and these, in `words`, with
// their `onsets`; the log of the sum of their weights, the residual that is told of them, and the best of
// them, -1 without any.
struct Left {
    Ints rows;
    Floats words, onsets;
    double log_weight, residual;
    std::int64_t leader;
};

// The first rows of a table, as a part of it.
inline Floats front(const Floats& table, py::ssize_t count) {
    const auto size = static_cast<py::ssize_t>(sizeof(double));
    const std::vector<py::ssize_t> shape{count, table.shape(1)}, strides{table.shape(1) * size, size};
    return Floats(shape, strides, table.data(), table);
}

// They move to the front of `words`, and their onsets to that of `onsets`; weights are against `best`.
inline Left left_of(const Model& model, Floats& words, Floats& onsets, std::int64_t now, double best,
                    double margin) {
    const Kind& kind = model.kind;
    const Bank bank = changing(model, words, onsets);
    for (int b = 1; b < bank.count(); ++b)
        require(bank.window_of(b - 1) <= bank.window_of(b), "hypotheses are not in order of onset");
    const std::vector<std::int64_t> rows = kept(kind, bank, now, best, margin);
    const auto count = static_cast<py::ssize_t>(rows.size());
    double top = -std::numeric_limits<double>::infinity(), sum = 0.0;
    std::int64_t leader = -1;
    int begun = 0;
    for (int i = 0, before = -1; i < count; ++i) {
        const int b = static_cast<int>(rows[i]), onset = bank.window_of(b);
        double* row = bank.own.row(i);
        if (b != i) std::copy_n(bank.own.row(b), model.words, row);
        if (onset != before && onset != begun)
            std::copy_n(bank.onsets.row(onset), model.onset_words, bank.onsets.row(begun));
        begun += onset != before;
        before = onset;
        row[kind.where.entry] -= best;
        if (i && !(joint(kind.where, row) > top)) continue;
        top = joint(kind.where, row);
        leader = i;
    }
    for (int i = 0; i < count; ++i) sum += std::exp(joint(kind.where, bank.own.row(i)) - top);
    const Floats left = front(words, count), since = front(onsets, begun);
    return {Ints(count, rows.data()),
            left,
            since,
            rows.empty() ? top : top + std::log(sum),
            residual_of(kind, bank_of(model, left, since)),
            leader};
}

// As `hypotheses.Moment`, with what is `assumed` of each contact by what begins, and random `directions`
// where it searches.
struct Moment {
    std::vector<std::pair<Floats, Bools>> assumed;
    std::vector<std::optional<Floats>> directions;
    Floats turn;
    std::int64_t onset, onset_ns, stamp_ns;
    std::shared_ptr<Seeable> window, before;
    Floats change, log_stay;
};

// What is told of a contact's hypotheses when a tick begins.
struct Task {
    const Model& model;
    int old;               // so many before the tick
    Floats words, onsets;  // in it
    Ticks ticks, gone;
    double log_stay;
    std::optional<Directions> directions;
};

// As `hypotheses.Alive`, `now` and free motion last.
inline py::tuple alive_of(const std::vector<const Model*>& models, const std::vector<Left>& left,
                          std::int64_t now) {
    py::ssize_t count = 1, b = 0;
    for (const Left& one : left) count += one.words.shape(0);
    Ints state(count), onset(count);
    Floats log_likelihood(count);
    const auto put = [&](std::size_t of, std::int64_t since, double told) {
        state.mutable_at(b) = static_cast<std::int64_t>(of);
        onset.mutable_at(b) = since;
        log_likelihood.mutable_at(b++) = told;
    };
    for (std::size_t i = 0; i < left.size(); ++i) {
        const Where& where = models[i]->kind.where;
        const Table table = table_of(left[i].words, models[i]->words);
        for (int h = 0; h < table.count; ++h)
            put(i, whole(table.row(h), where.onset), table.row(h)[where.log_likelihood]);
    }
    put(left.size(), now, 0.0);
    return py::make_tuple(state, onset, log_likelihood);
}

// As `hypotheses.Weighed`, with what is left of each contact.
struct Lived {
    std::vector<Left> left;
    Floats entry, log_left, residual;
    Ints leaders;
};

// Tables of the hypotheses of each contact and of their onsets.
using Tables = std::vector<std::pair<Floats, Floats>>;

// All contacts through a tick; what begins is numbered from `number` on, which goes on to the next. What is
// kept is so against the best of all and of free motion, whose `entry` is the last.
inline Lived live(const std::vector<const Model*>& models, const Tables& words, const Moment& moment,
                  std::int64_t& number, const Floats& entry, const std::vector<Two>& beyond,
                  const Weights& weights, double margin) {
    const std::size_t contacts = models.size();
    for (std::size_t size : {moment.assumed.size(), moment.directions.size()})
        require(size == contacts, "something is not told of each contact");
    const auto states = static_cast<py::ssize_t>(contacts) + 1;
    require_shape(moment.turn, {3, 3}, "a turn is a matrix");
    require_shape(moment.log_stay, {states}, "states do not have one chance to stay each");
    std::vector<Task> all;
    for (std::size_t i = 0; i < contacts; ++i) {
        const Model& model = *models[i];
        const auto& [born, told] = moment.assumed[i];
        const Table old = table_of(words[i].first, model.words), fresh = table_of(born, model.words);
        const Table earlier = table_of(words[i].second, model.onset_words);
        const int size = visit(model, [](auto family) { return decltype(family)::S; });
        require_shape(told, {fresh.count, size}, "what is told is not of these births");
        const Birth birth{fresh,           told.data(), moment.turn.data(), moment.onset,
                          moment.onset_ns, number,      entry.at(i)};
        number += fresh.count;
        const Ticks ticks = moment.window->ticks(model, beyond[i]);
        Ticks gone = (moment.before ? *moment.before : *moment.window).ticks(model, beyond[i]);
        gone.count = moment.before ? std::max(gone.count + 1 - ticks.count, 0) : 0;
        Floats both({old.count + fresh.count, old.words});
        Floats onsets({earlier.count + (fresh.count > 0), earlier.words});
        const Table all_rows = table_of(both, model.words), all_onsets = table_of(onsets, model.onset_words);
        visit(model, [&](auto family) {
            join<decltype(family)>(model.kind, old, earlier, birth, all_rows, all_onsets);
        });
        all.push_back({model, old.count, both, onsets, ticks, gone, moment.log_stay.at(i), std::nullopt});
        if (moment.directions[i])
            all[i].directions = directions_of(model, *moment.directions[i], moment.turn);
    }
    double best = entry.at(contacts);
    for (Task& one : all) {
        const Bank bank = changing(one.model, one.words, one.onsets);
        visit(one.model, [&](auto family) {
            py::gil_scoped_release release;
            advance<decltype(family)>(one.model.kind, bank, one.old, one.ticks, one.gone, weights,
                                      one.log_stay, one.directions ? &*one.directions : nullptr);
        });
        for (int b = 0; b < bank.count(); ++b)
            best = std::max(best, joint(one.model.kind.where, bank[b].own));
    }
    Lived lived{{}, entry, Floats(states), Floats(states - 1), Ints(states - 1)};
    for (std::size_t i = 0; i < contacts; ++i) {
        Task& one = all[i];  // who has not searched may only have lost its minimum
        const double least = one.directions ? margin : std::numeric_limits<double>::infinity();
        lived.left.push_back(left_of(one.model, one.words, one.onsets, moment.onset, best, least));
        lived.log_left.mutable_at(i) = lived.left[i].log_weight;
        lived.residual.mutable_at(i) = lived.left[i].residual;
        lived.leaders.mutable_at(i) = lived.left[i].leader;
    }
    lived.log_left.mutable_at(contacts) = entry.at(contacts) - best;
    number += 1;  // of free motion
    return lived;
}

}  // namespace kernels
