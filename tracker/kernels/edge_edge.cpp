// What takes long to compile, of two edges.
#define HERE EdgeEdge
#include "heavy.hpp"
