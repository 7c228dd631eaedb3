// Small linear algebra: vectors of three numbers, and arrays of sizes known at compile time; N is double or
// Lanes.
#pragma once

#include <algorithm>
#include <cmath>
#include <type_traits>
#include <utility>

#include "linalg/simd.hpp"

namespace kernels {

template <class N>
struct Vec {
    N x, y, z;
};

using Vector = Vec<double>;

template <class A, class B>
using Both = decltype(std::declval<A>() * std::declval<B>());

template <class A, class B>
Vec<Both<A, B>> operator+(const Vec<A>& a, const Vec<B>& b) {
    return {a.x + b.x, a.y + b.y, a.z + b.z};
}
template <class A, class B>
Vec<Both<A, B>> operator-(const Vec<A>& a, const Vec<B>& b) {
    return {a.x - b.x, a.y - b.y, a.z - b.z};
}
template <class N>
Vec<N> operator-(const Vec<N>& a) {
    return {-a.x, -a.y, -a.z};
}
template <class S, class N>
Vec<Both<S, N>> operator*(const S& s, const Vec<N>& a) {
    return {s * a.x, s * a.y, s * a.z};
}
template <class A, class B>
Both<A, B> inner(const Vec<A>& a, const Vec<B>& b) {
    return a.x * b.x + a.y * b.y + a.z * b.z;
}
template <class A, class B>
Vec<Both<A, B>> cross(const Vec<A>& a, const Vec<B>& b) {
    return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

// The vector that begins at `first`; zero if that is negative, for parameters that a contact lacks.
template <class N>
Vec<N> at(const N* x, int first) {
    return first >= 0 ? Vec<N>{x[first], x[first + 1], x[first + 2]} : Vec<N>{0.0, 0.0, 0.0};
}

template <class N>
void put(N* out, int first, const Vec<N>& v) {
    out[first] = v.x;
    out[first + 1] = v.y;
    out[first + 2] = v.z;
}

// The matrix (3, 3) that begins at `first`, times v.
template <class A, class B>
Vec<Both<A, B>> turned(const A* matrix, int first, const Vec<B>& v) {
    return {inner(at(matrix, first), v), inner(at(matrix, first + 3), v), inner(at(matrix, first + 6), v)};
}

template <class N>
struct Pair {
    Vec<N> u, v;
};

// Reference: `vectors.sphere_tangent`.
template <class N>
Pair<N> across(const Vec<N>& n) {
    const N sign = where(n.z < 0.0, N(-1.0), N(1.0));
    const N a = -1.0 / (sign + n.z), b = n.x * n.y * a;
    return {{1.0 + sign * n.x * n.x * a, sign * b, -sign * n.x}, {b, sign + n.y * n.y * a, -n.y}};
}

// vec(a b^T) from `first` on.
template <class N>
void outer(N* out, int first, const Vec<N>& a, const Vec<N>& b) {
    put(out, first, a.x * b);
    put(out, first + 3, a.y * b);
    put(out, first + 6, a.z * b);
}

// vec(a b^T + c d^T) from `first` on.
template <class N>
void outers(N* out, int first, const Vec<N>& a, const Vec<N>& b, const Vec<N>& c, const Vec<N>& d) {
    put(out, first, a.x * b + c.x * d);
    put(out, first + 3, a.y * b + c.y * d);
    put(out, first + 6, a.z * b + c.z * d);
}

// Columns [FIRST, END) of `vector (R,) @ matrix`, few enough for the sums to stay in registers.
template <int R, int STRIDE, int FIRST, int END, class N, class M>
void multiply_columns(const N* vector, const M* matrix, N* out) {
    N sum[END - FIRST];
    for (int j = FIRST; j < END; ++j) sum[j - FIRST] = vector[0] * matrix[j];
    for (int i = 1; i < R; ++i) {
        for (int j = FIRST; j < END; ++j) sum[j - FIRST] += vector[i] * matrix[i * STRIDE + j];
    }
    for (int j = FIRST; j < END; ++j) out[j] = sum[j - FIRST];
}

// `vector (R,) @ matrix (R, C)`, whose rows are `STRIDE` apart.
template <int R, int C, int STRIDE = C, int FIRST = 0, class N, class M>
void multiply(const N* vector, const M* matrix, N* out) {
    constexpr int most = 8, parts = (C - FIRST + most - 1) / most,
                  end = FIRST + (C - FIRST + parts - 1) / parts;
    multiply_columns<R, STRIDE, FIRST, end>(vector, matrix, out);
    if constexpr (end < C) multiply<R, C, STRIDE, end>(vector, matrix, out);
}

template <int SIZE, class N>
N dot(const N* a, const N* b) {
    N total = a[0] * b[0];
    for (int i = 1; i < SIZE; ++i) total += a[i] * b[i];
    return total;
}

// Solve `a y = b` for a positive definite a (SIZE, SIZE), of which the upper triangle is read. y overwrites
// b; the product of a's diagonal becomes its determinant.
template <int SIZE, class N>
void eliminate(N (&a)[SIZE][SIZE], N (&b)[SIZE]) {
    N inverse[SIZE];
    for (int k = 0; k < SIZE; ++k) {
        inverse[k] = 1.0 / a[k][k];
        for (int i = k + 1; i < SIZE; ++i) {
            const N factor = a[k][i] * inverse[k];
            for (int j = i; j < SIZE; ++j) a[i][j] -= factor * a[k][j];
            b[i] -= factor * b[k];
        }
    }
    for (int k = SIZE - 1; k >= 0; --k) {
        for (int j = k + 1; j < SIZE; ++j) b[k] -= a[k][j] * b[j];
        b[k] *= inverse[k];
    }
}

}  // namespace kernels
