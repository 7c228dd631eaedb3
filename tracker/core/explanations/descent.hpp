// Descent to the elements of a further contact, a start per lane. Reference:
// `conditional_contact.search`.
#pragma once

#include "contacts/prior.hpp"

namespace kernels {

// Numbers of the descent: the first damping, the least value of a form, and what is added to each curvature:
// a constant, and a share that is multiplied by the damping.
using DescentLimits = std::array<double, 4>;

// Reference: `search.Problem`: the forms (3, C, C) of squared residual, free motion and noise over some
// ticks.
template <class F>
struct FormationProblem {
    const double* matrices;
    double ticks;
    DescentLimits limits;
    Prior<F, Lanes> prior;
};

// Cost of a geometry: `carried` are its rows times the matrices, `forms` and `pull` as in the reference.
template <class F>
struct Weighed {
    Lanes carried[3][F::K][F::C], forms[3][F::K], pull[F::S], cost;

    // Reference: `Problem.cost` and `Problem._forms`.
    Weighed(const FormationProblem<F>& of, const Lanes* x) {
        Lanes c[F::K][F::C];
        rows<F>(x, c);
        of.prior.times(x, pull);
        cost = 0.5 * dot<F::S>(x, pull) - dot<F::S>(x, of.prior.information) + of.prior.constant;
        for (int s = 0; s < F::S; ++s) pull[s] -= of.prior.information[s];
        for (int k = 0; k < F::K; ++k) {
            for (int m = 0; m < 3; ++m) {
                multiply<F::C, F::C>(c[k], of.matrices + m * F::C * F::C, carried[m][k]);
                forms[m][k] = larger<Lanes>(dot<F::C>(carried[m][k], c[k]), of.limits[1]);
            }
            const Lanes loose = each(forms[1][k] / forms[2][k], [](double one) { return std::log1p(one); });
            cost += 0.5 * of.ticks * (forms[0][k] / forms[2][k] - loose);
        }
    }
};

// Reference: `Problem.descend`, in place; of the hessian only the upper triangle is used.
template <class F>
WIDE void descend(const FormationProblem<F>& of, int steps, Lanes* x) {
    Lanes axes[F::P][F::S], slopes[F::P][F::K][F::C], pushed[F::C], pulled[F::S], trial[F::S];
    Lanes step[F::P], hessian[F::P][F::P], damping = of.limits[0];
    for (; steps > 0; --steps) {
        const Weighed<F> at(of, x);
        free<F>(x, of.prior.anchors, axes);
        for (int p = 0; p < F::P; ++p) {
            slope<F>(x, axes[p], slopes[p]);
            of.prior.times(axes[p], pulled);
            step[p] = -dot<F::S>(axes[p], at.pull);
            for (int q = 0; q <= p; ++q) hessian[q][p] = dot<F::S>(axes[q], pulled);
            for (int k = 0; k < F::K; ++k) {
                const Lanes noise = at.forms[2][k], per_noise = of.ticks / noise;
                const Lanes by_noise = dot<F::C>(slopes[p][k], at.carried[2][k]);
                const Lanes by_loose = dot<F::C>(slopes[p][k], at.carried[1][k]) + by_noise;
                step[p] -= per_noise * dot<F::C>(slopes[p][k], at.carried[0][k]) +
                           per_noise * by_noise * (1.0 - at.forms[0][k] / noise) -
                           of.ticks * by_loose / (at.forms[1][k] + noise);
                multiply<F::C, F::C>(slopes[p][k], of.matrices, pushed);
                for (int q = 0; q <= p; ++q) hessian[q][p] += per_noise * dot<F::C>(slopes[q][k], pushed);
            }
            hessian[p][p] += of.limits[2] + of.limits[3] * damping * hessian[p][p];
        }
        for (int p : F::turns) hessian[p][p] += damping;
        eliminate(hessian, step);
        multiply<F::P, F::S>(step, axes[0], trial);
        for (int s = 0; s < F::S; ++s) trial[s] += x[s];
        normalise<F>(trial, of.prior.anchors);
        const Mask better = Weighed<F>(of, trial).cost < at.cost;
        for (int s = 0; s < F::S; ++s) x[s] = where(better, trial[s], x[s]);
        damping *= where(better, Lanes(settings.damping.decrease), Lanes(settings.damping.increase));
        damping = smaller<Lanes>(larger<Lanes>(damping, settings.damping.least), settings.damping.most);
    }
}

}  // namespace kernels
