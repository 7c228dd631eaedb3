"""Files of complete results, to load, plot, evaluate and export them later."""

from pathlib import Path
from typing import Any, Final

from contact_tracker.errors import ContactTrackerError, StateError
from contact_tracker.exports.columns import columns_of
from contact_tracker.motion.pose_validation import require_valid
from contact_tracker.outputs.outcome import Outcome
from contact_tracker.outputs.parts import known_parts
from contact_tracker.outputs.text import table
from contact_tracker.saved_state import Kind, classes_in, content_of, load

SUFFIX: Final = ".contacts"
"""Ending of their names."""
RESULT: Final = Kind("contact-tracker result", classes_in(Outcome), outlives_version=True)


def write_result(outcome: Outcome, path: Path, _: str) -> None:
    """Write a complete result."""
    path.write_bytes(content_of(Outcome(**vars(outcome)), RESULT))


def read_result(path: Path) -> Outcome:
    """The result in a file; no code in it is run. Raises StateError if the file is no result, is damaged, or
    was saved by a version whose results have other parts."""
    outcome = load(path, RESULT)
    try:
        _use(outcome)
    except ContactTrackerError as error:
        raise StateError(f"{path}: its poses are no poses: {error}") from error
    except Exception as error:  # its parts may be any values
        raise StateError(f"{path}: it is no saved result: name another file") from error
    assert isinstance(outcome, Outcome)
    return outcome


def _use(outcome: Any) -> None:
    """Use all parts of a result; raises any error if they do not fit each other."""
    if not isinstance(outcome, Outcome):
        raise TypeError("it is another value")
    require_valid(outcome.trajectory.poses, None)
    columns_of("ticks", outcome.beliefs), columns_of("segments", outcome.segments)
    texts = (*outcome.warnings, outcome.noise, outcome.trajectory.name, outcome.log or "")
    " ".join((*texts, *table(outcome.segments, outcome.origin_ns, outcome.with_wrenches)))
    known_parts(outcome), outcome.counts, [*outcome.segmentation.filtered]
    if outcome.labels is not None:
        outcome.labels.to_json()
    if outcome.touched is not None:
        _ = outcome.touched.learned
