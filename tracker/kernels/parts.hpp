// Parts of the kernels by themselves, for tests.
#pragma once

#include "bindings.hpp"

namespace kernels {

void add_parts(py::module_ module);

}  // namespace kernels
