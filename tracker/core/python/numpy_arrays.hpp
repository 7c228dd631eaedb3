// Types of numpy arrays.
#pragma once

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <stdexcept>
#include <vector>

namespace kernels {

namespace py = pybind11;

// C-contiguous; arrays of another layout are copied.
using Floats = py::array_t<double, py::array::c_style | py::array::forcecast>;
using Ints = py::array_t<std::int64_t, py::array::c_style | py::array::forcecast>;
using Bools = py::array_t<bool, py::array::c_style | py::array::forcecast>;

inline void require(bool holds, const char* what) {
    if (!holds) throw std::invalid_argument(what);
}

// Raise unless the array has this shape.
template <class Numbers>
void require_shape(const Numbers& array, const std::vector<py::ssize_t>& shape, const char* what) {
    require(array.ndim() == static_cast<py::ssize_t>(shape.size()) &&
                std::equal(shape.begin(), shape.end(), array.shape()),
            what);
}

// Raise unless the array has this shape and finite numbers.
inline void require_finite(const Floats& array, const std::vector<py::ssize_t>& shape, const char* what) {
    require_shape(array, shape, what);
    require(std::all_of(array.data(), array.data() + array.size(), [](double x) { return std::isfinite(x); }),
            what);
}

}  // namespace kernels
