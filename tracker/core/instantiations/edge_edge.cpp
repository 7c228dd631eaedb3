// What takes long to compile, of two edges.
#define HERE EdgeEdge
#include "instantiations/instantiations.hpp"
