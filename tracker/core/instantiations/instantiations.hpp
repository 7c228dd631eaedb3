// Instantiations of the templates that take long to compile. CMake makes a file for each family, so that they
// compile in parallel; it defines HERE as the family's name.
#pragma once

#include "update/contact_update.hpp"

namespace kernels {

#define HEAVY(PREFIX, F)                                                                                  \
    PREFIX template Lanes complete<F>(const Moments<F>&, Lanes*, Work<F>&);                               \
    PREFIX template void equations<F>(const Moments<F>&, const Lanes*, Work<F>&);                         \
    PREFIX template Lanes take_step<F>(const Lanes&, Work<F>&);                                           \
    PREFIX template void accept<F>(const Moments<F>&, const Mask&, Lanes*, Work<F>&);                     \
    PREFIX template Lanes volume<F>(const Lanes*, const Lanes*, Work<F>&);                                \
    PREFIX template EvidenceSums<F> sum_evidence<F>(const Kind&, const Lanes*, const std::int64_t*,       \
                                                    const Mask&, const Ticks&, const Lengths&);           \
    PREFIX template void accumulate_onsets<F>(const Kind&, const Table&, const Ticks&, const Lengths&,    \
                                              double);                                                    \
    PREFIX template void refit<F>(const Kind&, const Rows&, const Ticks&, int, const EvidenceParameters&, \
                                  Work<F>&);

#ifndef HERE
#define DECLARE(F) HEAVY(extern, Family<F>)
FAMILIES(DECLARE)
#undef DECLARE
#else
HEAVY(, Family<HERE>)
#endif

}  // namespace kernels
