"""What a guess found out about files that were never seen, while it is gathered."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from pmabench.base.imported import Imported
from pmabench.store.formats.record import Layout
from pmabench.store.importers.guess.columns import Proposal
from pmabench.store.records import Array


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
