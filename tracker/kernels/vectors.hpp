// Small linear algebra: vectors of three numbers, and arrays whose sizes the compiler knows.
#pragma once

#include <algorithm>
#include <cmath>

namespace kernels {

struct Vector {
    double x, y, z;
};

inline Vector operator+(Vector a, Vector b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
inline Vector operator-(Vector a, Vector b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
inline Vector operator-(Vector a) { return {-a.x, -a.y, -a.z}; }
inline Vector operator*(double s, Vector a) { return {s * a.x, s * a.y, s * a.z}; }
inline double inner(Vector a, Vector b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
inline Vector cross(Vector a, Vector b) {
    return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

// The vector that begins at `first`; zero where that is negative, for what a contact does not have.
inline Vector at(const double* x, int first) {
    return first >= 0 ? Vector{x[first], x[first + 1], x[first + 2]} : Vector{0.0, 0.0, 0.0};
}

inline void put(double* out, int first, Vector v) {
    out[first] = v.x;
    out[first + 1] = v.y;
    out[first + 2] = v.z;
}

// The matrix (3, 3) that begins at `first`, times v.
inline Vector turned(const double* matrix, int first, Vector v) {
    return {inner(at(matrix, first), v), inner(at(matrix, first + 3), v), inner(at(matrix, first + 6), v)};
}

struct Pair {
    Vector u, v;
};

// As `base.sphere_tangent`.
inline Pair across(Vector n) {
    const double sign = n.z >= 0.0 ? 1.0 : -1.0;
    const double a = -1.0 / (sign + n.z), b = n.x * n.y * a;
    return {{1.0 + sign * n.x * n.x * a, sign * b, -sign * n.x}, {b, sign + n.y * n.y * a, -n.y}};
}

// vec(a b^T) from `first` on.
inline void outer(double* out, int first, Vector a, Vector b) {
    put(out, first, a.x * b);
    put(out, first + 3, a.y * b);
    put(out, first + 6, a.z * b);
}

// vec(a b^T + c d^T) from `first` on.
inline void outers(double* out, int first, Vector a, Vector b, Vector c, Vector d) {
    put(out, first, a.x * b + c.x * d);
    put(out, first + 3, a.y * b + c.y * d);
    put(out, first + 6, a.z * b + c.z * d);
}

// `vector (N,) @ matrix (N, M)`, whose rows are `STRIDE` apart; most vectors here have many zeros.
template <int N, int M, int STRIDE = M>
inline void multiply(const double* vector, const double* matrix, double* out) {
    double sum[M] = {};
    for (int i = 0; i < N; ++i) {
        if (vector[i] != 0.0) {
            for (int j = 0; j < M; ++j) sum[j] += vector[i] * matrix[i * STRIDE + j];
        }
    }
    for (int j = 0; j < M; ++j) out[j] = sum[j];
}

template <int N>
inline double dot(const double* a, const double* b) {
    double total = 0.0;
    for (int i = 0; i < N; ++i) total += a[i] * b[i];
    return total;
}

// Solve `a y = b` of a positive definite a (N, N), of which the upper triangle is read; y comes to stand
// where b was, and in a's diagonal what multiplies to its determinant.
template <int N>
inline void eliminate(double (&a)[N][N], double (&b)[N]) {
    for (int k = 0; k < N; ++k) {
        const double inverse = 1.0 / a[k][k];
        for (int i = k + 1; i < N; ++i) {
            const double factor = a[k][i] * inverse;
            for (int j = i; j < N; ++j) a[i][j] -= factor * a[k][j];
            b[i] -= factor * b[k];
        }
    }
    for (int k = N - 1; k >= 0; --k) {
        for (int j = k + 1; j < N; ++j) b[k] -= a[k][j] * b[j];
        b[k] /= a[k][k];
    }
}

}  // namespace kernels
