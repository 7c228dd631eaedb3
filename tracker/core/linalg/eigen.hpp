// Eigenvectors of small symmetric matrices.
#pragma once

#include <algorithm>
#include <cmath>

namespace kernels {

// Most sweeps; more than needed, as Jacobi's method converges quadratically.
constexpr int sweeps = 12;
// Convergence: sum of squares off the diagonal, relative to that on it.
constexpr double least_beside = 1e-36;

template <int N>
using Square = double[N][N];

// Rotate the axes p and q such that a[p, q] vanishes.
template <int N>
void rotate(Square<N>& a, Square<N>& axes, int p, int q) {
    if (a[p][q] == 0.0) return;
    const double theta = 0.5 * (a[q][q] - a[p][p]) / a[p][q];
    const double tangent = (theta >= 0.0 ? 1.0 : -1.0) / (std::abs(theta) + std::sqrt(theta * theta + 1.0));
    const double cosine = 1.0 / std::sqrt(tangent * tangent + 1.0), sine = tangent * cosine;
    const auto turn = [cosine, sine](double& u, double& v) {
        const double before = u;
        u = cosine * before - sine * v;
        v = sine * before + cosine * v;
    };
    for (int k = 0; k < N; ++k) turn(a[k][p], a[k][q]);
    for (int k = 0; k < N; ++k) {
        turn(a[p][k], a[q][k]);
        turn(axes[p][k], axes[q][k]);
    }
}

// Eigenvectors of a symmetric a in the rows of `axes`, in ascending order of the eigenvalues, which are
// written to a's diagonal (Jacobi's method).
template <int N>
void eigen(Square<N>& a, Square<N>& axes) {
    for (int i = 0; i < N; ++i) {
        for (int j = 0; j < N; ++j) axes[i][j] = i == j ? 1.0 : 0.0;
    }
    for (int sweep = 0; sweep < sweeps; ++sweep) {
        double on = 0.0, off = 0.0;
        for (int i = 0; i < N; ++i) {
            on += a[i][i] * a[i][i];
            for (int j = i + 1; j < N; ++j) off += a[i][j] * a[i][j];
        }
        if (off <= least_beside * on) break;
        for (int p = 0; p < N - 1; ++p) {
            for (int q = p + 1; q < N; ++q) rotate<N>(a, axes, p, q);
        }
    }
    for (int i = 0; i < N - 1; ++i) {
        int least = i;
        for (int j = i + 1; j < N; ++j) {
            if (a[j][j] < a[least][least]) least = j;
        }
        std::swap(a[i][i], a[least][least]);
        std::swap(axes[i], axes[least]);
    }
}

}  // namespace kernels
