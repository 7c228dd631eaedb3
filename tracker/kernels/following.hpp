// What `following` does to a bank in every tick: its moments grow, and it learns from them.
#pragma once

#include "pricing.hpp"
#include "seeing.hpp"

namespace kernels {

// As in `evidence.Scales`.
struct Weights {
    Lengths lengths;
    double foreknowledge, independence;
};

// As `refit._weighed`; `work` is at the hypotheses' x (S,).
template <class F>
void weigh(const Kind& kind, const Rows& rows, const Lanes* x, const Weights& weights, const Sums<F>& sums,
           Work<F>& work) {
    const Where& where = kind.where;
    const Lanes ticks = larger<Lanes>(sums.ticks, 1.0);
    const Lanes share =
        weights.foreknowledge * kind.needed / larger<Lanes>(read(rows.since, kind.since.told), 1.0);
    Lanes earned = read(rows.own, where.earned), foretold[F::K], first[F::C];
    for (int k = 0; k < F::K; ++k) {
        foretold[k] = share * exp(-2.0 * sums.gain[k] / larger<Lanes>(sums.after, 1.0));
        earned += sums.gain[k];
        write(rows.own, where.row_weight + k, sums.precision[k] / ticks);
    }
    read(rows.since, kind.since.first, F::C, first);
    Lanes price = volume<F>(first, foretold, work);
    work.prior.times(x, work.pull);
    price += 0.5 * dot<F::S>(x, work.pull) - dot<F::S>(x, work.prior.information) + work.prior.constant;
    const Lanes told = sums.log_ratio + read(rows.own, where.settled) - smaller<Lanes>(earned, price);
    write(rows.own, where.log_likelihood, read(rows.own, where.lasted) + weights.independence * told);
    write(rows.own, where.rms, sqrt(sums.chi_sq / (ticks * double(F::K))));
    write(rows.own, where.x, F::S, x);
}

// As `refit.grow` of the `onsets`, by the newest of `ticks`, in which so much motion is `heard`.
template <class F>
WIDE void lengthen(const Kind& kind, const Table& onsets, const Ticks& ticks, double heard) {
    const WhereSince& where = kind.since;
    const double *pose = ticks.newest_pose(), precision = 1.0 / ticks.noise(ticks.count - 1, 0);
    const Vector place = kind.body_in_1 ? at(pose, T) : -at(pose, U);
    double lifted[F::C], products[F::C * (F::C + 1) / 2];
    for (int c = 0; c < F::C; ++c) lifted[c] = pose[kind.lifted[c]];
    for (int c = 0, i = 0; c < F::C; ++c) {
        for (int d = c; d < F::C; ++d) products[i++] = lifted[c] * lifted[d];
    }
    for (int o = 0; o < onsets.count; ++o) {
        double *row = onsets.row(o), *moments = row + where.moments;
        const bool begins = whole(row, where.onset) == ticks.newest();
        const double weight = precision * (begins ? 1.0 : std::max(heard, settings.at_rest));
        for (int i = 0; i < F::C * (F::C + 1) / 2; ++i) moments[i] += weight * products[i];
        for (int c = 0; begins && c < F::C; ++c) row[where.first + c] = lifted[c] * std::sqrt(precision);
        put(row, where.place_sum, at(row, where.place_sum) + weight * place);
        row[where.weight] += weight;
        row[where.told] += begins ? 1.0 : heard;
    }
}

// As `refit.grow` of all else.
template <class F>
void grow(const Kind& kind, const Bank& bank, const Ticks& ticks, double heard, double log_stay) {
    lengthen<F>(kind, bank.onsets, ticks, heard);
    for (int b = 0; b < bank.count(); ++b) {
        const Hypothesis one = bank[b];
        double anchors[6];
        if (whole(one.own, kind.where.onset) != ticks.newest()) one.own[kind.where.lasted] += log_stay;
        anchor(kind, one, anchors);
        normalise<F>(one.own + kind.where.x, anchors);
    }
}

// When hypotheses began, and of which ones both elements are known.
struct Begun {
    std::int64_t onset[lanes];
    Mask certain;

    Begun(const Kind& kind, const Rows& rows) {
        for (int i = 0; i < lanes; ++i) {
            onset[i] = whole(rows.own[i], kind.where.onset);
            certain.put(i, whole(rows.own[i], kind.where.certain) != 0);
        }
    }
};

// As `bank_update.settle` of the first `count` hypotheses, by the ticks that the window has lost: they are
// `gone`.
template <class F>
void settle(const Kind& kind, const Bank& bank, int count, const Ticks& gone, const Lengths& lengths) {
    const Where& where = kind.where;
    if (!gone.count) return;
    for (int first = 0; first < count; first += lanes) {  // they are in order of onset
        if (whole(bank.own.row(first), where.onset) > gone.newest()) return;
        const Rows rows = rows_of([&](int i) { return bank[std::min(first + i, count - 1)]; });
        Lanes x[F::S];
        read(rows.own, where.x, F::S, x);
        const Begun begun(kind, rows);
        const Sums<F> sums = add_up<F>(kind, x, begun.onset, begun.certain, gone, lengths);
        Lanes earned = read(rows.own, where.earned);
        for (int k = 0; k < F::K; ++k) earned += sums.gain[k];
        write(rows.own, where.settled, read(rows.own, where.settled) + sums.log_ratio);
        write(rows.own, where.earned, earned);
    }
}

// How many steps a hypothesis takes in every tick.
inline int steps_of(const Kind& kind, const Hypothesis& one) {
    return one.since[kind.since.told] < settings.first_ticks ? settings.first_steps : settings.refine_steps;
}

// As `refit.waits`.
inline bool waits(const Kind& kind, const double* row) {
    return !(joint(kind.where, row) >= -settings.wait_nats);
}

// Whether a hypothesis has fallen, whose log weight was that before the tick, from no more than so many
// `nats` behind the best: as in `refit.caught`.
inline bool fell(const Kind& kind, const double* row, double was, double nats) {
    const bool falls = was >= -nats && joint(kind.where, row) < was - settings.fall_nats;
    return falls && row[kind.where.rms] > settings.at_the_noise;
}

// As `refit.learn` of hypotheses that take so many steps.
template <class F>
WIDE void learn(const Kind& kind, const Rows& rows, const Ticks& ticks, int steps, const Weights& weights,
                Work<F>& work) {
    const Where& where = kind.where;
    const Moments<F> window(kind, rows);
    const Begun begun(kind, rows);
    Lanes x[F::S];
    read(rows.own, where.x, F::S, x);
    know<F>(kind, rows, work.prior);
    descend<F>(window, x, steps, work);
    weigh<F>(kind, rows, x, weights, add_up<F>(kind, x, begun.onset, begun.certain, ticks, weights.lengths),
             work);
}

// Hypotheses that are to learn, until as many stand side by side: those that take as many steps, and of which
// something is known, or nothing.
class Learners {
public:
    void add(const Kind& kind, const Hypothesis& one, int steps) {
        const bool known = !is_nothing_known(kind, one.own);
        for (Group& group : groups_) {
            if (group.steps == steps && group.known == known) return group.all.push_back(one);
        }
        groups_.push_back({steps, known, {one}});
    }

    template <class F>
    void learn(const Kind& kind, const Ticks& ticks, const Weights& weights, Work<F>& work) {
        for (Group& group : groups_) {
            for (std::size_t first = 0; first < group.all.size(); first += lanes) {
                const Rows rows = rows_of([&](int i) {  // the last one again where there are too few
                    return group.all[std::min(first + i, group.all.size() - 1)];
                });
                kernels::learn<F>(kind, rows, ticks, group.steps, weights, work);
            }
        }
        groups_.clear();
    }

private:
    struct Group {
        int steps;
        bool known;
        std::vector<Hypothesis> all;
    };

    std::vector<Group> groups_;
};

}  // namespace kernels
