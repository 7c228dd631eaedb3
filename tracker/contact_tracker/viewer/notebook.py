"""The viewer in a notebook (extra ``notebook``)."""

import os
from typing import Final

# Read when rerun_notebook is imported: otherwise the viewer's page is loaded from a server of rerun.
os.environ.setdefault("RERUN_NOTEBOOK_ASSET", "inline")

import rerun as rr
import rerun.blueprint as rrb
import rerun_notebook
from rerun.notebook import Viewer

from contact_tracker.viewer.offline import Shown, show

__all__ = ["Viewer", "show_in_notebook"]
WIDTH: Final = 1280
HEIGHT: Final = 720
_ = rerun_notebook  # raises here if it is missing: rerun itself imports without it


def show_in_notebook(shown: Shown, width: int = WIDTH, height: int = HEIGHT) -> Viewer:
    """A widget that shows the whole recording, with the size given in pixels."""
    viewers: list[Viewer] = []

    def sink(recording: rr.RecordingStream, blueprint: rrb.Blueprint | None) -> None:
        viewers.append(Viewer(width=width, height=height, recording=recording, blueprint=blueprint))

    show(shown, sink)
    return viewers[0]
