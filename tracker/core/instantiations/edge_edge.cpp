// Instantiations for edge-edge contacts.
#define HERE EdgeEdge
#include "instantiations/instantiations.hpp"
