"""Arrangement of the views: 3D and events on the left, plots over time on the right."""

import inspect
from typing import Any, Literal

import rerun as rr
import rerun.blueprint as rrb

from contact_tracker.viewer import canvas
from contact_tracker.viewer.scene import Eye

PanelState = Literal["collapsed", "expanded"]
BACKGROUND = (25, 28, 33)
"""Dark in light themes as well, on which the object's white elements are not seen."""
TRAIL_S = 4.0
LIVE_S = 10.0
_RESIDUAL = "Residual over 25 ticks of motion (1 = noise)"
_MOTION = "Slip at the touching point (m/s)"
_PAPER = "Paper's objectives, windows of 500 poses (normalised)"


def offline(eye: Eye, is_one_of_several: bool = False) -> rrb.Blueprint:
    """Layout of a whole recording; with several recordings their list is open."""
    everything = rr.TimeRange(start=rr.TimeRangeBoundary.infinite(), end=rr.TimeRangeBoundary.infinite())
    smoothed = _plot(canvas.P_SMOOTHED, "Probability, smoothed (all data)", everything, 1.05, legend=True)
    filtered = _plot(canvas.P_FILTERED, "Probability, filtered (data so far)", everything, 1.05)
    residual = _plot(canvas.RESIDUAL, _RESIDUAL, everything, 3.0, legend=True)
    paper = _plot(canvas.PAPER, _PAPER, everything, 1.0, legend=True)
    motion = _plot(canvas.MOTION, _MOTION, everything, None, legend=True)
    views = _states(everything), smoothed, filtered, rrb.Tabs(residual, motion, paper)
    over_time = rrb.Vertical(*views, row_shares=[15, 14, 7, 12])
    panel = rrb.TimePanel(state="collapsed", timeline=canvas.TIMELINE)
    return _blueprint(eye, over_time, panel, "expanded" if is_one_of_several else "collapsed")


def live(eye: Eye) -> rrb.Blueprint:
    """Layout of a live view: the last seconds before the cursor, which follows the data."""
    recent = rr.TimeRange(
        start=rr.TimeRangeBoundary.cursor_relative(seconds=-LIVE_S),
        end=rr.TimeRangeBoundary.cursor_relative(seconds=0.0),
    )
    over_time = rrb.Vertical(
        _states(recent),
        _plot(canvas.P_FILTERED, "Probability", recent, 1.05, legend=True),
        _plot(canvas.RESIDUAL, _RESIDUAL, recent, 3.0, legend=True),
        row_shares=[4, 4, 4],
    )
    panel = rrb.TimePanel(state="collapsed", timeline=canvas.TIMELINE, play_state="following")
    return _blueprint(eye, over_time, panel)


def _blueprint(
    eye: Eye, over_time: rrb.Container, panel: rrb.TimePanel, recordings: PanelState = "collapsed"
) -> rrb.Blueprint:
    events = rrb.TextLogView(
        origin=canvas.EVENTS,
        name="Changes of contact",
        columns=rrb.TextLogColumns(
            timeline_columns=[_no_column(canvas.TIMELINE), _no_column(canvas.STAMP)],
            text_log_columns=["LogLevel", "Body"],
        ),
    )
    legend = rrb.TextDocumentView(origin=canvas.LEGEND, name="What is what")
    left = rrb.Vertical(_space(eye), legend, events, row_shares=[18, 5, 5])
    return rrb.Blueprint(
        rrb.Horizontal(left, over_time, column_shares=[11, 9]),
        rrb.BlueprintPanel(state=recordings),
        rrb.SelectionPanel(state="collapsed"),
        panel,
        auto_views=False,
    )


def _no_column(timeline: str) -> rrb.encodings.TimelineColumn:
    """No time column: the text has the time, as the viewer's column is too narrow."""
    return rrb.encodings.TimelineColumn(timeline, visible=False)


def _space(eye: Eye) -> rrb.View:
    trail = rr.VisibleTimeRange(
        canvas.TIMELINE,
        start=rr.TimeRangeBoundary.cursor_relative(seconds=-TRAIL_S),
        end=rr.TimeRangeBoundary.cursor_relative(seconds=0.0),
    )
    controls = rrb.EyeControls3D(
        kind=rrb.Eye3DKind.Orbital,
        position=eye.position_m,
        look_target=(0.0, 0.0, 0.0),
        eye_up=eye.up,
        tracking_entity=canvas.CENTRE,  # the place of the eye is relative to it
    )
    # The world frame need not be level, so the viewer's ground grid would mislead.
    return rrb.Spatial3DView(
        origin="world",
        contents="world/**",
        name="Object and contact",
        background=BACKGROUND,
        line_grid=False,
        eye_controls=controls,
        overrides={canvas.TRAIL: rrb.VisibleTimeRanges(trail)},
    )


def _states(time_range: rr.TimeRange) -> rrb.View:
    options: dict[str, Any] = {}
    if "time_view" in inspect.signature(rrb.StateTimelineView.__init__).parameters:  # not yet in 0.38
        options["time_view"] = rrb.TimeAxis(view_range=time_range)
    return rrb.StateTimelineView(origin="state", name="Contact", **options)


def _plot(
    entity: str, name: str, time_range: rr.TimeRange, top: float | None, legend: bool = False
) -> rrb.View:
    return rrb.TimeSeriesView(
        origin=entity,
        name=name,
        axis_x=rrb.TimeAxis(view_range=time_range),
        axis_y=None if top is None else rrb.ScalarAxis(range=(0.0, top)),
        plot_legend=rrb.PlotLegend(rrb.Corner2D.LeftTop, visible=legend),
    )
