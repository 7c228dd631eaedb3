"""Figures of sequences, drawn by matplotlib: two takes with their alignment, and a graph of contacts."""

import csv
from collections.abc import Callable
from math import cos, pi, sin
from pathlib import Path
from typing import Any, Final

from matplotlib import pyplot
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Polygon

from contact_tracker.errors import printable
from contact_tracker.exports import figure as figures
from contact_tracker.exports.figure import PLAIN_TEXT, SHADE, save_figure
from contact_tracker.files import accept_any, whole_file
from contact_tracker.outputs.outcome import Outcome
from contact_tracker.sequences.comparison import Comparison, Verdict
from contact_tracker.sequences.graph import ContactGraph
from contact_tracker.sequences.steps import steps_of

_BAND: Final = {
    Verdict.SAME: "0.85",
    Verdict.OPEN: "0.95",
    Verdict.LONGER: "gold",
    Verdict.SHORTER: "gold",
    Verdict.ELSEWHERE: "orchid",
    Verdict.MISSING: "tomato",
    Verdict.NEW: "tomato",
}
_RIBBONS: Final = ((1.0, 1.25), (0.0, 0.25))
"""Lower and upper ends, on the vertical axis, of the first and the second take."""


@PLAIN_TEXT
def draw_comparison(comparison: Comparison) -> Figure:
    """Two ribbons of contacts, with a band between the segments of each step, coloured by its verdict."""
    figure, axes = pyplot.subplots(figsize=(10.0, 3.2), layout="constrained")
    takes = [steps_of(take) for take in comparison.takes]
    axes.set(xlim=(0.0, max(steps[-1].end_s for steps in takes)), ylim=(-0.02, 1.27), xlabel="time (s)")
    for steps, ribbon in zip(takes, _RIBBONS, strict=True):
        for part in steps:
            names = (part.segment.contact.value,)
            figures.draw_segment(axes, part.segment, part.start_s, part.end_s - part.start_s, ribbon, names)
    top, bottom = _RIBBONS[0][0], _RIBBONS[1][1]
    for step in comparison.steps:  # a step of a single take is a triangle
        upper = [(step.first[0].start_s, top), (step.first[-1].end_s, top)] if step.first else []
        lower = [(step.second[-1].end_s, bottom), (step.second[0].start_s, bottom)] if step.second else []
        ends = upper or lower
        middle = 0.5 * (ends[0][0] + ends[1][0]), 0.5 * (top + bottom)
        corners = [*(upper or [middle]), *(lower or [middle])]
        axes.add_patch(Polygon(corners, closed=True, **_style(step.verdict)))
    verdicts = dict.fromkeys(step.verdict for step in comparison.steps)
    handles = [Patch(**_style(verdict), label=f"step {verdict.value}") for verdict in verdicts]
    if any(step.is_open for steps in takes for step in steps):
        handles.append(figures.open_patch())
    axes.legend(handles=handles, loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)
    name_a, name_b = (printable(take.trajectory.name) for take in comparison.takes)
    axes.set_title(f"A: {name_a}\nB: {name_b}", loc="left", fontsize=figures.NAME_SIZE)
    axes.set_yticks([sum(ribbon) / 2.0 for ribbon in _RIBBONS], ["A", "B"])
    axes.spines[["top", "right", "left"]].set_visible(False)
    return figure


def _style(verdict: Verdict) -> dict[str, Any]:
    hatch = "xx" if verdict in (Verdict.MISSING, Verdict.NEW) else ""
    return {"facecolor": _BAND[verdict], "hatch": hatch, "edgecolor": "grey", "linewidth": 0.3}


@PLAIN_TEXT
def draw_graph(graph: ContactGraph) -> Figure:
    """The contacts on a circle, in order of first occurrence, and arrows with the numbers of transitions."""
    figure, axes = pyplot.subplots(figsize=(8.0, 8.0), layout="constrained")
    count = len(graph.nodes)
    angles = [pi / 2.0 - 2.0 * pi * k / max(count, 1) for k in range(count)]
    places = [(cos(a), sin(a)) for a in angles]
    for (source, target), times in graph.edges.items():
        line = {"linewidth": 0.7 + 0.6 * len(times), "color": "0.45", "connectionstyle": "arc3,rad=0.15"}
        arrow = {"arrowstyle": "-|>", "mutation_scale": 14, "shrinkA": 34, "shrinkB": 34, **line}
        axes.annotate("", places[target], places[source], arrowprops=arrow)
        if len(times) > 1:
            (x, y), (u, v) = places[source], places[target]
            # the arc's middle is to the right of the straight line
            middle = 0.5 * (x + u) + 0.075 * (v - y), 0.5 * (y + v) - 0.075 * (u - x)
            axes.text(*middle, str(len(times)), fontsize=8, ha="center", va="center", backgroundcolor="white")
    for node, (x, y) in zip(graph.nodes, places, strict=True):
        axes.scatter([x], [y], s=3200, color=SHADE[node.contact], edgecolor="white", zorder=2)
        text = "\n".join(filter(None, (node.name, *node.elements, f"{node.total_s:.1f} s")))
        axes.text(x, y, text, ha="center", va="center", fontsize=7, zorder=3)
    axes.set(xlim=(-1.3, 1.3), ylim=(-1.3, 1.3), aspect="equal")
    axes.set_axis_off()
    return figure


def write_comparison(comparison: Comparison, path: Path, check: Callable[[], None] = accept_any) -> None:
    """Write a CSV with a row per step, or the figure, atomically; raises OSError."""
    with whole_file(path, check) as temporary:
        if path.suffix.lower() != ".csv":
            save_figure(draw_comparison(comparison), temporary, path.suffix)
            return
        with open(temporary, "w", encoding="utf-8", newline="") as file:
            writer = csv.DictWriter(file, comparison.columns, lineterminator="\n")
            writer.writeheader()
            writer.writerows(step.to_json() for step in comparison.steps)


def write_contact_graph(outcome: Outcome, path: Path, check: Callable[[], None] = accept_any) -> None:
    """Write the figure of the contacts of a recording, atomically; raises OSError."""
    with whole_file(path, check) as temporary:
        save_figure(draw_graph(ContactGraph.of(outcome)), temporary, path.suffix)
