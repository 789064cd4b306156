"""Which columns of a MATLAB file were sampled together: each matrix and each struct may have its own clock."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import numpy as np

from pmabench.store.records import Array

EVEN = 5.0
"""Steps of a clock are no longer than so many usual ones."""
STILL = 0.05
"""A matrix whose channels move by less than this share of those of the others is a record of their zeros."""
_MATRIX = re.compile(r"(.+)\(:,(\d+)\)")


def matrix_of(name: str) -> str:
    """The matrix that a column belongs to; empty where it is a vector."""
    match = _MATRIX.fullmatch(name)
    return match[1] if match else ""


def is_clock(values: Array) -> bool:
    """Whether a column rises with every row, in steps of about the same size."""
    if len(values) < 10 or not np.isfinite(values).all():
        return False
    steps = np.diff(values)
    return bool(steps.min() > 0 and steps.max() < EVEN * float(np.median(steps)))


def together(columns: Mapping[str, Array]) -> dict[str, str]:
    """The matrix or struct that each column shares a clock with; empty where it is the file as a whole."""
    clocks = {(place, len(columns[name])) for name in columns if is_clock(columns[name]) for place in _places(name)[:1]}
    return {
        name: next((place for place in _places(name) if (place, len(values)) in clocks), "")
        for name, values in columns.items()
    }


def _places(name: str) -> list[str]:
    """The matrix of a column and the structs around it, from the inside: `a.b(:,1)` -> `a.b`, `a`, and the file."""
    places = [matrix_of(name)] if matrix_of(name) else []
    inside = matrix_of(name) or name
    while "." in inside:
        inside = inside.rpartition(".")[0]
        places.append(inside)
    return [*places, ""]


def alike(columns: Mapping[str, Array], owners: Mapping[str, str]) -> tuple[list[str], list[str]]:
    """Matrices of equally many columns that have clocks, as the tests of a file; and those that only hold zeros."""
    widths: dict[str, int] = {}
    for name, owner in owners.items():
        if owner and matrix_of(name) == owner:
            widths[owner] = widths.get(owner, 0) + 1
    if not widths:
        return [], []
    usual = max(set(widths.values()), key=lambda width: (list(widths.values()).count(width), width))
    tests = [owner for owner, width in widths.items() if width == usual]
    zeros = _zeros(columns, tests, usual) if len(tests) > 1 else []
    return [test for test in tests if test not in zeros], zeros


def _zeros(columns: Mapping[str, Array], tests: Sequence[str], width: int) -> list[str]:
    spans = np.array([[_span(columns[f"{test}(:,{k + 1})"]) for k in range(width)] for test in tests])
    clocks = [all(is_clock(columns[f"{test}(:,{k + 1})"]) for test in tests) for k in range(width)]
    moving = spans[:, ~np.array(clocks)]
    if not moving.shape[1]:
        return []
    most = np.maximum(moving.max(axis=0), 1e-300)
    return [test for test, still in zip(tests, (moving < STILL * most).all(axis=1), strict=True) if still]


def _span(values: Array) -> float:
    good = values[np.isfinite(values)]
    return float(np.ptp(np.quantile(good, [0.01, 0.99]))) if len(good) else 0.0
