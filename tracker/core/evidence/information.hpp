// What the motion, the prior and noise say about the geometry of one hypothesis. Reference:
// `observability.information_terms_reference`.
#pragma once

#include "evidence/evidence.hpp"
#include "fitting/gauss_newton.hpp"

namespace kernels {

// Free directions (P, S) at the geometry x, and information (P, P) along them of the ticks, of the prior and
// of noise alone; that of the ticks is at the optimum of x's coordinates.
template <class F>
struct InformationTerms {
    double tangent[F::P][F::S], data[F::P][F::P], prior[F::P][F::P], noise[F::P][F::P];
};

// Information of the ticks by the moments of the window.
template <class F>
void data_information(const Kind& kind, const Rows& rows, double (&out)[F::P][F::P]) {
    Work<F> work;
    const Moments<F> window(kind, rows);
    Lanes x[F::S];
    read(rows.own, kind.where.x, F::S, x);
    read_prior<F>(kind, rows, work.prior);
    complete<F>(window, x, work);
    equations<F>(window, x, work);
    for (int p = 0; p < F::P; ++p) {
        for (int q = 0; q < F::P; ++q) {
            out[p][q] = 0.0;
            for (int k = 0; k < F::K; ++k) out[p][q] += work.near.hessian[k][F::upper(p, q)][0];
        }
    }
}

// Information that noise of the poses with this variance (position, rotation) would add. It is that of the
// changes of each row when a pose is turned or shifted by one sigma.
template <class F>
void noise_information(const Kind& kind, const Hypothesis& one, const double* x, const Two& variance,
                       const double (&tangent)[F::P][F::S], double (&out)[F::P][F::P]) {
    double moments[F::C * F::C], row[F::K][F::C], turn[9], slopes[F::P][F::K][F::C], moved[F::P][F::C],
        carried[F::C];
    read_symmetric<F::C>(one.since, kind.since.second_moment, moments);
    rows<F>(x, row);
    for (int p = 0; p < F::P; ++p) {
        slope<F>(x, tangent[p], slopes[p]);
        std::fill_n(out[p], F::P, 0.0);
    }
    const double scale = scale_sq<F>(row[F::last], moments, turn);
    for (int k = 0; k < F::K; ++k) {
        const double weight = one.own[kind.where.row_weight + k] / (k == F::last ? scale : 1.0);
        for (int i = 0; i < Kind::perturbations; ++i) {
            const double* move = kind.moves.data() + i * F::C * F::C;
            const double precision = weight * variance[i < 3];
            for (int p = 0; p < F::P; ++p) multiply<F::C, F::C>(slopes[p][k], move, moved[p]);
            for (int p = 0; p < F::P; ++p) {
                multiply<F::C, F::C>(moved[p], moments, carried);
                for (int q = 0; q < F::P; ++q) out[p][q] += precision * dot<F::C>(carried, moved[q]);
            }
        }
    }
}

// Precision of the weak prior, directions on their sphere included, and of the hypothesis' own prior.
template <class F>
void prior_information(const Kind& kind, const Hypothesis& one, const double (&tangent)[F::P][F::S],
                       double (&out)[F::P][F::P]) {
    double precision[F::S * F::S], pulled[F::S];
    read_symmetric<F::S>(one.own, kind.where.prior_information, precision);
    for (int s = 0; s < F::S; ++s) precision[s * F::S + s] += kind.pull[s] > 0.0 ? kind.pull[s] : 1.0;
    for (int p = 0; p < F::P; ++p) {
        multiply<F::S, F::S>(tangent[p], precision, pulled);
        for (int q = 0; q < F::P; ++q) out[p][q] = dot<F::S>(pulled, tangent[q]);
    }
}

template <class F>
InformationTerms<F> information_terms(const Kind& kind, const Hypothesis& one, const Two& variance) {
    InformationTerms<F> terms;
    double anchors[6], x[F::S];
    std::copy_n(one.own + kind.where.x, F::S, x);
    anchor(kind, one, anchors);
    free<F>(x, anchors, terms.tangent);
    data_information<F>(kind, rows_of([&](int) { return one; }), terms.data);
    prior_information<F>(kind, one, terms.tangent, terms.prior);
    noise_information<F>(kind, one, x, variance, terms.tangent, terms.noise);
    return terms;
}

}  // namespace kernels
