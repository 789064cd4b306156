"""Curves as text: braille with 2 x 4 dots a character; knows numbers, no units."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pmabench.store.records import Array

_DOTS = np.array([[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]], dtype=np.int64)


def curve(
    t: Array, y: Array, span: tuple[float, float], range_: tuple[float, float], size: tuple[int, int]
) -> list[str]:
    """Lines of text, from the top, of y over t (both of shape (n,)) inside a span of t and a range of y.

    `size` is columns and rows of characters. Between neighbouring dots the curve is joined; what is no number is left
    out, and what lies outside the range is drawn at its edge.
    """
    columns, rows = max(1, size[0]), max(1, size[1])
    grid = np.zeros((rows * 4, columns * 2), dtype=bool)
    good = np.isfinite(y) & np.isfinite(t) & (t >= span[0]) & (t <= span[1])
    if good.any() and span[1] > span[0] and range_[1] > range_[0]:
        x = ((t[good] - span[0]) / (span[1] - span[0]) * (columns * 2 - 1) + 0.5).astype(np.int64)
        up = np.clip((y[good] - range_[0]) / (range_[1] - range_[0]), 0.0, 1.0)
        row = ((1.0 - up) * (rows * 4 - 1) + 0.5).astype(np.int64)
        _draw(grid, x, row)
    cells = grid.reshape(rows, 4, columns, 2).transpose(0, 2, 1, 3)
    codes = 0x2800 + (cells * _DOTS).sum(axis=(2, 3))
    return ["".join(chr(code) if code > 0x2800 else " " for code in line) for line in codes.tolist()]


def _draw(grid: NDArray[np.bool_], x: NDArray[np.int64], row: NDArray[np.int64]) -> None:
    """Dots from lowest to highest of each column, joined to the column before."""
    order = np.argsort(x, kind="stable")
    x, row = x[order], row[order]
    starts = np.flatnonzero(np.diff(x, prepend=-1))
    tops, bottoms = np.minimum.reduceat(row, starts), np.maximum.reduceat(row, starts)
    last = np.concatenate((starts[1:], [len(x)])) - 1
    before: tuple[int, int] | None = None
    for column, top, bottom, end in zip(x[starts], tops, bottoms, row[last], strict=True):
        if before is not None and column - before[0] <= 2:
            top, bottom = min(top, before[1]), max(bottom, before[1])
        grid[top : bottom + 1, column] = True
        before = int(column), int(end)
