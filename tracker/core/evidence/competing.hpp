// How well each contact explains the ticks since about an onset, against one of them. Reference:
// `ambiguity.competing_evidence`.
#pragma once

#include <limits>

#include "python/numpy_views.hpp"

namespace kernels {

// The log likelihood of a contact by onset: of the best hypothesis of each, without those far behind.
// Reference: `ambiguity._evidence`.
class EvidenceByOnset {
public:
    EvidenceByOnset(const BankLayout& where, const Table& table) {
        double top = -std::numeric_limits<double>::infinity(), best = top;
        for (int h = 0; h < table.count; ++h) top = std::max(top, log_weight_of(where, table.row(h)));
        for (int h = 0; h < table.count; ++h) {
            const double *row = table.row(h), weight = log_weight_of(where, row);
            const auto onset = static_cast<double>(whole(row, where.onset));
            if (weight < top - settings.near_nats) continue;
            if (points_.empty() || points_.back().first != onset)
                points_.emplace_back(onset, 0.0);
            else if (!(weight > best))
                continue;
            best = weight;
            points_.back().second = row[where.log_likelihood];
        }
    }

    // Interpolated, as by `np.interp`.
    double at(std::int64_t onset) const {
        const auto x = static_cast<double>(onset);
        if (x >= points_.back().first) return points_.back().second;
        std::size_t j = 0;
        while (points_[j].first <= x) ++j;
        if (!j) return points_[0].second;
        const auto [x0, y0] = points_[j - 1];
        const auto [x1, y1] = points_[j];
        return (y1 - y0) / (x1 - x0) * (x - x0) + y0;
    }

private:
    std::vector<std::pair<double, double>> points_;
};

// The evidence (nats) and the whitened residual of each state. `label` is the column of one of them; onsets
// that differ from `onset` by at most `slack` are about the same.
inline std::pair<Floats, Floats> competing_evidence(const std::vector<const Model*>& models,
                                                    const std::vector<Floats>& words, std::size_t label,
                                                    std::int64_t onset, std::int64_t slack) {
    const std::size_t contacts = models.size();
    require(words.size() == contacts && label <= contacts, "an entry per contact is missing");
    Floats evidence(contacts + 1), rms(contacts + 1);
    std::vector<std::int64_t> since(contacts + 1, onset);
    double *nats = evidence.mutable_data(), *residual = rms.mutable_data();
    for (std::size_t i = 0; i < contacts; ++i) {
        const Table table = table_of(words[i], models[i]->words);
        const BankLayout& where = models[i]->kind.where;
        const double* best = nullptr;
        for (int h = 0; h < table.count; ++h) {
            const double* row = table.row(h);
            if (std::abs(whole(row, where.onset) - onset) > slack) continue;
            if (!best || log_weight_of(where, row) > log_weight_of(where, best)) best = row;
        }
        const double none = std::numeric_limits<double>::infinity();
        nats[i] = best ? best[where.log_likelihood] : -none;
        residual[i] = best ? best[where.rms] : none;
        if (best) since[i] = whole(best, where.onset);
    }
    nats[contacts] = 0.0;
    residual[contacts] = 1.0;
    if (label < contacts) {
        const Table table = table_of(words[label], models[label]->words);
        require(table.count > 0, "the label has no hypothesis");
        const EvidenceByOnset own(models[label]->kind.where, table);
        for (std::size_t i = 0; i <= contacts; ++i) nats[i] -= own.at(since[i]);
    }
    nats[label] = 0.0;
    return {evidence, rms};
}

}  // namespace kernels
