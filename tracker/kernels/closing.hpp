// Ticks that are over, one after the other: as `averaging._closed`.
#pragma once

#include <memory>
#include <optional>

#include "hearing.hpp"

namespace kernels {

// How ticks are averaged, see kernels.pyi.
struct Averaging {
    std::int64_t tick_ns;
    std::array<double, 2> prior, floor;
    double outlier_sigmas;
    bool estimated;
    Onward onward;
};

// Frames of one's own.
struct Kept {
    std::vector<std::int64_t> stamp_ns;
    std::vector<double> position, quat;

    void add(const Frames& frames, const std::int64_t* stamps, int n) {
        stamp_ns.push_back(stamps[n]);
        position.insert(position.end(), frames.position + 3 * n, frames.position + 3 * n + 3);
        quat.insert(quat.end(), frames.quat + 4 * n, frames.quat + 4 * n + 4);
    }
    // Whether frame n is the last one, bit for bit.
    bool holds(const Frames& frames, int n) const {
        return count() && std::equal(position.end() - 3, position.end(), frames.position + 3 * n) &&
               std::equal(quat.end() - 4, quat.end(), frames.quat + 4 * n);
    }
    // As `Poses.fresh`, of one's own and these.
    void add_fresh(const Frames& frames, const std::int64_t* stamps) {
        for (int n = 0; n < frames.count; ++n) {
            if (!holds(frames, n)) add(frames, stamps, n);
        }
    }
    void forget(int many) {
        stamp_ns.erase(stamp_ns.begin(), stamp_ns.begin() + many);
        position.erase(position.begin(), position.begin() + 3 * many);
        quat.erase(quat.begin(), quat.begin() + 4 * many);
    }
    int count() const { return static_cast<int>(stamp_ns.size()); }
    Frames frames() const { return {position.data(), quat.data(), count()}; }
};

// As `averaging.Learnt`: `differences` (15, `known`), which are `own` where some are new.
struct Learnt {
    Noise noise;
    const double* differences;
    int known;
    std::vector<double> own;
    Kept waiting;
    std::optional<Motion> motion;
};

// As `noise.advance`: whether the noise is told anew.
inline bool listen(const Kept& frames, const std::array<double, 2>& prior, Learnt& learnt) {
    learnt.waiting.add_fresh(frames.frames(), frames.stamp_ns.data());
    const int whole = learnt.waiting.count() - order + 1, stride = settings.noise.stride;
    const int more = whole >= 0 ? whole / stride : -((stride - 1 - whole) / stride);
    if (more < settings.noise.untold * std::min(learnt.known + more, settings.noise.memory)) return false;
    const std::vector<double> heard =
        third_differences(learnt.waiting.frames(), learnt.waiting.stamp_ns.data());
    const int added = static_cast<int>(heard.size()) / kernels::differences;
    const int count = std::min(learnt.known + added, settings.noise.memory);
    const int lost = learnt.known + added - count, before = std::max(learnt.known - lost, 0);
    std::vector<double> all(count * kernels::differences);
    for (int i = 0; i < kernels::differences; ++i) {
        double* row = all.data() + i * count;
        std::copy_n(learnt.differences + (i + 1) * learnt.known - before, before, row);
        for (int n = before; n < count; ++n) row[n] = heard[(added - count + n) * kernels::differences + i];
    }
    learnt.own.swap(all);
    learnt.differences = learnt.own.data();
    learnt.known = count;
    learnt.waiting.forget(std::min(std::max(more, 0) * stride, learnt.waiting.count()));
    tell(learnt.differences, learnt.known, prior, learnt.noise);
    return true;
}

// As `averaging.Tick`; whether it has told the noise anew.
struct Mean {
    double zeta[25], excess[2];
    int count, outliers;
    bool told;
};

// The tick of these frames, whose time begins at `first_ns`, seen from the `origin`.
inline Mean close(const Frames& raw, const std::int64_t* stamps, std::int64_t first_ns, Vector origin,
                  bool is_rest, const Averaging& how, Learnt& learnt) {
    Kept kept;
    kept.add_fresh(raw, stamps);
    const Frames frames = kept.frames();
    Mean mean = {};
    const auto [across_m, about_rad] = deviation(learnt.noise);
    const double sigma_sq[] = {across_m * across_m, about_rad * about_rad};
    std::vector<double> ahead(frames.count);
    for (int n = 0; n < frames.count; ++n)
        ahead[n] = 1e-9 * (kept.stamp_ns[n] - first_ns) + 0.5e-9 * how.tick_ns;
    const auto good = std::make_unique<bool[]>(frames.count);
    Motion* motion = learnt.motion ? &*learnt.motion : nullptr;
    plausible(frames, ahead.data(), motion, origin, sigma_sq, how.outlier_sigmas, good.get());
    mean_lift(frames, good.get(), origin, mean.zeta);
    mean.count = static_cast<int>(std::count(good.get(), good.get() + frames.count, true));
    mean.outliers = frames.count - mean.count;
    if (how.estimated) {
        Kept typical;
        const bool few = 2 * mean.count <= frames.count;  // where most stand out, they are the noise
        for (int n = 0; n < frames.count; ++n) {
            if (few || good[n]) typical.add(frames, kept.stamp_ns.data(), n);
        }
        mean.told = listen(typical, how.prior, learnt);
    }
    const std::array<double, 2> sensor = deviation(learnt.noise);
    const Vector place = at(mean.zeta, 9);
    if (motion) {
        double variance[2];
        for (int i = 0; i < 2; ++i) variance[i] = sensor[i] * sensor[i] / mean.count + how.floor[i];
        advance(*motion, mean.zeta, place, variance, how.onward, mean.excess);
    } else if (!is_rest) {
        learnt.motion = motion_at(mean.zeta, place);
    }
    return mean;
}

}  // namespace kernels
