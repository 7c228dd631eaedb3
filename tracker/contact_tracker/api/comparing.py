"""Two takes of one task compared, from Python."""

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

from contact_tracker.api.offline import Result, segment
from contact_tracker.errors import OutputError, UsageError
from contact_tracker.exports.columns import to_pandas
from contact_tracker.exports.formats import FIGURES, check_output
from contact_tracker.recording import parts_of
from contact_tracker.sequences import comparison
from contact_tracker.sequences.comparison import TOLERANCE, compare_outcomes
from contact_tracker.trajectory.arguments import (
    errors_as,
    number_from,
    path_from,
    warn_of,
    with_known_arguments,
)

if TYPE_CHECKING:
    import pandas

    from contact_tracker.exports.figure import Figure


class Comparison(comparison.Comparison):
    """Two takes, step by step, with what Python makes of them."""

    def to_pandas(self) -> "pandas.DataFrame":
        """A DataFrame of pandas with a row per step (docs/assembly.md); raises MissingExtra."""
        return to_pandas(self.columns, {**comparison.COLUMNS})

    def plot(self) -> "Figure":
        """A figure of matplotlib: both takes, with the alignment between them."""
        from contact_tracker.exports.sequence_figures import draw_comparison

        return draw_comparison(self)

    def save(self, path: str | os.PathLike[str], overwrite: bool = False) -> None:
        """Write a CSV with a row per step, or the figure, by the suffix.

        Raises
        ------
        UsageError
            Another suffix, or the existing file is a recording or one of the takes.
        OutputError
            The file cannot be written.
        """
        from contact_tracker.exports.sequence_figures import write_comparison

        name = Path(path_from(path))
        with errors_as(OutputError, str(name)):
            if name.suffix.lower() not in (".csv", *FIGURES):
                raise UsageError(f"cannot write {name}: its name must end in .csv, {', '.join(FIGURES)}")
            read = [part for take in self.takes if take.log is not None for part in parts_of(take.log)]
            write_comparison(self, name, check_output(name, overwrite, read, "overwrite=True"))


@with_known_arguments
def compare(first: Any, second: Any, tolerance: float = TOLERANCE) -> Comparison:
    """Align two takes of one task by contacts and places, as ``contact-tracker compare`` does.

    Parameters
    ----------
    first, second : results of ``segment``, or what it takes; of one object in one place.
    tolerance : share of the longer duration by which a step may differ.

    Raises
    ------
    InputError
        A trajectory cannot be used.
    UsageError
        An argument is invalid, or there are too many segments.

    Warns
    -----
    ContactTrackerWarning
        Places are not compared, as nothing that touched is where it was.
    """
    tolerance = number_from(tolerance, "tolerance", "between 0 and 1", lambda share: 0.0 < share < 1.0)
    one, other = (take if isinstance(take, Result) else segment(take) for take in (first, second))
    found = compare_outcomes(one, other, tolerance)
    warn_of(found.notes)
    return Comparison(**vars(found))
