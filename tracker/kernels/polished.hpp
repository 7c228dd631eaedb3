// Elements of a stretch.
#pragma once

#include <pybind11/pybind11.h>

namespace kernels {

void add_polishing(pybind11::module_& module);

}  // namespace kernels
