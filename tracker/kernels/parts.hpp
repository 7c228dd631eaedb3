// What the module has beside what it does with hypotheses.
#pragma once

#include "bindings.hpp"

namespace kernels {

// Averaging of poses.
void add_averaging(py::module_& module);

// Parts of the kernels by themselves, for tests.
void add_parts(py::module_ module);

}  // namespace kernels
