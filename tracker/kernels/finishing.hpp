// What a stretch says once its noise is known, see `polish`.
#pragma once

#include "echoing.hpp"

namespace kernels {

// The weights of the rows at x: what does not echo, the sensor's own noise, makes a tick beside its
// neighbours worth more.
template <class F>
void weigh_rows(const Stretch<F>& stretch, const Errors<F>& errors, const double* x, double (&out)[F::K]) {
    Lanes same[F::S], residual[F::K], noise[F::K];
    std::copy_n(x, F::S, same);
    std::fill_n(out, F::K, 0.0);
    for (int w = 0; w < stretch.ticks.count; ++w) {
        stretch.see(same, w, residual, noise);
        for (int k = 0; k < F::K; ++k) out[k] += stretch.ticks.variance[2 * w] / noise[k][0];
    }
    for (int k = 0; k < F::K; ++k) {
        const double echo_sq = errors.echo[k] * errors.echo[k];
        out[k] *= errors.weight[k] * (1.0 + echo_sq) / (1.0 - echo_sq) / stretch.ticks.count;
    }
}

// Sums (C, C) of lifted poses over their noise.
template <class F>
void add_moments(const Kind& kind, const Ticks& ticks, double (&out)[F::C * F::C]) {
    std::fill_n(out, F::C * F::C, 0.0);
    for (int w = 0; w < ticks.count; ++w) {
        double own[F::C];
        for (int c = 0; c < F::C; ++c) own[c] = ticks.pose[w * Ticks::entries + kind.lifted[c]];
        for (int c = 0; c < F::C; ++c) {
            const double weighted = own[c] / ticks.variance[2 * w];
            for (int d = 0; d < F::C; ++d) out[c * F::C + d] += weighted * own[d];
        }
    }
}

// As `polish._belong`: which ticks are where the others foretell them.
template <class F>
struct Leverage {
    const Stretch<F>& stretch;
    const Errors<F>& errors;
    Information<F> covariance;

    Leverage(const Stretch<F>& stretch, const Errors<F>& errors, const Information<F>& information)
        : stretch(stretch), errors(errors) {
        Information<F> whole;
        stretch.hold(whole);
        for (int p = 0; p < F::P; ++p) {
            for (int q = 0; q < F::P; ++q) whole[p][q] += information[p][q];
        }
        invert<F>(whole, settings.polish.least_shown, covariance);
    }

    bool foretells(int w) const {
        const PolishSettings& use = settings.polish;
        for (int k = 0; k < F::K; ++k) {
            const double* slope = stretch.lines[k][w].of;
            double along[F::P];
            multiply<F::P, F::P>(slope, covariance[0], along);
            const double left = 1.0 - errors.weight[k] * dot<F::P>(along, slope);
            const double square = errors.weight[k] * slope[F::P] * slope[F::P];
            if (!(square / std::max(left, settings.echoes.least_scale) <
                  use.strange_sigmas * use.strange_sigmas))
                return false;
        }
        return true;
    }
};

}  // namespace kernels
