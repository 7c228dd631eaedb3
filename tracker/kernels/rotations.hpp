// Unit quaternions as in `quaternions`: `q` and `-q` are one rotation.
#pragma once

#include "eigen.hpp"
#include "settings.hpp"
#include "vectors.hpp"

namespace kernels {

struct Quaternion {
    Vector v;
    double w;
};

inline Quaternion quaternion_at(const double* xyzw) { return {at(xyzw, 0), xyzw[3]}; }

inline void put(double* out, const Quaternion& q) {
    put(out, 0, q.v);
    out[3] = q.w;
}

inline Quaternion operator*(const Quaternion& a, const Quaternion& b) {
    return {a.w * b.v + b.w * a.v + cross(a.v, b.v), a.w * b.w - inner(a.v, b.v)};
}

// Of the rotation, in the axes of a, that leads from it to b.
inline Quaternion between(const Quaternion& a, const Quaternion& b) { return Quaternion{-a.v, a.w} * b; }

inline Vector rotation_vector(const Quaternion& q) {
    const double sine = std::sqrt(inner(q.v, q.v)) + settings.least_sine;
    return (std::copysign(2.0 / sine, q.w) * std::atan2(sine, std::abs(q.w))) * q.v;
}

inline Quaternion of_rotation_vector(Vector v) {
    const double half = 0.5 * std::sqrt(inner(v, v)) + settings.least_sine;
    return {(0.5 * std::sin(half) / half) * v, std::cos(half)};
}

// The matrix (9) of a quaternion of any norm but zero.
inline void matrix_of(const Quaternion& q, double* out) {
    const double twice = 2.0 / (inner(q.v, q.v) + q.w * q.w);
    const auto [x, y, z] = q.v;
    const double w = q.w;
    put(out, 0, {1.0 - twice * (y * y + z * z), twice * (x * y - w * z), twice * (x * z + w * y)});
    put(out, 3, {twice * (x * y + w * z), 1.0 - twice * (x * x + z * z), twice * (y * z - w * x)});
    put(out, 6, {twice * (x * z - w * y), twice * (y * z + w * x), 1.0 - twice * (x * x + y * y)});
}

// Of the rotation nearest to a matrix (9).
inline Quaternion nearest(const double* m) {
    Square<4> form = {{m[0] - m[4] - m[8], m[1] + m[3], m[2] + m[6], m[7] - m[5]},
                      {0.0, m[4] - m[0] - m[8], m[5] + m[7], m[2] - m[6]},
                      {0.0, 0.0, m[8] - m[0] - m[4], m[3] - m[1]},
                      {0.0, 0.0, 0.0, m[0] + m[4] + m[8]}};
    for (int i = 0; i < 4; ++i) {
        for (int j = 0; j < i; ++j) form[i][j] = form[j][i];
    }
    Square<4> axes;
    eigen<4>(form, axes);
    return quaternion_at(axes[3]);
}

}  // namespace kernels
