// From the arrays of the numpy code to what the kernels take.
#pragma once

#include <pybind11/stl.h>

#include <cstdint>
#include <limits>
#include <map>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "arrays.hpp"
#include "dropping.hpp"
#include "heavy.hpp"

namespace kernels {

enum class Which { face_face, edge_face, vertex_face, edge_edge };

// A kind, which family it is of, and how many words a row of its table has.
struct Model {
    Kind kind;
    Which which;
    int words;
};

// Call with the family as a type.
template <class Function>
decltype(auto) visit(const Model& model, Function&& function) {
    switch (model.which) {
        case Which::face_face: return function(Family<FaceFace>{});
        case Which::edge_face: return function(Family<EdgeFace>{});
        case Which::vertex_face: return function(Family<VertexFace>{});
        default: return function(Family<EdgeEdge>{});
    }
}

// To be read.
inline Table table_of(const Model& model, const Floats& words) {
    require(words.ndim() == 2 && words.shape(1) == model.words, "not a table of this contact");
    return {const_cast<double*>(words.data()), static_cast<int>(words.shape(0)), model.words};
}

// To be changed in place: Python says so where that is not allowed.
inline Table changing(const Model& model, Floats& words) {
    words.mutable_data();
    return table_of(model, words);
}

// Some ticks, with the arrays that they look into.
struct Seeable {
    Ints number;
    Floats pose, variance, free;
    std::optional<Floats> uneven;

    Seeable(Ints number, Floats pose, Floats variance, Floats free, std::optional<Floats> uneven)
        : number(number), pose(pose), variance(variance), free(free), uneven(uneven) {
        require(number.ndim() == 1 && number.shape(0) > 0, "there are no ticks");
        const py::ssize_t count = number.shape(0);
        require_shape(pose, {count, Ticks::entries}, "a tick has one lifted pose");
        require_shape(variance, {count, 2}, "a tick has two variances");
        require_shape(free, {2, count, 2}, "a tick has two pairs of variances of free motion");
        if (uneven) require_shape(*uneven, {count, 3, 3}, "a tick has one covariance");
    }

    Ticks ticks() const {
        return {number.data(),
                pose.data(),
                variance.data(),
                free.data(),
                uneven ? uneven->data() : nullptr,
                static_cast<int>(number.shape(0))};
    }
};

inline Directions directions_of(const Model& model, const Floats& x, const Floats& turn) {
    const int size = visit(model, [](auto family) { return decltype(family)::S; });
    require(x.ndim() == 2 && x.shape(1) == size, "directions are not geometry of this contact");
    require_shape(turn, {3, 3}, "a turn is a matrix");
    return {x.data(), turn.data(), static_cast<int>(x.shape(0))};
}

// Which rows of a table are kept, and these, their weights against `best`; the log of the sum of all weights,
// and the residual that is told of them.
// These move to the front of `words`, of which what is returned is a part.
inline py::tuple left_of(const Model& model, Floats& words, std::int64_t now, double best, double margin) {
    const Where& where = model.kind.where;
    const Table table = changing(model, words);
    const std::vector<std::int64_t> rows = kept(model.kind, table, now, best, margin);
    const auto count = static_cast<py::ssize_t>(rows.size()), wide = static_cast<py::ssize_t>(model.words);
    double top = -std::numeric_limits<double>::infinity(), sum = 0.0;
    for (std::int64_t b : rows) top = std::max(top, joint(where, table.row(static_cast<int>(b))) - best);
    for (int i = 0; i < count; ++i) {
        double* row = table.row(i);
        if (rows[i] != i) std::copy_n(table.row(static_cast<int>(rows[i])), model.words, row);
        row[where.entry] -= best;
        sum += std::exp(joint(where, row) - top);
    }
    const auto size = static_cast<py::ssize_t>(sizeof(double));
    const std::vector<py::ssize_t> shape{count, wide}, strides{wide * size, size};
    const Floats left(shape, strides, words.data(), words);
    return py::make_tuple(Ints(count, rows.data()), left, rows.empty() ? top : top + std::log(sum),
                          residual_of(where, table, static_cast<int>(count)));
}

}  // namespace kernels
