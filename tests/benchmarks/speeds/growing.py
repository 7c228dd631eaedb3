"""Growth: time per tick late in a log, relative to the same poses in its first minute."""

import growth
from speeds.figures import Figure, Setup

MINUTE_S = 60.0


def measure(setup: Setup) -> list[Figure]:
    after_s = setup.lengths_s[-1]
    grown = growth.measure(setup.log, setup.model, after_s, min(MINUTE_S, after_s), setup.runs)
    name = f"after {grown.after_s:.0f} s against the first minute"
    return [
        Figure(f"{name}: a tick", float(grown.cpu_growth[-1]), "x", "<= 1.1"),
        Figure(f"{name}: hypotheses", float(grown.hypotheses_growth[-1]), "x"),
    ]
