"""What is found wrong in a file: one record for each finding, and the report that gathers them with their flags."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmabench.store.importers.map_rules import ColumnRule
from pmabench.store.records import Array, Flag, Flags

Bools = NDArray[np.bool_]


@dataclass(frozen=True)
class Found:
    """One finding: how many samples, the first of them, and a sentence."""

    level: str
    """`note`, `doubt` or `fault`."""
    kind: str
    text: str
    channel: str = ""
    count: int = 0
    index: int | None = None
    """Row of the first sample, from 0."""
    t: float | None = None
    """Its time stamp [s]."""
    effect: float | None = None
    """Change of the slope over pressure by these samples [1]; None where it was not measured."""
    withholds: bool = False
    """No rule can set it right: what rests on the file is withheld until the map answers it."""


@dataclass(frozen=True)
class Checked:
    """One channel: raw readings and SI values, both of shape (n,), and its rule."""

    rule: ColumnRule
    raw: Array
    si: Array


@dataclass
class Report:
    """Flags and findings while they are gathered; `t` [s] and `flags` have shape (n,)."""

    t: Array
    flags: Flags
    found: list[Found] = field(default_factory=list)
    rows: dict[int, NDArray[np.intp]] = field(default_factory=dict)
    """Place in `found` -> rows that it flags."""

    def mark(self, where: Bools, flag: Flag, level: str, kind: str, text: str, channel: str = "") -> None:
        """Flag samples and report them; nothing happens where there are none."""
        rows = np.flatnonzero(where)
        if len(rows) == 0:
            return
        self.flags[rows] |= np.uint16(flag)
        first = int(rows[0])
        samples = f"{len(rows)} sample" + ("s" if len(rows) > 1 else "")
        named = f"{channel}: {text}" if channel else text
        sentence = f"{named}; {samples}, first at {self.t[first]:.3f} s (row {first + 1})"
        self.rows[len(self.found)] = rows
        self.found.append(Found(level, kind, sentence, channel, len(rows), first, float(self.t[first])))

    def add(self, level: str, kind: str, text: str, channel: str = "", index: int | None = None) -> None:
        """Report what flags no sample; `index` is the row where it begins."""
        named = f"{channel}: {text}" if channel else text
        if index is None:
            self.found.append(Found(level, kind, named, channel))
        else:
            at = float(self.t[index])
            self.found.append(Found(level, kind, f"{named}; from {at:.3f} s (row {index + 1})", channel, 1, index, at))

    def withhold(self, kind: str, text: str, channel: str = "", index: int | None = None) -> None:
        """Report a fault that no rule can set right."""
        self.add("fault", kind, text, channel, index)
        self.found[-1] = replace(self.found[-1], withholds=True)

    def with_effect(self, place: int, effect: float, text: str) -> None:
        """Add what the samples of a finding change to it."""
        self.found[place] = replace(self.found[place], effect=effect, text=f"{self.found[place].text}; {text}")


def plain(found: Found) -> dict[str, Any]:
    """A finding as the manifest keeps it."""
    return asdict(found)
