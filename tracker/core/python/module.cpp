// The Python module `contact_tracker.hypotheses.compiled.kernels`, documented in kernels.pyi.
#include "python/numpy_views.hpp"
#include "python/read_settings.hpp"
#include "python/test_bindings.hpp"
#include "update/bank_update.hpp"

#define QUOTED(text) #text
#define AS_TEXT(text) QUOTED(text)

namespace kernels {
namespace {

// Words per row, and the first word of each column.
using Words = std::pair<int, pybind11::dict>;

BankLayout bank_layout(const Words& bank) {
    BankLayout to;
    read_fields(bank.second, "onset", to.onset, "number", to.number, "prior_index", to.prior_index,
                "known_pair_index", to.known_pair_index, "elements_known", to.elements_known, "needs_search",
                to.needs_search, "log_birth_weight", to.log_birth_weight, "protected_until",
                to.protected_until, "log_prior", to.log_prior, "llr_before_window", to.llr_before_window,
                "gain_before_window", to.gain_before_window, "log_likelihood", to.log_likelihood, "rms",
                to.rms, "prior_mean", to.prior_mean, "prior_information", to.prior_information, "line_anchor",
                to.line_anchor, "x", to.x, "row_weight", to.row_weight);
    return to;
}

OnsetLayout onset_layout(const Words& onsets) {
    OnsetLayout to;
    read_fields(onsets.second, "onset", to.onset, "onset_ns", to.onset_ns, "weight", to.weight,
                "effective_ticks", to.effective_ticks, "weighted_position_sum", to.weighted_position_sum,
                "onset_row", to.onset_row, "second_moment", to.second_moment);
    return to;
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
            const Kind kind{body_in_1, needed,  burn_in_ticks,     lifted,
                            pull,      relaxed, bank_layout(bank), onset_layout(onsets)};
            return Model{kind, which, bank.first, onsets.first};
        }));
    py::class_<TickArrays, std::shared_ptr<TickArrays>>(module, "Ticks")
        .def(py::init([](Ints number, Floats pose, Floats inverse, Floats variance, Floats excess,
                         Floats displacement_variance, std::optional<Floats> position_anisotropy,
                         std::optional<Floats> before) {
            TickArrays ticks{
                number, pose, inverse, variance, excess, displacement_variance, position_anisotropy, before};
            ticks.check_shapes();
            return ticks;
        }));
    py::class_<EvidenceParameters>(module, "EvidenceParameters")
        .def(py::init([](double radius_sq, double pull, double correlation, double prior_predictive_share,
                         double likelihood_exponent) {
            return EvidenceParameters{
                {radius_sq, pull, correlation}, prior_predictive_share, likelihood_exponent};
        }));
    py::class_<TickInput>(module, "TickInput")
        .def(py::init([](std::vector<std::pair<Floats, Bools>> assumed,
                         std::vector<std::optional<Floats>> directions, Floats turn, std::int64_t onset,
                         std::int64_t onset_ns, std::int64_t stamp_ns, std::shared_ptr<TickArrays> window,
                         std::shared_ptr<TickArrays> before, Floats change, Floats log_stay) {
            require(window != nullptr, "a tick input has no window");
            return TickInput{std::move(assumed), std::move(directions),
                             std::move(turn),    onset,
                             onset_ns,           stamp_ns,
                             std::move(window),  std::move(before),
                             std::move(change),  std::move(log_stay)};
        }));
    module.def("update", &update_tables);
    parts::add(module.def_submodule("parts"));
}
