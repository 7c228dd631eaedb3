// Likelihood of one geometry with the noise of every tick. Reference: `refinement`.
#pragma once

#include "evidence/evidence.hpp"

namespace kernels {

// Reference: `refinement.Equations`.
template <class F>
struct Equations {
    double cost = 0.0, gradient[F::P] = {}, curvature[F::P][F::P] = {}, tangent[F::P][F::S];
};

// Reference: `refinement._equations_reference` of x (S,); errors of row k have the precision `weight` and the
// `correlation` from tick to tick.
template <class F>
WIDE void equations_of(const Kind& kind, const double* x, const double* anchors, const Ticks& ticks,
                       const double* weight, const double* correlation, double step, Equations<F>& out) {
    constexpr int blocks = 1 + (F::P + 1) / 2;  // x, and a step along two tangents each, to both sides
    Lanes around[blocks][F::S], scaled[blocks][F::K], places[6];
    double before[F::K][1 + F::P] = {}, fresh[1 + F::P];
    free<F>(x, anchors, out.tangent);
    std::copy_n(anchors, 6, places);
    std::copy_n(x, F::S, around[0]);
    for (int i = 1; i < blocks; ++i) {
        for (int lane = 0; lane < lanes; ++lane) {
            const double* along = out.tangent[std::min(2 * (i - 1) + lane / 2, F::P - 1)];
            for (int s = 0; s < F::S; ++s)
                around[i][s].put(lane, x[s] + (lane % 2 ? -step : step) * along[s]);
        }
        normalise<F>(around[i], places);
    }
    for (int w = 0; w < ticks.count; ++w) {
        Measurement<F> measured;
        for (int i = 0; i < blocks; ++i) {
            measure<F>(kind, around[i], ticks.pose + w * Ticks::entries, measured);
            for (int k = 0; k < F::K; ++k)
                scaled[i][k] = measured.residual[k] / sqrt(noise_of<F>(ticks, w, k, measured));
        }
        for (int k = 0; k < F::K; ++k) {
            const double left = w ? std::pow(correlation[k], ticks.number[w] - ticks.number[w - 1]) : 0.0;
            for (int i = 0; i <= F::P; ++i) {
                const Lanes& sides = scaled[(i + 1) / 2][k];
                const int lane = 2 * (1 - i % 2);
                const double now = i ? (sides[lane] - sides[lane + 1]) / (2.0 * step) : sides[0];
                fresh[i] = (now - left * before[k][i]) / std::sqrt(1.0 - left * left);
                before[k][i] = now;
            }
            out.cost += 0.5 * weight[k] * fresh[0] * fresh[0];
            for (int p = 0; p < F::P; ++p) {
                out.gradient[p] += weight[k] * fresh[1 + p] * fresh[0];
                for (int q = 0; q < F::P; ++q) out.curvature[p][q] += weight[k] * fresh[1 + p] * fresh[1 + q];
            }
        }
    }
}

}  // namespace kernels
