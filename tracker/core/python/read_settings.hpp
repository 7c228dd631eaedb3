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

inline void configure(const pybind11::dict& values) {
    Settings& to = settings;
    Damping& damping = to.damping;
    read_fields(values, "first_damping", damping.first, "least_damping", damping.least, "most_damping",
                damping.most, "damping_decrease", damping.decrease, "damping_increase", damping.increase,
                "least_share", damping.least_share, "least_curvature", damping.least_curvature);
    read_fields(values, "tolerance", to.tolerance, "sine_sq_floor", to.sine_sq_floor, "tiny", to.tiny,
                "edge_ridge", to.edge_ridge, "vertex_ridge", to.vertex_ridge, "first_ticks", to.first_ticks,
                "rest_weight", to.rest_weight, "defer_nats", to.defer_nats, "far_nats", to.far_nats,
                "drop_nats", to.drop_nats, "relaxation_ridge", to.relaxation_ridge, "fitting_rms",
                to.fitting_rms, "least_gain", to.least_gain, "protection_nats", to.protection_nats,
                "protection_ticks", to.protection_ticks, "residual_ticks", to.residual_ticks);
    read_fields(values, "refine_steps", to.refine_steps, "first_steps", to.first_steps, "recovery_steps",
                to.recovery_steps, "followed_starts", to.followed_starts, "search_refits", to.search_refits,
                "unthinned_ticks", to.unthinned_ticks, "search_ages", to.search_ages, "is_search_age",
                to.is_search_age);
    to.rounds.clear();
    for (const auto& [steps, kept] : values["rounds"].cast<std::vector<std::pair<int, int>>>())
        to.rounds.push_back({steps, kept});
}

}  // namespace kernels
