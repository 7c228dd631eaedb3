// Elements of a stretch at their greatest likelihood.
#include "polished.hpp"

#include "bindings.hpp"
#include "finishing.hpp"

namespace kernels {
namespace {

// As `polish._settle` of the first hypothesis of a table: x (S,), row_weight (K,), moments (C, C), and the
// information (P, P); and whether the first tick, and the last one, is where the others foretell it.
template <class F>
py::tuple settled(const Model& model, const Hypothesis& one, const Ticks& ticks) {
    const PolishSettings& use = settings.polish;
    double x[F::S];
    Errors<F> errors;
    read(one.own, model.kind.where.x, F::S, x);
    std::fill_n(errors.weight, F::K, 1.0);
    std::fill_n(errors.echo, F::K, use.first_echo);
    Stretch<F> stretch(model.kind, one, ticks);
    for (int round = 0; round < use.rounds; ++round) {
        maximise<F>(stretch, errors, x);
        learn_errors<F>(stretch, errors);
    }
    Information<F> information = {};
    each_new<F>(stretch.lines, ticks, errors.echo, [&](int k, const Linear<F>& line) {
        for (int p = 0; p < F::P; ++p) {
            for (int q = 0; q < F::P; ++q) information[p][q] += errors.weight[k] * line.of[p] * line.of[q];
        }
    });
    double row_weight[F::K], moments[F::C * F::C];
    weigh_rows<F>(stretch, errors, x, row_weight);
    add_moments<F>(model.kind, ticks, moments);
    const Leverage<F> leverage(stretch, errors, information);
    return py::make_tuple(Floats(F::S, x), Floats(F::K, row_weight), Floats({F::C, F::C}, moments),
                          Floats({F::P, F::P}, information[0]), leverage.foretells(0),
                          leverage.foretells(ticks.count - 1));
}

py::tuple polished(const Model& model, const Floats& words, const Floats& onsets, const Seeable& seen) {
    const Bank bank = bank_of(model, words, onsets);
    require(bank.count() > 0, "there is no hypothesis");
    return visit(model,
                 [&](auto family) { return settled<decltype(family)>(model, bank[0], seen.ticks(model)); });
}

}  // namespace

void add_polishing(py::module_& module) { module.def("polished", &polished); }

}  // namespace kernels
