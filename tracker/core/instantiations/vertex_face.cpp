// What takes long to compile, of vertices and faces.
#define HERE VertexFace
#include "instantiations/instantiations.hpp"
