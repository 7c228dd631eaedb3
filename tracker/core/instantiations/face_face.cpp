// Instantiations for face-face contacts.
#define HERE FaceFace
#include "instantiations/instantiations.hpp"
