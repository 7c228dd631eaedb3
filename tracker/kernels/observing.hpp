// What the window of a hypothesis shows of its geometry, and what noise alone would feign, see
// `observability`.
#pragma once

#include <cmath>
#include <optional>
#include <stdexcept>

#include "bindings.hpp"
#include "fitting.hpp"
#include "hearing.hpp"

namespace kernels {

constexpr int ways_of_a_pose = 6;

// As `observability.feigned_information` along the `axes`; `off` (6, C, C) is what `_perturbations` has.
template <class F>
void feign(const Kind& kind, const Hypothesis& one, const double (&axes)[F::P][F::S], const Two& variance,
           const double* off, double (&out)[F::P][F::P]) {
    constexpr int each = ways_of_a_pose * F::C, all = F::K * each;
    double x[F::S], moments[F::C * F::C], c[F::K][F::C], turn[9], moved[F::P][all], seen[F::P][all];
    read(one.own, kind.where.x, F::S, x);
    read_symmetric<F::C>(one.since, kind.since.moments, moments);
    rows<F>(x, c);
    const double scale = scale_sq<F>(c[F::last], moments, turn);
    for (int p = 0; p < F::P; ++p) {
        slope<F>(x, axes[p], c);
        for (int k = 0; k < F::K; ++k) {
            const double weight = one.own[kind.where.row_weight + k] / (k == F::last ? scale : 1.0);
            double* own = moved[p] + k * each;
            multiply<F::C, each>(c[k], off, own);
            for (int way = 0; way < ways_of_a_pose; ++way) {
                const double sigmas = std::sqrt(weight * variance[way < 3 ? 1 : 0]);  // first turns
                for (int i = 0; i < F::C; ++i) own[way * F::C + i] *= sigmas;
                multiply<F::C, F::C>(own + way * F::C, moments, seen[p] + k * each + way * F::C);
            }
        }
        for (int q = 0; q <= p; ++q) out[p][q] = out[q][p] = dot<all>(seen[p], moved[q]);
    }
}

// As `following.information`.
template <class F>
void tell(const Kind& kind, const Hypothesis& one, double (&out)[F::P][F::P]) {
    const Rows rows = rows_of([&](int) { return one; });
    Work<F> work;
    Lanes x[F::S];
    read(rows.own, kind.where.x, F::S, x);
    know<F>(kind, rows, work.prior);
    descend<F>(Moments<F>(kind, rows), x, 0, work);
    for (int p = 0; p < F::P; ++p) {
        for (int q = 0; q < F::P; ++q) {
            out[p][q] = 0.0;
            for (int k = 0; k < F::K; ++k) out[p][q] += work.near.hessian[k][F::upper(p, q)][0];
        }
    }
}

// Of the first so many numbers of both.
inline double dot_of(const double* a, const double* b, int count) {
    double sum = 0.0;
    for (int i = 0; i < count; ++i) sum += a[i] * b[i];
    return sum;
}

// `rows left rows^T`, of rows (R, C) and a symmetric matrix (C, C).
template <int R, int C>
void seen_along(const double* rows, const double* left, double (&out)[R][R]) {
    double image[R][C];
    for (int i = 0; i < R; ++i) {
        multiply<C, C>(rows + i * C, left, image[i]);
        for (int j = 0; j <= i; ++j) out[i][j] = out[j][i] = dot<C>(image[i], rows + j * C);
    }
}

// As `small.eigenvectors(a, b)` of symmetric matrices, b positive definite: values, and vectors in rows.
template <int N>
void eigen_against(const Square<N>& a, Square<N>& b, double* values, Square<N>& vectors) {
    for (int i = 0; i < N; ++i) {  // Cholesky's factor, below
        for (int j = 0; j <= i; ++j) {
            const double left = b[i][j] - dot_of(b[i], b[j], j);
            if (i == j && !(left > 0.0)) throw std::invalid_argument("not positive definite");
            b[i][j] = i == j ? std::sqrt(left) : left / b[j][j];
        }
    }
    Square<N> half, whole, axes;
    for (int j = 0; j < N; ++j) {  // half = L^-1 a; whole = half L^-T
        for (int i = 0; i < N; ++i) {
            double left = a[i][j];
            for (int k = 0; k < i; ++k) left -= b[i][k] * half[k][j];
            half[i][j] = left / b[i][i];
        }
    }
    for (int i = 0; i < N; ++i) {
        for (int j = 0; j < N; ++j) whole[i][j] = (half[i][j] - dot_of(whole[i], b[j], j)) / b[j][j];
    }
    for (int i = 0; i < N; ++i) {
        for (int j = 0; j < i; ++j) whole[i][j] = whole[j][i] = 0.5 * (whole[i][j] + whole[j][i]);
    }
    eigen<N>(whole, axes);
    for (int v = 0; v < N; ++v) {
        values[v] = whole[v][v];
        for (int i = N - 1; i >= 0; --i) {
            double left = axes[v][i];
            for (int k = i + 1; k < N; ++k) left -= b[k][i] * vectors[v][k];
            vectors[v][i] = left / b[i][i];
        }
    }
}

// As `observability.posterior_covariance`, the ways in rows.
template <int P>
void posterior(const double* told, const Square<P>& ways, const Square<P>& prior, Square<P>& out) {
    Square<P> precision, scaled, inverse;
    seen_along<P, P>(ways[0], prior[0], precision);
    double scale[P];
    for (int p = 0; p < P; ++p) {
        precision[p][p] += std::max(told[p] - 1.0, 0.0);
        scale[p] = 1.0 / std::sqrt(precision[p][p]);
    }
    for (int p = 0; p < P; ++p) {
        for (int q = 0; q < P; ++q) {
            precision[p][q] *= scale[p] * scale[q];
            scaled[q][p] = ways[p][q] * scale[p];
        }
    }
    invert<P>(precision, inverse);
    seen_along<P, P>(scaled[0], inverse[0], out);
}

// Of the first hypothesis of a table, as `observability.shown`: `off` as for `feign`, `vague` (S, S) what it
// knows of x from the outset, and what the ticks tell if that is not what its window does.
inline py::tuple shown(const Model& model, const Floats& words, const Floats& onsets, const Two& variance,
                       const Floats& off, const Floats& vague, const std::optional<Floats>& information) {
    const Bank bank = bank_of(model, words, onsets);
    require(bank.count() > 0, "there is no hypothesis");
    return visit(model, [&](auto family) {
        using F = decltype(family);
        constexpr int P = F::P, S = F::S;
        require_shape(off, {F::C, ways_of_a_pose * F::C}, "not what poses of this contact may be off by");
        require_shape(vague, {S, S}, "not a precision of x");
        if (information) require_shape(*information, {P, P}, "not information along free directions");
        double x[S], anchors[6], axes[P][S], known[S * S], values[P], across[S][P], covariance[S][S];
        Square<P> told, prior, against, ways, spread;
        read(bank[0].own, model.kind.where.x, S, x);
        read_symmetric<S>(bank[0].own, model.kind.where.known, known);
        for (int i = 0; i < S * S; ++i) known[i] += vague.data()[i];
        anchor(model.kind, bank[0], anchors);
        free<F>(x, anchors, axes);
        feign<F>(model.kind, bank[0], axes, variance, off.data(), against);
        if (information) {
            std::copy_n(information->data(), P * P, told[0]);
        } else {
            tell<F>(model.kind, bank[0], told);
        }
        seen_along<P, S>(axes[0], known, prior);
        Floats tangent({S, P}), columns({P, P});
        for (int p = 0; p < P; ++p) {
            for (int q = 0; q < P; ++q) against[p][q] += prior[p][q];
            for (int s = 0; s < S; ++s) tangent.mutable_at(s, p) = across[s][p] = axes[p][s];
        }
        eigen_against<P>(told, against, values, ways);
        posterior<P>(values, ways, prior, spread);
        seen_along<S, P>(across[0], spread[0], covariance);
        for (int p = 0; p < P; ++p) {
            for (int q = 0; q < P; ++q) columns.mutable_at(q, p) = ways[p][q];
        }
        return py::make_tuple(Floats({S, S}, covariance[0]), tangent, Floats({P, P}, prior[0]),
                              Floats(P, values), columns);
    });
}

}  // namespace kernels
