// Bindings of single kernels for tests, with the names and arguments of their kernels.
#pragma once

#include "update/bank_update.hpp"

namespace kernels::parts {

// Fits posed by a test: windows of hypotheses, and their priors.
struct Problems {
    const Model& model;
    Bank bank;
    const Floats &precision, &information, &constant, &anchors;

    int own(int first, int i) const { return std::min(first + i, bank.count() - 1); }

    Rows rows(int first) const {
        return rows_of([&](int i) { return bank[own(first, i)]; });
    }

    // The priors of the hypotheses from `first` on, one per lane.
    template <class F>
    void read_prior(int first, Prior<F, Lanes>& prior) const {
        const auto row = [&](int i) { return own(first, i); };
        gather(precision.data(), F::S * F::S, row, prior.precision);
        gather(information.data(), F::S, row, prior.information);
        gather(anchors.data(), 6, row, prior.anchors);
        gather(constant.data(), 1, row, &prior.constant);
    }
};

// With negative `steps` only the coordinates follow the directions (`complete`), and there is no hessian.
inline py::tuple minimise(const Model& model, const Floats& words, const Floats& onsets,
                          const Floats& precision, const Floats& information, const Floats& constant,
                          const Floats& anchors, int steps, const Floats& start) {
    const Problems given{model, bank_of(model, words, onsets), precision, information, constant, anchors};
    return visit(model, [&](auto family) {
        using F = decltype(family);
        const int count = given.bank.count();
        py::array_t<double> x({count, F::S}), cost(count), hessian({count, F::K, F::U});
        py::array_t<bool> converged(count);
        Work<F> work;
        Lanes geometry[F::S];
        for (int first = 0; first < count; first += lanes) {
            const auto row = [&](int i) { return given.own(first, i); };
            given.read_prior<F>(first, work.prior);
            gather(start.data(), F::S, row, geometry);
            const Moments<F> window(model.kind, given.rows(first));
            Descent descent{Lanes(0.0), Lanes(0.0), false};
            if (steps >= 0)
                descent = descend<F>(window, geometry, steps, work);
            else
                descent.cost = complete<F>(window, geometry, work);
            scatter(geometry, F::S, row, x.mutable_data());
            scatter(&descent.cost, 1, row, cost.mutable_data());
            if (steps < 0) continue;
            const Mask done = kernels::converged<F>(descent, work);
            scatter(work.near.hessian[0], F::K * F::U, row, hessian.mutable_data());
            for (int i = 0; i < lanes; ++i) converged.mutable_at(given.own(first, i)) = done[i];
        }
        return py::make_tuple(x, cost, hessian, converged);
    });
}

inline void accumulate(const Model& model, Floats words, Floats onsets, const TickArrays& seen,
                       const EvidenceParameters& weights, double log_stay) {
    words.mutable_data();  // raises for read-only arrays
    onsets.mutable_data();
    const Bank bank = bank_of(model, words, onsets);
    const Ticks ticks = seen.ticks(model);
    visit(model, [&](auto family) {
        kernels::accumulate<decltype(family)>(model.kind, bank, ticks, weights.lengths, ticks.motion_ratio(),
                                              log_stay);
    });
}

inline std::vector<int> select_for_search(const Model& model, const Floats& words, const Floats& onsets) {
    return kernels::select_for_search(model.kind, bank_of(model, words, onsets));
}

inline py::tuple keep_best(const Model& model, const Floats& words, const Floats& onsets, std::int64_t now,
                           double best, double margin) {
    GrowingBank growing(model, words, onsets, 0, 0);
    const KeptHypotheses left = kernels::keep_best(
        model.kind, Bank(model.kind, growing.own(), growing.onsets()), now, best, margin, growing);
    const auto [own, since] = growing.left();
    return py::make_tuple(Ints(left.rows.size(), left.rows.data()), own, since, left.log_weight,
                          left.residual, left.leader[0]);
}

inline py::tuple relax(const Model& model, const Floats& moments) {
    return visit(model, [&](auto family) {
        using F = decltype(family);
        const int windows = static_cast<int>(moments.shape(0)), most = model.kind.relaxed;
        py::array_t<double> x({windows, most, F::S});
        py::array_t<std::int64_t> many(windows);
        for (int b = 0; b < windows; ++b) {
            const double* window = moments.data() + b * F::C * F::C;
            many.mutable_at(b) = kernels::relax<F>(window, most, x.mutable_data() + b * most * F::S);
        }
        return py::make_tuple(x, many);
    });
}

// Add all bindings to a module.
inline void add(py::module_ module) {
    module.def("minimise", &minimise);
    module.def("accumulate", &accumulate, py::arg("model"), py::arg("words").noconvert(),
               py::arg("onsets").noconvert(), py::arg("ticks"), py::arg("weights"), py::arg("log_stay"));
    module.def("select_for_search", &select_for_search);
    module.def("keep_best", &keep_best);
    module.def("relax", &relax);
}

}  // namespace kernels::parts
