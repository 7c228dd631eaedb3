// SIMD: a number per lane, each lane of another hypothesis.
#pragma once

#include <cmath>

// Function that the file of a family (see `instantiations.hpp`) also compiles for processors with wide
// registers; which of the two is called is decided when the module is loaded.
#if !defined(__GNUC__)
#define WIDE
#elif defined(HERE) && defined(__x86_64__) && defined(__GLIBC__) && !defined(__clang__)
#if __GNUC__ >= 12  // supports these levels in target_clones
#define WIDE_PROCESSOR "arch=x86-64-v3"
#else
#define WIDE_PROCESSOR "fma"
#endif
#define WIDE __attribute__((flatten, noinline, target_clones(WIDE_PROCESSOR, "default")))
#else
#define WIDE __attribute__((noinline))  // calls the one compiled in another file
#endif

namespace kernels {

constexpr int lanes = 4;

#ifdef __GNUC__

typedef double Packed __attribute__((vector_size(8 * lanes)));
typedef long long Bits __attribute__((vector_size(8 * lanes)));

#else  // the same without vector extensions; the compiler may vectorise it

template <class Entry>
struct Array {
    Entry entries[lanes];

    Entry operator[](int i) const { return entries[i]; }
    Entry& operator[](int i) { return entries[i]; }
};

using Packed = Array<double>;
using Bits = Array<long long>;

#define EACH(Out, operation, A)                                         \
    inline Out operator operation(const A& a, const A& b) {             \
        Out out;                                                        \
        for (int i = 0; i < lanes; ++i) out[i] = (a[i] operation b[i]); \
        return out;                                                     \
    }
EACH(Packed, +, Packed)
EACH(Packed, -, Packed)
EACH(Packed, *, Packed)
EACH(Packed, /, Packed)
EACH(Bits, <, Packed)
EACH(Bits, &, Bits)
EACH(Bits, |, Bits)
#undef EACH

#endif

// A number per lane.
struct Lanes {
    Packed v;

    Lanes() = default;
    Lanes(const Packed& packed) : v(packed) {}
    // Explicit: copies as one object, and is not passed in registers between functions that were compiled
    // for processors with different registers.
    Lanes(const Lanes& other) : v(other.v) {}
    Lanes& operator=(const Lanes& other) {
        v = other.v;
        return *this;
    }
    Lanes(double same) {
        for (int i = 0; i < lanes; ++i) v[i] = same;
    }

    double operator[](int i) const { return v[i]; }
    void put(int i, double one) { v[i] = one; }

    Lanes& operator+=(const Lanes& other) { return *this = v + other.v; }
    Lanes& operator-=(const Lanes& other) { return *this = v - other.v; }
    Lanes& operator*=(const Lanes& other) { return *this = v * other.v; }
};

inline Lanes operator+(const Lanes& a, const Lanes& b) { return a.v + b.v; }
inline Lanes operator-(const Lanes& a, const Lanes& b) { return a.v - b.v; }
inline Lanes operator*(const Lanes& a, const Lanes& b) { return a.v * b.v; }
inline Lanes operator/(const Lanes& a, const Lanes& b) { return a.v / b.v; }
inline Lanes operator-(const Lanes& a) { return Lanes(0.0).v - a.v; }

// A truth value per lane.
struct Mask {
    Bits bits;

    Mask() = default;
    Mask(const Bits& bits) : bits(bits) {}
    Mask(const Mask& other) : bits(other.bits) {}
    Mask& operator=(const Mask& other) {
        bits = other.bits;
        return *this;
    }
    Mask(bool same) {
        for (int i = 0; i < lanes; ++i) bits[i] = same ? -1 : 0;
    }

    bool operator[](int i) const { return bits[i] != 0; }
    void put(int i, bool one) { bits[i] = one ? -1 : 0; }
};

inline Mask operator<(const Lanes& a, const Lanes& b) { return Bits(a.v < b.v); }
inline Mask operator&(const Mask& a, const Mask& b) { return Bits(a.bits & b.bits); }
inline Mask operator|(const Mask& a, const Mask& b) { return Bits(a.bits | b.bits); }

inline bool any(const Mask& mask) {
    bool found = false;
    for (int i = 0; i < lanes; ++i) found |= mask[i];
    return found;
}

inline Lanes where(const Mask& mask, const Lanes& a, const Lanes& b) {
#ifdef __GNUC__
    return Packed(mask.bits ? a.v : b.v);
#else
    Lanes out;
    for (int i = 0; i < lanes; ++i) out.v[i] = mask[i] ? a[i] : b[i];
    return out;
#endif
}
inline double where(bool holds, double a, double b) { return holds ? a : b; }

inline Mask operator!(const Mask& mask) {
    Mask out;
    for (int i = 0; i < lanes; ++i) out.put(i, !mask[i]);
    return out;
}

// Apply to each lane.
template <class Function>
Lanes each(const Lanes& a, Function&& function) {
    Lanes out;
    for (int i = 0; i < lanes; ++i) out.v[i] = function(a.v[i]);
    return out;
}

inline Lanes sqrt(const Lanes& a) {
    return each(a, [](double one) { return std::sqrt(one); });
}
inline Lanes exp(const Lanes& a) {
    return each(a, [](double one) { return std::exp(one); });
}
inline Lanes log(const Lanes& a) {
    return each(a, [](double one) { return std::log(one); });
}
inline Lanes abs(const Lanes& a) { return where(a < 0.0, -a, a); }

// Like std::max and std::min, per lane.
template <class N>
N larger(const N& a, const N& b) {
    return where(a < b, b, a);
}
template <class N>
N smaller(const N& a, const N& b) {
    return where(b < a, b, a);
}

}  // namespace kernels
