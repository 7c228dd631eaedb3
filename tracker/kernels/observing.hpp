// What the window of a hypothesis shows of its geometry, and what noise alone would feign, see
// `observability`.
#pragma once

#include "bindings.hpp"
#include "fitting.hpp"

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

// Of the first hypothesis of a table the free directions (P, S) at x, what its window tells along them, as
// `following.information`, and what noise of this `variance` feigns (P, P).
inline py::tuple shown(const Model& model, const Floats& words, const Floats& onsets, const Two& variance,
                       const Floats& off) {
    const Bank bank = bank_of(model, words, onsets);
    require(bank.count() > 0, "there is no hypothesis");
    return visit(model, [&](auto family) {
        using F = decltype(family);
        require_shape(off, {F::C, ways_of_a_pose * F::C}, "not what poses of this contact may be off by");
        double x[F::S], anchors[6], axes[F::P][F::S], told[F::P][F::P], feigned[F::P][F::P];
        read(bank[0].own, model.kind.where.x, F::S, x);
        anchor(model.kind, bank[0], anchors);
        free<F>(x, anchors, axes);
        feign<F>(model.kind, bank[0], axes, variance, off.data(), feigned);
        tell<F>(model.kind, bank[0], told);
        return py::make_tuple(Floats({F::P, F::S}, axes[0]), Floats({F::P, F::P}, told[0]),
                              Floats({F::P, F::P}, feigned[0]));
    });
}

}  // namespace kernels
