// Residuals and evidence of hypotheses on the ticks since their onsets: the sums of `summed`.
#pragma once

#include "table.hpp"

namespace kernels {

// W ticks: `number` (W,) as `Window.index`; `pose` (W, 25) lifted, of frame 1 in frame 2; `free` (2, W, 2)
// variances of free motion, of fitted and of certain hypotheses; `uneven` (W, 3, 3), or nothing.
struct Ticks {
    const std::int64_t* number;
    const double *pose, *variance, *free, *uneven;
    int count;

    static constexpr int entries = 25;

    const double* newest() const { return pose + (count - 1) * entries; }
};

constexpr int T = 9, U = 12, TXR = 15;  // where the lifted pose has them; R comes first

// `radius_sq` of the body, and what a touching point far away costs.
struct Lengths {
    double radius_sq, pull;
};

// As `summed.Sums` of one hypothesis.
template <class F>
struct Sums {
    double log_ratio, chi_sq, ticks, after, gain[F::K], precision[F::K];
};

// As `Measurement` of one tick.
template <class F>
struct Seen {
    double residual[F::K], lever_sq, reach_sq;
    Vector along;
};

// As `Family.measure` where element 2 is a plane.
template <class F>
void faced(bool body_in_1, const double* x, const double* r, Seen<F>& seen) {
    const Vector n = at(x, F::d2), n_r = n.x * at(r, 0) + n.y * at(r, 3) + n.z * at(r, 6);
    const double nt = inner(n, at(r, T)), h = x[F::h];
    seen.along = body_in_1 ? n : n_r;
    if constexpr (F::q1 < 0) {
        const auto [b1, b2] = across(at(x, F::d1));
        seen.residual[0] = inner(n_r, b1);
        seen.residual[1] = inner(n_r, b2);
        seen.residual[2] = nt - h;
        seen.lever_sq = seen.reach_sq = 0.0;
    } else {
        const Vector q = at(x, F::q1), arm = body_in_1 ? q : q + at(r, U);
        double reach_sq = inner(arm, arm), height = inner(n_r, q);
        if constexpr (F::d1 >= 0) {
            const Vector d = at(x, F::d1);
            const double s = -inner(d, arm);
            seen.residual[0] = inner(n_r, d);
            reach_sq -= s * s;
            height += s * seen.residual[0];
        }
        seen.residual[F::last] = height + nt - h;
        if (!body_in_1) height += nt;
        seen.lever_sq = std::max(reach_sq - height * height, 0.0);
        seen.reach_sq = reach_sq;
    }
}

// As `edge_edge.measure`.
template <class F>
void crossed(const double* x, const double* r, Seen<F>& seen) {
    const Vector d1 = at(x, F::d1), q1 = at(x, F::q1), d2 = at(x, F::d2), q2 = at(x, F::q2);
    const Vector across = turned(r, 0, d1);
    const double d2_r_m1 = inner(d2, turned(r, 0, cross(q1, d1)));
    const double volume = d2_r_m1 + inner(cross(q2, d2), across) + inner(d2, turned(r, TXR, d1));
    const double cosine = inner(d2, across),
                 sine_sq = std::max(1.0 - cosine * cosine, settings.sine_sq_floor);
    const double w_d1 = inner(q1, d1) + inner(d1, at(r, U)) - inner(q2, across);
    const double w_d2 = inner(d2, turned(r, 0, q1)) + inner(d2, at(r, T)) - inner(d2, q2);
    const double s = (cosine * w_d2 - w_d1) / sine_sq, sine = std::sqrt(sine_sq);
    seen.reach_sq = inner(q1, q1) + 2.0 * s * inner(q1, d1) + s * s;
    seen.residual[0] = volume / sine;
    seen.along = (1.0 / sine) * cross(across, d2);
    seen.lever_sq = std::max(seen.reach_sq - d2_r_m1 * d2_r_m1 / sine_sq, 0.0);
}

// What a hypothesis says of tick w; `narrowed` (K,) is by how many times the variance under free motion
// exceeds the noise, multiplied over ticks: a logarithm takes longer.
template <class F>
void add(const Kind& kind, const double* x, const Ticks& ticks, int w, int certain, bool after,
         const Lengths& lengths, double (&narrowed)[F::K], Sums<F>& sums) {
    constexpr double most = 1e100;  // before it overflows
    Seen<F> seen;
    const double* pose = ticks.pose + w * Ticks::entries;
    if constexpr (F::crosses) {
        crossed<F>(x, pose, seen);
    } else {
        faced<F>(kind.body_in_1, x, pose, seen);
    }
    const double position = ticks.variance[2 * w], rotation = ticks.variance[2 * w + 1];
    const double *free = ticks.free + 2 * (certain * ticks.count + w), *uneven = ticks.uneven;
    for (int k = 0; k < F::K; ++k) {
        double noise = rotation, excess = free[1];
        if (k == F::last) {
            noise = position + rotation * seen.lever_sq;
            excess = free[0] + free[1] * (seen.lever_sq + lengths.radius_sq);
            if (uneven) noise += inner(seen.along, turned(uneven + 9 * w, 0, seen.along));
        }
        const double whole = noise + excess, square = seen.residual[k] * seen.residual[k];
        const double inverse = 1.0 / (noise * whole);
        sums.precision[k] += position * whole * inverse;
        sums.chi_sq += square * whole * inverse;
        if (after) {
            sums.log_ratio -= 0.5 * square * excess * inverse;
            narrowed[k] *= whole * whole * inverse;
            if (narrowed[k] > most) {
                sums.gain[k] += 0.5 * std::log(narrowed[k]);
                narrowed[k] = 1.0;
            }
        }
    }
    if (after && ticks.free[2 * w] > 0.0) sums.log_ratio -= lengths.pull * seen.reach_sq;
}

// As `summed.summed` of one hypothesis x (S,).
template <class F>
Sums<F> add_up(const Kind& kind, const double* x, std::int64_t onset, bool certain, const Ticks& ticks,
               const Lengths& lengths) {
    int first = ticks.count;
    while (first > 0 && ticks.number[first - 1] >= onset) --first;
    const bool given = first < ticks.count && ticks.number[first] == onset;
    const int after = first + given;  // the first tick is given, and tells nothing
    Sums<F> sums{};
    sums.ticks = ticks.count - first;
    sums.after = ticks.count - after;
    double narrowed[F::K];
    std::fill_n(narrowed, F::K, 1.0);
    for (int w = first; w < ticks.count; ++w)
        add<F>(kind, x, ticks, w, certain, w >= after, lengths, narrowed, sums);
    for (int k = 0; k < F::K; ++k) {
        sums.gain[k] += 0.5 * std::log(narrowed[k]);
        sums.log_ratio += sums.gain[k];
    }
    return sums;
}

}  // namespace kernels
