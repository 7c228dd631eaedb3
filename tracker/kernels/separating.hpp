// What the motion so far tells apart: as `separability.used_directions` and `separability.rivals_since`.
#pragma once

#include <cmath>
#include <limits>
#include <vector>

#include "bindings.hpp"
#include "eigen.hpp"

namespace kernels {

// Of a pose the place, and the way to another one as a twist in the world's frame, by that (shift, turn).
struct Way {
    Vector middle;
    double twist[6];
};

// From the lifted pose `before` to `after`, with places from a `centre`.
inline Way way_of(const double* before, const double* after, const Vector& centre, double tiny) {
    double step[9], trace = 0.0;
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) step[3 * i + j] = inner(at(after, 3 * i), at(before, 3 * j));
        trace += step[4 * i];
    }
    // tan of half the angle along the axis, twice: exact about an axis
    const double scale = 1.0 / std::max(0.5 + 0.5 * trace, tiny);
    const Vector turned = scale * Vector{step[7] - step[5], step[2] - step[6], step[3] - step[1]};
    const Vector from = at(before, T) - centre, to = at(after, T) - centre;
    Way way{0.5 * (from + to), {}};
    put(way.twist, 0, to - from - cross(turned, way.middle));
    put(way.twist, 3, turned);
    return way;
}

// In how many directions lifted poses (W, 25) move by more than `used` times the noise, in steps of so many
// ticks; these count by their `activity` (W,).
inline int used_directions(const Floats& poses, const Floats& activity, const Two& variance, int stride,
                           double tiny, double used) {
    const py::ssize_t count = activity.size(), steps = count - stride;
    require_shape(activity, {count}, "a tick has one activity");
    require_shape(poses, {count, Ticks::entries}, "a tick has one lifted pose");
    require(stride > 0, "a step takes a tick at least");
    if (steps <= 0) return 0;
    const auto pose = [&](py::ssize_t w) { return poses.data() + w * Ticks::entries; };
    Vector centre = {0.0, 0.0, 0.0};
    for (py::ssize_t w = 0; w < count; ++w) centre = centre + at(pose(w), T);
    centre = (1.0 / static_cast<double>(count)) * centre;
    Square<6> power = {}, axes;
    double whole = 0.0, lever_sq = 0.0;
    for (py::ssize_t w = 0; w < steps; ++w) {
        const Way way = way_of(pose(w), pose(w + stride), centre, tiny);
        const double weight = activity.data()[w + stride] + tiny;
        for (int i = 0; i < 6; ++i) {
            for (int j = 0; j < 6; ++j) power[i][j] += weight * way.twist[i] * way.twist[j];
        }
        whole += weight;
        lever_sq += inner(way.middle, way.middle);
    }
    lever_sq *= 2.0 / 3.0 / static_cast<double>(steps);
    const double rotation = 2.0 * variance[1], position = 2.0 * variance[0] + rotation * lever_sq;
    const auto noise = [&](int i) { return std::sqrt(i < 3 ? position : rotation); };
    for (int i = 0; i < 6; ++i) {
        for (int j = 0; j < 6; ++j) power[i][j] /= whole * noise(i) * noise(j);
    }
    eigen<6>(power, axes);
    int found = 0;
    for (int i = 0; i < 6; ++i) found += power[i][i] > used;
    return found;
}

// A contact's evidence at its onsets, in order: of the best hypothesis of each, but of those that are far
// behind.
struct Evidence {
    std::vector<std::int64_t> onset;
    std::vector<double> told, weight;

    Evidence(const Where& where, const Table& table, double far) {
        double best = -std::numeric_limits<double>::infinity();
        for (int b = 0; b < table.count; ++b) best = std::max(best, joint(where, table.row(b)));
        for (int b = 0; b < table.count; ++b) {
            const double *row = table.row(b), own = joint(where, row);
            if (!(own >= best - far)) continue;
            const std::int64_t since = whole(row, where.onset);
            const bool another = onset.empty() || onset.back() != since;
            if (!another && !(own > weight.back())) continue;
            if (another) {
                onset.push_back(since);
                told.emplace_back();
                weight.emplace_back();
            }
            told.back() = row[where.log_likelihood];
            weight.back() = own;
        }
        require(!onset.empty(), "the label has no hypothesis");
    }

    // As `numpy.interp`.
    double at(std::int64_t since) const {
        const auto after = std::upper_bound(onset.begin(), onset.end(), since) - onset.begin();
        if (after == 0) return told.front();
        if (after == static_cast<std::ptrdiff_t>(onset.size())) return told.back();
        const double share = static_cast<double>(since - onset[after - 1]) /
                             static_cast<double>(onset[after] - onset[after - 1]);
        return told[after - 1] + share * (told[after] - told[after - 1]);
    }
};

// Evidence and residual (contacts + 1,) of each state since about an `onset`, give or take some ticks of
// `slack`, against the `label`.
inline py::tuple rivals(const std::vector<const Model*>& models, const std::vector<Floats>& words, int label,
                        std::int64_t onset, std::int64_t slack, double far) {
    const int contacts = static_cast<int>(models.size());
    require(words.size() == models.size(), "something is not told of each contact");
    require(std::count(models.begin(), models.end(), nullptr) == 0, "a contact is None");
    require(0 <= label && label <= contacts, "no such label");
    constexpr double infinity = std::numeric_limits<double>::infinity();
    Floats evidence(contacts + 1), rms(contacts + 1);
    std::vector<std::int64_t> since(contacts + 1, onset);
    for (int i = 0; i < contacts; ++i) {
        const Where& where = models[i]->kind.where;
        const Table table = table_of(words[i], models[i]->words);
        const double* best = nullptr;
        for (int b = 0; b < table.count; ++b) {
            const double* row = table.row(b);
            if (std::abs(whole(row, where.onset) - onset) > slack) continue;
            if (!best || joint(where, row) > joint(where, best)) best = row;
        }
        evidence.mutable_at(i) = best ? best[where.log_likelihood] : -infinity;
        rms.mutable_at(i) = best ? best[where.rms] : infinity;
        if (best) since[i] = whole(best, where.onset);
    }
    evidence.mutable_at(contacts) = 0.0;
    rms.mutable_at(contacts) = 1.0;
    if (label < contacts) {
        const Evidence own(models[label]->kind.where, table_of(words[label], models[label]->words), far);
        for (int i = 0; i <= contacts; ++i) evidence.mutable_at(i) -= own.at(since[i]);
    }
    evidence.mutable_at(label) = 0.0;
    return py::make_tuple(evidence, rms);
}

}  // namespace kernels
