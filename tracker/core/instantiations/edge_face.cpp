// What takes long to compile, of edges and faces.
#define HERE EdgeFace
#include "instantiations/instantiations.hpp"
