// Update of all banks by several ticks, up to a stop condition. Reference: `bank_update.update`.
#pragma once

#include <cmath>
#include <utility>
#include <vector>

#include "update/bank_update.hpp"

namespace kernels {

// Reference: `tick_update.StopCondition`; `due` are pairs of an onset and its due time (ns), `current` is the
// onset among them of the most probable contact, or -1.
struct StopCondition {
    double probability, posterior_power;
    std::vector<std::pair<std::int64_t, std::int64_t>> due;
    std::int64_t current;
};

// Like `numpy.logaddexp`.
inline double add_logs(double a, double b) {
    const double lead = a - b;
    if (lead == 0.0 || a == b) return a + std::log(2.0);
    if (lead > 0.0) return a + std::log1p(std::exp(-lead));
    return lead <= 0.0 ? b + std::log1p(std::exp(lead)) : lead;
}

// Reference: `hmm.birth_log_weights`.
inline Floats birth_log_weights(const Floats& log_left, const Floats& change) {
    const py::ssize_t states = log_left.size();
    require_shape(log_left, {states}, "states do not have one weight each");
    require_shape(change, {states, states}, "changes are from state to state");
    Floats entry(states);
    for (py::ssize_t j = 0; j < states; ++j) {
        double sum = -std::numeric_limits<double>::infinity();
        for (py::ssize_t i = 0; i < states; ++i) sum = add_logs(sum, log_left.at(i) + change.at(i, j));
        entry.mutable_at(j) = sum;
    }
    return entry;
}

// Whether the stop condition holds after a tick: a contact is this probable, and its onset is due; or the
// most probable state is not the current one any more.
inline bool must_stop(const StopCondition& until, const std::vector<const Model*>& models,
                      std::vector<GrowingBank>& growing, const BankUpdate& updated, std::int64_t stamp_ns) {
    const double* log_left = updated.log_left.data();
    const std::size_t contacts = models.size(),
                      best = std::max_element(log_left, log_left + contacts + 1) - log_left;
    if (best == contacts) return until.current != -1;
    const KeptHypotheses& left = updated.left[best];
    if (left.leader < 0) return true;  // the weights are NaN
    const Bank bank(models[best]->kind, growing[best].own(), growing[best].onsets());
    const std::int64_t onset_ns =
        whole(bank.since(static_cast<int>(left.leader)), models[best]->kind.since.onset_ns);
    std::int64_t is_due_ns = stamp_ns, current = -1;
    for (const auto& [of, due_ns] : until.due) {
        if (of == onset_ns) is_due_ns = due_ns, current = of;
    }
    if (current != until.current) return true;
    double sum = 0.0;
    for (std::size_t i = 0; i <= contacts; ++i)
        sum += std::exp(until.posterior_power * (log_left[i] - log_left[best]));
    constexpr double nearly = 1.0 - 1e-9;  // the caller evaluates the condition exactly
    return 1.0 / sum >= nearly * until.probability && stamp_ns >= is_due_ns;
}

// Tables of the hypotheses of each contact and of their onsets.
using Tables = std::vector<std::pair<Floats, Floats>>;

// Copies of the tables, with room for all births of the `inputs`.
inline std::vector<GrowingBank> growing_banks(const std::vector<const Model*>& models, const Tables& words,
                                              const std::vector<const TickInput*>& inputs) {
    std::vector<GrowingBank> growing;
    for (const TickInput* input : inputs) {
        for (std::size_t size : {input->assumed.size(), input->directions.size()})
            require(size == models.size(), "an entry per contact is missing");
    }
    for (std::size_t i = 0; i < models.size(); ++i) {
        py::ssize_t more = 0, onsets = 0;
        for (const TickInput* input : inputs) {
            const py::ssize_t many = input->assumed[i].first.shape(0);
            more += many;
            onsets += many > 0;
        }
        growing.emplace_back(*models[i], words[i].first, words[i].second, more, onsets);
    }
    return growing;
}

// Update by at least one of the `inputs`, up to the first after which the stop condition holds. `entry` are
// the log birth weights of the states in the first.
inline py::tuple update_in_batch(const std::vector<const Model*>& models, const Tables& words,
                                 const std::vector<const TickInput*>& inputs, std::int64_t number,
                                 Floats entry, const std::vector<Two>& beyond,
                                 const EvidenceParameters& weights, double margin,
                                 const std::optional<StopCondition>& until) {
    for (std::size_t size : {words.size(), beyond.size()})
        require(size == models.size(), "an entry per contact is missing");
    require(std::count(models.begin(), models.end(), nullptr) == 0, "a contact is None");
    require(!inputs.empty() && !std::count(inputs.begin(), inputs.end(), nullptr),
            "there are no tick inputs");
    require_shape(entry, {static_cast<py::ssize_t>(models.size()) + 1}, "states do not have one entry each");
    std::vector<GrowingBank> growing = growing_banks(models, words, inputs);
    BankUpdate updated;
    py::list weighed, kept, rows;
    for (const TickInput* input : inputs) {
        if (input != inputs.front()) entry = birth_log_weights(updated.log_left, input->change);
        updated = update_banks(models, growing, *input, number, entry, beyond, weights, margin);
        weighed.append(py::make_tuple(updated.entry, updated.log_left, updated.residual, updated.leaders,
                                      live_hypotheses(models, growing, input->onset)));
        if (until && must_stop(*until, models, growing, updated, input->stamp_ns)) break;
    }
    for (std::size_t i = 0; i < models.size(); ++i) {
        const std::vector<std::int64_t>& left = updated.left[i].rows;
        kept.append(growing[i].left());
        rows.append(Ints(left.size(), left.data()));
    }
    return py::make_tuple(kept, rows, weighed);
}

}  // namespace kernels
