// Constants of the algorithm; Python passes them in (`configure`), so that each is defined once.
#pragma once

#include <vector>

namespace kernels {

// Levenberg-Marquardt damping, see `gauss_newton.py`.
struct Damping {
    double first, least, most, decrease, increase, least_share, least_curvature;
};

// Round of the search: steps per start, and the number of best starts kept.
struct Round {
    int steps, kept;
};

struct Settings {
    Damping damping;
    double tolerance;                           // gauss_newton.py
    double sine_sq_floor, tiny;                 // contacts.edge_edge
    double ridge;                               // contacts.family
    double decisive, fitting_rms;               // evidence.DECISIVE, SAME_FIT_RATIO
    double used, lever_m, one_axis, no_motion;  // motion/window.py
    int stride_ticks;
    // hypotheses/schedule.py, as all below
    double first_ticks, rest_weight, near_nats;
    int first_steps, recovery_steps, followed_starts, unthinned_ticks;
    std::vector<double> search_ages;
    std::vector<bool> is_search_age;
    std::vector<Round> rounds;
};

inline Settings settings;

}  // namespace kernels
