"""Files of the sequence of contacts of a recording: a plan, and the graph of contacts."""

from pathlib import Path

from contact_tracker.outputs.outcome import Outcome
from contact_tracker.sequences.graph import ContactGraph
from contact_tracker.sequences.plan import Plan


def write_plan(outcome: Outcome, path: Path, _: str) -> None:
    """Write the recording as a plan (TOML)."""
    path.write_text(Plan.of(outcome).toml, encoding="utf-8")


def write_graph(outcome: Outcome, path: Path, _: str) -> None:
    """Write the graph of the recording's contacts (GraphML)."""
    path.write_text(ContactGraph.of(outcome).graphml, encoding="utf-8")
