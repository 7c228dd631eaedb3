// Directions in which the object moves. Reference: `window.used_directions`.
#pragma once

#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

#include "evidence/evidence.hpp"
#include "linalg/eigen.hpp"

namespace kernels {

constexpr int directions = 6;

// Median of each of the two variances from tick `first` on. Reference: `linalg.median`.
inline std::array<double, 2> usual_variance(const Ticks& ticks, int first) {
    std::array<double, 2> usual{};
    std::vector<double> rising(ticks.count - first);
    for (int i = 0; i < 2; ++i) {
        for (int t = first; t < ticks.count; ++t) rising[t - first] = ticks.variance[2 * t + i];
        std::sort(rising.begin(), rising.end());
        usual[i] = 0.5 * rising[(rising.size() - 1) / 2] + 0.5 * rising[rising.size() / 2];
    }
    return usual;
}

// Mean square of twists, and their squared deviations by noise.
struct TwistPower {
    Square<directions> power;
    double noise[directions];

    int rank() const;
};

// The twists from tick `first` on about the centre of all positions, and with the shifts of the body's
// origin. Reference: `window.twist_power`.
inline std::array<TwistPower, 2> twist_power(const Ticks& ticks, int first) {
    std::array<TwistPower, 2> result;
    const int stride = settings.stride_ticks, steps = ticks.count - first - stride;
    double centre[3] = {}, weights = 0.0, lever_sq = 0.0;
    for (int t = first; t < ticks.count; ++t)
        for (int i = 0; i < 3; ++i) centre[i] += ticks.pose[t * Ticks::entries + 9 + i];
    for (double& one : centre) one /= ticks.count - first;
    for (auto& one : result)
        for (auto& row : one.power) std::fill_n(row, directions, 0.0);
    for (int t = first; t < first + steps; ++t) {
        const double *before = ticks.pose + t * Ticks::entries, *after = before + stride * Ticks::entries;
        double step[3][3], middle[3], twist[2][directions], *turned = twist[0] + 3;
        for (int i = 0; i < 9; ++i) {
            const double *a = after + i / 3 * 3, *b = before + i % 3 * 3;
            step[i / 3][i % 3] = a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
        }
        const double trace = step[0][0] + step[1][1] + step[2][2];
        for (int i = 0; i < 3; ++i) {
            const int j = (i + 1) % 3, k = (i + 2) % 3;
            turned[i] = (step[k][j] - step[j][k]) / std::max(0.5 + 0.5 * trace, settings.no_motion);
            middle[i] = 0.5 * (before[9 + i] + after[9 + i]) - centre[i];
            lever_sq += middle[i] * middle[i];
        }
        double swung[3];
        put(swung, 0, cross(at(turned, 0), at(middle, 0)));
        for (int i = 0; i < 3; ++i) {
            twist[1][i] = after[9 + i] - before[9 + i];
            twist[0][i] = twist[1][i] - swung[i];
            twist[1][3 + i] = turned[i];
        }
        const double weight = ticks.motion_ratio(t + stride) + settings.no_motion;
        weights += weight;
        for (int k = 0; k < 2; ++k)
            for (int i = 0; i < directions; ++i)
                for (int j = 0; j < directions; ++j)
                    result[k].power[i][j] += weight * twist[k][i] * twist[k][j];
    }
    const std::array<double, 2> usual = usual_variance(ticks, first);
    const double turn = 2.0 * usual[1], swing = turn * lever_sq / steps * 2.0 / 3.0;
    for (int k = 0; k < 2; ++k) {
        for (auto& row : result[k].power)
            for (double& one : row) one /= weights;
        for (int i = 0; i < directions; ++i)
            result[k].noise[i] = i < 3 ? 2.0 * usual[0] + (k ? 0.0 : swing) : turn;
    }
    return result;
}

// Eigenvalues, ascending, of a matrix with rows and columns times `factor`.
inline std::array<double, directions> rising(const Square<directions>& of,
                                             const double (&factor)[directions]) {
    Square<directions> scaled, axes;
    for (int i = 0; i < directions; ++i)
        for (int j = 0; j < directions; ++j) scaled[i][j] = of[i][j] * factor[i] * factor[j];
    eigen<directions>(scaled, axes);
    std::array<double, directions> values;
    for (int i = 0; i < directions; ++i) values[i] = scaled[i][i];
    return values;
}

inline int TwistPower::rank() const {
    double factor[directions];
    for (int i = 0; i < directions; ++i) factor[i] = 1.0 / std::sqrt(noise[i]);
    const auto share = rising(power, factor);
    return static_cast<int>(
        std::count_if(share.begin(), share.end(), [](double x) { return x > settings.used; }));
}

// Number of directions used from tick `first` on. Reference: `window.used_directions`.
inline int used_directions(const Ticks& ticks, int first) {
    if (ticks.count - first <= settings.stride_ticks) return 0;
    const auto [power, at_origin] = twist_power(ticks, first);
    const int used = power.rank();
    if (used < 2) return used;
    double factor[directions];
    for (int i = 0; i < directions; ++i) factor[i] = i < 3 ? 1.0 : settings.lever_m;
    const auto length = rising(power.power, factor);
    if (length[directions - 2] < settings.one_axis * settings.one_axis * length.back()) return 1;
    return std::min(used, std::max(at_origin.rank(), 2));
}

// Number of directions used since the tick `onset`, and the motion (ticks). Reference:
// `ambiguity.motion_since`.
inline std::pair<int, double> motion_since(const Ticks& ticks, std::int64_t onset) {
    const auto first =
        static_cast<int>(std::lower_bound(ticks.number, ticks.number + ticks.count, onset) - ticks.number);
    double moved = 0.0;
    for (int t = first; t < ticks.count; ++t) moved += ticks.motion_ratio(t);
    return {used_directions(ticks, first), moved};
}

}  // namespace kernels
