"""A figure for papers and notebooks, drawn by matplotlib (extra ``plot``)."""

from typing import Final

import numpy as np
from matplotlib import pyplot
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Figure

from contact_tracker.paper.window_curves import WindowCurves
from contact_tracker.states import CONTACTS, STATES
from contact_tracker.tracking.segmentation import Segmentation
from contact_tracker.viewer.scene import COLOUR, Colour

_NAMED: Final = 0.03
"""Smallest share of the recording for which a segment is labelled."""


def draw_figure(found: Segmentation, origin_ns: int, curves: WindowCurves | None = None) -> Figure:
    """A ribbon of the segments, below it their posteriors, and the paper's curves if given.

    Time counts from ``origin_ns``.
    """
    has_curves = curves is not None and len(curves.stamp_ns) > 0
    figure = pyplot.figure(figsize=(10.0, 7.5 if has_curves else 4.5), layout="constrained")
    rows = 3 if has_curves else 2
    ribbon, posterior, *below = figure.subplots(rows, 1, sharex=True, height_ratios=(1.0, 4.0, 4.0)[:rows])
    seconds = (found.stamp_ns - origin_ns) * 1e-9
    spans = [((s.start_ns - origin_ns) * 1e-9, (s.end_ns - s.start_ns) * 1e-9) for s in found.segments]
    total_s = sum(duration for _, duration in spans)
    for segment, (start_s, duration_s) in zip(found.segments, spans, strict=True):
        colour = _fraction(COLOUR[segment.contact])
        ribbon.axvspan(
            start_s, start_s + duration_s, color=colour, alpha=0.25 + 0.75 * segment.probability, lw=0
        )
        if duration_s > _NAMED * total_s:
            middle_s = start_s + 0.5 * duration_s
            ribbon.text(middle_s, 0.5, segment.contact.value, ha="center", va="center", clip_on=True)
    ribbon.set(yticks=[], ylim=(0.0, 1.0))
    ribbon.set_ylabel("label")
    for state, share in zip(STATES, np.transpose(found.beliefs.probability), strict=True):
        posterior.plot(seconds, share, color=_fraction(COLOUR[state]), label=state.value)
    posterior.set(ylabel="probability", ylim=(0.0, 1.02))
    posterior.legend(ncols=1, loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)
    if len(seconds):
        posterior.set_xlim(min(seconds[0], *(start_s for start_s, _ in spans)), seconds[-1])
    if curves is not None:
        for axes in below:
            _draw_curves(axes, curves, origin_ns)
    (below or [posterior])[-1].set_xlabel("time (s)")
    return figure


def _draw_curves(axes: Axes, curves: WindowCurves, origin_ns: int) -> None:
    """Draw the curves like the paper's Fig. 5, each value at the end of its window."""
    seconds = (curves.stamp_ns - origin_ns) * 1e-9
    for contact, curve in zip(CONTACTS, curves.normalised.T, strict=True):
        axes.plot(seconds, curve, color=_fraction(COLOUR[contact]), label=contact.value)
    axes.set(ylabel="objective / its maximum", ylim=(0.0, 1.02))


def _fraction(colour: Colour) -> tuple[float, float, float]:
    red, green, blue = colour
    return red / 255.0, green / 255.0, blue / 255.0
