"""What the importer of foreign files must know of a kind of test, as plain data; standard library only."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Commanded:
    """How the commands of a trial, and with them its operating point, are read off the columns of a file."""

    output: str
    """What is commanded: `pressure` or `displacement`. Without a column of commands the measured channel is taken."""
    phases: tuple[tuple[str, str], ...] = ()
    """Way of a change -> name of the phase that begins with it; the first way that fits. Ways: `CHANGES` in
    `store.importers.commands`.
    """
    point: tuple[tuple[str, str], ...] = ()
    """Coordinate of the operating point -> how it is measured: `COORDINATES` there."""
    ramps: bool = False
    """Every change is a ramp, however short."""
    sine: bool = False
    """The command is a sine; it makes one phase of that name."""
    still: bool = False
    """A trial in which nothing changes has an operating point, too."""


@dataclass(frozen=True)
class Imported:
    """What a kind of test, or of recording, needs of a file of another program."""

    commanded: Commanded | None = None
    """None: what a search or a loop commanded cannot be read off a file."""
    recording: bool = False
    """Recorded for this reduction alone: commands and operating points are those that the map's cut gives."""
    follows: str = ""
    """Channel that rises with the pressure: `force` where the length is set from outside, else `displacement`."""
    point: tuple[str, ...] = ()
    """Coordinates that each file has one value of; they are measured where neither map nor name gives them."""
    held: bool = False
    """The muscle is held at one length throughout a file."""
    loaded: bool = False
    """Each trial hangs from a load, whose weight the cell shows where no column gives it."""
    lifted: bool = False
    """A load leaves its support and is set down: where that happens is looked for."""
    timed: bool = False
    """Displacement is timed against pressure: one that moves before the pressure is reported."""
    shown: str = ""
    """What a file shows for which `import --guess` proposes this kind: `signs` in `store.importers.guess.signs`."""
