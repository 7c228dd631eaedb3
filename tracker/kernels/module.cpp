// The Python module `contact_tracker.compiled.kernels`; kernels.pyi says what it has.
#include "averaging.hpp"
#include "beginning.hpp"
#include "bindings.hpp"
#include "elements.hpp"
#include "inference.hpp"
#include "observing.hpp"
#include "parts.hpp"
#include "polished.hpp"
#include "products.hpp"
#include "reading.hpp"
#include "separating.hpp"
#include "sliding.hpp"
#include "striding.hpp"

#define QUOTED(text) #text
#define AS_TEXT(text) QUOTED(text)

namespace kernels {
namespace {

// How many words rows have, and where columns begin.
using Words = std::pair<int, std::map<std::string, int>>;

int word(const Words& rows, const std::string& column) {
    const auto found = rows.second.find(column);
    if (found == rows.second.end()) throw std::invalid_argument("a table without " + column);
    return found->second;
}

Where where_of(const Words& bank) {
    const auto at = [&](const std::string& column) { return word(bank, column); };
    return {at("onset"),          at("number"),   at("source"),     at("pair"),
            at("certain"),        at("searched"), at("met"),        at("entry"),
            at("grace"),          at("lasted"),   at("settled"),    at("earned"),
            at("log_likelihood"), at("rms"),      at("known_mean"), at("known"),
            at("pivot"),          at("x"),        at("row_weight")};
}

WhereSince since_of(const Words& onsets) {
    const auto at = [&](const std::string& column) { return word(onsets, column); };
    return {at("onset"),     at("onset_ns"), at("weight"), at("told"),
            at("place_sum"), at("first"),    at("moments")};
}

using Form = std::array<int, 5>;
using Sizes = std::array<int, 4>;

template <class F>
bool is_family(const Form& form, const Sizes& sizes) {
    return form == Form{F::d1, F::q1, F::d2, F::q2, F::h} && sizes == Sizes{F::S, F::C, F::K, F::P};
}

Which which_of(const Form& form, const Sizes& sizes) {
    if (is_family<Family<FaceFace>>(form, sizes)) return Which::face_face;
    if (is_family<Family<EdgeFace>>(form, sizes)) return Which::edge_face;
    if (is_family<Family<VertexFace>>(form, sizes)) return Which::vertex_face;
    require(is_family<Family<EdgeEdge>>(form, sizes), "kernels know no family of this form and these sizes");
    return Which::edge_edge;
}

py::tuple summed(const Model& model, const Floats& x, const Ints& onset, const Bools& certain,
                 const Seeable& seen, const Weights& weights) {
    return visit(model, [&](auto family) {
        using F = decltype(family);
        require(x.ndim() == 2 && x.shape(1) == F::S, "not geometry of this contact");
        const int count = static_cast<int>(x.shape(0));
        py::array_t<double> totals({count, 4}), gain({count, F::K}), precision({count, F::K});
        for (int first = 0; first < count; first += lanes) {
            Lanes geometry[F::S];
            std::int64_t begun[lanes];
            Mask sure;
            const auto own = [&](int i) { return std::min(first + i, count - 1); };
            for (int i = 0; i < lanes; ++i) {
                begun[i] = onset.at(own(i));
                sure.put(i, certain.at(own(i)));
                for (int s = 0; s < F::S; ++s) geometry[s].put(i, x.data()[own(i) * F::S + s]);
            }
            const Sums<F> sums =
                add_up<F>(model.kind, geometry, begun, sure, seen.ticks(model), weights.lengths);
            for (int i = 0; i < lanes; ++i) {
                const double total[] = {sums.log_ratio[i], sums.chi_sq[i], sums.ticks[i], sums.after[i]};
                std::copy_n(total, 4, totals.mutable_data() + 4 * own(i));
                for (int k = 0; k < F::K; ++k) {
                    gain.mutable_at(own(i), k) = sums.gain[k][i];
                    precision.mutable_at(own(i), k) = sums.precision[k][i];
                }
            }
        }
        return py::make_tuple(totals, gain, precision);
    });
}

void learned(const Model& model, Floats words, const Floats& onsets, const Seeable& seen, const Ints& steps,
             const Weights& weights) {
    const Bank bank = changing(model, words, onsets);
    visit(model, [&](auto family) {
        Work<decltype(family)> work;
        Learners learners;
        for (int b = 0; b < bank.count(); ++b) {
            const int own = static_cast<int>(steps.at(b));
            if (own >= 0) learners.add(model.kind, bank[b], own);
        }
        learners.learn<decltype(family)>(model.kind, seen.ticks(model), weights, work);
    });
}

void searched(const Model& model, Floats words, const Floats& onsets, const Seeable& seen, const Ints& rows,
              const Floats& directions, const Floats& turn, const Weights& weights) {
    const Bank bank = changing(model, words, onsets);
    const Directions drawn = directions_of(model, directions, turn);
    visit(model, [&](auto family) {
        Work<decltype(family)> work;
        for (py::ssize_t i = 0; i < rows.shape(0); ++i) {
            require(rows.at(i) >= 0 && rows.at(i) < bank.count(), "no such row");
            search<decltype(family)>(model.kind, bank, static_cast<int>(rows.at(i)), drawn, seen.ticks(model),
                                     weights, work);
        }
    });
}

template <class X, class Y>
void minimise_all(const Floats& k, double tolerance, int iterations, Floats& x, Floats& y, Floats& value,
                  Bools& converged) {
    constexpr int n = X::size * Y::size;
    const py::ssize_t count = k.shape(0);
    require(k.ndim() == 3 && k.shape(1) == n && k.shape(2) == n, "K is not of these factors");
    require_shape(x, {count, X::size}, "there is not one start of each window");
    require_shape(y, {count, Y::size}, "there is not one start of each window");
    for (int w = 0; w < k.shape(0); ++w) {
        const Minimum found = minimise<X, Y>(k.data() + w * n * n, x.mutable_data() + w * X::size,
                                             y.mutable_data() + w * Y::size, tolerance, iterations);
        value.mutable_at(w) = found.value;
        converged.mutable_at(w) = found.converged;
    }
}

// Call with what a factor is, as a type.
template <class Function>
void with_factor(const std::string& factor, Function&& function) {
    if (factor == "point") return function(Point{});
    if (factor == "plane") return function(Plane{});
    require(factor == "line", "a factor is a point, a plane or a line");
    function(Line{});
}

py::tuple minimised(const std::string& of_x, const std::string& of_y, const Floats& k, const Floats& from_x,
                    const Floats& from_y, double tolerance, int iterations) {
    Floats x(from_x.request()), y(from_y.request()), value(k.shape(0));
    Bools converged(k.shape(0));
    with_factor(of_x, [&](auto a) {
        with_factor(of_y, [&](auto b) {
            minimise_all<decltype(a), decltype(b)>(k, tolerance, iterations, x, y, value, converged);
        });
    });
    return py::make_tuple(value, x, y, converged);
}

}  // namespace
}  // namespace kernels

PYBIND11_MODULE(kernels, module) {
    using namespace kernels;
    read_settings();
    module.attr("FINGERPRINT") = AS_TEXT(FINGERPRINT);  // of the sources
    py::class_<Model>(module, "Model")
        .def(py::init([](const Form& form, const Sizes& sizes, const Words& bank, const Words& onsets,
                         bool body_in_1, double needed, double patience, std::vector<std::int64_t> lifted,
                         std::vector<double> pull, int relaxed) {
            const Which which = which_of(form, sizes);
            require(pull.size() == static_cast<std::size_t>(sizes[0]), "not a pull of each of x");
            require(lifted.size() == static_cast<std::size_t>(sizes[1]), "not a column of each of the lift");
            const Kind kind{body_in_1, needed,  patience,       lifted,
                            pull,      relaxed, where_of(bank), since_of(onsets)};
            return Model{kind, which, bank.first, onsets.first};
        }));
    py::class_<Seeable, std::shared_ptr<Seeable>>(module, "Ticks")
        .def(py::init<Ints, Floats, Floats, Floats, Floats, Floats, std::optional<Floats>>());
    py::class_<Weights>(module, "Weights")
        .def(py::init([](double radius_sq, double pull, double foreknowledge, double independence) {
            return Weights{{radius_sq, pull}, foreknowledge, independence};
        }));
    module.def("summed", &summed);
    py::class_<Moment>(module, "Moment")
        .def(py::init([](std::vector<std::pair<Floats, Bools>> assumed,
                         std::vector<std::optional<Floats>> directions, Floats turn, std::int64_t onset,
                         std::int64_t onset_ns, std::int64_t stamp_ns, std::shared_ptr<Seeable> window,
                         std::shared_ptr<Seeable> before, Floats change, Floats log_stay) {
            require(window != nullptr, "a moment is seen in a window");
            return Moment{std::move(assumed), std::move(directions),
                          std::move(turn),    onset,
                          onset_ns,           stamp_ns,
                          std::move(window),  std::move(before),
                          std::move(change),  std::move(log_stay)};
        }));
    py::class_<Until>(module, "Until")
        .def(py::init(
            [](double probability, double sureness, std::vector<std::pair<std::int64_t, std::int64_t>> due) {
                return Until{probability, sureness, std::move(due)};
            }));
    module.def("strode", &strode);
    module.def("entered", &entered);
    module.def("used_directions", &used_directions);
    module.def("rivals", &rivals);
    module.def("learned", &learned, py::arg("model"), py::arg("words").noconvert(), py::arg("onsets"),
               py::arg("ticks"), py::arg("steps"), py::arg("weights"));
    module.def("searched", &searched, py::arg("model"), py::arg("words").noconvert(), py::arg("onsets"),
               py::arg("ticks"), py::arg("rows"), py::arg("directions"), py::arg("turn"), py::arg("weights"));
    module.def("shown", &shown);
    module.def("begun", &begun);
    module.def("part_row", &part_row);
    module.def("face_row", &face_row);
    module.def("minimised", &minimised);
    module.def("slid", &slid, py::arg("trail").noconvert(), py::arg("first"), py::arg("end"),
               py::arg("number"), py::arg("newest"), py::arg("excess"), py::arg("count"), py::arg("sensor"),
               py::arg("floor"), py::arg("position_m2"));
    add_averaging(module);
    add_inference(module);
    add_polishing(module);
    parts::add(module.def_submodule("parts"));
}
