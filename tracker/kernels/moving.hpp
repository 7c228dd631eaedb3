// Free motion, as in `free_motion`: two smooth vectors, the position and the integrated rotation.
#pragma once

#include "rotations.hpp"

namespace kernels {

// One of the two: `state` (3, 3) and `covariance` (3, 3) of any of its axes; the two predictions'
// `log_square` and their `latest`, `shape` (3, 3), `direction` and `echo` of the filter's errors, as in
// `FreeMotion`.
struct Path {
    static constexpr int most = 8;  // of `latest`

    double state[3][3], covariance[3][3], log_square[2], latest[most][2], shape[3][3], echo;
    Vector last, direction;
};

struct Motion {
    Path path[2];
    Quaternion orientation;
    double weight;
    int latest, ticks;

    // As `FreeMotion.is_settled`.
    bool is_settled() const { return weight > 0.0 && ticks >= settings.motion.settling_ticks; }
};

// What a tick does to a state, as `free_motion.onward`, and by how much it makes fade what was before.
struct Onward {
    double onward[3][3], jerk[3][3], fade, fade_shape;
};

// As `free_motion.begin`.
inline Motion motion_at(const double* rotation, Vector position) {
    Motion motion = {};
    motion.orientation = nearest(rotation);
    put(motion.path[0].state[0], 0, position);
    motion.path[0].last = position;
    for (Path& path : motion.path) {
        for (int i = 0; i < 3; ++i) {
            const double spread = settings.motion.prior_spread[i];
            path.covariance[i][i] = spread * spread;
            path.shape[i][i] = 1.0 / 3.0;
        }
    }
    return motion;
}

// As `FreeMotion.spread` of one path.
inline double spread(const Path& path, double weight) {
    return settings.motion.bias * std::exp(std::min(path.log_square[0], path.log_square[1]) / weight);
}

// As `free_motion.predicted` of one path, `ahead` seconds after the middle of the last tick.
inline Vector ahead_of(const Path& path, double ahead) {
    return at(path.state[0], 0) + ahead * at(path.state[1], 0) + 0.5 * ahead * ahead * at(path.state[2], 0);
}

inline double determinant(const double (&a)[3][3]) {
    return inner(at(a[0], 0), cross(at(a[1], 0), at(a[2], 0)));
}

// As `FreeMotion.excess` of one path.
inline double excess(const Path& path, const Motion& motion, double variance) {
    if (motion.weight == 0.0) return 0.0;
    double now[2] = {};
    for (int i = 0; i < motion.latest; ++i) {
        for (int p = 0; p < 2; ++p) now[p] += path.latest[i][p];
    }
    const double lately = settings.motion.bias * std::exp(std::min(now[0], now[1]) / motion.latest);
    const double least = std::min(spread(path, motion.weight), lately);
    const double moving = std::max(least / variance - settings.motion.still, 0.0);
    double axes[3][3];
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) axes[i][j] = (i == j ? 1.0 : 0.0) + 3.0 * moving * path.shape[i][j];
    }
    const double echo = std::max(path.echo, 0.0), fresh = (1.0 - echo) / (1.0 + echo);
    return variance * (std::pow(std::max(determinant(axes), 1.0), fresh / 3.0) - 1.0);
}

// As `free_motion._filtered` of one path, which a tick with this mean and `variance` follows; returns by how
// much the prediction was off.
inline Vector filter(Path& path, double weight, const Onward& tick, Vector value, double variance) {
    double state[3][3], moved[3][3], covariance[3][3];
    for (int i = 0; i < 3; ++i) {
        multiply<3, 3>(tick.onward[i], path.state[0], state[i]);
        multiply<3, 3>(tick.onward[i], path.covariance[0], moved[i]);
    }
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) covariance[i][j] = dot<3>(moved[i], tick.onward[j]);
    }
    const double unexplained =
        weight != 0.0 ? std::max(spread(path, weight) - variance - covariance[0][0], 0.0) : variance;
    const double strength = unexplained * (settings.motion.jerk_share / tick.jerk[0][0]);
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) covariance[i][j] += strength * tick.jerk[i][j];
    }
    const Vector innovation = value - at(state[0], 0);
    const double inverse = 1.0 / (covariance[0][0] + variance);
    double gain[3], carried[3][3];
    for (int i = 0; i < 3; ++i) gain[i] = covariance[i][0] * inverse;
    for (int i = 0; i < 3; ++i) {
        put(path.state[i], 0, at(state[i], 0) + gain[i] * innovation);
        for (int j = 0; j < 3; ++j) carried[i][j] = covariance[i][j] - gain[i] * covariance[0][j];
    }
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j)
            path.covariance[i][j] = carried[i][j] - carried[i][0] * gain[j] + variance * gain[i] * gain[j];
    }
    return innovation;
}

// What the errors of both predictions teach of one path.
inline void learn_errors(Path& path, int latest, const Onward& tick, Vector innovation, Vector step) {
    const double squares[] = {inner(innovation, innovation), inner(step, step)};
    if (latest == settings.motion.now_ticks) {
        for (int i = 1; i < latest; ++i) std::copy_n(path.latest[i], 2, path.latest[i - 1]);
        --latest;
    }
    for (int p = 0; p < 2; ++p) {
        const double log_square = std::log(squares[p] / 3.0 + settings.motion.tiny);
        path.log_square[p] = tick.fade * path.log_square[p] + log_square;
        path.latest[latest][p] = log_square;
    }
    const Vector direction = (1.0 / (std::sqrt(squares[0]) + settings.motion.tiny)) * innovation;
    const double kept = tick.fade_shape, fresh = 1.0 - kept;
    path.echo = kept * path.echo + fresh * inner(direction, path.direction);
    path.direction = direction;
    double unit[3];
    put(unit, 0, direction);
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) path.shape[i][j] = kept * path.shape[i][j] + fresh * unit[i] * unit[j];
    }
}

// As `free_motion.advance`, in place; `excess` (2,) of the tick.
inline void advance(Motion& motion, const double* rotation, Vector position, const double* variance,
                    const Onward& tick, double* excess_of) {
    const Quaternion orientation = nearest(rotation);
    const Vector turn = rotation_vector(between(motion.orientation, orientation));
    const Vector value[] = {position, motion.path[1].last + turn};
    const bool settled = motion.ticks >= settings.motion.settling_ticks;
    for (int i = 0; i < 2; ++i) {
        Path& path = motion.path[i];
        const Vector innovation = filter(path, motion.weight, tick, value[i], variance[i]);
        if (settled) learn_errors(path, motion.latest, tick, innovation, value[i] - path.last);
        path.last = value[i];
        excess_of[i] = 0.0;
    }
    motion.orientation = orientation;
    ++motion.ticks;
    if (!settled) return;
    motion.weight = tick.fade * motion.weight + 1.0;
    motion.latest = std::min(motion.latest + 1, settings.motion.now_ticks);
    for (int i = 0; i < 2; ++i) excess_of[i] = excess(motion.path[i], motion, variance[i]);
}

}  // namespace kernels
