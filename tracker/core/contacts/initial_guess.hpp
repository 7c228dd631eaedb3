// Reference: `Family.starts`, the solutions of relaxed problems.
#pragma once

#include "bank/hypothesis.hpp"
#include "linalg/eigen.hpp"

namespace kernels {

// Curvature up to this many times the regularisation leaves a direction
// undetermined.
constexpr double undetermined = 10.0;

// Reference: `family.smallest_directions`, the entries kept; `moments` are overwritten.
template <int N, int FIRST, int COUNT>
void smallest_directions(Square<N>& moments, Square<COUNT>& out, Square<COUNT>& axes) {
    const auto kept = [](int c) { return c >= FIRST && c < FIRST + COUNT; };
    double trace = 0.0;
    for (int c = 0; c < N; ++c) trace += moments[c][c];
    for (int c = 0; c < N; ++c) {
        if (!kept(c)) moments[c][c] += settings.ridge * trace;
    }
    for (int c = 0; c < N; ++c) {
        if (kept(c)) continue;
        const double inverse = 1.0 / moments[c][c];
        for (int i = 0; i < N; ++i) {
            if (i <= c && !kept(i)) continue;
            const double factor = moments[i][c] * inverse;
            for (int j = 0; j < N; ++j) {
                if (j > c || kept(j)) moments[i][j] -= factor * moments[c][j];
            }
        }
    }
    for (int i = 0; i < COUNT; ++i) {
        for (int j = 0; j < COUNT; ++j) {
            out[i][j] = 0.5 * (moments[FIRST + i][FIRST + j] + moments[FIRST + j][FIRST + i]);
        }
    }
    eigen<COUNT>(out, axes);
}

// Direction of the image of a unit vector under the matrix (3, 3); the vector itself if the image is zero.
inline Vector image(const Square<3>& matrix, Vector v) {
    const Vector image = turned(matrix[0], 0, v);
    const double length = std::sqrt(inner(image, image));
    return length > 0.0 ? (1.0 / length) * image : v;
}

// Right singular vectors in the rows of `axes`, in ascending order of singular values.
inline void singular(const Square<3>& matrix, Square<3>& axes) {
    Square<3> squared;
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) {
            squared[i][j] = 0.0;
            for (int k = 0; k < 3; ++k) squared[i][j] += matrix[k][i] * matrix[k][j];
        }
    }
    eigen<3>(squared, axes);
}

// Direction in frame 1 that deviates least from a face of normal n, over the window's poses.
template <int N>
Vector edge_in(const double* moments, Vector n) {
    const double normal[3] = {n.x, n.y, n.z};
    Square<3> left = {}, axes;
    for (int j = 0; j < 3; ++j) {
        for (int m = 0; m < 3; ++m) {
            for (int i = 0; i < 3; ++i) {
                for (int k = 0; k < 3; ++k)
                    left[j][m] += normal[i] * normal[k] * moments[(3 * i + j) * N + 3 * k + m];
            }
        }
    }
    eigen<3>(left, axes);
    return at(axes[0], 0);
}

// `relax` for two lines.
template <class F>
int relax_lines(Square<F::C>& lifted, double least, int many, double* out) {
    Square<9> large, large_axes;
    Square<3> pair, axes;
    Square<18> varying;  // the constant entry of the lift appears in no row
    for (int c = 0; c < 18; ++c) std::copy_n(lifted[c], 18, varying[c]);
    smallest_directions<18, 9, 9>(varying, large, large_axes);
    if (!(large[1][1] > least)) return 0;
    for (int k = 0; k < many; ++k, out += F::S) {
        std::copy_n(large_axes[k], 9, pair[0]);
        singular(pair, axes);
        const Vector d1 = at(axes[2], 0);
        put(out, F::d1, d1);
        put(out, F::d2, image(pair, d1));
    }
    return many;
}

// Reference: `Family.starts` of one window's moments (C, C), into `out` (`many`, S);
// returns how many there are.
//
// There are fewer where the poses do not determine a unique smallest direction of coefficients: Jacobi's
// method would then return one that depends on the axes of the frames.
template <class F>
int relax(const double* moments, int many, double* out) {
    double trace = 0.0;
    for (int c = 0; c < F::C; ++c) trace += moments[c * F::C + c];
    std::fill_n(out, many * F::S, 0.0);
    Square<F::C> lifted;
    std::copy_n(moments, F::C * F::C, lifted[0]);
    for (int c = 0; c < F::C; ++c) lifted[c][c] += settings.damping.least_share * trace;
    const double least = undetermined * settings.damping.least_share * trace;
    if constexpr (F::crosses) return relax_lines<F>(lifted, least, many, out);
    int count = 0;
    if constexpr (F::q1 >= 0) {
        Square<3> small, axes;
        smallest_directions<F::C, 9, 3>(lifted, small, axes);
        if (small[1][1] > least) {
            for (; count < 3; ++count) put(out + count * F::S, F::d2, at(axes[count], 0));
        }
    }
    if constexpr (F::d1 >= 0) {
        Square<3> mean, axes;
        for (int i = 0; i < 9; ++i) mean[i / 3][i % 3] = moments[i * F::C + F::C - 1];
        singular(mean, axes);
        for (int k = 2; k >= 0; --k, ++count) {
            put(out + count * F::S, F::d2, image(mean, at(axes[k], 0)));
            put(out + count * F::S, F::d1, at(axes[k], 0));
        }
    }
    if constexpr (F::d1 >= 0 && F::q1 >= 0) {
        for (int k = 0; k < count; ++k) {
            put(out + k * F::S, F::d1, edge_in<F::C>(moments, at(out + k * F::S, F::d2)));
        }
    }
    return count;
}

}  // namespace kernels
