// Known elements as parts of a prior, see `given`.
#pragma once

#include <limits>

#include "bindings.hpp"
#include "eigen.hpp"

namespace kernels {

// As `given._inverse` of a covariance (N, N), whose rows are `stride` numbers apart.
template <int N>
void inverse(const double* covariance, int stride, int lengths, double smallest, Square<N>& out) {
    Square<N> scaled, axes;
    double weight[N];
    const auto unit = [&](int first, int end) {
        double largest = 0.0;
        for (int i = first; i < end; ++i) largest = std::max(largest, covariance[i * stride + i]);
        std::fill(weight + first, weight + end, largest > 0.0 ? 1.0 / std::sqrt(largest) : 1.0);
    };
    unit(0, N - lengths);
    unit(N - lengths, N);
    for (int i = 0; i < N; ++i) {
        for (int j = 0; j < N; ++j) scaled[i][j] = weight[i] * covariance[i * stride + j] * weight[j];
    }
    eigen<N>(scaled, axes);
    std::fill_n(out[0], N * N, 0.0);
    for (int a = 0; a < N; ++a) {
        if (!(scaled[a][a] > smallest * std::max(scaled[N - 1][N - 1], 0.0))) continue;
        for (int i = 0; i < N; ++i) {
            for (int j = 0; j < N; ++j)
                out[i][j] += weight[i] * axes[a][i] * weight[j] * axes[a][j] / scaled[a][a];
        }
    }
}

// `P a P` of a matrix (6, 6), where P takes from both halves of a vector what is along d.
inline void take_along(const Vector& d, Square<6>& a) {
    const auto across = [&](Square<6>& matrix) {
        for (auto& row : matrix) {
            for (int half : {0, 3}) put(row, half, at(row, half) - inner(at(row, half), d) * d);
        }
    };
    const auto transpose = [](Square<6>& matrix) {
        for (int i = 0; i < 6; ++i) {
            for (int j = 0; j < i; ++j) std::swap(matrix[i][j], matrix[j][i]);
        }
    };
    across(a);
    transpose(a);
    across(a);
}

// As `given._part` of an element that is told by N numbers: these, the information, and a point that is NaN
// but for lines that go through it.
template <int N>
Floats part_of(const double* numbers, const double* covariance, int lengths, double smallest) {
    Floats out(N + N * N + 3);
    double *row = out.mutable_data(), *point = row + N + N * N;
    Square<N> information;
    std::fill_n(point, 3, std::numeric_limits<double>::quiet_NaN());
    if constexpr (N == 6) {
        const Vector d = at(numbers, 0);
        Square<6> known;
        std::copy_n(covariance, 36, known[0]);
        take_along(d, known);
        inverse<6>(known[0], 6, lengths, smallest, information);
        take_along(d, information);
        bool turns = false;
        for (int i = 0; i < 9; ++i) turns = turns || covariance[i / 3 * 6 + i % 3] != 0.0;
        if (inner(d, d) > 0.0 || !turns) std::copy_n(numbers + 3, 3, point);
    } else {
        inverse<N>(covariance, N, lengths, smallest, information);
    }
    std::copy_n(numbers, N, row);
    std::copy_n(information[0], N * N, row + N);
    return out;
}

inline Floats part_row(const Floats& numbers, const Floats& covariance, int lengths, double smallest) {
    const py::ssize_t count = numbers.size();
    require_shape(numbers, {count}, "an element is told by a row of numbers");
    require_shape(covariance, {count, count}, "a covariance is a matrix");
    require(lengths >= 0 && lengths <= count, "more lengths than numbers");
    const auto with = [&](auto of) { return of(numbers.data(), covariance.data(), lengths, smallest); };
    if (count == 3) return with(part_of<3>);
    if (count == 4) return with(part_of<4>);
    require(count == 6, "no element has so many numbers");
    return with(part_of<6>);
}

// As `given._face`, a row of `given._Faces`.
inline Floats face_row(const Floats& numbers, const Floats& covariance, double smallest) {
    require_shape(numbers, {4}, "a face has a normal and an offset");
    require_shape(covariance, {4, 4}, "a covariance is a matrix");
    const double* with = covariance.data();
    Square<3> information;
    inverse<3>(with, 4, 0, smallest, information);
    double off[4] = {0.0, 0.0, 0.0, 1.0}, variance = 0.0;
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) off[i] -= information[i][j] * with[4 * j + 3];
    }
    for (int i = 0; i < 4; ++i) {
        for (int j = 0; j < 4; ++j) variance += off[i] * with[4 * i + j] * off[j];
    }
    if (!(variance > smallest * with[15])) variance = 0.0;
    Floats out(17);
    double* row = out.mutable_data();
    std::copy_n(numbers.data(), 3, row);
    std::copy_n(information[0], 9, row + 3);
    row[12] = numbers.data()[3];
    for (int i = 0; i < 3; ++i) row[13 + i] = -off[i];
    row[16] = variance;
    return out;
}

}  // namespace kernels
