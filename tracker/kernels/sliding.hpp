// The window one tick on: as `sliding.slid`.
#pragma once

#include <algorithm>
#include <tuple>

#include "bindings.hpp"

namespace kernels {

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

// As `sliding._Rows`.
using Trail = std::tuple<Ints, Floats, Floats, Floats, Floats, Floats>;

// Write the row `end` of the trail; variance and unevenness of the rows from `first` to that.
inline py::tuple slid(Trail trail, py::ssize_t first, py::ssize_t end, std::int64_t number,
                      const Floats& newest, const Two& excess, double count, const Two& sensor,
                      const Two& floor, const Floats& position) {
    auto& [numbers, zeta, inverse, excesses, unheld, frames] = trail;
    const py::ssize_t room = numbers.size(), now = end + 1 - first;
    require(0 <= first && first <= end && end < room, "no room for a tick");
    require_shape(numbers, {room}, "a tick has a number");
    for (const Floats& poses : {zeta, inverse})
        require_shape(poses, {room, Ticks::entries}, "a tick has one lifted pose");
    for (const Floats& two : {excesses, unheld})
        require_shape(two, {room, 2}, "a tick has two variances of each sort");
    require_shape(frames, {room}, "a tick has a number of frames");
    require_shape(newest, {Ticks::entries}, "a tick has one lifted pose");
    require_shape(position, {3, 3}, "a covariance is a matrix");
    double* pose = zeta.mutable_data() + end * Ticks::entries;
    const Two way = end > 0 ? travel(newest.data(), pose - Ticks::entries) : Two{};
    std::copy_n(newest.data(), Ticks::entries, pose);
    invert_lift(pose, inverse.mutable_data() + end * Ticks::entries);
    for (int i = 0; i < 2; ++i) {
        excesses.mutable_data()[2 * end + i] = excess[i];
        unheld.mutable_data()[2 * end + i] = std::max(excess[i], way[i]);
    }
    numbers.mutable_data()[end] = number;
    frames.mutable_data()[end] = count;
    Floats variance({now, py::ssize_t(2)}), uneven({now, py::ssize_t(3), py::ssize_t(3)});
    double beyond[9], *spread = variance.mutable_data(), *out = uneven.mutable_data();
    std::copy_n(position.data(), 9, beyond);
    const double mean = (beyond[0] + beyond[4] + beyond[8]) / 3.0;
    for (int i = 0; i < 9; i += 4) beyond[i] -= mean;
    for (py::ssize_t w = first; w <= end; ++w) {
        const double share = 1.0 / std::max(frames.data()[w], 1.0);
        for (int i = 0; i < 2; ++i) *spread++ = share * sensor[i] + floor[i];
        for (int i = 0; i < 9; ++i) *out++ = share * beyond[i];
    }
    return py::make_tuple(variance, uneven);
}

}  // namespace kernels
