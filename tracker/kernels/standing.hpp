// Which frames of a tick stand out: as `averaging._plausible`.
#pragma once

#include <vector>

#include "moving.hpp"

namespace kernels {

// N frames: `position` (N, 3) and `quat` (N, 4).
struct Frames {
    const double *position, *quat;
    int count;

    Vector at_frame(int n) const { return at(position, 3 * n); }
    Quaternion facing(int n) const { return quaternion_at(quat + 4 * n); }
};

// How far a frame is from a pose: by position, and by the turn in the body's axes.
struct Off {
    double by[6];

    Vector half(int i) const { return at(by, 3 * i); }
    double square(int i) const { return inner(half(i), half(i)); }
};

inline Off off(const Frames& frames, int n, Vector position, const Quaternion& facing) {
    Off off;
    put(off.by, 0, frames.at_frame(n) - position);
    put(off.by, 3, rotation_vector(between(facing, frames.facing(n))));
    return off;
}

// Median of so many `numbers`, whose order is lost: the mean of both in the middle.
inline double median(double* numbers, int count) {
    double* middle = numbers + count / 2;
    std::nth_element(numbers, middle, numbers + count);
    return count % 2 ? *middle : 0.5 * (*middle + *std::max_element(numbers, middle));
}

// Less the median over the `neighbours` around each (as many as there are).
inline std::vector<Off> beside_neighbours(const std::vector<Off>& offs) {
    const int count = static_cast<int>(offs.size());
    const int width = std::min(settings.neighbours, count - 1 + count % 2);
    std::vector<Off> out = offs;
    std::vector<double> some(width);
    for (int n = 0; n < count; ++n) {
        const int first = std::clamp(n - width / 2, 0, count - width);
        for (int c = 0; c < 6; ++c) {
            for (int i = 0; i < width; ++i) some[i] = offs[first + i].by[c];
            out[n].by[c] -= median(some.data(), width);
        }
    }
    return out;
}

// From where the motion goes, `ahead` (N,) seconds after the middle of the last tick.
inline std::vector<Off> off_motion(const Frames& frames, const double* ahead, const Motion& motion,
                                   Vector origin) {
    std::vector<Off> offs(frames.count);
    for (int n = 0; n < frames.count; ++n) {
        const Vector turn = ahead_of(motion.path[1], ahead[n]) - motion.path[1].last;
        offs[n] = off(frames, n, ahead_of(motion.path[0], ahead[n]) + origin,
                      motion.orientation * of_rotation_vector(turn));
    }
    return offs;
}

// The median over frames of the squared steps to the next one, of either half.
inline double step_sq(const std::vector<Off>& offs, int half) {
    std::vector<double> squares(offs.size() - 1);
    for (std::size_t n = 0; n < squares.size(); ++n) {
        const Vector step = offs[n + 1].half(half) - offs[n].half(half);
        squares[n] = inner(step, step);
    }
    return median(squares.data(), static_cast<int>(squares.size()));
}

// Into `good` (N,), with the variances `sigma_sq` (2,) of a pose.
inline void plausible(const Frames& frames, const double* ahead, const Motion* motion, Vector origin,
                      const double* sigma_sq, double outlier_sigmas, bool* good) {
    const int neighbours = settings.neighbours, count = frames.count;
    std::fill_n(good, count, true);
    double allowed[2];
    std::vector<Off> offs;
    if (motion && motion->is_settled()) {
        offs = off_motion(frames, ahead, *motion, origin);
        double share = 1.0;
        if (count >= 3) {
            offs = beside_neighbours(offs);
            share = (std::min(neighbours, count) - 1.0) / count;
        }
        for (int i = 0; i < 2; ++i)
            allowed[i] = sigma_sq[i] + spread(motion->path[i], motion->weight) * share * share;
    } else if (count >= neighbours) {
        offs.resize(count);
        for (int n = 0; n < count; ++n) offs[n] = off(frames, n, frames.at_frame(0), frames.facing(0));
        for (int i = 0; i < 2; ++i) allowed[i] = std::max(sigma_sq[i], step_sq(offs, i));
        offs = beside_neighbours(offs);
    } else {
        return;
    }
    const double most = outlier_sigmas * outlier_sigmas;
    for (int n = 0; n < count; ++n)
        good[n] = offs[n].square(0) < most * allowed[0] && offs[n].square(1) < most * allowed[1];
    if (std::none_of(good, good + count, [](bool one) { return one; })) std::fill_n(good, count, true);
}

// As `lift.mean_lift` of the `good` (N,) frames, seen from the `origin`, into `zeta` (25,).
inline void mean_lift(const Frames& frames, const bool* good, Vector origin, double* zeta) {
    double r[9], used = 0.0;
    std::fill_n(zeta, 25, 0.0);
    for (int n = 0; n < frames.count; ++n) {
        if (!good[n]) continue;
        const Vector t = frames.at_frame(n) - origin;
        matrix_of(frames.facing(n), r);
        for (int i = 0; i < 9; ++i) zeta[i] += r[i];
        put(zeta, 9, at(zeta, 9) + t);
        const Vector rows[] = {at(r, 0), at(r, 3), at(r, 6)};
        put(zeta, 12, at(zeta, 12) + t.x * rows[0] + t.y * rows[1] + t.z * rows[2]);
        put(zeta, 15, at(zeta, 15) + t.y * rows[2] - t.z * rows[1]);
        put(zeta, 18, at(zeta, 18) + t.z * rows[0] - t.x * rows[2]);
        put(zeta, 21, at(zeta, 21) + t.x * rows[1] - t.y * rows[0]);
        used += 1.0;
    }
    for (int i = 0; i < 24; ++i) zeta[i] /= used;
    zeta[24] = 1.0;
}

}  // namespace kernels
