// The Python module `contact_tracker.compiled.kernels`; kernels.pyi says what
// it has.
#include "python/numpy_views.hpp"
#include "python/read_settings.hpp"
#include "python/test_bindings.hpp"
#include "update/batch_update.hpp"

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

BankLayout where_of(const Words& bank) {
    const auto at = [&](const std::string& column) { return word(bank, column); };
    return {at("onset"),
            at("number"),
            at("prior_index"),
            at("known_pair_index"),
            at("elements_known"),
            at("needs_search"),
            at("from_landmark"),
            at("log_birth_weight"),
            at("protected_until"),
            at("log_prior"),
            at("llr_before_window"),
            at("gain_before_window"),
            at("log_likelihood"),
            at("rms"),
            at("prior_mean"),
            at("prior_information"),
            at("line_anchor"),
            at("x"),
            at("row_weight")};
}

OnsetLayout since_of(const Words& onsets) {
    const auto at = [&](const std::string& column) { return word(onsets, column); };
    return {
        at("onset"),     at("onset_ns"),     at("weight"), at("effective_ticks"), at("weighted_position_sum"),
        at("onset_row"), at("second_moment")};
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

}  // namespace
}  // namespace kernels

PYBIND11_MODULE(kernels, module) {
    using namespace kernels;
    module.attr("FINGERPRINT") = AS_TEXT(FINGERPRINT);  // of the sources
    module.def("configure", &configure);
    py::class_<Model>(module, "Model")
        .def(py::init([](const Form& form, const Sizes& sizes, const Words& bank, const Words& onsets,
                         bool body_in_1, double needed, double burn_in_ticks,
                         std::vector<std::int64_t> lifted, std::vector<double> pull, int relaxed) {
            const Which which = which_of(form, sizes);
            require(pull.size() == static_cast<std::size_t>(sizes[0]), "not a pull of each of x");
            require(lifted.size() == static_cast<std::size_t>(sizes[1]), "not a column of each of the lift");
            const Kind kind{body_in_1, needed,  burn_in_ticks,  lifted,
                            pull,      relaxed, where_of(bank), since_of(onsets)};
            return Model{kind, which, bank.first, onsets.first};
        }));
    py::class_<TickArrays, std::shared_ptr<TickArrays>>(module, "Ticks")
        .def(py::init<Ints, Floats, Floats, Floats, Floats, Floats, std::optional<Floats>,
                      std::optional<Floats>>());
    py::class_<EvidenceParameters>(module, "EvidenceParameters")
        .def(py::init(
            [](double radius_sq, double pull, double correlation, double foreknowledge, double independence) {
                return EvidenceParameters{{radius_sq, pull, correlation}, foreknowledge, independence};
            }));
    py::class_<TickInput>(module, "TickInput")
        .def(py::init([](std::vector<std::pair<Floats, Bools>> assumed,
                         std::vector<std::optional<Floats>> directions, Floats turn, std::int64_t onset,
                         std::int64_t onset_ns, std::int64_t stamp_ns, std::shared_ptr<TickArrays> window,
                         std::shared_ptr<TickArrays> before, Floats change, Floats log_stay) {
            require(window != nullptr, "a moment is seen in a window");
            return TickInput{std::move(assumed), std::move(directions),
                             std::move(turn),    onset,
                             onset_ns,           stamp_ns,
                             std::move(window),  std::move(before),
                             std::move(change),  std::move(log_stay)};
        }));
    py::class_<StopCondition>(module, "StopCondition")
        .def(py::init(
            [](double probability, double sureness, std::vector<std::pair<std::int64_t, std::int64_t>> due) {
                return StopCondition{probability, sureness, std::move(due)};
            }));
    module.def("update", &update_in_batch);
    parts::add(module.def_submodule("parts"));
}
