// Instantiations for edge-face contacts.
#define HERE EdgeFace
#include "instantiations/instantiations.hpp"
