"""What was found out about files: `Guess` of the whole, `Proposal` of one column."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from pmabench.base.kind import Imported
from pmabench.store.formats.record import Layout
from pmabench.store.records import Array

STILL = 3e-4
"""A length is held that moves by less than this [m]."""
METRES = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "um": 1e-6, "in": 0.0254}


@dataclass
class Proposal:
    """What one column seems to be."""

    name: str
    values: Array
    role: str = "ignore"
    unit: str = ""
    """As pmabench spells it; empty where it is not known."""
    reasons: list[str] = field(default_factory=list)
    doubts: list[str] = field(default_factory=list)
    mixed: str = ""
    """Name of a file in which it holds whole numbers while it does not in others; empty where all are alike."""
    elsewhere: float = 0.0
    """The highest value in other files of the same layout."""
    middles: list[float] = field(default_factory=list)
    """The median in each of these."""
    question: str = ""
    """What is asked about its role, where the choice is open."""
    written: str = "number"
    """How a time is written, as the map says it; empty where it may be days or a plain number."""
    order: str = ""
    """Order of day and month in its dates, where the year comes last; `??` where the file leaves it open."""
    period: float = 0.0
    """Distance of the samples [s] that a time counts; 0 where the file does not give it."""
    bare: bool = False
    """Nothing but its numbers shows what it is: the file gives no name, or one for all columns of a matrix."""
    factor: str = ""
    """What its heading multiplies the unit by, as it is written: `x10`, `/10`."""
    strange: str = ""
    """What is written in place of a unit that is not known."""
    extra: dict[str, str] = field(default_factory=dict)
    """Further entries of the map that are known of it."""

    @property
    def good(self) -> Array:
        """Values without those that are none."""
        return self.values[np.isfinite(self.values)]

    @property
    def apart(self) -> bool:
        """Whether it is a length that is another one in another file of the layout."""
        middles = [*self.middles, *([float(np.median(self.good))] if len(self.good) else [])]
        return len(middles) > 1 and float(np.ptp(middles)) > STILL / METRES.get(self.unit, 1e-3)


@dataclass
class Guess:
    """What was found; `columns` in the order of the file."""

    files: list[Path]
    layout: Layout
    columns: list[Proposal]
    optional: list[str]
    """Names of columns that some of the files lack."""
    left_out: list[str]
    kinds: Mapping[str, Imported]
    """What each kind of test needs of a file, by its name."""
    kind: str = ""
    trials: dict[str, str] = field(default_factory=dict)
    """Lines of `trials`, as text."""
    smallest_of: str = "pressure_command"
    """Role whose unit `smallest` of `trials` has."""
    forms: list[str] = field(default_factory=list)
    form_of: str = "file"
    form_units: dict[str, str] = field(default_factory=dict)
    form_comma: bool = False
    form_asked: dict[str, str] = field(default_factory=dict)
    """Key of a form -> why it is asked whether a number in the names is that."""
    rate: tuple[float, float] = (1.0, 1000.0)
    gap: float = 1.0
    reasons: dict[str, list[str]] = field(default_factory=dict)
    """`file`, `sampling`, `trials`, `name_tells` -> why."""
    doubts: list[str] = field(default_factory=list)
    known: str = ""
    """Name of a shipped map that takes these files as they are."""
    frequency: float = 0.0
    """Of a command that is one sine [Hz], to the resolution of its spectrum."""
    either: str = ""
    """A number whose comma may be the decimal sign or group digits."""
    lacks: str = ""
    """A channel without which nothing can be fitted, and that was not found."""
    constant: bool = False
    """The pressure was not recorded: it is that of the operating point."""
    tests: list[str] = field(default_factory=list)
    """Names of several tests in each file, in their order."""
    slower: tuple[float, float] = (1.0, 1.0)
    """Least and largest step of the clocks of the tests, against that of the test that is shown."""
    period: float = 0.0
    """Distance of the samples that a header gives [s]; 0 where none does."""
    seconds: Array | None = None
    """Time of each row [s], where a time was found."""
    exported: bool = False
    """The record of an exported run answers what else would be asked."""
    simulated: bool = False
    specimen: dict[str, str] = field(default_factory=dict)
    """Where a file gives it."""

    @property
    def test(self) -> Imported:
        """What the kind that is proposed needs of a file."""
        return self.kinds.get(self.kind, Imported())

    def open_point(self, name: str) -> bool:
        """Whether a coordinate is needed of each file, and no name of a file or folder gives it."""
        return name in self.test.point and not any(f"{{{name}}}" in form for form in self.forms)

    def role(self, role: str) -> Proposal | None:
        """The column with a role, where there is one."""
        return next((column for column in self.columns if column.role == role), None)
