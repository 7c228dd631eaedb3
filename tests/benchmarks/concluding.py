"""What the second half of ``segment`` takes for hours: Viterbi, smoothing and beliefs, without pass and fits.

    python tests/benchmarks/concluding.py LOG --hours 10

The online pass over LOG is fed to it over and over, and elements are not fitted: neither knows how long a
recording is. Printed after each tenth: hours, CPU time and memory.
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
    """Tells nothing, at once."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> "Future[Any]":
        future: Future[Any] = Future()
        future.set_result(SegmentFit(Contact.FREE, None, (), 0.0, np.zeros(1)))
        return future


def recorded(path: str) -> list[FilteredTick]:
    """The online pass; of the states only what does not grow."""
    once, model = [], load_model("default")
    for seen in forward(open_log(path), model):
        state = seen.state._replace(banks=(), sliding_window=EMPTY_WINDOW)
        once.append(seen._replace(state=state))
    return once


def repeated(once: list[FilteredTick], ticks: int) -> Iterator[FilteredTick]:
    """``once`` over and over, each time later."""
    tick_ns = once[0].state.model.tick_ns
    for number in range(ticks):
        row = number % len(once)
        seen, later = once[row], number - row
        later_ns = later * tick_ns
        alive = seen.state.live_hypotheses._replace(onset=seen.state.live_hypotheses.onset + later)
        state = seen.state._replace(
            log_transition=once[max(row, 1)].state.log_transition, live_hypotheses=alive
        )
        start_ns, stamp_ns = seen.tick.start_ns + later_ns, seen.tick.stamp_ns + later_ns
        onset_ns = seen.belief.onset_ns + later_ns
        belief = replace(seen.belief, stamp_ns=stamp_ns, onset_ns=onset_ns)
        tick = replace(seen.tick, start_ns=start_ns, stamp_ns=stamp_ns)
        yield FilteredTick(state, tick, belief)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("log")
    parser.add_argument("--hours", type=float, default=10.0)
    args = parser.parse_args()
    once, segmenter, segments = recorded(args.log), Segmenter(NoFits()), 0
    ticks = round(args.hours * 3600.0 / once[0].state.model.tick_s)
    begin_s = time.process_time()
    for number, seen in enumerate(repeated(once, ticks), start=1):
        segmenter.note(seen.state, seen.tick_result, seen.belief)
        if segmenter.due:
            segments += len(segmenter.conclude().segments)
        if number % (ticks // 10) == 0:
            peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
            cpu_s = time.process_time() - begin_s
            print(f"{number / ticks * args.hours:6.2f} h  {cpu_s:7.1f} s  peak {peak_mb:4.0f} MB", flush=True)
    segments += len(segmenter.finish().segments)
    taken_ms = 1e3 * (time.process_time() - begin_s) / ticks
    print(f"{ticks} ticks, {segments} segments, {taken_ms:.2f} ms of CPU time per tick")


if __name__ == "__main__":
    main()
