// Views of numpy arrays as inputs of the kernels.
#pragma once

#include <pybind11/stl.h>

#include <cstdint>
#include <optional>
#include <stdexcept>
#include <utility>
#include <vector>

#include "instantiations/instantiations.hpp"
#include "python/numpy_arrays.hpp"

namespace kernels {

#define NAME(F) F,
enum class Which { FAMILIES(NAME) };
#undef NAME

// A contact model: its parameters, its family, the words per row of its tables, its column among the
// contacts, the ticks from one search to the next, and the sets of random directions `drawn` (D, N, S), used
// in turn.
struct Model {
    Kind kind;
    Which which;
    int words, onset_words, column, search_interval;
    Floats drawn;

    // Reference: `global_search.is_due`.
    bool is_due(std::int64_t tick) const { return (tick + column) % search_interval == 0; }

    // Reference: `global_search.directions`, in the frame of a body with the orientation `turn` (3, 3).
    Directions directions(std::int64_t tick, const Floats& turn) const {
        const double* some = drawn.data(tick % drawn.shape(0), 0, 0);
        return {some, turn.data(), static_cast<int>(drawn.shape(1))};
    }
};

// Call with the family as a compile-time type.
template <class Function>
decltype(auto) visit(const Model& model, Function&& function) {
#define CASE(F) \
    case Which::F: return function(Family<F>{});
    switch (model.which) { FAMILIES(CASE) }
#undef CASE
    throw std::logic_error("no family");
}

// A read-only view of rows of `words` words.
inline Table table_of(const Floats& rows, int words) {
    require(rows.ndim() == 2 && rows.shape(1) == words, "not a table of this contact");
    return {const_cast<double*>(rows.data()), static_cast<int>(rows.shape(0)), words};
}

inline Bank bank_of(const Model& model, const Floats& words, const Floats& onsets) {
    return {model.kind, table_of(words, model.words), table_of(onsets, model.onset_words)};
}

// Arrays of a window: the lifted `pose` of the body in the world and its `inverse`; the rest as in `Ticks`.
struct TickArrays {
    Ints number;
    Floats pose, inverse, variance, excess, displacement_variance;
    std::optional<Floats> position_anisotropy, before;

    void check_shapes() const {
        require(number.ndim() == 1 && number.shape(0) > 0, "there are no ticks");
        const py::ssize_t count = number.shape(0);
        for (const Floats& one : {pose, inverse})
            require_finite(one, {count, Ticks::entries}, "a tick has one lifted pose, of finite numbers");
        for (const Floats& two : {variance, excess, displacement_variance})
            require_finite(two, {count, 2}, "a tick has two finite variances of each sort");
        if (position_anisotropy)
            require_finite(*position_anisotropy, {count, 3, 3}, "a tick has one finite covariance");
        if (before) require_finite(*before, {2, Ticks::entries}, "a finite pose is before, and its inverse");
    }

    // The ticks for a contact, which adds `beyond` to their noise variance.
    Ticks ticks(const Model& model, const Two& beyond = {}) const {
        return ticks(model.kind.body_in_1, beyond);
    }

    // The same with poses of the body in the world, or of the world in the body.
    Ticks ticks(bool of_body = true, const Two& beyond = {}) const {
        return {number.data(),
                (of_body ? pose : inverse).data(),
                variance.data(),
                excess.data(),
                displacement_variance.data(),
                position_anisotropy ? position_anisotropy->data() : nullptr,
                before ? before->data() + (of_body ? 0 : Ticks::entries) : nullptr,
                static_cast<int>(number.shape(0)),
                beyond};
    }
};

}  // namespace kernels
