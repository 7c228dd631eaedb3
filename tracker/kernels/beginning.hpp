// What begins of a contact, as rows of a bank that have seen nothing: as `begins.begun`.
#pragma once

#include <cmath>
#include <limits>

#include "bindings.hpp"

namespace kernels {

// What a pair of elements tells of x, as in `given`.
template <class F>
struct Foreknown {
    double mean[F::S] = {}, information[F::S][F::S] = {}, pivot[6];

    Foreknown() { std::fill_n(pivot, 6, std::numeric_limits<double>::quiet_NaN()); }
};

// A row of `given._part` of the element that x has from `first` on; returns where it ends.
template <class F>
int put_part(const Floats& part, int first, double* pivot, Foreknown<F>& prior) {
    int width = 1;
    while (width * width + width + 3 < part.size()) ++width;
    require_shape(part, {width * width + width + 3}, "what an element tells does not have its numbers");
    require(first + width <= F::S, "an element has more numbers than x");
    const double* of = part.data();
    std::copy_n(of, width, prior.mean + first);
    for (int i = 0; i < width; ++i)
        std::copy_n(of + (i + 1) * width, width, prior.information[first + i] + first);
    std::copy_n(of + part.size() - 3, 3, pivot);
    return first + width;
}

// As `given._facing`, of rows of `given._face`.
template <class F>
void put_faces(const Floats& first, const Floats& second, Foreknown<F>& prior) {
    constexpr int information = 3, offset = 12, slope = 13, left = 16;
    const Floats* faces[] = {&first, &second};
    double off[F::S] = {}, variance = 0.0, height = 0.0;
    for (int f = 0; f < 2; ++f) {
        require_shape(*faces[f], {left + 1}, "what a face tells does not have its numbers");
        const double* of = faces[f]->data();
        for (int i = 0; i < 3; ++i) {
            prior.mean[3 * f + i] = f ? of[i] : -of[i];
            off[3 * f + i] = f ? -of[slope + i] : of[slope + i];
            std::copy_n(of + information + 3 * i, 3, prior.information[3 * f + i] + 3 * f);
        }
        height += of[offset];
        variance += of[left];
    }
    off[6] = 1.0;
    if (std::isfinite(variance)) prior.mean[6] = height;
    const double weight = variance > 0.0 ? 1.0 / variance : 0.0;
    for (int i = 0; i < F::S; ++i) {
        for (int j = 0; j < F::S; ++j) prior.information[i][j] += weight * off[i] * off[j];
    }
}

// As `given.by_feet`.
template <class F>
void move_feet(const Kind& kind, Vector near, Foreknown<F>& prior) {
    constexpr int size = F::S;
    const int turn = kind.body_in_1 ? F::d2 : F::d1, place = kind.body_in_1 ? F::q2 : F::q1;
    require(turn >= 0 && place >= 0, "the surroundings have no line in this contact");
    const Vector direction = at(prior.mean, turn), point = at(prior.mean, place);
    const double along = inner(near - point, direction);
    double* pivot = prior.pivot + (kind.body_in_1 ? 3 : 0);
    put(prior.mean, place, point + along * direction);
    put(pivot, 0, at(pivot, 0) + along * direction);
    double before[size][size];
    std::copy_n(prior.information[0], size * size, before[0]);
    for (int j = 0; j < 3; ++j) {
        for (int i = 0; i < size; ++i) {
            prior.information[i][turn + j] -= along * before[i][place + j];
            prior.information[turn + j][i] -= along * before[place + j][i];
        }
        for (int i = 0; i < 3; ++i)
            prior.information[turn + i][turn + j] += along * along * before[place + i][place + j];
    }
}

// As `Given.told`, into `told` (S,); whether that leaves no direction open.
template <class F>
bool tell(const Foreknown<F>& prior, bool* told) {
    bool all = true;
    for (int s = 0; s < F::S; ++s) told[s] = prior.information[s][s] > 0.0;
    for (const int d : {F::d1, F::d2}) {
        if (d < 0) continue;
        const bool known = prior.mean[d] != 0.0 || prior.mean[d + 1] != 0.0 || prior.mean[d + 2] != 0.0;
        std::fill_n(told + d, 3, known);
        all = all && known;
    }
    return all;
}

// Into a row that is blank: what the elements tell, and what is told of it; which is number `source`, if
// anything is told or they were `met`.
template <class F>
void put_prior(const Kind& kind, const Foreknown<F>& prior, int source, bool met, double* row, bool* told) {
    const Where& where = kind.where;
    bool something = met;
    double* known = row + where.known;
    for (int i = 0; i < F::S; ++i) {
        for (int j = i; j < F::S; ++j) {
            *known++ = prior.information[i][j];
            something = something || prior.information[i][j] != 0.0;
        }
    }
    std::copy_n(prior.mean, F::S, row + where.known_mean);
    std::copy_n(prior.pivot, 6, row + where.pivot);
    const bool searches = !tell(prior, told);
    put_whole(row, where.searched, searches);
    row[where.grace] = searches ? kind.patience : 0.0;
    put_whole(row, where.source, something ? source : 0);
}

// Rows like the `blank` one of what begins with these elements (see `given.rows_of`) on both sides, and what
// of x is told (n, S).
inline py::tuple begun(const Model& model, const Floats& blank, const std::vector<Floats>& first,
                       const std::vector<Floats>& second, const std::optional<Floats>& near,
                       const std::vector<double>& log_share, const std::vector<std::int64_t>& pair,
                       const std::vector<bool>& certain, const std::vector<bool>& met) {
    const std::size_t count = first.size();
    for (std::size_t size : {second.size(), log_share.size(), pair.size(), certain.size(), met.size()})
        require(size == count, "something is not told of each that begins");
    require_shape(blank, {1, model.words}, "not a row of this contact");
    if (near) require_shape(*near, {3}, "a place has three numbers");
    return visit(model, [&](auto family) {
        using F = decltype(family);
        const Kind& kind = model.kind;
        const py::ssize_t many = static_cast<py::ssize_t>(count);
        Floats words({many, py::ssize_t(model.words)});
        Bools told({many, py::ssize_t(F::S)});
        for (std::size_t i = 0; i < count; ++i) {
            Foreknown<F> prior;
            if (model.which == Which::face_face) {
                if constexpr (F::q1 < 0) put_faces(first[i], second[i], prior);
            } else {
                const int end = put_part(first[i], 0, prior.pivot, prior);
                require(put_part(second[i], end, prior.pivot + 3, prior) == F::S,
                        "elements have fewer numbers than x");
            }
            if (near) move_feet(kind, at(near->data(), 0), prior);
            double* row = words.mutable_data() + i * model.words;
            std::copy_n(blank.data(), model.words, row);
            put_prior(kind, prior, static_cast<int>(i) + 1, met[i], row, told.mutable_data() + i * F::S);
            put_whole(row, kind.where.pair, pair[i]);
            put_whole(row, kind.where.certain, certain[i]);
            put_whole(row, kind.where.met, met[i]);
            row[kind.where.lasted] = row[kind.where.log_likelihood] = log_share[i];
        }
        return py::make_tuple(words, told);
    });
}

}  // namespace kernels
