"""How the views are arranged: 3D and events on the left, everything over time on the right."""

import inspect
from typing import Any

import rerun as rr
import rerun.blueprint as rrb

from contact_tracker.viewer import canvas
from contact_tracker.viewer.scene import Viewpoint

TRAIL_S = 4.0
LIVE_S = 10.0


def offline(viewpoint: Viewpoint | None, paper: bool) -> rrb.Blueprint:
    """The whole recording at once; ``paper``: with the fixed-window curves."""
    everything = rr.TimeRange(start=rr.TimeRangeBoundary.infinite(), end=rr.TimeRangeBoundary.infinite())
    smoothed = _plot(canvas.P_SMOOTHED, "Probability, smoothed (all data)", everything, top=1.05, legend=True)
    filtered = _plot(canvas.P_FILTERED, "Probability, filtered (data so far)", everything, top=1.05)
    minima = [_plot(canvas.RESIDUAL, "Residual over 25 ticks of motion (1 = noise)", everything, top=3.0)]
    if paper:
        minima.append(
            _plot(canvas.PAPER, "Paper's objectives, fixed window (normalised)", everything, top=1.0)
        )
    over_time = rrb.Vertical(
        _states(everything), smoothed, filtered, rrb.Tabs(*minima), row_shares=[10, 14, 10, 10]
    )
    eye = None if viewpoint is None else _eye(viewpoint)
    return _blueprint(_space(eye), over_time, rrb.TimePanel(state="collapsed", timeline=canvas.TIMELINE))


def live() -> rrb.Blueprint:
    """The last seconds before the cursor, which follows the data."""
    recent = rr.TimeRange(
        start=rr.TimeRangeBoundary.cursor_relative(seconds=-LIVE_S),
        end=rr.TimeRangeBoundary.cursor_relative(seconds=0.0),
    )
    over_time = rrb.Vertical(
        _states(recent),
        _plot(canvas.P_FILTERED, "Probability", recent, top=1.05, legend=True),
        _plot(canvas.RESIDUAL, "Residual over 25 ticks of motion (1 = noise)", recent, top=3.0),
        row_shares=[2, 3, 3],
    )
    panel = rrb.TimePanel(state="collapsed", timeline=canvas.TIMELINE, play_state="following")
    return _blueprint(_space(None), over_time, panel)


def _blueprint(space: rrb.View, over_time: rrb.Container, panel: rrb.TimePanel) -> rrb.Blueprint:
    events = rrb.TextLogView(
        origin=canvas.EVENTS,
        name="Changes of contact",
        columns=rrb.TextLogColumns(
            timeline_columns=[_no_column(canvas.TIMELINE), _no_column(canvas.STAMP)],
            text_log_columns=["LogLevel", "Body"],
        ),
    )
    left = rrb.Vertical(space, events, row_shares=[3, 1])
    return rrb.Blueprint(
        rrb.Horizontal(left, over_time, column_shares=[11, 9]),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        panel,
        auto_views=False,
    )


def _eye(viewpoint: Viewpoint) -> rrb.EyeControls3D:
    return rrb.EyeControls3D(
        kind=rrb.Eye3DKind.Orbital,
        position=viewpoint.eye_m,
        look_target=viewpoint.target_m,
        eye_up=viewpoint.up,
    )


def _no_column(timeline: str) -> rrb.encodings.TimelineColumn:
    """The text says the time: the viewer's own column is too narrow to read."""
    return rrb.encodings.TimelineColumn(timeline, visible=False)


def _space(eye: rrb.EyeControls3D | None) -> rrb.View:
    trail = rr.VisibleTimeRange(
        canvas.TIMELINE,
        start=rr.TimeRangeBoundary.cursor_relative(seconds=-TRAIL_S),
        end=rr.TimeRangeBoundary.cursor_relative(seconds=0.0),
    )
    # The world frame need not be level, so the viewer's ground grid would mislead.
    return rrb.Spatial3DView(
        origin="world",
        name="Object and contact",
        line_grid=False,
        eye_controls=eye,
        overrides={canvas.TRAIL: rrb.VisibleTimeRanges(trail)},
    )


def _states(time_range: rr.TimeRange) -> rrb.View:
    options: dict[str, Any] = {}
    if "time_view" in inspect.signature(rrb.StateTimelineView.__init__).parameters:  # not yet in 0.38
        options["time_view"] = rrb.TimeAxis(view_range=time_range)
    return rrb.StateTimelineView(origin="state", name="Contact", **options)


def _plot(entity: str, name: str, time_range: rr.TimeRange, top: float, legend: bool = False) -> rrb.View:
    return rrb.TimeSeriesView(
        origin=entity,
        name=name,
        axis_x=rrb.TimeAxis(view_range=time_range),
        axis_y=rrb.ScalarAxis(range=(0.0, top)),
        plot_legend=rrb.PlotLegend(rrb.Corner2D.LeftTop, visible=legend),
    )
