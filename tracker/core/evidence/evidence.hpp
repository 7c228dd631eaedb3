// Residuals and evidence of hypotheses on the ticks since their onsets. Reference: `evidence.sum_evidence`.
#pragma once

#include "bank/hypothesis.hpp"

namespace kernels {

using Two = std::array<double, 2>;

// The W ticks of a window, as in `window.Window`: `number` (W,) is its `index`, `pose` (W, 25) the lifted
// poses of frame 1 in frame 2, `excess` (W, 2) its `innovation_excess`, `before` the lifted pose of the
// tick before the first. A contact adds `beyond` to the noise `variance` (W, 2).
// `position_anisotropy` (W, 3, 3) and `before` may be null.
struct Ticks {
    const std::int64_t* number;
    const double *pose, *variance, *excess, *displacement_variance, *position_anisotropy, *before;
    int count;
    Two beyond;

    static constexpr int entries = 25;

    double noise(int w, int i) const { return variance[2 * w + i] + beyond[i]; }

    std::int64_t newest() const { return number[count - 1]; }

    const double* newest_pose() const { return pose + (count - 1) * entries; }

    const double* before_newest() const { return count > 1 ? newest_pose() - entries : before; }

    // Reference: `Window.motion_ratio`.
    double motion_ratio(int w) const {
        const auto share = [&](int i) {
            const double free = excess[2 * w + i];
            return free / (free + noise(w, i));
        };
        return std::max(share(0), share(1));
    }
    double motion_ratio() const { return motion_ratio(count - 1); }
};

constexpr int T = 9, U = 12,
              TXR = 15;  // first entries of parts of the lifted pose; R is at 0

// Squared radius of the body (m^2), the weak prior's cost of the squared distance of a touching point
// (1/m^2), and the correlation of errors from tick to tick.
struct Lengths {
    double radius_sq, pull, correlation;

    // Reference: `EvidenceParameters.alone`.
    double alone() const { return std::sqrt(1.0 - correlation * correlation); }
};

// Reference: `evidence.EvidenceSums`, a hypothesis per lane.
template <class F>
struct EvidenceSums {
    Lanes log_ratio, chi_sq, ticks, after, gain[F::K], precision[F::K];
};

// Reference: `Measurement` of one tick.
template <class F>
struct Measurement {
    Lanes residual[F::K], lever_sq, reach_sq;
    Vec<Lanes> along;
};

// Reference: `Family.measure` where element 2 is a plane.
template <class F>
void faced(bool body_in_1, const Lanes* x, const double* r, Measurement<F>& measured) {
    const Vec<Lanes> n = at(x, F::d2), n_r = n.x * at(r, 0) + n.y * at(r, 3) + n.z * at(r, 6);
    const Lanes nt = inner(n, at(r, T)), h = x[F::h];
    measured.along = body_in_1 ? n : n_r;
    if constexpr (F::q1 < 0) {
        const auto [b1, b2] = across(at(x, F::d1));
        measured.residual[0] = inner(n_r, b1);
        measured.residual[1] = inner(n_r, b2);
        measured.residual[2] = nt - h;
        measured.lever_sq = measured.reach_sq = 0.0;
    } else {
        const Vec<Lanes> q = at(x, F::q1), arm = body_in_1 ? q : q + at(r, U);
        Lanes reach_sq = inner(arm, arm), height = inner(n_r, q);
        if constexpr (F::d1 >= 0) {
            const Vec<Lanes> d = at(x, F::d1);
            const Lanes s = -inner(d, arm);
            measured.residual[0] = inner(n_r, d);
            reach_sq -= s * s;
            height += s * measured.residual[0];
        }
        measured.residual[F::last] = height + nt - h;
        if (!body_in_1) height += nt;
        measured.lever_sq = larger<Lanes>(reach_sq - height * height, 0.0);
        measured.reach_sq = reach_sq;
    }
}

// Reference: `edge_edge.measure`.
template <class F>
void crossed(const Lanes* x, const double* r, Measurement<F>& measured) {
    const Vec<Lanes> d1 = at(x, F::d1), q1 = at(x, F::q1), d2 = at(x, F::d2), q2 = at(x, F::q2);
    const Vec<Lanes> across = turned(r, 0, d1);
    const Lanes d2_r_m1 = inner(d2, turned(r, 0, cross(q1, d1)));
    const Lanes volume = d2_r_m1 + inner(cross(q2, d2), across) + inner(d2, turned(r, TXR, d1));
    const Lanes cosine = inner(d2, across);
    const Lanes sine_sq = larger<Lanes>(1.0 - cosine * cosine, settings.sine_sq_floor);
    const Lanes w_d1 = inner(q1, d1) + inner(d1, at(r, U)) - inner(q2, across);
    const Lanes w_d2 = inner(d2, turned(r, 0, q1)) + inner(d2, at(r, T)) - inner(d2, q2);
    const Lanes inverse_sq = 1.0 / sine_sq, inverse = sqrt(inverse_sq);
    const Lanes s = (cosine * w_d2 - w_d1) * inverse_sq;
    measured.reach_sq = inner(q1, q1) + 2.0 * s * inner(q1, d1) + s * s;
    measured.residual[0] = volume * inverse;
    measured.along = inverse * cross(across, d2);
    measured.lever_sq = larger<Lanes>(measured.reach_sq - d2_r_m1 * d2_r_m1 * inverse_sq, 0.0);
}

// Reference: `Family.measure` at one lifted pose.
template <class F>
void measure(const Kind& kind, const Lanes* x, const double* pose, Measurement<F>& measured) {
    if constexpr (F::crosses) {
        crossed<F>(x, pose, measured);
    } else {
        faced<F>(kind.body_in_1, x, pose, measured);
    }
}

// Reference: `evidence.residual_noise`, of the k-th row in tick w.
template <class F>
Lanes noise_of(const Ticks& ticks, int w, int k, const Measurement<F>& measured) {
    const double rotation = ticks.noise(w, 1), *uneven = ticks.position_anisotropy;
    if (k < F::last) return rotation;
    const Lanes even = ticks.noise(w, 0) + rotation * measured.lever_sq;
    return uneven ? even + inner(measured.along, turned(uneven + 9 * w, 0, measured.along)) : even;
}

// Residuals (K,) of the previous tick, and the lanes in which there is one.
template <class F>
struct Residuals {
    Lanes before[F::K];
    Mask known;

    // Reference: `evidence._whitened`.
    void whiten(const Mask& after, const Lengths& lengths, Lanes (&residual)[F::K]) {
        const double alone = lengths.alone();
        for (int k = 0; k < F::K; ++k) {
            const Lanes now = residual[k];
            residual[k] = where(after & known, now - lengths.correlation * before[k], alone * now);
            before[k] = now;
        }
        known = true;
    }
};

// Add tick w to the sums of the hypotheses in whose windows it `counts`; in those it comes `after` the first
// tick, also to their evidence. `variance_ratio` (K,) is the product over ticks of the ratio of free motion's
// variance to the noise; one logarithm of the product is faster than one per tick.
template <class F>
void add(const Kind& kind, const Lanes* x, const Ticks& ticks, int w, const Mask& certain, const Mask& counts,
         const Mask& after, const Lengths& lengths, Residuals<F>& last, Lanes (&variance_ratio)[F::K],
         EvidenceSums<F>& sums) {
    const Lanes most = 1e100, none = 0.0;  // before it overflows
    Measurement<F> measured;
    measure<F>(kind, x, ticks.pose + w * Ticks::entries, measured);
    if (lengths.correlation > 0.0) last.whiten(after, lengths, measured.residual);
    const double position = ticks.noise(w, 0);
    const double *fitted = ticks.excess + 2 * w, *known = ticks.displacement_variance + 2 * w;
    const Lanes free[] = {where(certain, known[0], Lanes(fitted[0])),
                          where(certain, known[1], Lanes(fitted[1]))};
    for (int k = 0; k < F::K; ++k) {
        const Lanes noise = noise_of<F>(ticks, w, k, measured);
        const Lanes excess =
            k < F::last ? free[1] : free[0] + free[1] * (measured.lever_sq + lengths.radius_sq);
        const Lanes whole = noise + excess, square = measured.residual[k] * measured.residual[k];
        const Lanes inverse = 1.0 / (noise * whole), over_noise = whole * inverse;
        sums.precision[k] += where(counts, position * over_noise, none);
        sums.chi_sq += where(counts, square * over_noise, none);
        sums.log_ratio -= where(after, 0.5 * square * excess * inverse, none);
        variance_ratio[k] *= where(after, whole * over_noise, Lanes(1.0));
        const Mask much = most < variance_ratio[k];
        if (any(much)) {
            sums.gain[k] += where(much, 0.5 * log(variance_ratio[k]), none);
            variance_ratio[k] = where(much, Lanes(1.0), variance_ratio[k]);
        }
    }
    if (fitted[0] > 0.0) sums.log_ratio -= where(after, lengths.pull * measured.reach_sq, none);
}

// Index of the first tick of a hypothesis, and of the first that contributes to its evidence: the first
// tick is given.
struct Since {
    int first, after;
};

inline Since since(const Ticks& ticks, std::int64_t onset) {
    int first = ticks.count;
    while (first > 0 && ticks.number[first - 1] >= onset) --first;
    return {first, first + (first < ticks.count && ticks.number[first] == onset)};
}

// Reference: `evidence.sum_evidence` of hypotheses x (S,).
template <class F>
WIDE EvidenceSums<F> sum_evidence(const Kind& kind, const Lanes* x, const std::int64_t* onset,
                                  const Mask& certain, const Ticks& ticks, const Lengths& lengths) {
    Since begun[lanes];
    EvidenceSums<F> sums;
    int first = ticks.count;
    for (int i = 0; i < lanes; ++i) {
        begun[i] = since(ticks, onset[i]);
        first = std::min(first, begun[i].first);
        sums.ticks.put(i, ticks.count - begun[i].first);
        sums.after.put(i, ticks.count - begun[i].after);
    }
    Lanes variance_ratio[F::K];
    sums.log_ratio = sums.chi_sq = 0.0;
    std::fill_n(sums.gain, F::K, Lanes(0.0));
    std::fill_n(sums.precision, F::K, Lanes(0.0));
    std::fill_n(variance_ratio, F::K, Lanes(1.0));
    Residuals<F> last{{}, first == 0 && ticks.before};
    if (lengths.correlation > 0.0 && first == 0 && ticks.before) {
        Measurement<F> measured;
        measure<F>(kind, x, ticks.before, measured);
        std::copy_n(measured.residual, F::K, last.before);
    }
    for (int w = first; w < ticks.count; ++w) {
        Mask counts, after;
        for (int i = 0; i < lanes; ++i) {
            counts.put(i, w >= begun[i].first);
            after.put(i, w >= begun[i].after);
        }
        add<F>(kind, x, ticks, w, certain, counts, after, lengths, last, variance_ratio, sums);
    }
    for (int k = 0; k < F::K; ++k) {
        sums.gain[k] += 0.5 * log(variance_ratio[k]);
        sums.log_ratio += sums.gain[k];
    }
    return sums;
}

}  // namespace kernels
