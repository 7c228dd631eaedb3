// Hidden Markov inference.
#pragma once

#include <pybind11/pybind11.h>

namespace kernels {

void add_inference(pybind11::module_& module);

}  // namespace kernels
