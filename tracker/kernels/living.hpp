// What lives on after a tick: as `hypotheses.advance`.
#pragma once

#include <limits>
#include <optional>
#include <utility>
#include <vector>

#include "bindings.hpp"
#include "dropping.hpp"

namespace kernels {

// What is left of a contact after a tick: which `rows` of its table are kept, and these, in `words`; the log
// of the sum of their weights, the residual that is told of them, and the best of them, -1 without any.
struct Left {
    Ints rows;
    Floats words;
    double log_weight, residual;
    std::int64_t leader;
};

// They move to the front of `words`, of which what is returned is a part; weights are against `best`.
inline Left left_of(const Model& model, Floats& words, std::int64_t now, double best, double margin) {
    const Where& where = model.kind.where;
    const Table table = changing(model, words);
    const std::vector<std::int64_t> rows = kept(model.kind, table, now, best, margin);
    const auto count = static_cast<py::ssize_t>(rows.size()), wide = static_cast<py::ssize_t>(model.words);
    double top = -std::numeric_limits<double>::infinity(), sum = 0.0;
    std::int64_t leader = -1;
    for (int i = 0; i < count; ++i) {
        double* row = table.row(i);
        if (rows[i] != i) std::copy_n(table.row(static_cast<int>(rows[i])), model.words, row);
        row[where.entry] -= best;
        if (i && !(joint(where, row) > top)) continue;
        top = joint(where, row);
        leader = i;
    }
    for (int i = 0; i < count; ++i) sum += std::exp(joint(where, table.row(i)) - top);
    const auto size = static_cast<py::ssize_t>(sizeof(double));
    const std::vector<py::ssize_t> shape{count, wide}, strides{wide * size, size};
    return {Ints(count, rows.data()), Floats(shape, strides, words.data(), words),
            rows.empty() ? top : top + std::log(sum), residual_of(where, table, static_cast<int>(count)),
            leader};
}

// What is told of a contact's hypotheses when a tick begins.
struct Task {
    const Model& model;
    Table old;     // before the tick
    Floats words;  // in it
    Birth birth;
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
        const Table table = table_of(*models[i], left[i].words);
        for (int h = 0; h < table.count; ++h)
            put(i, whole(table.row(h), where.onset), table.row(h)[where.log_likelihood]);
    }
    put(left.size(), now, 0.0);
    return py::make_tuple(state, onset, log_likelihood);
}

// All contacts through a tick, before which the window had the ticks `before`, and what is kept against the
// best of all and of free motion, whose `entry` is the last.
inline py::tuple advanced(const std::vector<const Model*>& models, const std::vector<Floats>& words,
                          const std::vector<std::pair<Floats, Bools>>& assumed, const Floats& turn,
                          std::int64_t onset, std::int64_t onset_ns, std::int64_t number, const Floats& entry,
                          const Seeable& window, const Seeable* before, const std::vector<Two>& beyond,
                          const Weights& weights, const Floats& log_stay, double margin,
                          const std::vector<std::optional<Floats>>& directions) {
    const std::size_t contacts = models.size();
    for (std::size_t size : {words.size(), assumed.size(), beyond.size(), directions.size()})
        require(size == contacts, "something is not told of each contact");
    require(std::count(models.begin(), models.end(), nullptr) == 0, "a contact is None");
    const auto states = static_cast<py::ssize_t>(contacts) + 1;
    require_shape(turn, {3, 3}, "a turn is a matrix");
    require_shape(entry, {states}, "states do not have one entry each");
    require_shape(log_stay, {states}, "states do not have one chance to stay each");
    std::vector<Task> all;
    for (std::size_t i = 0; i < contacts; ++i) {
        const Model& model = *models[i];
        const auto& [born, told] = assumed[i];
        const Table old = table_of(model, words[i]), fresh = table_of(model, born);
        const int size = visit(model, [](auto family) { return decltype(family)::S; });
        require_shape(told, {fresh.count, size}, "what is told is not of these births");
        const Birth birth{fresh, told.data(), turn.data(), onset, onset_ns, number, entry.at(i)};
        number += fresh.count;
        const Ticks ticks = window.ticks(model, beyond[i]);
        Ticks gone = (before ? *before : window).ticks(model, beyond[i]);
        gone.count = before ? std::max(gone.count + 1 - ticks.count, 0) : 0;
        all.push_back({model, old, Floats({old.count + fresh.count, old.words}), birth, ticks, gone,
                       log_stay.at(i), std::nullopt});
        if (directions[i]) all[i].directions = directions_of(model, *directions[i], turn);
    }
    double best = entry.at(contacts);
    for (Task& one : all) {
        const Table table = changing(one.model, one.words);
        visit(one.model, [&](auto family) {
            py::gil_scoped_release release;
            advance<decltype(family)>(one.model.kind, one.old, one.birth, table, one.ticks, one.gone, weights,
                                      one.log_stay, one.directions ? &*one.directions : nullptr);
        });
        for (int b = 0; b < table.count; ++b)
            best = std::max(best, joint(one.model.kind.where, table.row(b)));
    }
    py::list kept, rows;
    Floats log_left(states), residual(states - 1);
    Ints leaders(states - 1);
    std::vector<Left> left;
    for (Task& one : all) {  // who has not searched may only have lost its minimum
        const double least = one.directions ? margin : std::numeric_limits<double>::infinity();
        left.push_back(left_of(one.model, one.words, onset, best, least));
    }
    for (std::size_t i = 0; i < contacts; ++i) {
        kept.append(left[i].words);
        rows.append(left[i].rows);
        log_left.mutable_at(i) = left[i].log_weight;
        residual.mutable_at(i) = left[i].residual;
        leaders.mutable_at(i) = left[i].leader;
    }
    log_left.mutable_at(contacts) = entry.at(contacts) - best;
    return py::make_tuple(kept, rows, log_left, residual, leaders, alive_of(models, left, onset));
}

}  // namespace kernels
