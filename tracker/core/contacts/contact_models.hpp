// The families of `contacts`: one formula for all, with the elements of each known at compile time.
//
// Element 1 is a plane (direction d1), a line (d1, q1) or a point (q1); element
// 2 a plane (d2, h) or a line (d2, q2). The formulas are derived in the
// families.
#pragma once

#include <array>

#include "linalg/vectors.hpp"
#include "settings.hpp"

namespace kernels {

// Reference: `family.Form`; `each` is the number of rows per pose.
struct FaceFace {
    static constexpr int d1 = 0, q1 = -1, d2 = 3, q2 = -1, h = 6, each = 3;
};
struct EdgeFace {
    static constexpr int d1 = 0, q1 = 3, d2 = 6, q2 = -1, h = 9, each = 2;
};
struct VertexFace {
    static constexpr int d1 = -1, q1 = 0, d2 = 3, q2 = -1, h = 6, each = 1;
};
struct EdgeEdge {
    static constexpr int d1 = 0, q1 = 3, d2 = 6, q2 = 9, h = -1, each = 1;
};

// All families: the kernels are compiled for each of them.
#define FAMILIES(EACH) EACH(FaceFace) EACH(EdgeFace) EACH(VertexFace) EACH(EdgeEdge)

// Columns [first, end).
struct Columns {
    int first, end;
};

// Sizes as in `contacts.family`: S of x, C of a lifted pose, K of its rows, P
// of free directions; the latter are `turns` or `shifts`, as in `form`.
template <class Form>
struct Family : Form {
    static constexpr int of_1 = 2 * (Form::d1 >= 0) + (Form::q1 >= 0 ? (Form::d1 >= 0 ? 2 : 3) : 0);
    static constexpr int of_2 = 2 + 2 * (Form::q2 >= 0) + (Form::h >= 0);
    static constexpr int S =
        3 * (Form::d1 >= 0) + 3 * (Form::q1 >= 0) + 3 + 3 * (Form::q2 >= 0) + (Form::h >= 0);
    static constexpr int C = Form::q2 >= 0 ? 19 : 13;
    static constexpr int K = Form::each;
    static constexpr int P = of_1 + of_2;
    // Numbers of the upper triangle of a symmetric matrix (P, P), stored row by row.
    static constexpr int U = P * (P + 1) / 2;
    // Index of the entry (p, q) or (q, p) in the upper triangle.
    static constexpr int upper(int p, int q) { return p > q ? upper(q, p) : p * P - p * (p - 1) / 2 + q - p; }
    static constexpr int last = K - 1;
    static constexpr bool crosses = Form::q2 >= 0;
    // Whether both elements are faces, which share one height.
    static constexpr bool facing = Form::q1 < 0;
    // The k-th row is zero beyond its first `active_in(k)` columns: rows of directions do not depend on
    // the position.
    static constexpr int active_in(int k) { return k < last ? 9 : crosses ? 18 : C; }
    static constexpr int T = 2 * (Form::d1 >= 0) + 2, L = P - T;

    static constexpr bool turns_in(int p) { return p < of_1 ? Form::d1 >= 0 && p < 2 : p < of_1 + 2; }

    // Whether a free direction is on a sphere or a height; the weak prior is flat along these only.
    static constexpr bool flat_in(int p) { return turns_in(p) || (Form::h >= 0 && p == P - 1); }

    template <int N>
    static constexpr std::array<int, N> those(bool turning) {
        std::array<int, N> found{};
        for (int p = 0, n = 0; p < P; ++p) {
            if (turns_in(p) == turning) found[n++] = p;
        }
        return found;
    }

    static constexpr std::array<int, T> turns = those<T>(true);
    static constexpr std::array<int, L> shifts = those<L>(false);

    // Columns in which a shift changes the last row.
    static constexpr Columns shifted_by(int i) {
        return Form::h >= 0 && shifts[i] == P - 1 ? Columns{12, 13} : Columns{0, 9};
    }
};

// Reference: `Family.rows`, (K, C).
template <class F, class N>
void rows(const N* x, N (&out)[F::K][F::C]) {
    const Vec<N> d1 = at(x, F::d1), q1 = at(x, F::q1), d2 = at(x, F::d2);
    N* last = out[F::last];
    if constexpr (F::crosses) {
        outers(last, 0, d2, cross(q1, d1), cross(at(x, F::q2), d2), d1);
        outer(last, 9, d2, d1);
        last[18] = 0.0;
    } else {
        for (int k = 0; k < F::last; ++k) std::fill_n(out[k], F::C, N(0.0));
        outer(last, 0, d2, q1);
        put(last, 9, d2);
        last[12] = -x[F::h];
        if constexpr (F::last == 1) outer(out[0], 0, d2, d1);
        if constexpr (F::last == 2) {
            const auto [b1, b2] = across(d1);
            outer(out[0], 0, d2, b1);
            outer(out[1], 0, d2, b2);
        }
    }
}

// Derivative of the rows (K, C) along v: `v @ Family.rows_derivative(x)`.
template <class F, class N>
void slope(const N* x, const N* v, N (&out)[F::K][F::C]) {
    const Vec<N> d1 = at(x, F::d1), q1 = at(x, F::q1), d2 = at(x, F::d2);
    const Vec<N> e1 = at(v, F::d1), p1 = at(v, F::q1), e2 = at(v, F::d2);
    N* last = out[F::last];
    if constexpr (F::crosses) {
        const Vec<N> q2 = at(x, F::q2), p2 = at(v, F::q2);
        const Vec<N> m1 = cross(p1, d1) + cross(q1, e1), m2 = cross(p2, d2) + cross(q2, e2);
        N more[9];
        outers(last, 0, e2, cross(q1, d1), cross(q2, d2), e1);
        outers(more, 0, d2, m1, m2, d1);
        for (int i = 0; i < 9; ++i) last[i] += more[i];
        outers(last, 9, e2, d1, d2, e1);
        last[18] = 0.0;
    } else {
        for (int k = 0; k < F::last; ++k) std::fill_n(out[k], F::C, N(0.0));
        outers(last, 0, e2, q1, d2, p1);
        put(last, 9, e2);
        last[12] = -v[F::h];
        if constexpr (F::last == 1) outers(out[0], 0, e2, d1, d2, e1);
        if constexpr (F::last == 2) {
            const auto [b1, b2] = across(d1);
            outers(out[0], 0, e2, b1, d2, -inner(e1, b1) * d1);
            outers(out[1], 0, e2, b2, d2, -inner(e1, b2) * d1);
        }
    }
}

// Like `slope`, of the last row (C,), for a v that shifts without turning; entries outside the shifted
// columns are not written.
template <class F, class N>
void slope_of_last(const N* x, const N* v, N (&out)[F::C]) {
    const Vec<N> p1 = at(v, F::q1), d2 = at(x, F::d2);
    if constexpr (F::crosses) {
        const Vec<N> d1 = at(x, F::d1);
        outers(out, 0, d2, cross(p1, d1), cross(at(v, F::q2), d2), d1);
    } else {
        outer(out, 0, d2, p1);
        out[12] = -v[F::h];
    }
}

// Coordinates zero, in place.
template <class F, class N>
void unshift(N* x) {
    if constexpr (F::q1 >= 0) std::fill_n(x + F::q1, 3, N(0.0));
    if constexpr (F::q2 >= 0) std::fill_n(x + F::q2, 3, N(0.0));
    if constexpr (F::h >= 0) x[F::h] = 0.0;
}

// Reference: `Family.scale_sq`; `turn` (9) becomes the derivative of its logarithm by
// `outer(d2, d1)`.
template <class F, class N>
N scale_sq(const N* row, const N* moments, N* turn) {
    if constexpr (!F::crosses) return 1.0;
    const N* rotation = moments + 18 * F::C;  // sums; the last entry is the sum of the weights
    const N cosine = dot<9>(rotation, row + 9) / larger<N>(rotation[18], settings.tiny);
    const N floor = settings.sine_sq_floor, scale = larger<N>(1.0 - cosine * cosine, floor);
    const N factor =
        where(floor < scale, -2.0 * cosine / (larger<N>(rotation[18], settings.tiny) * scale), N(0.0));
    for (int i = 0; i < 9; ++i) turn[i] = factor * rotation[i];
    return scale;
}

template <int D, int Q, class N>
void normalise_element(N* x, const N* anchor) {
    if constexpr (D >= 0) {
        using std::sqrt;
        const Vec<N> raw = at(x, D), n = (1.0 / sqrt(inner(raw, raw))) * raw;
        put(x, D, n);
        if constexpr (Q >= 0) put(x, Q, at(x, Q) - inner(n, at(x, Q) - at(anchor, 0)) * n);
    }
}

// Reference: `Family.normalise`, in place.
template <class F, class N>
void normalise(N* x, const N* anchors) {
    normalise_element<F::d1, F::q1>(x, anchors);
    normalise_element<F::d2, F::q2>(x, anchors + 3);
}

template <class F, int D, int Q, class N>
void free_element(const N* x, const N* anchor, int p, N (*out)[F::S]) {
    if constexpr (D < 0) {
        for (int i = 0; i < 3; ++i) out[p + i][Q + i] = 1.0;
    } else {
        const Vec<N> n = at(x, D);
        const auto [b1, b2] = across(n);
        put(out[p], D, b1);
        put(out[p + 1], D, b2);
        if constexpr (Q >= 0) {
            const Vec<N> arm = at(x, Q) - at(anchor, 0);
            put(out[p], Q, -inner(arm, b1) * n);
            put(out[p + 1], Q, -inner(arm, b2) * n);
            put(out[p + 2], Q, b1);
            put(out[p + 3], Q, b2);
        }
    }
}

// Reference: `Family.tangent`; a direction per row (P, S).
template <class F, class N>
void free(const N* x, const N* anchors, N (&out)[F::P][F::S]) {
    for (auto& direction : out) std::fill_n(direction, F::S, N(0.0));
    free_element<F, F::d1, F::q1>(x, anchors, 0, out);
    free_element<F, F::d2, F::q2>(x, anchors + 3, F::of_1, out);
    if constexpr (F::h >= 0) out[F::P - 1][F::h] = 1.0;
}

// Reference: `ContactModel.turned`, in place.
template <class F>
void turn_world(bool body_in_1, const double* turn, double* x) {
    const int d = body_in_1 ? F::d2 : F::d1;
    if (d >= 0) put(x, d, turned(turn, 0, at(x, d)));
}

}  // namespace kernels
