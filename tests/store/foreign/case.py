"""One foreign file with what is true in it, and the clean test that all of them begin with.

A muscle is held at 5 mm of contraction, filled to 600 kPa, held and exhausted, in 30 s at 100 Hz. Its force is
2.30 N/kPa times the pressure, so that the slope does not depend on which samples are fitted.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
RATE = 100.0
ROWS = 3000
SLOPE = 2.30
"""[N/kPa]"""
CONTRACTION = 5e-3
"""[m]"""
NAME = "contraction5mm_test1.csv"


@dataclass(frozen=True)
class Measured:
    """What was measured: seconds from its first row, kPa gauge, N."""

    t: Array
    P: Array
    F: Array


@dataclass(frozen=True)
class Case:
    """Files that are read in one call, and what a right importer makes of them.

    Right is one of: every sample that is used has its true value; or what is wrong is reported by `process`, and no
    value that it makes wrong is accepted; or it is refused or asked about. A report, refusal or question names the
    matter: it fits `words`.
    """

    name: str
    group: str
    files: dict[str, bytes]
    words: str
    """Regular expression, without regard to upper and lower case."""
    truth: tuple[Measured, ...]
    """The tests in the files, in order."""
    damaged: bool = False
    """Some samples are wrong in the file itself: leaving them out without a word is not right."""
    clock: float = 2e-3
    """How far a time may be from the truth [s]."""
    must: bool = False
    """It is in a form that is too common to be refused; a question is as good as reading it."""
    known: str = ""
    """Why it fails today; empty where it does not."""


def clean(seed: int = 1, rows: int = ROWS) -> Measured:
    """Fill, hold and exhaust, with noise of 0.3 kPa and 0.4 N."""
    chance = np.random.default_rng(seed)
    t = np.arange(rows) / RATE
    share = t / t[-1]
    P = np.interp(share, [0, 0.05, 0.4, 0.6, 0.93, 1], [5, 5, 600, 600, 5, 5])
    F = SLOPE * P
    return Measured(t, P + 0.3 * chance.standard_normal(rows), F + 0.4 * chance.standard_normal(rows))


def lines(columns: Sequence[Iterable[str]], delimiter: str = ",") -> list[str]:
    """Rows of a table of texts."""
    return [delimiter.join(row) for row in zip(*columns, strict=True)]


def fixed(values: Iterable[float], digits: int = 2) -> list[str]:
    """Numbers as a logger prints them."""
    return [f"{value:.{digits}f}" for value in values]


def commas(values: Iterable[float], digits: int = 2) -> list[str]:
    """The same with a decimal comma."""
    return [text.replace(".", ",") for text in fixed(values, digits)]


def text(header: Sequence[str], rows: Sequence[str], end: str = "\n") -> bytes:
    """A text file in UTF-8."""
    return end.join([*header, *rows, ""]).encode()


HEADER = "time (s),pressure (kPa),force (N)"


def plain(t: Array, P: Array, F: Array, header: str = HEADER) -> bytes:
    """The layout that needs no thought: comma, point, a header with units."""
    return text([header], lines([fixed(t), fixed(P), fixed(F)]))
