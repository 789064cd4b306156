"""What a kind of test is: the record `KIND` of each folder below `pmabench.kinds`, or of another package.

Parts are named as "module:name" and loaded where they are used, so that naming a kind imports no numerics. `Imported`
holds what the importer of foreign files needs.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from importlib import import_module
from typing import Any


@dataclass(frozen=True)
class Commanded:
    """How the commands of a trial, and its operating point, are found in the columns of a file."""

    output: str
    """What is commanded: `pressure` or `displacement`. Without a column of commands the measured channel is used."""
    phases: tuple[tuple[str, str], ...] = ()
    """Kind of change -> name of the phase that begins with it; the first that fits. Kinds: `CHANGES` in
    `store.importers.commands`.
    """
    point: tuple[tuple[str, str], ...] = ()
    """Coordinate of the operating point -> how it is measured, in `COORDINATES` there."""
    ramps: bool = False
    """Every change is a ramp, however short."""
    sine: bool = False
    """The command is a sine; it makes one phase of that name."""
    still: bool = False
    """A trial without any change also has an operating point."""


@dataclass(frozen=True)
class Imported:
    """What a kind of test, or of recording, needs from a file of another program."""

    commanded: Commanded | None = None
    """None: no commands are looked for in a file."""
    recording: bool = False
    """Recorded for this reduction alone: commands and operating points come from the `cut` of the map."""
    follows: str = ""
    """Channel that rises with the pressure: `force` if the length is set from outside, else `displacement`."""
    point: tuple[str, ...] = ()
    """Coordinates with one value per file; measured if neither map nor file name gives them."""
    held: bool = False
    """The muscle is held at one length throughout a file."""
    loaded: bool = False
    """Each trial hangs from a load; its weight is measured by the load cell if no column gives it."""
    lifted: bool = False
    """A load leaves its support and is set down; these moments are searched for."""
    timed: bool = False
    """Times of displacement and pressure are compared: a displacement before the pressure is reported."""
    shown: str = ""
    """Signs in a file by which `import --guess` proposes this kind: `signs` in `store.importers.guess.signs`."""


@dataclass(frozen=True)
class Result:
    """A coefficient that a kind of test determines: symbol, title, unit, whether it is a headline."""

    symbol: str
    """Symbol of the field: F_ce, K, B_c."""
    title: str
    """Name in words: `stiffness`. The same title in two kinds of test means the same coefficient."""
    quantity: str
    """Key of `QUANTITIES` for the unit; empty if none fits, then `unit` is used."""
    headline: bool = False
    """Whether it is a key result, shown on the terminal and on the first page of a report."""
    plot: str = ""
    """Title of a plot shared with other coefficients of the same title; if empty, it has its own plot."""
    unit: str = ""
    """SI unit if no quantity is declared."""
    positive: bool = False
    """Whether it cannot be negative, so that its interval ends at 0; terms of its curves may be negative."""


@dataclass(frozen=True)
class Kind:
    """One kind of test, or another way to reduce its runs."""

    name: str
    """Name in protocol files and run folders: `static-load`."""
    title: str
    """Name as a heading: `Static load`."""
    results: tuple[Result, ...]
    """Its coefficients, in the order of columns and figures."""
    reduction: str
    """`module:reduce`: (runs, options) -> Analysis."""
    order: int = 1000
    """Position among the kinds in reports and lists."""
    papers: tuple[str, ...] = ()
    """Sources of its procedure."""
    protocol: str = ""
    """`module:Class` of its protocol file; empty if it is only imported, or reduces the runs of another kind."""
    live: str = ""
    """`module:measure`: (run, trial, expected, quick) -> result of a single trial, for the display.

    `pmabench.kinds.reduce:of_one_trial` takes the key numbers of its reduction.
    """
    moves: str = ""
    """Channel that changes in each of its trials, unless nothing moved."""
    repeated: str = ""
    """`module:function`: (run, trial) -> the value for comparing repeats; None or `NotUsable` without one."""
    repeated_is: str = ""
    """Name of that value: `stiffness`."""
    drifts: str = ""
    """Channel to whose scale its values are proportional, if the reduction does not itself weigh a change of it."""
    regulated: bool = True
    """Whether the pressure comes to a constant command, and its reduction does not itself weigh the difference."""
    word: str = ""
    """Its name in a comparison of tests, `sine`; the same for two reductions of the same runs."""
    offers: str = ""
    """`module:offers`: Analysis -> its `Offer` of each quantity that other kinds of test also measure."""
    after: str = ""
    """`module:options`: offers of the specimen's other tests -> options of this reduction, which runs after them."""
    reverses: bool = False
    """Whether it examines small reversals of the motion."""
    instead: str = ""
    """Advice to run it if other tests contradict each other on F_ce, F or K."""
    figures: dict[str, str] = field(default_factory=dict)
    """Kind of trace -> `module:function` that draws such traces: (traces, analysis) -> pictures."""
    front: dict[str, str] = field(default_factory=dict)
    """Kind of trace that may be drawn on the first page -> `module:function`, as in `figures`."""
    published: dict[str, tuple[str, str, str]] = field(default_factory=dict)
    """Kind of trace over which published points can be drawn -> its axes, and the marks common to all its points."""
    options: tuple[str, ...] = ()
    """Options of its reduction for users."""
    parts: dict[str, str] = field(default_factory=dict)
    """Parts for certain commands, as "module:name": `tune by steps`, `tune by model`.

    `next trial`: chooses the trials of a plan one by one, `Chooser(plan, expected, goals, seconds).decide(runs)`.

    `slow rows`: (run, trial, rate) -> rows of pressure, contraction and force for a form of all tests, or why there are
    none. `form of all tests`: this kind is such a form, whose reduction takes the runs of all others with slow rows.
    """
    methods: dict[str, str] = field(default_factory=dict)
    """Method of its reduction -> what it does, in a sentence or two."""
    imported: Imported | None = None
    """Its needs from a file of another program; None if such files cannot be of this kind."""
    loop: bool = False
    """It controls on calibrated values: a run does not show what it would have done with another calibration."""
    also: tuple[Kind, ...] = ()
    """Other reductions of its runs, with their own results."""

    def part(self, what: str) -> Any:
        """Load the object that a field names as "module:name"; raises AttributeError or ImportError."""
        return load(getattr(self, what))


def load(target: str) -> Any:
    """Load the object named "module:name"."""
    module, _, name = target.partition(":")
    return getattr(import_module(module), name)
