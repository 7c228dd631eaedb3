// Number of constraints that two contacts impose together. Reference:
// `conditional_contact.constraints_of_two`.
#pragma once

#include "evidence/directions.hpp"
#include "python/numpy_views.hpp"

namespace kernels {

// In the newest tick, with both contacts of one kind: their elements are the rows of `x` (2, S). Gradients
// that differ by less than `same_row` are of one constraint.
inline int count_constraints(const Model& model, const TickArrays& window, const Floats& x, double same_row) {
    return visit(model, [&](auto family) {
        using F = decltype(family);
        require_shape(x, {2, F::S}, "elements are not geometry of this contact");
        const Ticks ticks = window.ticks(model);
        Square<directions> square{}, axes;
        for (int i = 0; i < 2; ++i) {
            double row[F::K][F::C], moved[F::C], lifted[F::C], gradient[directions];
            rows<F>(x.data(i, 0), row);
            for (int c = 0; c < F::C; ++c) lifted[c] = ticks.newest_pose()[model.kind.lifted[c]];
            for (const auto& one : row) {
                double length_sq = 0.0;
                for (int d = 0; d < directions; ++d) {
                    multiply<F::C, F::C>(one, model.kind.moves.data() + d * F::C * F::C, moved);
                    gradient[d] = dot<F::C>(moved, lifted) * (d < 3 ? 1.0 : settings.lever_m);
                    length_sq += gradient[d] * gradient[d];
                }
                if (length_sq == 0.0) continue;
                for (int p = 0; p < directions; ++p)
                    for (int q = 0; q < directions; ++q)
                        square[p][q] += gradient[p] * gradient[q] / length_sq;
            }
        }
        eigen<directions>(square, axes);
        int count = 0;
        for (int d = 0; d < directions; ++d) count += square[d][d] > same_row * same_row;
        return count;
    });
}

}  // namespace kernels
