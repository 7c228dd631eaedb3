// Reading of the constants that Python passes in when it loads the module.
#pragma once

#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <utility>
#include <vector>

#include "settings.hpp"

namespace kernels {

// Read fields from a dictionary, each after its name; raises KeyError if one is missing.
inline void read_fields(const pybind11::dict&) {}
template <class Field, class... More>
void read_fields(const pybind11::dict& values, const char* name, Field& field, More&&... more) {
    field = values[name].cast<Field>();
    read_fields(values, more...);
}

// The field of `to` of that name.
#define FIELD(name) #name, to.name

inline void configure(const pybind11::dict& values) {
    Settings& to = settings;
    Damping& damping = to.damping;
    read_fields(values, "first_damping", damping.first, "least_damping", damping.least, "most_damping",
                damping.most, "damping_decrease", damping.decrease, "damping_increase", damping.increase,
                "least_share", damping.least_share, "least_curvature", damping.least_curvature);
    read_fields(values, FIELD(tolerance), FIELD(sine_sq_floor), FIELD(tiny), FIELD(ridge), FIELD(used),
                FIELD(lever_m), FIELD(one_axis), FIELD(no_motion), FIELD(stride_ticks), FIELD(first_ticks),
                FIELD(rest_weight), FIELD(near_nats), FIELD(decisive), FIELD(fitting_rms),
                FIELD(recovery_steps), FIELD(first_steps), FIELD(followed_starts), FIELD(unthinned_ticks),
                FIELD(search_ages), FIELD(is_search_age));
    to.rounds.clear();
    for (const auto& [steps, kept] : values["rounds"].cast<std::vector<std::pair<int, int>>>())
        to.rounds.push_back({steps, kept});
}

}  // namespace kernels
