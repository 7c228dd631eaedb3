// Constants, read from the Python modules that have them.
#pragma once

#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <array>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "hearing.hpp"
#include "moving.hpp"

namespace kernels {

inline Damping damping_of(const pybind11::module_& module) {
    const auto number = [&](const char* name) { return module.attr(name).cast<double>(); };
    return {number("FIRST_DAMPING"), number("LEAST_DAMPING"), number("MOST_DAMPING"),   number("LESS"),
            number("MORE"),          number("LEAST_SHARE"),   number("LEAST_CURVATURE")};
}

inline MotionSettings motion_of(const pybind11::module_& module) {
    const auto number = [&](const char* name) { return module.attr(name).cast<double>(); };
    const auto count = [&](const char* name) { return module.attr(name).cast<int>(); };
    const int now = count("NOW_TICKS");
    if (now < 1 || now > Path::most)
        throw std::invalid_argument("kernels have no room for so many NOW_TICKS");
    const auto spread = module.attr("PRIOR_SPREAD").cast<std::array<double, 3>>();
    return {number("JERK_SHARE"),
            number("STILL"),
            number("LOG_BIAS"),
            number("TINY"),
            {spread[0], spread[1], spread[2]},
            count("SETTLING_TICKS"),
            now};
}

inline NoiseSettings noise_of(const pybind11::module_& module) {
    const auto number = [&](const char* name) { return module.attr(name).cast<double>(); };
    const auto count = [&](const char* name) { return module.attr(name).cast<int>(); };
    if (count("ORDER") != order) throw std::invalid_argument("kernels take differences of another ORDER");
    return {
        number("REGULAR"),          number("SCALE"), number("PRIOR"),  number("BALL"),  number("SPREAD_M"),
        number("MEDIAN_OF_CHI_SQ"), number("TINY"),  number("UNTOLD"), count("STRIDE"), count("MEMORY")};
}

inline PolishSettings polish_of(const pybind11::module_& module) {
    const auto number = [&](const char* name) { return module.attr(name).cast<double>(); };
    const auto count = [&](const char* name) { return module.attr(name).cast<int>(); };
    return {number("STEP"),        number("FIRST_DAMPING"),  number("LEAST_DAMPING"),   number("LESS"),
            number("MORE"),        number("TOLERANCE_NATS"), number("LEAST_CURVATURE"), number("FIRST_ECHO"),
            number("LEAST_SHOWN"), number("STRANGE_SIGMAS"), count("ROUNDS"),           count("STEPS")};
}

inline EchoSettings echoes_of(const pybind11::module_& module) {
    const auto number = [&](const char* name) { return module.attr(name).cast<double>(); };
    return {number("PRIOR_TICKS"), number("MOST_ECHO"), number("LEAST_SCALE"), number("LEAST_SHARE"),
            module.attr("LEARNING_STEPS").cast<int>()};
}

// Raises what Python raises where one is missing.
inline void read_settings() {
    const auto load = [](const char* name) {
        return pybind11::module_::import((std::string("contact_tracker.") + name).c_str());
    };
    const pybind11::module_ fit = load("fit"), edges = load("contacts.edge_edge"), pace = load("pace");
    const auto number = [&](const char* name) { return pace.attr(name).cast<double>(); };
    const auto count = [&](const char* name) { return pace.attr(name).cast<int>(); };
    settings.fits = damping_of(fit);
    settings.products = damping_of(load("paper.batched"));
    settings.tolerance = fit.attr("TOLERANCE").cast<double>();
    settings.sine_sq_floor = edges.attr("SINE_SQ_FLOOR").cast<double>();
    settings.tiny = edges.attr("TINY").cast<double>();
    settings.edge_ridge = edges.attr("RIDGE").cast<double>();
    settings.vertex_ridge = load("contacts.vertex_face").attr("RIDGE").cast<double>();
    settings.motion = motion_of(load("free_motion"));
    settings.noise = noise_of(load("noise"));
    settings.polish = polish_of(load("polish"));
    settings.echoes = echoes_of(load("echoes"));
    settings.least_sine = load("quaternions").attr("TINY").cast<double>();
    settings.neighbours = load("averaging").attr("NEIGHBOURS").cast<int>();
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
