// The window one tick on: as `sliding.slid`.
#pragma once

#include <algorithm>
#include <array>

#include "bindings.hpp"

namespace kernels {

using Two = std::array<double, 2>;

// As `contacts.base.lift_of_inverse`.
inline void invert_lift(const double* zeta, double* out) {
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) {
            out[3 * i + j] = zeta[3 * j + i];
            out[TXR + 3 * i + j] = zeta[TXR + 3 * j + i];
        }
        out[T + i] = -zeta[U + i];
        out[U + i] = -zeta[T + i];
    }
    out[Ticks::entries - 1] = zeta[Ticks::entries - 1];
}

// As `travel.travel_to`.
inline Two travel(const double* zeta, const double* before) {
    Two squares = {};
    for (int i = 0; i < U; ++i) squares[i < T] += (zeta[i] - before[i]) * (zeta[i] - before[i]);
    return {squares[0] / 3.0, squares[1] / 6.0};
}

// The newest entries of `old`, which has so many `words` for a tick, and room for that of one more, which is
// returned.
inline double* carry_on(const Floats& old, int words, py::ssize_t first, py::ssize_t count, double* out) {
    return std::copy_n(old.data() + first * words, (count - 1) * words, out);
}

inline py::tuple slid(const Ints& index, const Floats& zeta, const Floats& inverse, const Floats& free,
                      const Floats& frames, std::int64_t number, const Floats& newest, const Two& excess,
                      double count, py::ssize_t most, const Two& sensor, const Two& floor,
                      const Floats& position) {
    const py::ssize_t before = index.size(), first = std::max<py::ssize_t>(before + 1 - most, 0);
    const py::ssize_t now = before + 1 - first;
    require(now > 0, "no room for a tick");
    require_shape(zeta, {before, Ticks::entries}, "a tick has one lifted pose");
    require_shape(inverse, {before, Ticks::entries}, "a tick has one lifted pose");
    require_shape(free, {2, before, 2}, "a tick has two pairs of variances of free motion");
    require_shape(frames, {before}, "a tick has a number of frames");
    require_shape(newest, {Ticks::entries}, "a tick has one lifted pose");
    require_shape(position, {3, 3}, "a covariance is a matrix");
    Ints indices(now);
    Floats poses({now, py::ssize_t(Ticks::entries)}), inverses({now, py::ssize_t(Ticks::entries)}),
        counts(now);
    Floats frees({py::ssize_t(2), now, py::ssize_t(2)}), variance({now, py::ssize_t(2)});
    Floats uneven({now, py::ssize_t(3), py::ssize_t(3)});
    *std::copy_n(index.data() + first, now - 1, indices.mutable_data()) = number;
    *carry_on(frames, 1, first, now, counts.mutable_data()) = count;
    std::copy_n(newest.data(), Ticks::entries,
                carry_on(zeta, Ticks::entries, first, now, poses.mutable_data()));
    invert_lift(newest.data(), carry_on(inverse, Ticks::entries, first, now, inverses.mutable_data()));
    const double* last = zeta.data() + (before - 1) * Ticks::entries;
    const Two way = before ? travel(newest.data(), last) : Two{};
    for (int which = 0; which < 2; ++which) {
        double* out = std::copy_n(free.data() + 2 * (which * before + first), 2 * (now - 1),
                                  frees.mutable_data() + 2 * which * now);
        for (int i = 0; i < 2; ++i) out[i] = which ? std::max(excess[i], way[i]) : excess[i];
    }
    const double mean = (position.at(0, 0) + position.at(1, 1) + position.at(2, 2)) / 3.0;
    for (py::ssize_t w = 0; w < now; ++w) {
        const double share = 1.0 / std::max(counts.at(w), 1.0);
        for (int i = 0; i < 2; ++i) variance.mutable_at(w, i) = share * sensor[i] + floor[i];
        for (int i = 0; i < 3; ++i) {
            for (int j = 0; j < 3; ++j)
                uneven.mutable_at(w, i, j) = share * (position.at(i, j) - (i == j ? mean : 0.0));
        }
    }
    return py::make_tuple(indices, poses, inverses, frees, variance, uneven, counts);
}

}  // namespace kernels
