// Instantiations for vertex-face contacts.
#define HERE VertexFace
#include "instantiations/instantiations.hpp"
