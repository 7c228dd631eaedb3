// Forward over the states and back again: the inference of `hmm`, of `running.Forward` and `past.Past`.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <stdexcept>
#include <utility>
#include <vector>

namespace kernels {

constexpr double impossible = -std::numeric_limits<double>::infinity();
constexpr double lowest = std::numeric_limits<double>::lowest();  // instead of it, where it is subtracted

// What may come of a beginning: numbers of each state at each onset (O, N).
struct Entries {
    std::vector<std::int64_t> onset;
    std::vector<double> sum, best;
    std::vector<int> origin;
};

// As `running.Step`; of each entry, onset and state.
struct TickStep {
    std::vector<double> source, probability;
    std::vector<std::int32_t> onset, best;
    std::vector<std::int8_t> state;
};

// As `running.Forward`.
class Forward {
public:
    Forward(std::vector<double> log_initial, double negligible)
        : initial_(std::move(log_initial)), negligible_(negligible), left_(2 * initial_.size()) {}

    // Sums and maxima (2, N) over the paths to each state.
    const std::vector<double>& left() const { return left_; }
    // At the end of the last tick: of what was there the weights, and the best paths.
    const Entries& ended() const { return ended_; }

    TickStep advance(const std::int64_t* state, const std::int64_t* onset, const double* log_likelihood,
                     int count, const double* change) {
        TickStep step;
        begin(change, step.source);
        gather(state, onset, log_likelihood, count);
        const double norm = score();
        const std::size_t states = initial_.size();
        std::vector<double> total(states, 0.0);
        step.best.assign(2 * states, -1);
        for (std::size_t j = 0; j < states; ++j) finish(j, total[j], step);
        for (std::size_t cell = 0; cell < ended_.sum.size(); ++cell) {
            const double weight = ended_.sum[cell], of_state = total[cell % states];
            if (!(weight > negligible_ * of_state)) continue;
            step.onset.push_back(static_cast<std::int32_t>(ended_.onset[cell / states]));
            step.state.push_back(static_cast<std::int8_t>(cell % states));
            step.probability.push_back(weight / of_state);
        }
        forget(norm);
        return step;
    }

private:
    std::vector<double> initial_;
    double negligible_;
    std::vector<double> left_;
    Entries entry_, ended_;  // ended_.sum is a weight against the state's best
    std::vector<double> top_, many_;
    std::int64_t ticks_ = 0;

    // What begins now, and from where.
    void begin(const double* change, std::vector<double>& source) {
        const std::size_t states = initial_.size();
        source.assign(states * states, 0.0);
        for (std::size_t j = 0; j < states; ++j) {
            double sum = initial_[j], best = initial_[j];
            int origin = -1;
            if (ticks_) {
                const auto into = [&](int of, std::size_t i) {
                    return left_[of * states + i] + change[i * states + j];
                };
                double most = impossible, whole = 0.0;
                best = impossible, origin = 0;
                for (std::size_t i = 0; i < states; ++i) {
                    most = std::max(most, into(0, i));
                    if (into(1, i) > best) best = into(1, i), origin = static_cast<int>(i);
                }
                for (std::size_t i = 0; i < states; ++i)
                    whole += std::exp(into(0, i) - std::max(most, lowest));
                sum = std::max(most, lowest) + std::log(whole);
                for (std::size_t i = 0; i < states; ++i)
                    source[i * states + j] = std::exp(into(0, i) - std::max(sum, lowest));
            }
            entry_.sum.push_back(sum);
            entry_.best.push_back(best);
            entry_.origin.push_back(origin);
        }
        entry_.onset.push_back(ticks_++);
    }

    // Of the hypotheses of each onset and state the best log-likelihood, and as how many of it they all
    // count.
    void gather(const std::int64_t* state, const std::int64_t* onset, const double* log_likelihood,
                int count) {
        const std::size_t states = initial_.size();
        std::vector<std::size_t> cell(count);
        top_.assign(entry_.sum.size(), impossible);
        many_.assign(entry_.sum.size(), 0.0);
        for (int h = 0; h < count; ++h) {
            const auto found = std::lower_bound(entry_.onset.begin(), entry_.onset.end(), onset[h]);
            if (found == entry_.onset.end() || *found != onset[h] || state[h] < 0 ||
                state[h] >= static_cast<std::int64_t>(states))
                throw std::invalid_argument("a hypothesis of which nothing has begun");
            if (!std::isfinite(log_likelihood[h])) throw std::invalid_argument("no path covers all ticks");
            cell[h] = static_cast<std::size_t>(found - entry_.onset.begin()) * states + state[h];
            top_[cell[h]] = std::max(top_[cell[h]], log_likelihood[h]);
        }
        for (int h = 0; h < count; ++h) many_[cell[h]] += std::exp(log_likelihood[h] - top_[cell[h]]);
    }

    // Paths that end now; weights matter up to a factor: without the one returned they outgrow their digits.
    double score() {
        ended_ = entry_;
        double norm = impossible;
        for (std::size_t cell = 0; cell < top_.size(); ++cell) {
            ended_.sum[cell] += top_[cell];
            ended_.best[cell] += top_[cell];
            norm = std::max(norm, ended_.sum[cell]);
        }
        if (!std::isfinite(norm)) throw std::invalid_argument("no path covers all ticks");
        for (std::size_t cell = 0; cell < top_.size(); ++cell) {
            ended_.sum[cell] -= norm;
            ended_.best[cell] -= norm;
        }
        return norm;
    }

    // What is left in state j.
    void finish(std::size_t j, double& total, TickStep& step) {
        const std::size_t states = initial_.size(), cells = ended_.sum.size();
        double most = lowest;
        std::size_t winner = j;
        for (std::size_t cell = j; cell < cells; cell += states) {
            most = std::max(most, ended_.sum[cell]);
            if (ended_.best[cell] > ended_.best[winner]) winner = cell;
        }
        for (std::size_t cell = j; cell < cells; cell += states) {
            ended_.sum[cell] = std::exp(ended_.sum[cell] - most) * many_[cell];
            total += ended_.sum[cell];
        }
        left_[j] = most + std::log(total);
        left_[states + j] = ended_.best[winner];
        if (!std::isfinite(ended_.best[winner])) return;
        step.best[j] = static_cast<std::int32_t>(ended_.onset[winner / states]);
        step.best[states + j] = ended_.origin[winner];
    }

    // Onsets of which nothing is alive.
    void forget(double norm) {
        const std::size_t states = initial_.size();
        std::size_t kept = 0;
        for (std::size_t o = 0; o < entry_.onset.size(); ++o) {
            const auto alive = many_.begin() + static_cast<std::ptrdiff_t>(o * states);
            if (std::none_of(alive, alive + static_cast<std::ptrdiff_t>(states),
                             [](double n) { return n > 0.0; }))
                continue;
            entry_.onset[kept] = entry_.onset[o];
            for (std::size_t j = 0; j < states; ++j) {
                entry_.sum[kept * states + j] = entry_.sum[o * states + j] - norm;
                entry_.best[kept * states + j] = entry_.best[o * states + j] - norm;
                entry_.origin[kept * states + j] = entry_.origin[o * states + j];
            }
            ++kept;
        }
        entry_.onset.resize(kept);
        for (auto* numbers : {&entry_.sum, &entry_.best}) numbers->resize(kept * states);
        entry_.origin.resize(kept * states);
    }
};

}  // namespace kernels
