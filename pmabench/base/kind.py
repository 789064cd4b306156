"""What a kind of test is: the record that each folder below `pmabench.kinds`, or another package, gives as `KIND`.

Parts are named as "module:name" and loaded where they are used, so that naming a kind imports no numerics. What the
importer of foreign files must know of a kind is `Imported`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from importlib import import_module
from typing import Any


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


@dataclass(frozen=True)
class Result:
    """A coefficient that a kind of test gives, as it is declared: symbol, title, unit, whether it is a headline."""

    symbol: str
    """As in the field: F_ce, K, B_c."""
    title: str
    """In words, as they follow `the`: `stiffness`. The same title in two kinds of test means the same coefficient."""
    quantity: str
    """Key of `QUANTITIES`, which has the unit; empty where none is the right one, and `unit` says it."""
    headline: bool = False
    """Whether it is a key number: on the terminal, and on the first page of a report."""
    plot: str = ""
    """Title of the plot that it shares with others of the same; where empty, it has a plot for itself."""
    unit: str = ""
    """SI unit where no quantity is declared."""
    positive: bool = False
    """Whether it cannot be below 0, so that its interval ends there; terms of its curves can be below."""


@dataclass(frozen=True)
class Kind:
    """One kind of test, or another way to reduce its runs."""

    name: str
    """As in protocol files and run folders: `static-load`."""
    title: str
    """As a heading: `Static load`."""
    results: tuple[Result, ...]
    """Its coefficients; columns and figures have their order."""
    reduction: str
    """`module:reduce`: (runs, options) -> Analysis."""
    order: int = 1000
    """Place among the kinds in reports and lists."""
    papers: tuple[str, ...] = ()
    """Where its procedure comes from."""
    protocol: str = ""
    """`module:Class` of its protocol file; empty where it is only imported, or another reduction of the same runs."""
    live: str = ""
    """`module:measure`: (run, trial, expected, quick) -> what one trial says by itself, for the display."""
    moves: str = ""
    """Channel that changes in each of its trials, unless nothing moved."""
    compares: str = ""
    """Channel in which the repeats of an operating point are compared over time."""
    repeated: str = ""
    """`module:function`: (run, trial) -> the value that repeats are checked by; None or `NotUsable` without one."""
    repeated_is: str = ""
    """What that value is: `stiffness`."""
    word: str = ""
    """Its name in a comparison of tests, `sine`; two reductions of the same runs have the same."""
    offers: str = ""
    """`module:offers`: Analysis -> its `Offer` of each quantity that other kinds of test measure, too."""
    after: str = ""
    """`module:options`: offers of the specimen's other tests -> options of this reduction, which is done after them."""
    reverses: bool = False
    """Whether it looks at small reversals of the motion."""
    at_rest: bool = False
    """Whether its F_ce is what limits against static load compare with."""
    instead: str = ""
    """The advice to run it where other tests contradict each other on F_ce, F or K."""
    figures: dict[str, str] = field(default_factory=dict)
    """Kind of trace -> `module:function` that draws traces of it: (traces, analysis) -> pictures."""
    front: dict[str, str] = field(default_factory=dict)
    """Kind of trace of which one may be drawn on the first page -> `module:function`, as in `figures`."""
    published: dict[str, tuple[str, str, str]] = field(default_factory=dict)
    """Kind of trace over which published points can be drawn -> its axes, and the marks that all its points share."""
    options: tuple[str, ...] = ()
    """Options of its reduction that a user can give."""
    parts: dict[str, str] = field(default_factory=dict)
    """What some commands look up, as "module:name": `check options`, `tune by steps`, `tune by model`.

    `next trial`: chooses the trials of a plan one by one, `Chooser(plan, expected, goals, seconds).decide(runs)`.

    `slow rows`: (run, trial, rate) -> rows of pressure, contraction and force for a form of all tests, or why there are
    none. `form of all tests`: this kind is such a form, whose reduction takes the runs of all others with slow rows.
    """
    methods: dict[str, str] = field(default_factory=dict)
    """Method of its reduction -> what it does, in a sentence or two."""
    imported: Imported | None = None
    """What it needs of a file of another program; None where such files cannot be of this kind."""
    loop: bool = False
    """Its loop acts on calibrated values: runs do not show what it would have done with another calibration."""
    also: tuple[Kind, ...] = ()
    """Other ways to reduce its runs, with results of their own."""

    def part(self, what: str) -> Any:
        """The object that a field of "module:name" names; AttributeError or ImportError where it is not there."""
        return load(getattr(self, what))


def load(target: str) -> Any:
    """The object named "module:name"."""
    module, _, name = target.partition(":")
    return getattr(import_module(module), name)
