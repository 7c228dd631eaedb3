// Constants of the Python code, which are read from there when the module is loaded: none is said twice.
#pragma once

#include <vector>

namespace kernels {

// Of Levenberg and Marquardt's damping, as in `fit` and in `paper.batched`.
struct Damping {
    double first, least, most, less, more, least_share, least_curvature;
};

// `rounds` are steps and how many of the best go on.
struct Round {
    int steps, kept;
};

// Of `free_motion`.
struct MotionSettings {
    double jerk_share, still, bias, tiny, prior_spread[3];
    int settling_ticks, now_ticks;
};

// Of `noise`.
struct NoiseSettings {
    double regular, scale, prior, ball, spread, median_of_chi_sq, tiny, untold;
    int stride, memory;
};

// Of `polish`.
struct PolishSettings {
    double step, first_damping, least_damping, less, more, tolerance, least_curvature, first_echo,
        least_shown, strange_sigmas;
    int rounds, steps;
};

// Of `echoes`.
struct EchoSettings {
    double prior_ticks, most_echo, least_scale, least_share;
    int learning_steps;
};

struct Settings {
    MotionSettings motion;
    NoiseSettings noise;
    PolishSettings polish;
    EchoSettings echoes;
    double least_sine;  // quaternions
    int neighbours;     // averaging
    Damping fits, products;
    double tolerance;                        // fit
    double sine_sq_floor, tiny, edge_ridge;  // contacts.edge_edge
    double vertex_ridge;                     // contacts.vertex_face
    // pace, as all below
    double first_ticks, at_rest, wait_nats, far_nats, fall_nats, lift, at_the_noise, least_gain, met_patience,
        grace_nats, grace_ticks, residual_ticks;
    int refine_steps, first_steps, fallen_steps, screened, weighed, young;
    std::vector<double> ages;
    std::vector<bool> due;
    std::vector<Round> rounds;
};

inline Settings settings;

}  // namespace kernels
