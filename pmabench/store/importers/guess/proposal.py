"""Data of a guess: `Guess` for the files, `Proposal` for one column."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from pmabench.base.kind import Imported
from pmabench.store.formats.record import Layout
from pmabench.store.records import Array

STILL = 3e-4
"""Largest range of a length that counts as held [m]."""
METRES = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "um": 1e-6, "in": 0.0254}


@dataclass
class Proposal:
    """Probable meaning of one column."""

    name: str
    values: Array
    role: str = "ignore"
    unit: str = ""
    """Unit in pmabench's spelling; empty where unknown."""
    reasons: list[str] = field(default_factory=list)
    doubts: list[str] = field(default_factory=list)
    mixed: str = ""
    """A file in which it has whole numbers although not in others; empty where all files are alike."""
    elsewhere: float = 0.0
    """Highest absolute value in other files of the same layout."""
    middles: list[float] = field(default_factory=list)
    """Its median in each of the other files."""
    question: str = ""
    """Question about its role or unit, where the choice is open; else empty."""
    written: str = "number"
    """How a time is written, as in a map; empty where it may be days or a plain number."""
    order: str = ""
    """Order of day and month in dates whose year comes last; `??` where the file does not show it."""
    period: float = 0.0
    """Sampling period [s] of a column that counts samples; 0 where the file does not give it."""
    bare: bool = False
    """Whether the file gives it no name, or one for all columns of a matrix."""
    factor: str = ""
    """Factor of the unit in its heading, as written: `x10`, `/10`; empty for none."""
    strange: str = ""
    """Text in place of a unit that is not recognised."""
    extra: dict[str, str] = field(default_factory=dict)
    """Further known entries for the map."""

    @property
    def good(self) -> Array:
        """The finite values."""
        return self.values[np.isfinite(self.values)]

    @property
    def whole(self) -> bool:
        """Whether it has whole numbers only, and more than 12 different ones."""
        good = self.good
        return len(good) > 0 and bool(np.all(good == np.round(good))) and len(np.unique(good)) > 12

    @property
    def apart(self) -> bool:
        """Whether it is a length with different medians in different files."""
        middles = [*self.middles, *([float(np.median(self.good))] if len(self.good) else [])]
        return len(middles) > 1 and float(np.ptp(middles)) > STILL / METRES.get(self.unit, 1e-3)


@dataclass
class Guess:
    """All that was found; `columns` in the order of the file."""

    files: list[Path]
    layout: Layout
    columns: list[Proposal]
    optional: list[str]
    """Names of columns that some of the files lack."""
    left_out: list[str]
    kinds: Mapping[str, Imported]
    """Kind of test -> what it needs from a file."""
    kind: str = ""
    trials: dict[str, str] = field(default_factory=dict)
    """Entries of the map's `trials`, as text."""
    smallest_of: str = "pressure_command"
    """Role of the channel in whose unit `smallest` of `trials` is given."""
    forms: list[str] = field(default_factory=list)
    form_of: str = "file"
    form_units: dict[str, str] = field(default_factory=dict)
    form_comma: bool = False
    form_asked: dict[str, str] = field(default_factory=dict)
    """Key of a form -> reason to ask whether a number in the names has this meaning."""
    rate: tuple[float, float] = (1.0, 1000.0)
    gap: float = 1.0
    reasons: dict[str, list[str]] = field(default_factory=dict)
    """Part of the map (`file`, `sampling`, `trials`, `name_tells`) -> reasons."""
    doubts: list[str] = field(default_factory=list)
    known: str = ""
    """Name of a shipped map that fits these files; empty for none."""
    frequency: float = 0.0
    """Frequency of a command that is a single sine [Hz], with the resolution of its spectrum; else 0."""
    either: str = ""
    """Example of a number whose comma may be decimal or thousands sign; else empty."""
    lacks: str = ""
    """A channel that is needed for a fit and was not found; empty for none."""
    constant: bool = False
    """Whether the pressure was not recorded and is taken from the operating point."""
    tests: list[str] = field(default_factory=list)
    """Names of the tests in each file, in order, if there are several."""
    slower: tuple[float, float] = (1.0, 1.0)
    """Smallest and largest sampling period of the tests, relative to that of the test that is shown."""
    period: float = 0.0
    """Sampling period from a header [s]; 0 where none gives it."""
    seconds: Array | None = None
    """Time of each row [s], shape (n,); None where no time was found."""

    @property
    def test(self) -> Imported:
        """What the proposed kind of test needs from a file."""
        return self.kinds.get(self.kind, Imported())

    def open_point(self, name: str) -> bool:
        """Whether the test needs a coordinate that no name of a file or folder gives."""
        return name in self.test.point and not any(f"{{{name}}}" in form for form in self.forms)

    def role(self, role: str) -> Proposal | None:
        """The column with a role; None without one."""
        return next((column for column in self.columns if column.role == role), None)
