// The algorithm of `polish` and `echoes`, of one hypothesis and all ticks of a stretch.
#pragma once

#include <vector>

#include "eigen.hpp"
#include "knowing.hpp"
#include "seeing.hpp"

namespace kernels {

// What a tick's k-th residual is in units of its noise, and before that its derivative along each of the free
// directions.
template <class F>
struct Linear {
    double of[F::P + 1];
};

template <class F>
using Linearised = std::vector<Linear<F>>[F::K];

template <class F>
using Information = Square<F::P>;

// As `echoes.Errors`.
template <class F>
struct Errors {
    double weight[F::K], echo[F::K];
};

// As `echoes.new_in`: what is new in a tick's line, where of the one before so much is `left`.
template <class F>
Linear<F> new_in(const Linear<F>& line, const Linear<F>& before, double left) {
    const double scale = 1.0 / std::sqrt(1.0 - left * left);
    Linear<F> out;
    for (int z = 0; z <= F::P; ++z) out.of[z] = scale * (line.of[z] - left * before.of[z]);
    return out;
}

// Call with every line, as far as it is new, and which row it is of.
template <class F, class Function>
void each_new(const Linearised<F>& lines, const Ticks& ticks, const double (&echo)[F::K],
              Function&& function) {
    for (int k = 0; k < F::K; ++k) {
        std::int64_t gap = 0;
        double left = 0.0;
        function(k, lines[k][0]);
        for (int w = 1; w < ticks.count; ++w) {
            const std::int64_t now = ticks.number[w] - ticks.number[w - 1];
            if (now != gap) left = std::pow(echo[k], static_cast<double>(gap = now));
            function(k, new_in<F>(lines[k][w], lines[k][w - 1], left));
        }
    }
}

// One hypothesis, what it knew before and how it may move.
template <class F>
struct Stretch {
    const Kind& kind;
    const Ticks& ticks;
    Prior<F, double> prior;
    double axes[F::P][F::S];
    Linearised<F> lines;

    Stretch(const Kind& kind, const Hypothesis& one, const Ticks& ticks) : kind(kind), ticks(ticks) {
        know<F>(kind, one, prior);
        for (auto& own : lines) own.resize(ticks.count);
    }

    // Residuals of some geometries in tick w, and their noise variances.
    void see(const Lanes* x, int w, Lanes (&residual)[F::K], Lanes (&noise)[F::K]) const {
        Seen<F> seen;
        kernels::see<F>(kind, x, ticks, w, seen);
        std::copy_n(seen.residual, F::K, residual);
        std::fill_n(noise, F::last, Lanes(ticks.noise(w, 1)));
        noise[F::last] = ticks.noise(w, 0) + ticks.noise(w, 1) * seen.lever_sq;
        if (ticks.uneven) noise[F::last] += inner(seen.along, turned(ticks.uneven + 9 * w, 0, seen.along));
    }

    // As `polish._linearised` at x, by differences.
    void linearise(const double* x) {
        constexpr int around = 1 + 2 * F::P, groups = (around + lanes - 1) / lanes;
        Lanes some[groups][F::S], residual[F::K], noise[F::K];
        free<F>(x, prior.anchors, axes);
        for (int g = 0; g < groups * lanes; ++g) {
            double there[F::S];
            const int p = (std::min(g, around - 1) + 1) / 2 - 1;  // to either side along each direction
            for (int s = 0; s < F::S; ++s)
                there[s] = p < 0 ? x[s] : x[s] + (g % 2 ? 1.0 : -1.0) * settings.polish.step * axes[p][s];
            if (p >= 0) normalise<F>(there, prior.anchors);
            for (int s = 0; s < F::S; ++s) some[g / lanes][s].put(g % lanes, there[s]);
        }
        for (int w = 0; w < ticks.count; ++w) {
            double seen[F::K][groups * lanes];
            for (int g = 0; g < groups; ++g) {
                see(some[g], w, residual, noise);
                for (int k = 0; k < F::K; ++k) {
                    const Lanes whitened = residual[k] / sqrt(noise[k]);
                    for (int i = 0; i < lanes; ++i) seen[k][g * lanes + i] = whitened[i];
                }
            }
            for (int k = 0; k < F::K; ++k) {
                for (int p = 0; p < F::P; ++p) {
                    const double across = seen[k][2 * p + 1] - seen[k][2 * p + 2];
                    lines[k][w].of[p] = across / (2.0 * settings.polish.step);
                }
                lines[k][w].of[F::P] = seen[k][0];
            }
        }
    }

    // What the prior says along the free directions.
    void hold(Information<F>& held) const {
        for (int p = 0; p < F::P; ++p) {
            double pulled[F::S];
            prior.times(axes[p], pulled);
            for (int q = 0; q < F::P; ++q) held[p][q] = dot<F::S>(axes[q], pulled);
        }
    }
};

// Where a step begins or ends: x, what it costs, and the normal equations there.
template <class F>
struct Place {
    double x[F::S], cost, gradient[F::P], curvature[F::P][F::P];

    // From the lines there.
    void weigh(const Stretch<F>& at, const Errors<F>& errors) {
        double pull[F::S];
        at.prior.times(x, pull);
        cost = 0.5 * dot<F::S>(x, pull) - dot<F::S>(x, at.prior.information) + at.prior.constant;
        for (int s = 0; s < F::S; ++s) pull[s] -= at.prior.information[s];
        at.hold(curvature);
        for (int p = 0; p < F::P; ++p) gradient[p] = dot<F::S>(at.axes[p], pull);
        each_new<F>(at.lines, at.ticks, errors.echo, [&](int k, const Linear<F>& line) {
            const double residual = errors.weight[k] * line.of[F::P];
            cost += 0.5 * residual * line.of[F::P];
            for (int p = 0; p < F::P; ++p) {
                gradient[p] += residual * line.of[p];
                for (int q = p; q < F::P; ++q) curvature[p][q] += errors.weight[k] * line.of[p] * line.of[q];
            }
        });
    }
};

// As `polish._maximise` from x, in place: the lines there remain.
template <class F>
void maximise(Stretch<F>& stretch, const Errors<F>& errors, double (&x)[F::S]) {
    const PolishSettings& use = settings.polish;
    Place<F> here, there;
    double damping = use.first_damping;
    std::copy_n(x, F::S, here.x);
    stretch.linearise(x);
    here.weigh(stretch, errors);
    for (int left = use.steps; left > 0; --left) {
        double step[F::P], matrix[F::P][F::P], moved[F::S];
        std::copy_n(here.curvature[0], F::P * F::P, matrix[0]);
        for (int p = 0; p < F::P; ++p) {
            matrix[p][p] += damping * matrix[p][p] + use.least_curvature;
            step[p] = -here.gradient[p];
        }
        eliminate(matrix, step);
        free<F>(here.x, stretch.prior.anchors, stretch.axes);
        multiply<F::P, F::S>(step, stretch.axes[0], moved);
        for (int s = 0; s < F::S; ++s) there.x[s] = here.x[s] + moved[s];
        normalise<F>(there.x, stretch.prior.anchors);
        stretch.linearise(there.x);
        there.weigh(stretch, errors);
        const double gain = std::abs(dot<F::P>(here.gradient, step));
        if (there.cost < here.cost) {
            here = there;
            damping = std::max(use.less * damping, use.least_damping);
        } else {
            damping *= use.more;
        }
        if (gain < use.tolerance) break;
    }
    std::copy_n(here.x, F::S, x);
    stretch.linearise(x);
}

}  // namespace kernels
