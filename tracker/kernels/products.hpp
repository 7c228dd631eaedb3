// The algorithm of `paper.batched`: one window after the other.
#pragma once

#include <type_traits>
#include <utility>

#include "settings.hpp"
#include "vectors.hpp"

namespace kernels {

// What a factor is, see `paper.kronecker`: so many entries, and directions in which they are free.
struct Point {
    static constexpr int size = 4, free = 3;
};
struct Plane {
    static constexpr int size = 4, free = 3;
};
struct Line {
    static constexpr int size = 6, free = 4;
};

// K at some x and y: with x put in on the left, `on_x` (b, n), or y, `on_y` (a, n); on both sides, as in
// `batched._Contracted`, `by_x` (a, a) with y, `by_y` (b, b) with x, `mixed` (b, a) with x and y.
template <class X, class Y>
struct Contracted {
    static constexpr int a = X::size, b = Y::size, n = a * b;

    double x[a], y[b], on_x[b][n], on_y[a][n], by_x[a][a], by_y[b][b], mixed[b][a];

    // As `batched._contracted` at the x and y there; returns the value.
    double contract(const double* k) {
        std::fill_n(on_x[0], b * n, 0.0);
        std::fill_n(on_y[0], a * n, 0.0);
        for (int i = 0; i < a; ++i) {
            for (int j = 0; j < b; ++j) {
                const double* row = k + (i * b + j) * n;
                for (int c = 0; c < n; ++c) {
                    on_x[j][c] += x[i] * row[c];
                    on_y[i][c] += y[j] * row[c];
                }
            }
        }
        for (int i = 0; i < a; ++i) {
            for (int h = 0; h < a; ++h) by_x[i][h] = dot<b>(on_y[i] + h * b, y);
        }
        for (int j = 0; j < b; ++j) {
            std::fill_n(by_y[j], b, 0.0);
            for (int h = 0; h < a; ++h) {
                mixed[j][h] = dot<b>(on_x[j] + h * b, y);
                for (int c = 0; c < b; ++c) by_y[j][c] += x[h] * on_x[j][h * b + c];
            }
        }
        double value = 0.0;
        for (int i = 0; i < a; ++i) value += x[i] * dot<a>(by_x[i], x);
        return value;
    }
};

// As `batched._tangent`, a direction a row.
template <class Z>
void free_directions(const double* e, double (&out)[Z::free][Z::size]) {
    std::fill_n(out[0], Z::free * Z::size, 0.0);
    if constexpr (std::is_same_v<Z, Point>) {
        for (int i = 0; i < 3; ++i) out[i][i] = 1.0;
    } else {
        const auto [u, v] = across(at(e, 0));
        put(out[0], 0, u);
        put(out[1], 0, v);
        if constexpr (std::is_same_v<Z, Plane>) {
            out[2][3] = 1.0;
        } else {
            put(out[0], 3, -inner(at(e, 3), u) * at(e, 0));
            put(out[1], 3, -inner(at(e, 3), v) * at(e, 0));
            put(out[2], 3, u);
            put(out[3], 3, v);
        }
    }
}

// As `batched._move`, a `step` along the directions.
template <class Z>
void move(const double* e, const double* step, const double (&free)[Z::free][Z::size], double* out) {
    multiply<Z::free, Z::size>(step, free[0], out);
    for (int i = 0; i < Z::size; ++i) out[i] += e[i];
    if constexpr (!std::is_same_v<Z, Point>) {
        const double norm = std::sqrt(inner(at(out, 0), at(out, 0)));
        for (int i = 0; i < 3; ++i) out[i] /= norm;
        if constexpr (std::is_same_v<Z, Line>) {
            put(out, 3, at(out, 3) - inner(at(out, 0), at(out, 3)) * at(out, 0));
        }
    }
}

// Memory of a step: directions in which x and y may move, gradient, curvature and step of both.
template <class X, class Y>
struct Step {
    static constexpr int p = X::free, q = Y::free;

    double free_x[p][X::size], free_y[q][Y::size], gradient[p + q], curvature[p + q][p + q];

    // Gradient, and the upper triangle of the curvature.
    void equations(const Contracted<X, Y>& here) {
        double by_x[X::size], by_y[Y::size];
        for (int i = 0; i < p; ++i) {
            multiply<X::size, X::size>(free_x[i], here.by_x[0], by_x);
            gradient[i] = dot<X::size>(by_x, here.x);
            for (int j = i; j < p; ++j) curvature[i][j] = dot<X::size>(by_x, free_x[j]);
        }
        for (int i = 0; i < q; ++i) {
            multiply<Y::size, X::size>(free_y[i], here.mixed[0], by_x);
            for (int j = 0; j < p; ++j) curvature[j][p + i] = dot<X::size>(by_x, free_x[j]);
            multiply<Y::size, Y::size>(free_y[i], here.by_y[0], by_y);
            gradient[p + i] = dot<Y::size>(by_y, here.y);
            for (int j = i; j < q; ++j) curvature[p + i][p + j] = dot<Y::size>(by_y, free_y[j]);
        }
    }

    // As in `batched._step`.
    void damp(double damping) {
        double largest = 0.0;
        for (int i = 0; i < p + q; ++i) largest = std::max(largest, curvature[i][i]);
        const double floor = settings.products.least_share * largest + settings.products.least_curvature;
        for (int i = 0; i < p + q; ++i) curvature[i][i] += damping * (curvature[i][i] + floor) + floor;
    }

    // A step from `here`; returns the value `there`.
    double attempt(const double* k, const Contracted<X, Y>& here, double damping, Contracted<X, Y>& there) {
        free_directions<X>(here.x, free_x);
        free_directions<Y>(here.y, free_y);
        equations(here);
        damp(damping);
        double step[p + q];
        for (int i = 0; i < p + q; ++i) step[i] = -gradient[i];
        eliminate(curvature, step);
        move<X>(here.x, step, free_x, there.x);
        move<Y>(here.y, step + p, free_y, there.y);
        return there.contract(k);
    }
};

struct Minimum {
    double value;
    bool converged;
};

// As `batched.minimise_batched` of one window; x and y in place.
template <class X, class Y>
Minimum minimise(const double* k, double* x, double* y, double tolerance, int iterations) {
    Contracted<X, Y> memory[2], *here = memory, *there = memory + 1;
    Step<X, Y> step;
    std::copy_n(x, X::size, here->x);
    std::copy_n(y, Y::size, here->y);
    double damping = settings.products.first;
    Minimum found{here->contract(k), false};
    for (int i = 0; i < iterations && !found.converged; ++i) {
        const double tried = step.attempt(k, *here, damping, *there), gain = found.value - tried;
        if (gain > 0.0) {
            found.converged = gain <= tolerance * found.value;
            found.value = tried;
            damping = std::max(damping * settings.products.less, settings.products.least);
            std::swap(here, there);
        } else {
            found.converged = damping >= settings.products.most;
            damping = std::min(damping * settings.products.more, settings.products.most);
        }
    }
    std::copy_n(here->x, X::size, x);
    std::copy_n(here->y, Y::size, y);
    return found;
}

}  // namespace kernels
