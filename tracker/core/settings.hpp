// Constants of the algorithm. Python passes them in (`configure`): none is said
// twice.
#pragma once

#include <vector>

namespace kernels {

// Of Levenberg and Marquardt's damping, as in `fit`.
struct Damping {
    double first, least, most, less, more, least_share, least_curvature;
};

// `rounds` are steps and how many of the best go on.
struct Round {
    int steps, kept;
};

struct Settings {
    Damping damping;
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
