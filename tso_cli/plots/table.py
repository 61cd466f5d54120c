"""Rows of text and numbers -> an aligned table for a terminal."""

from __future__ import annotations

import math
from collections.abc import Sequence
from numbers import Real

Cell = str | float | int | None


def text_table(header: Sequence[str], rows: Sequence[Sequence[Cell]], decimals: int = 3, rule_before_last: bool = False) -> str:
    """Columns two spaces apart; text to the left, numbers to the right.

    Parameters
    ----------
    header : one title per column.
    rows : as many cells each. Floats show ``decimals`` decimals (more for small ones: never fewer than 3 digits), whole
        numbers all of theirs, None and NaN a dash.
    rule_before_last : set the last row, a mean or a sum, off by a line.

    Returns
    -------
    str
        Lines without trailing spaces and without a final newline.
    """
    texts = [[_text(cell, decimals) for cell in row] for row in rows]
    for row in texts:
        if len(row) != len(header):
            raise ValueError(f"a row has {len(row)} cells, expected {len(header)}")
    widths = [max(map(len, column)) for column in zip(header, *texts, strict=True)]
    right = [
        any(isinstance(row[i], Real) for row in rows) and not any(isinstance(row[i], str) for row in rows)
        for i in range(len(header))
    ]
    rule = ["-" * width for width in widths]
    lines = [list(header), rule, *texts]
    if rule_before_last and rows:
        lines.insert(len(lines) - 1, rule)
    return "\n".join(
        "  ".join(
            cell.rjust(width) if to_right else cell.ljust(width)
            for cell, width, to_right in zip(line, widths, right, strict=True)
        ).rstrip()
        for line in lines
    )


def _text(cell: Cell, decimals: int) -> str:
    if cell is None or (isinstance(cell, float) and math.isnan(cell)):
        return "-"
    if isinstance(cell, str):
        return cell
    if isinstance(cell, Real) and not hasattr(cell, "__index__"):
        plain = f"{float(cell):.{decimals}f}"
        # 0.000 would hide that a distance is not zero.
        return f"{float(cell):.3g}" if cell != 0 and abs(float(cell)) < 10.0 ** (1 - decimals) else plain
    return str(cell)
