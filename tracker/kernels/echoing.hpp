// The algorithm of `echoes`: what residuals say of their errors.
#pragma once

#include "polishing.hpp"

namespace kernels {

template <class F>
using Pairs = Square<F::P + 1>;

// Add products of two lines.
template <class F>
void add_products(const Linear<F>& a, const Linear<F>& b, Pairs<F>& out) {
    for (int i = 0; i <= F::P; ++i) {
        for (int j = 0; j <= F::P; ++j) out[i][j] += a.of[i] * b.of[j];
    }
}

template <class F>
double vdot(const Pairs<F>& a, const Pairs<F>& b) {
    return dot<(F::P + 1) * (F::P + 1)>(a[0], b[0]);
}

// As `echoes._Sums` of one row: products in the `first` tick, of neighbours that are so far apart, and
// `product` and `square` of those right after each other.
template <class F>
struct EchoSums {
    struct Apart {
        std::int64_t gap;
        Pairs<F> later, earlier, across;
    };

    Pairs<F> first = {}, product = {}, square = {};
    std::vector<Apart> apart;

    Apart& of(std::int64_t gap) {
        for (Apart& one : apart) {
            if (one.gap == gap) return one;
        }
        apart.push_back({gap, {}, {}, {}});
        return apart.back();
    }

    EchoSums(const std::vector<Linear<F>>& lines, const Ticks& ticks) {
        add_products<F>(lines[0], lines[0], first);
        const auto gap = [&](int w) { return ticks.number[w] - ticks.number[w - 1]; };
        int pairs = 0, paired = 0;
        for (int w = 0; w < ticks.count; ++w) {
            const bool follows = w > 0 && gap(w) == 1;
            pairs += follows;
            if (follows || (w + 1 < ticks.count && gap(w + 1) == 1)) {
                ++paired;
                add_products<F>(lines[w], lines[w], square);
            }
            if (!w) continue;
            Apart& own = of(gap(w));
            add_products<F>(lines[w], lines[w], own.later);
            add_products<F>(lines[w - 1], lines[w - 1], own.earlier);
            add_products<F>(lines[w], lines[w - 1], own.across);
        }
        for (const Apart& own : apart) {
            if (own.gap == 1) symmetrise(own.across, product);
        }
        for (int i = 0; i <= F::P; ++i) {
            for (int j = 0; j <= F::P; ++j) {
                product[i][j] *= 0.5 / std::max(pairs, 1);
                square[i][j] /= std::max(paired, 1);
            }
        }
    }

    static void symmetrise(const Pairs<F>& across, Pairs<F>& out) {
        for (int i = 0; i <= F::P; ++i) {
            for (int j = 0; j <= F::P; ++j) out[i][j] = across[i][j] + across[j][i];
        }
    }

    // As `_Sums.new`.
    void fresh(double echo, Pairs<F>& out) const {
        std::copy_n(first[0], (F::P + 1) * (F::P + 1), out[0]);
        for (const Apart& own : apart) {
            const double left = std::pow(echo, static_cast<double>(own.gap)), whole = 1.0 - left * left;
            for (int i = 0; i <= F::P; ++i) {
                for (int j = 0; j <= F::P; ++j) {
                    const double both = own.across[i][j] + own.across[j][i];
                    const double sum = own.later[i][j] - left * both + left * left * own.earlier[i][j];
                    out[i][j] += sum / whole;
                }
            }
        }
    }
};

// What is known along the ways that are shown: those told more than a share `least` of the most.
template <class F>
void invert(Information<F>& told, double least, Information<F>& out) {
    Information<F> ways;
    eigen<F::P>(told, ways);
    for (auto& row : out) std::fill_n(row, F::P, 0.0);
    for (int i = 0; i < F::P; ++i) {
        if (!(told[i][i] > least * told[F::P - 1][F::P - 1])) continue;
        for (int p = 0; p < F::P; ++p) {
            for (int q = 0; q < F::P; ++q) out[p][q] += ways[i][p] * ways[i][q] / told[i][i];
        }
    }
}

// As `echoes.learnt` of the lines of a stretch, in place.
template <class F>
void learn_errors(const Stretch<F>& stretch, Errors<F>& errors) {
    const EchoSettings& use = settings.echoes;
    const double count = stretch.ticks.count;
    std::vector<EchoSums<F>> sums;
    for (const auto& lines : stretch.lines) sums.emplace_back(lines, stretch.ticks);
    Pairs<F> fresh[F::K], taken;
    for (int k = 0; k < F::K; ++k) sums[k].fresh(errors.echo[k], fresh[k]);
    Information<F> held, told, left;
    stretch.hold(held);
    for (int step = 0; step < use.learning_steps; ++step) {
        std::copy_n(held[0], F::P * F::P, told[0]);
        for (int k = 0; k < F::K; ++k) {
            for (int p = 0; p < F::P; ++p) {
                for (int q = 0; q < F::P; ++q) told[p][q] += errors.weight[k] * fresh[k][p][q];
            }
        }
        invert<F>(told, use.least_share, left);
        for (int p = 0; p <= F::P; ++p) {  // and the residual itself
            for (int q = 0; q <= F::P; ++q) taken[p][q] = p < F::P && q < F::P ? left[p][q] : p == q;
        }
        for (int k = 0; k < F::K; ++k) {
            const double square = std::max(vdot<F>(sums[k].square, taken), use.least_scale);
            const double echo = vdot<F>(sums[k].product, taken) / square;
            errors.echo[k] = std::min(std::max(echo, 0.0), use.most_echo);
            sums[k].fresh(errors.echo[k], fresh[k]);
            const double variance = std::max(vdot<F>(fresh[k], taken) / count, use.least_scale);
            errors.weight[k] = std::pow(variance, -count / (count + use.prior_ticks));
        }
    }
}

}  // namespace kernels
