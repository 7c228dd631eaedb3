// Noise from third differences, as in `noise`.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "standing.hpp"

namespace kernels {

constexpr int order = 3, differences = 15;  // numbers of one

// As `noise._third_differences`: `out` (n, 15), one after the other.
inline std::vector<double> third_differences(const Frames& frames, const std::int64_t* stamp_ns) {
    std::vector<double> out;
    if (frames.count <= order) return out;
    const int steps = frames.count - 1;
    std::vector<Off> step(steps);
    std::vector<double> interval(steps);
    for (int n = 0; n < steps; ++n) {
        put(step[n].by, 0, frames.at_frame(n + 1) - frames.at_frame(n));
        put(step[n].by, 3, rotation_vector(between(frames.facing(n), frames.facing(n + 1))));
        interval[n] = static_cast<double>(stamp_ns[n + 1] - stamp_ns[n]);
    }
    std::vector<double> sorted = interval;
    const double usual = settings.noise.regular * median(sorted.data(), steps);
    for (int n = 0; n + 2 < steps; n += settings.noise.stride) {
        if (!(std::max({interval[n], interval[n + 1], interval[n + 2]}) < usual)) continue;
        double one[differences];
        matrix_of(frames.facing(n + 1), one + 6);
        for (int i = 0; i < 2; ++i) {
            const Vector third =
                step[n + 2].half(i) - step[n + 1].half(i) - (step[n + 1].half(i) - step[n].half(i));
            put(one, 3 * i, (1.0 / settings.noise.scale) * third);
        }
        const Vector across = at(one, 0);
        put(one, 0, across.x * at(one, 6) + across.y * at(one, 9) + across.z * at(one, 12));
        out.insert(out.end(), one, one + differences);
    }
    return out;
}

// Of a positive definite matrix.
template <int N>
void invert(const Square<N>& a, Square<N>& out) {
    for (int i = 0; i < N; ++i) {
        Square<N> left;
        double unit[N] = {};
        std::copy_n(a[0], N * N, left[0]);
        unit[i] = 1.0;
        eliminate(left, unit);
        std::copy_n(unit, N, out[i]);
    }
}

template <int N>
double trace(const Square<N>& a) {
    double sum = 0.0;
    for (int i = 0; i < N; ++i) sum += a[i][i];
    return sum;
}

template <int N>
void scale(Square<N>& a, double by) {
    for (auto& row : a) {
        for (double& entry : row) entry *= by;
    }
}

template <int N>
double distance_sq(const double* row, const Square<N>& inverse) {
    double image[N];
    multiply<N, N>(row, inverse[0], image);
    return dot<N>(image, row);
}

// As `noise._shape` of rows (n, N): one step from `shape`, in place.
template <int N>
void reshape(const std::vector<double>& rows, Square<N>& shape) {
    Square<N> inverse, scatter = {};
    invert<N>(shape, inverse);
    const int count = static_cast<int>(rows.size()) / N;
    for (int n = 0; n < count; ++n) {
        const double *row = &rows[n * N], length_sq = distance_sq<N>(row, inverse);
        const double weight = length_sq > settings.noise.tiny ? 1.0 / length_sq : 0.0;
        for (int i = 0; i < N; ++i) {
            const double share = weight * row[i];
            for (int j = 0; j < N; ++j) scatter[i][j] += share * row[j];
        }
    }
    const double size = N * count / std::max(trace<N>(scatter), settings.noise.tiny);
    for (int i = 0; i < N; ++i) {
        for (int j = 0; j < N; ++j) shape[i][j] = scatter[i][j] * size + (i == j ? settings.noise.ball : 0.0);
    }
    scale<N>(shape, N / trace<N>(shape));
}

// As `noise._covariance`, one step from `covariance`, in place.
inline void draw(const std::vector<double>& rows, double prior, Square<3>& covariance) {
    reshape<3>(rows, covariance);
    Square<3> inverse;
    invert<3>(covariance, inverse);
    const std::size_t count = rows.size() / 3;
    std::vector<double> distance(count);
    for (std::size_t n = 0; n < count; ++n) distance[n] = distance_sq<3>(&rows[3 * n], inverse);
    std::nth_element(distance.begin(), distance.begin() + count / 2, distance.end());
    const double measured =
        std::max(distance[count / 2] / settings.noise.median_of_chi_sq, 1e-6 * prior * prior);
    const double share = settings.noise.prior / (count + settings.noise.prior);
    scale<3>(covariance, std::pow(measured, 1.0 - share) * std::pow(prior, 2.0 * share));
}

// As `noise._centre`.
inline Vector centre(const Square<6>& shape, double lever, double count) {
    Square<3> turns, inverse, swing;
    for (int i = 0; i < 3; ++i) std::copy_n(shape[3 + i] + 3, 3, turns[i]);
    invert<3>(turns, inverse);
    double left = 0.0;
    for (int i = 0; i < 3; ++i) {
        multiply<3, 3>(shape[i] + 3, inverse[0], swing[i]);
        left += shape[i][i];
        for (int j = 0; j < 3; ++j) left -= swing[i][j] * shape[3 + j][i];
    }
    const double spread = settings.noise.spread;
    const double doubt_sq = left / trace<3>(turns) * lever * lever / count;
    return (0.5 * lever / (1.0 + doubt_sq / (spread * spread))) *
           Vector{swing[2][1] - swing[1][2], swing[0][2] - swing[2][0], swing[1][0] - swing[0][1]};
}

// As `noise.NoiseEstimate`.
struct Noise {
    Square<3> position, rotation;
    Vector centre;
    Square<6> shape;
};

// Deviations (2,) as `NoiseEstimate` tells them.
inline std::array<double, 2> deviation(const Noise& noise) {
    double c[3], swung = 0.0;
    put(c, 0, noise.centre);
    const double turns = trace<3>(noise.rotation);
    for (int i = 0; i < 3; ++i) swung += turns * c[i] * c[i] - c[i] * dot<3>(noise.rotation[i], c);
    return {std::sqrt((trace<3>(noise.position) + swung) / 3.0), std::sqrt(turns / 3.0)};
}

// As `noise.begin`.
inline Noise ball(const std::array<double, 2>& sigma) {
    Noise noise = {};
    for (int i = 0; i < 3; ++i) {
        noise.position[i][i] = sigma[0] * sigma[0];
        noise.rotation[i][i] = sigma[1] * sigma[1];
    }
    for (int i = 0; i < 6; ++i) noise.shape[i][i] = 1.0;
    return noise;
}

// As `noise._told` by differences (15, n), `noise` in place.
inline void tell(const double* told, int count, const std::array<double, 2>& prior, Noise& noise) {
    if (count < 2 * order) {
        noise = ball(prior);
        return;
    }
    const auto [across_m, about_rad] = deviation(noise);
    std::vector<double> both(6 * count), at_centre(3 * count), about(3 * count);
    const auto column = [&](int n, int first) {
        return Vector{told[first * count + n], told[(first + 1) * count + n], told[(first + 2) * count + n]};
    };
    for (int n = 0; n < count; ++n) {
        put(&both[6 * n], 0, (1.0 / across_m) * column(n, 0));
        put(&both[6 * n], 3, (1.0 / about_rad) * column(n, 3));
        put(&about[3 * n], 0, column(n, 3));
    }
    reshape<6>(both, noise.shape);
    noise.centre = centre(noise.shape, across_m / about_rad, count);
    for (int n = 0; n < count; ++n) {
        const Vector off = column(n, 0) - cross(noise.centre, column(n, 3));
        put(&at_centre[3 * n], 0,
            {inner(column(n, 6), off), inner(column(n, 9), off), inner(column(n, 12), off)});
    }
    draw(at_centre, prior[0], noise.position);
    draw(about, prior[1], noise.rotation);
}

}  // namespace kernels
