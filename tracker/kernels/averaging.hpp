// Averaging of poses.
#pragma once

#include <pybind11/pybind11.h>

namespace kernels {

void add_averaging(pybind11::module_& module);

}  // namespace kernels
