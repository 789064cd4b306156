"""Effect of a departure from the assumed form on a value: a line of its budget, or a reason to withhold it.

A significant departure shifts the value one way: its effect is added to the half width linearly. One that the data
only do not exclude adds as a square. Reasons are in decision 0019.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import hypot, inf, isfinite, sqrt

import numpy as np

from pmabench.analysis.shared import student
from pmabench.analysis.shared.samples import step_of
from pmabench.base.quantities import show
from pmabench.store.analyses.results import Estimate, Finding, Parts, Source, is_below_0, withhold
from pmabench.store.records import Array, RunData, TrialData

MOST_HIDDEN = 0.02
"""Default share of a value above which a significant departure withholds it."""
NEGLIGIBLE = 0.05
"""Share of a half width below which an effect is left out of the budget."""
OFF = 0.02
"""Share of a set pressure by which the measured one may be off it without a doubt; intervals hold it anyway."""
STEEPER = 1.5
"""Factor by which a value may change more with the pressure than to the nearest other pressure."""
GUESSED = 2.0
"""Factor on value over pressure where one pressure was tested: a muscle has force only above some pressure."""
SURE = 0.9995
"""Probability of Student's t above which a change from cycle to cycle is significant."""
NAMES = {
    "repeats": "scatter of repeats",
    "method": "method",
    "calibration": "calibration",
    "skew": "time between the streams",
    "drift": "drift",
}


@dataclass(frozen=True)
class Doubt:
    """The effect of one departure on one value."""

    name: str
    """Name of the line in the budget."""
    part: str
    """Field of `Parts` to which it is added."""
    half: float
    """Effect on the value at the largest size that the data allow [as the value]."""
    seen: bool
    """Whether the departure is significant."""
    reason: str = ""
    """Note with which the value is withheld where the effect is too large: what was found, how large, what to do."""
    most: float = MOST_HIDDEN
    """Share of the value above which a significant departure withholds it."""


def weighed(e: Estimate, doubts: Iterable[Doubt], scale: float | None = None) -> Estimate:
    """The estimate with the effects of `doubts` in its interval and budget, or withheld.

    Effects are compared with `scale` [as the value] in place of a value that can be near 0.
    """
    if e.value is None:
        return e
    known = sorted(doubts, key=lambda one: one.half, reverse=True)
    size = abs(e.value) if scale is None else scale
    worst = next((one for one in known if one.seen and one.reason and one.half > one.most * size), None)
    if worst is not None:
        limit = f"{100 * worst.most:.2g} %" if scale is None else show(worst.most * size, e.quantity, 2)
        return withhold(e, f"{worst.reason} (an effect above {limit} is not left to an interval)")
    before = e.parts.combined or 0.0
    known = [one for one in known if one.half > NEGLIGIBLE * before]
    rest = hypot(before, *(one.half for one in known if not one.seen))
    more = more_than_squares([one.half for one in known if one.seen], rest)
    lines = [Source(one.name, one.part, "B", one.half * (more if one.seen else 1.0)) for one in known]
    if not lines:
        return e
    halves = vars(e.parts) | {
        part: hypot(getattr(e.parts, part) or 0.0, *(line.half or 0.0 for line in lines if line.part == part))
        for part in {line.part for line in lines}
    }
    named = ((part, half) for part, half in vars(e.parts).items() if half)
    base = e.budget or [Source(NAMES[part], part, "A" if part == "repeats" else "B", half) for part, half in named]
    budget = sorted((*base, *lines), key=lambda line: line.half or 0.0, reverse=True)
    return replace(e, parts=Parts(**halves), budget=tuple(budget))


def off_command(off: float, pressure: float, value: float, over_P: float | None) -> float:
    """Possible error of a value that is given for a set `pressure` from which the measured one is `off` [Pa].

    `over_P` is its derivative by pressure [per Pa]; where that is unknown, a multiple of value over pressure.
    """
    if not isfinite(off) or pressure <= 0:
        return 0.0
    return abs(off) * (STEEPER * abs(over_P) if over_P is not None else GUESSED * abs(value) / pressure)


def off_command_findings(where: str, off: float, pressure: float) -> list[Finding]:
    """A doubt where a measured pressure [Pa] is `off` a set one by more than `OFF` of it."""
    if not abs(off) > OFF * pressure > 0:
        return []
    text = (
        f"at {where} the pressure is measured {show(abs(off), 'pressure', 2)} {'above' if off > 0 else 'below'} the "
        "command: the regulator or the gauge is off. Values are given for the command, and their intervals hold either"
    )
    return [Finding("doubt", text)]


def more_than_squares(shifts: Sequence[float], rest: float) -> float:
    """Factor on `shifts` so that their squares and `rest` squared sum to the square of `rest` plus all shifts.

    Shifts add linearly to a half width, while budgets add lines as squares.
    """
    total, squares = sum(shifts), sum(shift**2 for shift in shifts)
    return sqrt((total**2 + 2 * total * rest) / squares) if squares else 1.0


@dataclass(frozen=True)
class Change:
    """Absolute change of a value from the first cycle to the last [as the value]."""

    size: float
    """Best estimate."""
    most: float
    """Upper end of the 95 % interval."""
    seen: bool


def change_over(cycles: Sequence[Array]) -> Change | None:
    """Change of values by cycle, one array per trial, from a common slope; None without three cycles in a trial."""
    rows = [(np.arange(len(one)) - 0.5 * (len(one) - 1), one - one.mean()) for one in cycles if len(one) > 2]
    if not rows:
        return None
    place, off = (np.concatenate(column) for column in zip(*rows, strict=True))
    freedom = len(off) - len(rows) - 1
    power = float(place @ place)
    slope = float(place @ off) / power
    error = float(np.sqrt(np.sum((off - slope * place) ** 2) / freedom / power))
    count, size = max(len(one) for one in cycles), abs(slope)
    most = (size + float(student.ppf(0.975, freedom)) * error) * count
    return Change(size * count, most, size > float(student.ppf(SURE, freedom)) * error)


def force_from_cycle_to_cycle(cycles: Sequence[Array]) -> list[Doubt]:
    """Doubt about a change of force from the first cycle to the last [N]; empty where not significant."""
    change = change_over(cycles)
    if change is None or not change.seen:
        return []
    text = f"from cycle to cycle the force changes, by {show(change.size, 'force', 2)} in all: the cell drifts, or the"
    reason = f"{text} muscle is not at rest yet. Do more cycles before those that count, and check the zero of the cell"
    return [Doubt("change from cycle to cycle", "drift", change.most, seen=True, reason=reason)]


CUT_OFF = "half a step of the channels, where a converter cuts off"


def half_steps(pairs: Iterable[tuple[RunData, TrialData]], channels: Iterable[str]) -> dict[str, float]:
    """Channel -> half its quantisation step [SI]: a converter that truncates reads too low by that on average.

    Channels with a declared offset uncertainty are left out: they were calibrated through their converter.
    """
    found: dict[str, float] = {}
    for run, trial in pairs:
        for name in channels:
            info = run.channels.get(name)
            if name in trial.channels and (info is None or not info.offset_uncertainty):
                step = step_of(trial.channels[name][trial.usable])
                found[name] = max(found.get(name, 0.0), 0.5 * step if step < inf else 0.0)
    return found


def cut_off(half: Mapping[str, float], changes: Mapping[str, float]) -> Doubt:
    """Doubt from `half_steps` about a value with the derivatives `changes` by the channels."""
    return Doubt(CUT_OFF, "method", hypot(*(half.get(name, 0.0) * change for name, change in changes.items())), False)


OF_THE_LOOP = ("F_c", "H", "W", "W_c", "eta", "phi")
"""Symbols that depend on the gap between both branches."""


def without_negative_friction(estimates: Sequence[Estimate]) -> list[Estimate]:
    """The estimates; those of `OF_THE_LOOP` are withheld in cells whose F_c is below 0 by more than its interval."""
    found = [e for e in estimates if e.symbol == "F_c" and is_below_0(e)]

    def judged(e: Estimate) -> Estimate:
        why = next((one for one in found if e.symbol in OF_THE_LOOP and one.at.items() <= e.at.items()), None)
        if why is None or e.value is None:
            return e
        size = f"{show(why.value or 0.0, 'force', 3)} +- {show(why.parts.combined or 0.0, 'force', 2)}"
        return withhold(e, f"F_c is {size} here, and {NARROWED}")

    return [judged(e) for e in estimates]


NARROWED = (
    "friction is never below 0: something narrows the loop, as a force cell does that has hysteresis or is pulled at "
    "through a mount with friction. Load and unload the cell with the same weights, and compare what it reads"
)
