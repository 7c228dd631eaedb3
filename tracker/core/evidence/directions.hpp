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

// Mean square of the twists from tick `first` on, and their squared deviations by noise. Reference:
// `window.twist_power`.
inline void twist_power(const Ticks& ticks, int first, Square<directions>& power,
                        double (&noise)[directions]) {
    const int stride = settings.stride_ticks, steps = ticks.count - first - stride;
    double centre[3] = {}, weights = 0.0, lever_sq = 0.0;
    for (int t = first; t < ticks.count; ++t)
        for (int i = 0; i < 3; ++i) centre[i] += ticks.pose[t * Ticks::entries + 9 + i];
    for (double& one : centre) one /= ticks.count - first;
    for (auto& row : power) std::fill_n(row, directions, 0.0);
    for (int t = first; t < first + steps; ++t) {
        const double *before = ticks.pose + t * Ticks::entries, *after = before + stride * Ticks::entries;
        double step[3][3], middle[3], twist[directions], *turned = twist + 3;
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
        for (int i = 0; i < 3; ++i) twist[i] = after[9 + i] - before[9 + i] - swung[i];
        const double weight = ticks.motion_ratio(t + stride) + settings.no_motion;
        weights += weight;
        for (int i = 0; i < directions; ++i)
            for (int j = 0; j < directions; ++j) power[i][j] += weight * twist[i] * twist[j];
    }
    for (auto& row : power)
        for (double& one : row) one /= weights;
    const std::array<double, 2> usual = usual_variance(ticks, first);
    const double turn = 2.0 * usual[1], shift = 2.0 * usual[0] + turn * lever_sq / steps * 2.0 / 3.0;
    for (int i = 0; i < directions; ++i) noise[i] = i < 3 ? shift : turn;
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

// Number of directions used from tick `first` on. Reference: `window.used_directions`.
inline int used_directions(const Ticks& ticks, int first) {
    if (ticks.count - first <= settings.stride_ticks) return 0;
    Square<directions> power;
    double noise[directions], factor[directions];
    twist_power(ticks, first, power, noise);
    for (int i = 0; i < directions; ++i) factor[i] = 1.0 / std::sqrt(noise[i]);
    const auto share = rising(power, factor);
    const auto used = std::count_if(share.begin(), share.end(), [](double x) { return x > settings.used; });
    if (used < 2) return static_cast<int>(used);
    for (int i = 0; i < directions; ++i) factor[i] = i < 3 ? 1.0 : settings.lever_m;
    const auto length = rising(power, factor);
    const bool is_one = length[directions - 2] < settings.one_axis * settings.one_axis * length.back();
    return is_one ? 1 : static_cast<int>(used);
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
