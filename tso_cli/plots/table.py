"""Tables of text and numbers for the terminal."""

from __future__ import annotations

import math
from collections.abc import Sequence
from numbers import Real

Cell = str | float | int | None


def text_table(
    header: Sequence[str],
    rows: Sequence[Sequence[Cell]],
    decimals: int = 3,
    rule_before_last: bool = False,
) -> str:
    """A table with columns two spaces apart, text to the left, numbers to the right.

    It has no final newline. A float has ``decimals`` decimals, or 3 digits if it is small; None and
    NaN are a dash. ``rule_before_last`` puts a line above the last row.
    """
    texts = [[_text(cell, decimals) for cell in row] for row in rows]
    widths = [max(map(len, column)) for column in zip(header, *texts, strict=True)]
    right = [
        any(isinstance(row[i], Real) for row in rows)
        and not any(isinstance(row[i], str) for row in rows)
        for i in range(len(header))
    ]
    rule = ["-" * width for width in widths]
    lines = [list(header), rule, *texts]
    if rule_before_last and rows:
        lines.insert(-1, rule)

    def aligned(line: Sequence[str]) -> str:
        cells = zip(line, widths, right, strict=True)
        return "  ".join(
            cell.rjust(width) if number else cell.ljust(width) for cell, width, number in cells
        ).rstrip()

    return "\n".join(map(aligned, lines))


def _text(cell: Cell, decimals: int) -> str:
    if cell is None or (isinstance(cell, float) and math.isnan(cell)):
        return "-"
    if isinstance(cell, str):
        return cell
    if isinstance(cell, Real) and not hasattr(cell, "__index__"):
        # With fixed decimals a small number would read 0.000.
        small = cell != 0 and abs(float(cell)) < 10.0 ** (1 - decimals)
        return f"{float(cell):.3g}" if small else f"{float(cell):.{decimals}f}"
    return str(cell)
