"""Plain aligned text tables."""

from collections.abc import Sequence


def table(header: Sequence[str], rows: Sequence[Sequence[str]], left: int = 1) -> str:
    """Align columns, the first ``left`` ones to the left, the others to the right; no trailing newline."""
    lines = [tuple(header), *map(tuple, rows)]
    widths = [max(len(cell) for cell in column) for column in zip(*lines, strict=True)]
    return "\n".join(
        "  ".join(
            cell.ljust(width) if i < left else cell.rjust(width)
            for i, (cell, width) in enumerate(zip(line, widths, strict=True))
        ).rstrip()
        for line in lines
    )


def number(value: float, decimals: int = 3) -> str:
    """Fixed decimals; ``-`` where there is no value."""
    return f"{value:.{decimals}f}" if value == value else "-"
