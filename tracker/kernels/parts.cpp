// Parts of the kernels by themselves, for tests: as the functions are that they stand for.
#include "parts.hpp"

namespace kernels {
namespace {

template <class F>
void put_prior(const Floats& precision, const Floats& information, const Floats& constant,
               const Floats& anchors, int b, Prior<F>& prior) {
    std::copy_n(precision.data() + b * F::S * F::S, F::S * F::S, prior.precision);
    std::copy_n(information.data() + b * F::S, F::S, prior.information);
    prior.constant = constant.data()[b];
    std::copy_n(anchors.data() + b * 6, 6, prior.anchors);
}

py::tuple minimised(const Model& model, const Floats& words, const Floats& precision,
                    const Floats& information, const Floats& constant, const Floats& anchors,
                    const Ints& steps, const Floats& start) {
    const Table table = table_of(model, words);
    return visit(model, [&](auto family) {
        using F = decltype(family);
        py::array_t<double> x({table.count, F::S}), cost(table.count),
            hessian({table.count, F::K, F::P, F::P});
        py::array_t<bool> converged(table.count);
        std::copy_n(start.data(), table.count * F::S, x.mutable_data());
        Work<F> work;
        for (int b = 0; b < table.count; ++b) {
            put_prior<F>(precision, information, constant, anchors, b, work.prior);
            const Moments window = moments_of(model.kind, table.row(b));
            double* own = hessian.mutable_data() + b * F::K * F::P * F::P;
            const Descent found =
                descend<F>(window, x.mutable_data() + b * F::S, static_cast<int>(steps.at(b)), own, work);
            cost.mutable_at(b) = found.cost;
            converged.mutable_at(b) = kernels::converged<F>(found, own, work);
        }
        return py::make_tuple(x, cost, hessian, converged);
    });
}

py::tuple completed(const Model& model, const Floats& words, const Floats& precision,
                    const Floats& information, const Floats& constant, const Floats& anchors,
                    const Floats& start) {
    const Table table = table_of(model, words);
    return visit(model, [&](auto family) {
        using F = decltype(family);
        py::array_t<double> x({table.count, F::S}), cost(table.count);
        std::copy_n(start.data(), table.count * F::S, x.mutable_data());
        Work<F> work;
        for (int b = 0; b < table.count; ++b) {
            put_prior<F>(precision, information, constant, anchors, b, work.prior);
            cost.mutable_at(b) =
                complete<F>(moments_of(model.kind, table.row(b)), x.mutable_data() + b * F::S, work);
        }
        return py::make_tuple(x, cost);
    });
}

void grown(const Model& model, Floats words, const Seeable& seen, double heard, double log_stay) {
    const Table table = changing(model, words);
    visit(model, [&](auto family) {
        for (int b = 0; b < table.count; ++b) {
            grow<decltype(family)>(model.kind, table.row(b), seen.ticks(), heard, log_stay);
        }
    });
}

std::vector<int> offered(const Model& model, const Floats& words) {
    return visit(model, [&](auto family) {
        Prior<decltype(family)> prior;
        return givers<decltype(family)>(model.kind, table_of(model, words), prior);
    });
}

std::vector<int> searching(const Model& model, const Floats& words) {
    return lost(model.kind, table_of(model, words));
}

py::tuple dropped(const Model& model, const Floats& words, std::int64_t now, double best, double margin) {
    return left_of(model, table_of(model, words), now, best, margin);
}

py::tuple relaxed(const Model& model, const Floats& moments) {
    return visit(model, [&](auto family) {
        using F = decltype(family);
        const int windows = static_cast<int>(moments.shape(0)), most = model.kind.relaxed;
        py::array_t<double> x({windows, most, F::S});
        py::array_t<std::int64_t> many(windows);
        for (int b = 0; b < windows; ++b) {
            const double* window = moments.data() + b * F::C * F::C;
            many.mutable_at(b) = relax<F>(window, most, x.mutable_data() + b * most * F::S);
        }
        return py::make_tuple(x, many);
    });
}

}  // namespace

void add_parts(py::module_ module) {
    module.def("minimised", &minimised);
    module.def("completed", &completed);
    module.def("grown", &grown, py::arg("model"), py::arg("words").noconvert(), py::arg("ticks"),
               py::arg("heard"), py::arg("log_stay"));
    module.def("offered", &offered);
    module.def("searching", &searching);
    module.def("dropped", &dropped);
    module.def("relaxed", &relaxed);
}

}  // namespace kernels
