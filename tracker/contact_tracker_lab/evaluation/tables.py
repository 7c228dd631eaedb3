"""Plain aligned text tables."""

from collections.abc import Sequence


def table(header: Sequence[str], rows: Sequence[Sequence[str]], left: int = 1) -> str:
    """Align columns, the first ``left`` ones to the left, others to the right; no trailing newline.

    A row of one cell is a title of the rows below it, as wide as it is.
    """
    lines = [tuple(header), *map(tuple, rows)]
    columns = zip(*(line for line in lines if len(line) > 1), strict=True)
    widths = [max(map(len, column)) for column in columns]
    return "\n".join(
        "  ".join(
            cell.ljust(width) if i < left else cell.rjust(width)
            for i, (cell, width) in enumerate(zip(line, widths, strict=len(line) > 1))
        ).rstrip()
        for line in lines
    )


def number(value: float, decimals: int = 3) -> str:
    """Fixed decimals; ``-`` where there is no value."""
    return f"{value:.{decimals}f}" if value == value else "-"
