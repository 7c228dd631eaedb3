// Constants, read from the Python modules that have them.
#pragma once

#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <string>
#include <utility>
#include <vector>

#include "settings.hpp"

namespace kernels {

inline Damping damping_of(const pybind11::module_& module) {
    const auto number = [&](const char* name) { return module.attr(name).cast<double>(); };
    return {number("FIRST_DAMPING"), number("LEAST_DAMPING"), number("MOST_DAMPING"),   number("LESS"),
            number("MORE"),          number("LEAST_SHARE"),   number("LEAST_CURVATURE")};
}

// Raises what Python raises where one is missing.
inline void read_settings() {
    const auto load = [](const char* name) {
        return pybind11::module_::import((std::string("contact_tracker.") + name).c_str());
    };
    const pybind11::module_ fit = load("hypotheses.gauss_newton"), edges = load("contacts.edge_edge"),
                            pace = load("hypotheses.schedule");
    const auto number = [&](const char* name) { return pace.attr(name).cast<double>(); };
    const auto count = [&](const char* name) { return pace.attr(name).cast<int>(); };
    settings.fits = damping_of(fit);
    settings.tolerance = fit.attr("TOLERANCE").cast<double>();
    settings.sine_sq_floor = edges.attr("SINE_SQ_FLOOR").cast<double>();
    settings.tiny = edges.attr("TINY").cast<double>();
    settings.edge_ridge = edges.attr("RIDGE").cast<double>();
    settings.vertex_ridge = load("contacts.vertex_face").attr("RIDGE").cast<double>();
    settings.first_ticks = number("FIRST_TICKS");
    settings.at_rest = number("AT_REST");
    settings.wait_nats = number("WAIT_NATS");
    settings.far_nats = number("FAR_NATS");
    settings.fall_nats = number("FALL_NATS");
    settings.lift = number("LIFT");
    settings.at_the_noise = number("AT_THE_NOISE");
    settings.least_gain = number("LEAST_GAIN");
    settings.met_patience = number("MET_PATIENCE");
    settings.grace_nats = number("GRACE_NATS");
    settings.grace_ticks = number("GRACE_TICKS");
    settings.residual_ticks = number("RESIDUAL_TICKS");
    settings.refine_steps = count("REFINE_STEPS");
    settings.first_steps = count("FIRST_STEPS");
    settings.fallen_steps = count("FALLEN_STEPS");
    settings.screened = count("SCREENED");
    settings.weighed = count("WEIGHED");
    settings.young = count("YOUNG");
    settings.ages = pace.attr("AGES").attr("tolist")().cast<std::vector<double>>();
    settings.due = pace.attr("DUE").attr("tolist")().cast<std::vector<bool>>();
    settings.rounds.clear();
    for (const auto& round : pace.attr("ROUNDS")) {
        const auto [steps, kept] = round.cast<std::pair<int, int>>();
        settings.rounds.push_back({steps, kept});
    }
}

}  // namespace kernels
