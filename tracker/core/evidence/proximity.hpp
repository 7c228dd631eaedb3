// Evidence of a pose that pairs of known elements touch. Reference: `births.proximity_evidence`.
#pragma once

#include <limits>
#include <numeric>

#include "evidence/evidence.hpp"

namespace kernels {

// Variances of residuals if the elements may be anywhere, see `births`: of the cosine of an angle,
// and of a distance (m^2); the log share below which a birth is left out, and the most known pairs that
// begin.
struct BirthLimits {
    double any_direction, any_distance, hopeless;
    int most;
};

// m pairs of known elements: their geometry `x` (m, S), and the changes (m, K, P, C) of the residuals'
// coefficients by one standard deviation of the elements.
struct KnownPairs {
    const double *x, *deviation;
    int count;
};

// The gain (K,) of each row if it vanishes, and the log-likelihood ratio of touching against anywhere.
template <class F>
struct Touching {
    Lanes gain[F::K], log_ratio;
};

// Evidence of the newest of `ticks`. Reference: `births._touching_evidence`, a pair per lane.
template <class F>
Touching<F> touching_evidence(const Kind& kind, const KnownPairs& pairs, const int (&pair)[lanes],
                              const Ticks& ticks, const BirthLimits& limits) {
    const double* pose = ticks.newest_pose();
    Lanes x[F::S];
    gather(pairs.x, F::S, [&](int i) { return pair[i]; }, x);
    Measurement<F> measured;
    measure<F>(kind, x, pose, measured);
    Touching<F> touching;
    touching.log_ratio = 0.0;
    for (int k = 0; k < F::K; ++k) {
        Lanes spread;
        for (int i = 0; i < lanes; ++i) {
            const double* change = pairs.deviation + (pair[i] * F::K + k) * F::P * F::C;
            double sum = 0.0;
            for (int p = 0; p < F::P; ++p, change += F::C) {
                double moved = 0.0;
                for (int c = 0; c < F::C; ++c) moved += change[c] * pose[kind.lifted[c]];
                sum += moved * moved;
            }
            spread.put(i, sum);
        }
        if constexpr (F::crosses) {
            const Lanes cosine = inner(at(x, F::d2), turned(pose, 0, at(x, F::d1)));
            spread = spread / larger<Lanes>(1.0 - cosine * cosine, settings.sine_sq_floor);
        }
        const Lanes noise = noise_of<F>(ticks, ticks.count - 1, k, measured) + spread;
        const Lanes ratio = (k == F::last ? limits.any_distance : limits.any_direction) / noise;
        touching.gain[k] = each(ratio, [](double one) { return 0.5 * std::log1p(one); });
        touching.log_ratio += touching.gain[k] - 0.5 * measured.residual[k] * measured.residual[k] / noise *
                                                     (ratio / (1.0 + ratio));
    }
    return touching;
}

inline double log_sum_exp(const std::vector<double>& values) {
    const double top = values.empty() ? -std::numeric_limits<double>::infinity()
                                      : *std::max_element(values.begin(), values.end());
    if (!std::isfinite(top)) return top;
    double sum = 0.0;
    for (double one : values) sum += std::exp(one - top);
    return top + std::log(sum);
}

// Evidence for the birth of a contact: the log odds that any proposal touches, the mean gain of an angle and
// of the distance, and the proposals that are kept, with their log shares given the pose.
struct BirthEvidence {
    double log_odds;
    Two gain;
    std::vector<std::int64_t> rows;
    std::vector<double> log_share;
};

// Reference: `ProximityEvidence.of`. `log_share` (n,) are the log prior shares times the likelihood ratios of
// those that are `known` (n,).
inline void keep_births(std::vector<double> log_share, const bool* known, const BirthLimits& limits,
                        BirthEvidence& out) {
    out.log_odds = log_sum_exp(log_share);
    std::vector<std::int64_t> pairs;
    std::vector<bool> kept(log_share.size());
    for (std::size_t i = 0; i < log_share.size(); ++i) {
        log_share[i] -= out.log_odds;
        kept[i] = log_share[i] > limits.hopeless;
        if (kept[i] && known[i]) pairs.push_back(static_cast<std::int64_t>(i));
    }
    std::stable_sort(pairs.begin(), pairs.end(),
                     [&](std::int64_t a, std::int64_t b) { return log_share[a] < log_share[b]; });
    for (int i = 0; i < static_cast<int>(pairs.size()) - limits.most; ++i) kept[pairs[i]] = false;
    for (std::size_t i = 0; i < log_share.size(); ++i) {
        if (!kept[i]) continue;
        out.rows.push_back(static_cast<std::int64_t>(i));
        out.log_share.push_back(log_share[i]);
    }
    const double left = log_sum_exp(out.log_share);
    for (double& one : out.log_share) one -= left;
}

// Evidence for the birth of a contact with proposals of these log prior shares, some of which are `known`.
template <class F>
BirthEvidence birth_evidence(const Kind& kind, std::vector<double> log_share, const bool* known,
                             const KnownPairs& pairs, const Ticks& ticks, const BirthLimits& limits) {
    BirthEvidence found{0.0, {0.0, 0.0}, {}, {}};
    std::size_t row = 0;
    for (int first = 0; first < pairs.count; first += lanes) {
        int pair[lanes];
        for (int i = 0; i < lanes; ++i) pair[i] = std::min(first + i, pairs.count - 1);
        const Touching<F> touching = touching_evidence<F>(kind, pairs, pair, ticks, limits);
        for (int i = 0; i < lanes && first + i < pairs.count; ++i) {
            while (!known[row]) ++row;
            log_share[row++] += touching.log_ratio[i];
            for (int k = 0; k < F::K; ++k) found.gain[k == F::last] += touching.gain[k][i];
        }
    }
    found.gain[0] /= std::max(F::last, 1) * pairs.count;
    found.gain[1] /= pairs.count;
    keep_births(std::move(log_share), known, limits, found);
    return found;
}

}  // namespace kernels
