// Back from what is alive through the open ticks: as `past.Past`.
#pragma once

#include <algorithm>
#include <cstdint>
#include <vector>

namespace kernels {

// Of one tick, as in `running.Step`: so many `entries` of onset, state and probability.
struct Passed {
    const double *source, *probability;
    const std::int32_t* onset;
    const std::int8_t* state;
    int entries;
};

// Numbers (N, C) of beginnings from onset `first` on, each held until it is taken: as `past._Held`.
class Held {
public:
    Held(std::int64_t first, std::size_t onsets, std::size_t size)
        : first_(first), size_(size), row_(onsets, -1) {}

    // Where those of an onset are, zero at first; nothing for what nobody asks for.
    double* of(std::int64_t onset) {
        if (onset < first_) return nullptr;
        int& row = row_[onset - first_];
        if (row < 0) {
            if (free_.empty()) {
                free_.push_back(static_cast<int>(table_.size() / size_));
                table_.resize(table_.size() + size_, 0.0);
            }
            row = free_.back();
            free_.pop_back();
        }
        return &table_[row * size_];
    }

    // Move what began then into `begun`; whether there was any.
    bool take(std::int64_t onset, std::vector<double>& begun) {
        int& row = row_[onset - first_];
        if (row < 0) return false;
        double* numbers = &table_[row * size_];
        std::copy_n(numbers, size_, begun.begin());
        std::fill_n(numbers, size_, 0.0);
        free_.push_back(row);
        row = -1;
        return true;
    }

    // How far the columns differ, over all that is held.
    double apart(std::size_t columns) const {
        double sum = 0.0;
        for (auto row = table_.begin(); row != table_.end(); row += static_cast<std::ptrdiff_t>(columns)) {
            const auto [least, most] = std::minmax_element(row, row + static_cast<std::ptrdiff_t>(columns));
            sum += *most - *least;
        }
        return sum;
    }

private:
    std::int64_t first_;
    std::size_t size_;
    std::vector<int> row_, free_;
    std::vector<double> table_;
};

// As `past.Past._followed`: from the newest tick on `tell(row, cover, held)`, until it says that it is
// enough.
template <class Tell>
void follow_back(const std::vector<Passed>& ticks, std::int64_t first, const Passed& living,
                 const double* futures, std::size_t states, std::size_t columns, Tell&& tell) {
    Held held(first, ticks.size(), states * columns);
    std::vector<double> cover(states * columns, 0.0), left(cover), begun(cover);
    const auto put = [&](const Passed& some, int entry, const double* numbers, double share) {
        double* out = held.of(some.onset[entry]);
        if (!out) return;
        for (std::size_t c = 0; c < columns; ++c) out[some.state[entry] * columns + c] += share * numbers[c];
    };
    for (int entry = 0; entry < living.entries; ++entry) {
        const double* numbers = futures + entry * columns;
        put(living, entry, numbers, 1.0);
        for (std::size_t c = 0; c < columns; ++c) cover[living.state[entry] * columns + c] += numbers[c];
    }
    bool any_left = false;
    for (std::size_t row = ticks.size(); row-- > 0;) {
        const Passed& tick = ticks[row];
        if (any_left) {
            for (std::size_t i = 0; i < cover.size(); ++i) cover[i] += left[i];
            for (int entry = 0; entry < tick.entries; ++entry)
                put(tick, entry, &left[tick.state[entry] * columns], tick.probability[entry]);
        }
        if (!tell(row, cover, held)) return;
        any_left = held.take(first + static_cast<std::int64_t>(row), begun);
        if (!any_left) continue;
        for (std::size_t i = 0; i < cover.size(); ++i) cover[i] = std::max(cover[i] - begun[i], 0.0);
        std::fill(left.begin(), left.end(), 0.0);
        for (std::size_t i = 0; i < states; ++i) {
            for (std::size_t j = 0; j < states; ++j) {
                const double share = tick.source[i * states + j];
                for (std::size_t c = 0; c < columns; ++c)
                    left[i * columns + c] += share * begun[j * columns + c];
            }
        }
    }
}

// As `past.Past._common`.
inline std::size_t common(const std::vector<Passed>& ticks, std::int64_t first, const Passed& living,
                          const double* futures, std::size_t states, std::size_t columns, double tolerance,
                          std::size_t checked) {
    std::size_t common = ticks.size();
    follow_back(ticks, first, living, futures, states, columns,
                [&](std::size_t row, const std::vector<double>& cover, const Held& held) {
                    double spread = 0.0;
                    for (std::size_t i = 0; i < states; ++i) {
                        const auto begin = cover.begin() + static_cast<std::ptrdiff_t>(i * columns);
                        const auto [least, most] =
                            std::minmax_element(begin, begin + static_cast<std::ptrdiff_t>(columns));
                        spread = std::max(spread, *most - *least);
                    }
                    if (spread > tolerance) {
                        common = row;
                    } else if (row % checked == 0 && spread + 2.0 * held.apart(columns) <= tolerance) {
                        return false;  // what is older than all that is held stays in its state
                    }
                    return true;
                });
    return common;
}

}  // namespace kernels
