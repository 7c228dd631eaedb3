"""Trackers whose ticks and noise are adapted to the stream: multiple-model estimation (docs/theory.md)."""

from contact_tracker.adaptation.offline import OfflineTracker, segment
from contact_tracker.adaptation.online import AdaptiveState, advance, finish, start, step, take
from contact_tracker.adaptation.report import Report, report

__all__ = [
    "AdaptiveState",
    "OfflineTracker",
    "Report",
    "advance",
    "finish",
    "report",
    "segment",
    "start",
    "step",
    "take",
]
