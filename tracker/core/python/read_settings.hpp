// Constants of the algorithm, which Python passes in when it loads the module:
// none is said twice.
#pragma once

#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <utility>
#include <vector>

#include "settings.hpp"

namespace kernels {

// From a dictionary by the names of the fields; raises KeyError where one is
// missing.
inline void configure(const pybind11::dict& values) {
    const auto number = [&](const char* name) { return values[name].cast<double>(); };
    const auto count = [&](const char* name) { return values[name].cast<int>(); };
    settings.damping = {number("first_damping"),  number("least_damping"), number("most_damping"),
                        number("less"),           number("more"),          number("least_share"),
                        number("least_curvature")};
    settings.tolerance = number("tolerance");
    settings.sine_sq_floor = number("sine_sq_floor");
    settings.tiny = number("tiny");
    settings.edge_ridge = number("edge_ridge");
    settings.vertex_ridge = number("vertex_ridge");
    settings.first_ticks = number("first_ticks");
    settings.at_rest = number("at_rest");
    settings.wait_nats = number("wait_nats");
    settings.far_nats = number("far_nats");
    settings.fall_nats = number("fall_nats");
    settings.lift = number("lift");
    settings.at_the_noise = number("at_the_noise");
    settings.least_gain = number("least_gain");
    settings.met_patience = number("met_patience");
    settings.grace_nats = number("grace_nats");
    settings.grace_ticks = number("grace_ticks");
    settings.residual_ticks = number("residual_ticks");
    settings.refine_steps = count("refine_steps");
    settings.first_steps = count("first_steps");
    settings.fallen_steps = count("fallen_steps");
    settings.screened = count("screened");
    settings.weighed = count("weighed");
    settings.young = count("young");
    settings.ages = values["ages"].cast<std::vector<double>>();
    settings.due = values["due"].cast<std::vector<bool>>();
    settings.rounds.clear();
    for (const auto& [steps, kept] : values["rounds"].cast<std::vector<std::pair<int, int>>>())
        settings.rounds.push_back({steps, kept});
}

}  // namespace kernels
