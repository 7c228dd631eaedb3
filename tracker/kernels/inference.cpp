// Hidden Markov inference: forward while ticks come in, and back.
#include "inference.hpp"

#include <pybind11/numpy.h>
#include <pybind11/stl.h>

#include "arrays.hpp"
#include "backward.hpp"
#include "trellis.hpp"

namespace kernels {
namespace {

template <class Number>
py::array_t<Number> shaped(const std::vector<Number>& numbers, std::vector<py::ssize_t> shape) {
    return py::array_t<Number>(std::move(shape), numbers.data());
}

template <class Number>
py::array_t<Number> listed(const std::vector<Number>& numbers) {
    return shaped(numbers, {static_cast<py::ssize_t>(numbers.size())});
}

py::tuple advance(Forward& forward, const Ints& state, const Ints& onset, const Floats& log_likelihood,
                  const Floats& change) {
    const auto states = static_cast<py::ssize_t>(forward.left().size() / 2);
    const py::ssize_t count = state.size();
    require_shape(state, {count}, "hypotheses have one state each");
    require_shape(onset, {count}, "hypotheses have one onset each");
    require_shape(log_likelihood, {count}, "hypotheses have one log-likelihood each");
    require_shape(change, {states, states}, "changes are from state to state");
    const TickStep step = forward.advance(state.data(), onset.data(), log_likelihood.data(),
                                          static_cast<int>(count), change.data());
    return py::make_tuple(shaped(step.source, {states, states}), listed(step.onset), listed(step.state),
                          listed(step.probability), shaped(step.best, {2, states}));
}

py::tuple living(const Forward& forward) {
    const Entries& ended = forward.ended();
    const std::size_t states = forward.left().size() / 2;
    std::vector<double> total(states, 0.0), log_weight, best;
    std::vector<std::int64_t> onset, state, origin;
    for (std::size_t cell = 0; cell < ended.sum.size(); ++cell) total[cell % states] += ended.sum[cell];
    for (std::size_t cell = 0; cell < ended.sum.size(); ++cell) {
        if (!(ended.sum[cell] > 0.0)) continue;
        const std::size_t j = cell % states;
        onset.push_back(ended.onset[cell / states]);
        state.push_back(static_cast<std::int64_t>(j));
        log_weight.push_back(std::log(ended.sum[cell]) - std::log(total[j]) + forward.left()[j]);
        best.push_back(ended.best[cell]);
        origin.push_back(ended.origin[cell]);
    }
    return py::make_tuple(listed(onset), listed(state), listed(log_weight), listed(best), listed(origin));
}

using Onsets = py::array_t<std::int32_t, py::array::c_style | py::array::forcecast>;
using States = py::array_t<std::int8_t, py::array::c_style | py::array::forcecast>;

// Steps as they are in Python, with the arrays that are looked into.
struct Steps {
    std::vector<std::tuple<Floats, Onsets, States, Floats>> arrays;
    std::vector<Passed> ticks;

    explicit Steps(const py::list& steps) {
        for (const py::handle& step : steps) {
            const auto all = step.cast<py::tuple>();
            arrays.emplace_back(all[0], all[1], all[2], all[3]);
        }
        for (const auto& [source, onset, state, probability] : arrays) {
            require(onset.size() == state.size() && onset.size() == probability.size(), "not a step");
            ticks.push_back({source.data(), probability.data(), onset.data(), state.data(),
                             static_cast<int>(onset.size())});
        }
    }

    std::size_t states() const { return static_cast<std::size_t>(std::get<0>(arrays.at(0)).shape(0)); }
};

// What is alive at the end, with the numbers (L, C) that are followed.
Passed alive(const Onsets& onset, const States& state, const Floats& futures) {
    require_shape(state, {onset.size()}, "what is alive has one state each");
    require(futures.ndim() == 2 && futures.shape(0) == onset.size(), "what is alive has one row each");
    return {nullptr, nullptr, onset.data(), state.data(), static_cast<int>(onset.size())};
}

Floats covered(const py::list& steps, std::int64_t first, const Onsets& onset, const States& state,
               const Floats& probability) {
    const Steps open(steps);
    const std::size_t states = open.states();
    Floats out({static_cast<py::ssize_t>(open.ticks.size()), static_cast<py::ssize_t>(states)});
    follow_back(open.ticks, first, alive(onset, state, probability), probability.data(), states, 1,
                [&](std::size_t row, const std::vector<double>& cover, const Held&) {
                    std::copy(cover.begin(), cover.end(), out.mutable_data() + row * states);
                    return true;
                });
    return out;
}

std::size_t in_common(const py::list& steps, std::int64_t first, const Onsets& onset, const States& state,
                      const Floats& futures, double tolerance, std::size_t checked) {
    const Steps open(steps);
    return common(open.ticks, first, alive(onset, state, futures), futures.data(), open.states(),
                  static_cast<std::size_t>(futures.shape(1)), tolerance, checked);
}

}  // namespace

void add_inference(py::module_& module) {
    py::class_<Forward>(module, "Forward")
        .def(py::init<std::vector<double>, double>())
        .def("advance", &advance)
        .def("living", &living);
    module.def("covered", &covered);
    module.def("in_common", &in_common);
}

}  // namespace kernels
