// What takes long to compile, of two faces.
#define HERE FaceFace
#include "instantiations/instantiations.hpp"
