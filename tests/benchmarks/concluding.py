"""Time and memory of Viterbi, smoothing and beliefs in ``segment``, without the forward pass and the fits.

    python tests/benchmarks/concluding.py LOG --hours 10

The forward pass over LOG is repeated, and elements are not fitted: the cost of both is proportional to the
duration. Printed after each tenth: hours, CPU time and memory.
"""

import argparse
import resource
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future
from dataclasses import replace
from typing import Any

import numpy as np

from contact_tracker.config.loading import load_model
from contact_tracker.motion.window import EMPTY_WINDOW
from contact_tracker.recording import open_log
from contact_tracker.states import Contact
from contact_tracker.tracking.forward_pass import FilteredTick, forward
from contact_tracker.tracking.offline_smoother import Segmenter
from contact_tracker.tracking.segment_fit import SegmentFit


class NoFits(Executor):
    """Returns an empty fit at once."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> "Future[Any]":
        future: Future[Any] = Future()
        future.set_result(SegmentFit(Contact.FREE, None, (), 0.0, np.zeros(1)))
        return future


def recorded(path: str) -> list[FilteredTick]:
    """The forward pass; the states without banks and windows, to save memory."""
    ticks, model = [], load_model("default")
    for tick in forward(open_log(path), model):
        state = tick.state._replace(banks=(), sliding_window=EMPTY_WINDOW)
        ticks.append(tick._replace(state=state))
    return ticks


def repeated(ticks: list[FilteredTick], count: int) -> Iterator[FilteredTick]:
    """``count`` ticks: ``ticks`` repeated, shifted in time."""
    tick_ns = ticks[0].state.model.tick_ns
    for number in range(count):
        row = number % len(ticks)
        one, later = ticks[row], number - row
        later_ns = later * tick_ns
        alive = one.state.live_hypotheses._replace(onset=one.state.live_hypotheses.onset + later)
        state = one.state._replace(
            log_transition=ticks[max(row, 1)].state.log_transition, live_hypotheses=alive
        )
        start_ns, stamp_ns = one.tick.start_ns + later_ns, one.tick.stamp_ns + later_ns
        onset_ns = one.belief.onset_ns + later_ns
        belief = replace(one.belief, stamp_ns=stamp_ns, onset_ns=onset_ns)
        tick = replace(one.tick, start_ns=start_ns, stamp_ns=stamp_ns)
        yield FilteredTick(state, tick, belief)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("log")
    parser.add_argument("--hours", type=float, default=10.0)
    args = parser.parse_args()
    ticks, segmenter, segments = recorded(args.log), Segmenter(NoFits()), 0
    count = round(args.hours * 3600.0 / ticks[0].state.model.tick_s)
    begin_s = time.process_time()
    for number, tick in enumerate(repeated(ticks, count), start=1):
        segmenter.note(tick.state, tick.tick_result, tick.belief)
        if segmenter.due:
            segments += len(segmenter.conclude().segments)
        if number % (count // 10) == 0:
            peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
            cpu_s = time.process_time() - begin_s
            print(f"{number / count * args.hours:6.2f} h  {cpu_s:7.1f} s  peak {peak_mb:4.0f} MB", flush=True)
    segments += len(segmenter.finish().segments)
    taken_ms = 1e3 * (time.process_time() - begin_s) / count
    print(f"{count} ticks, {segments} segments, {taken_ms:.2f} ms of CPU time per tick")


if __name__ == "__main__":
    main()
