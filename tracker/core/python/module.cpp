// The Python module `contact_tracker.hypotheses.compiled.kernels`, documented in kernels.pyi.
#include "evidence/competing.hpp"
#include "evidence/directions.hpp"
#include "evidence/proximity.hpp"
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
    read_fields(bank.second, FIELD(onset), FIELD(number), FIELD(prior_index), FIELD(known_pair_index),
                FIELD(elements_known), FIELD(needs_search), FIELD(log_birth_weight), FIELD(log_prior),
                FIELD(llr_before_window), FIELD(gain_before_window), FIELD(log_likelihood), FIELD(rms),
                FIELD(prior_mean), FIELD(prior_information), FIELD(line_anchor), FIELD(x), FIELD(row_weight));
    return to;
}

OnsetLayout onset_layout(const Words& onsets) {
    OnsetLayout to;
    read_fields(onsets.second, FIELD(onset), FIELD(onset_ns), FIELD(weight), FIELD(effective_ticks),
                FIELD(weighted_position_sum), FIELD(onset_row), FIELD(second_moment));
    return to;
}

using Form = std::array<int, 5>;
using Sizes = std::array<int, 4>;

template <class F>
bool is_family(const Form& form, const Sizes& sizes) {
    return form == Form{F::d1, F::q1, F::d2, F::q2, F::h} && sizes == Sizes{F::S, F::C, F::K, F::P};
}

Which which_of(const Form& form, const Sizes& sizes) {
#define CHECK(F) \
    if (is_family<Family<F>>(form, sizes)) return Which::F;
    FAMILIES(CHECK)
#undef CHECK
    throw std::invalid_argument("kernels know no family of this form and these sizes");
}

// Reference: `births.proximity_evidence` of a contact with some pairs of `known` elements. Returns
// the log odds, the gain (2,), and the index and the table rows of the proposals that are kept.
py::tuple weigh_births(const Model& model, const Floats& words, const Bools& known, const Floats& x,
                       const Floats& deviation, const TickArrays& window, const Two& beyond,
                       const BirthLimits& limits) {
    const Table table = table_of(words, model.words);
    const auto pairs = static_cast<int>(x.shape(0));
    require_shape(known, {table.count}, "each proposal is of known elements or not");
    require(pairs > 0 && std::count(known.data(), known.data() + known.size(), true) == pairs,
            "the known pairs are not those of the proposals");
    std::vector<double> log_share;
    for (int b = 0; b < table.count; ++b) log_share.push_back(table.row(b)[model.kind.where.log_likelihood]);
    const BirthEvidence found = visit(model, [&](auto family) {
        using F = decltype(family);
        require_shape(x, {pairs, F::S}, "known elements are not geometry of this contact");
        require_shape(deviation, {pairs, F::K, F::P, F::C}, "not the deviations of these elements");
        return birth_evidence<F>(model.kind, log_share, known.data(), {x.data(), deviation.data(), pairs},
                                 window.ticks(model, beyond), limits);
    });
    Floats kept({static_cast<py::ssize_t>(found.rows.size()), py::ssize_t(model.words)});
    for (std::size_t i = 0; i < found.rows.size(); ++i) {
        double* row = kept.mutable_data() + i * model.words;
        std::copy_n(table.row(static_cast<int>(found.rows[i])), model.words, row);
        row[model.kind.where.log_prior] = row[model.kind.where.log_likelihood] = found.log_share[i];
    }
    return py::make_tuple(found.log_odds, found.gain, Ints(found.rows.size(), found.rows.data()), kept);
}

// Reference: `bank_update.fit_window`: refit all hypotheses of a bank to a window, and search minima of those
// whose elements are open, from the directions of this `tick`.
py::tuple fit_window(const Model& model, const Floats& words, const Floats& onsets, const TickArrays& window,
                     const Floats& turn, std::int64_t tick, const EvidenceParameters& weights) {
    require_finite(turn, {3, 3}, "a turn is a matrix of finite numbers");
    GrowingBank fitted(model, words, onsets, 0, 0);
    const Bank bank(model.kind, fitted.own(), fitted.onsets());
    const Directions directions = model.directions(tick, turn);
    visit(model, [&](auto family) {
        fit<decltype(family)>(model.kind, bank, window.ticks(model), directions, weights);
    });
    return py::cast(fitted.left());
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
                         std::vector<std::int64_t> lifted, std::vector<double> pull, int relaxed, int column,
                         int search_interval, const Floats& drawn) {
            const Which which = which_of(form, sizes);
            require(pull.size() == static_cast<std::size_t>(sizes[0]), "not a pull of each of x");
            require(lifted.size() == static_cast<std::size_t>(sizes[1]), "not a column of each of the lift");
            const Kind kind{body_in_1, needed,  burn_in_ticks,     lifted,
                            pull,      relaxed, bank_layout(bank), onset_layout(onsets)};
            require(drawn.ndim() == 3 && drawn.shape(0) > 0 && drawn.shape(2) == sizes[0],
                    "directions are not geometry of this contact");
            return Model{kind, which, bank.first, onsets.first, column, search_interval, drawn};
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
    module.def("update", &update_tables);
    py::class_<BirthLimits>(module, "BirthLimits").def(py::init<double, double, double, int>());
    module.def("weigh_births", &weigh_births);
    module.def("competing_evidence", &competing_evidence);
    module.def("motion_since", [](const TickArrays& window, std::int64_t onset) {
        return motion_since(window.ticks(), onset);
    });
    module.def("fit_window", &fit_window);
    parts::add(module.def_submodule("parts"));
}
