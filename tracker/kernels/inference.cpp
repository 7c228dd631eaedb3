// Hidden Markov inference: forward while ticks come in, and back.
#include "inference.hpp"

#include <pybind11/numpy.h>
#include <pybind11/stl.h>

#include <tuple>

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

// Refuse what looks beyond N `states` or to where nothing has begun, before the tick `end`.
void require_entries(const Onsets& onset, const States& state, std::size_t states, std::int64_t end) {
    require(onset.ndim() == 1, "onsets are in a row");
    require_shape(state, {onset.size()}, "there is not one state for each onset");
    for (py::ssize_t i = 0; i < onset.size(); ++i) {
        require(state.data()[i] >= 0 && state.data()[i] < static_cast<std::int64_t>(states), "no such state");
        require(onset.data()[i] < end, "an onset that is to come");
    }
}

// Steps from tick `first` on as they are in Python, with the arrays that are looked into.
struct Steps {
    std::vector<std::tuple<Floats, Onsets, States, Floats>> arrays;
    std::vector<Passed> ticks;
    std::size_t states;
    std::int64_t first, end;

    Steps(const py::list& steps, std::int64_t first) : first(first), end(first + py::len(steps)) {
        require(!steps.empty(), "there are no steps");
        for (const py::handle& step : steps) {
            const auto all = step.cast<py::tuple>();
            arrays.emplace_back(all[0], all[1], all[2], all[3]);
        }
        const py::ssize_t wide = std::get<0>(arrays[0]).size() ? std::get<0>(arrays[0]).shape(0) : 0;
        states = static_cast<std::size_t>(wide);
        for (const auto& [source, onset, state, probability] : arrays) {
            require_shape(source, {wide, wide}, "sources are from state to state");
            require_entries(onset, state, states, end);
            require_shape(probability, {onset.size()}, "there is not one probability for each onset");
            ticks.push_back({source.data(), probability.data(), onset.data(), state.data(),
                             static_cast<int>(onset.size())});
        }
    }

    // What is alive at the end, with the numbers (L, C) that are followed.
    Passed alive(const Onsets& onset, const States& state, const Floats& futures) const {
        require_entries(onset, state, states, end);
        require(futures.ndim() == 2 && futures.shape(1) > 0, "there are no futures");
        require_shape(futures, {onset.size(), futures.shape(1)}, "there is not one row for each onset");
        return {nullptr, nullptr, onset.data(), state.data(), static_cast<int>(onset.size())};
    }
};

Floats covered(const py::list& steps, std::int64_t first, const Onsets& onset, const States& state,
               const Floats& probability) {
    const Steps open(steps, first);
    const std::size_t states = open.states;
    require_shape(probability, {onset.size(), 1}, "there is not one probability for each onset");
    Floats out({static_cast<py::ssize_t>(open.ticks.size()), static_cast<py::ssize_t>(states)});
    follow_back(open.ticks, first, open.alive(onset, state, probability), probability.data(), states, 1,
                [&](std::size_t row, const std::vector<double>& cover, const Held&) {
                    std::copy(cover.begin(), cover.end(), out.mutable_data() + row * states);
                    return true;
                });
    return out;
}

std::size_t in_common(const py::list& steps, std::int64_t first, const Onsets& onset, const States& state,
                      const Floats& futures, double tolerance, std::size_t checked) {
    require(checked > 0, "checked every so many ticks, at least one");
    const Steps open(steps, first);
    return common(open.ticks, first, open.alive(onset, state, futures), futures.data(), open.states,
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
