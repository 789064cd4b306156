"""The line of a finished trial: measured and expected values, `ok` or the reasons to doubt.

A trial is evaluated by the functions of its kind of test that `process` uses, without intervals, and compared with the
specimen file's prediction and with earlier repeats. Draws nothing.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from math import isfinite, sqrt
from pathlib import Path

import numpy as np

from pmabench.analysis.shared.samples import never, not_moved
from pmabench.analysis.trial import Expected, Found, Measured, Quick
from pmabench.base.errors import InvalidFile
from pmabench.base.quantities import show
from pmabench.kinds import registry
from pmabench.store.records import UNUSABLE, Flag, RunData, TrialData


def read_expected(folder: Path) -> Expected | None:
    """`expected` of the specimen file of a run; None if it is missing or cannot be read."""
    from pmabench.bench.files.specimen import SpecimenFile
    from pmabench.files.document import read_document, validate

    try:
        expected = validate(SpecimenFile, read_document(folder / "specimen.yaml")).expected
    except InvalidFile:
        return None
    if expected is None:
        return None
    points = sorted(expected.points, key=lambda point: point.pressure)
    columns = {name: np.array([getattr(p, name) for p in points]) for name in ("pressure", "F_ce", "K", "B_c", "B_r")}
    return Expected(source=expected.source, F_c=expected.F_c, **columns)


FAR = 0.10
"""Relative deviation from the prediction, or from fewer than three repeats, above which a value is doubted."""
SPREADS = 3.0
"""The same for three or more repeats, in standard deviations ..."""
LEAST = 0.01
"""... if that is more than this relative deviation."""
USED = ("finished", "failed")
"""Only trials with these statuses have numbers."""
REACHED = (0.02, 3e3)
"""Tolerance for reaching a pressure: fraction of the command, and at least this value [Pa]."""
BEGIN = 0.2
"""Time at the begin of a trial in which a pressure that was set before it is looked at [s]."""


@dataclass(frozen=True)
class Number:
    """One quantity of a trial and its reference [SI]."""

    symbol: str
    quantity: str
    value: float | None
    reference: float | None = None
    reference_is: str = ""
    """`expected` (from the specimen file) or `repeats` (their mean); empty without a reference."""
    assumed: bool = False
    """Whether it depends on the specimen file: with one load alone K and F_ce cannot be separated."""
    half: float | None = None
    """Half width of the 95 % interval, from the scatter of trials alone."""

    @property
    def off(self) -> float | None:
        """Relative deviation from the reference; None without one."""
        if self.value is None or not self.reference:
            return None
        return self.value / self.reference - 1.0


@dataclass(frozen=True)
class TrialLine:
    """The verdict on one trial, with its numbers and doubts."""

    index: int
    point: dict[str, float]
    repeat: int
    status: str
    numbers: tuple[Number, ...]
    doubts: tuple[str, ...]
    again: bool = False
    """A reference trial that was repeated because the run continues another one; not a trial of the plan."""

    @property
    def number(self) -> int:
        """Number of the trial, from 1."""
        return self.index + 1

    @property
    def ok(self) -> bool:
        """Whether there is no doubt about the trial."""
        return not self.doubts

    @property
    def mark(self) -> str:
        """`ok`; `? ` with a doubt; a dash if it gave no number, as expected."""
        nothing = bool(self.numbers) and all(number.value is None for number in self.numbers)
        return "? " if self.doubts else "– " if nothing else "ok"

    @property
    def ended(self) -> bool:
        """Whether the trial was completed."""
        return self.status in USED

    def replaces(self, earlier: TrialLine) -> bool:
        """Whether this line replaces an earlier one; a repeat that did not finish does not."""
        return earlier.index == self.index and (self.status == "finished" or earlier.status != "finished")


@dataclass
class Verdicts:
    """Judges the trials of one run, one after the other."""

    expected: Expected | None = None
    _quick: Quick = field(default_factory=Quick)
    _earlier: dict[tuple[tuple[str, float], ...], dict[int, dict[str, float]]] = field(default_factory=dict)
    """Operating point -> trial -> its numbers."""

    def judge(self, run: RunData, trial: TrialData, at_limit: Sequence[str] = ()) -> TrialLine:
        """The line of a trial; `at_limit` are the reasons of its `limit-reached` events."""
        doubts = [] if trial.status == "finished" else [f"the trial is {trial.status}"]
        doubts += at_limit
        doubts += _flagged(trial)
        numbers = tuple(self._numbers(run, trial, doubts)) if trial.status in USED else ()
        point = dict(trial.point)
        return TrialLine(trial.index, point, trial.repeat, trial.status, numbers, tuple(doubts), trial.again)

    def _numbers(self, run: RunData, trial: TrialData, doubts: list[str]) -> Iterator[Number]:
        """Quantities of a completed trial; appends to `doubts`."""
        try:
            measured, reasons = measure(run, trial, self.expected, self._quick)
        except (ValueError, KeyError, IndexError, TypeError, ZeroDivisionError, np.linalg.LinAlgError) as error:
            measured, reasons = [], [f"its numbers cannot be computed ({error})"]
        doubts += [reason for reason in reasons if reason not in doubts]
        kind = registry.find(run.kind)
        if kind and not_moved(kind.moves, trial, self.expected.holds if self.expected is not None else never):
            doubts.append(f"{kind.moves} changed by less than its noise: nothing moved")
        doubts += _not_reached(trial)
        key = tuple(sorted((name, round(value, 6)) for name, value in trial.point.items()))
        before = self._earlier.setdefault(key, {})
        if trial.status == "finished":
            before.pop(trial.index, None)  # it is being repeated
        for item in measured:
            number, doubt = _compare(item, [seen[item.symbol] for seen in before.values() if item.symbol in seen])
            yield number
            if doubt:
                doubts.append(doubt)
        if trial.status == "finished":
            kept = {m.symbol: m.value for m in measured if m.value is not None and not m.pooled and isfinite(m.value)}
            before[trial.index] = kept


def _compare(item: Measured, earlier: list[float]) -> tuple[Number, str]:
    """A number with its reference, and a doubt if it deviates too much; repeats have priority over a prediction."""
    value, reference, source = item.value, item.expected, "expected" if item.expected is not None else ""
    doubt = ""
    if earlier and not item.pooled:
        mean = sum(earlier) / len(earlier)
        allowed = FAR * abs(mean)
        if len(earlier) >= 3:
            spread = sqrt(sum((v - mean) ** 2 for v in earlier) / (len(earlier) - 1))
            allowed = max(SPREADS * spread, LEAST * abs(mean))
        if value is not None and abs(value - mean) > max(allowed, item.noise):
            doubt = f"{item.symbol} {_away(value, mean)} its repeats ({show(mean, item.quantity, 3)})"
        if reference is None:
            reference, source = mean, "repeats"
    elif value is not None and reference is not None and not item.assumed:
        far = abs(value - reference) > max(FAR * abs(reference), item.tolerance)
        doubt = (
            "" if not far else f"{item.symbol} {_away(value, reference)} expected ({show(reference, item.quantity, 3)})"
        )
    return Number(item.symbol, item.quantity, value, reference, source, item.assumed, item.half), doubt


def _away(value: float, reference: float) -> str:
    if not reference:
        return "not"
    off = value / reference - 1.0
    return f"{abs(off):.0%} {'above' if value > reference else 'below'}"


def _flagged(trial: TrialData) -> list[str]:
    """Number of samples that fits exclude, with their flags."""
    bad = trial.flags & np.uint16(UNUSABLE)
    if not bad.any():
        return []
    names = [str(flag.name) for flag in Flag if flag and flag & UNUSABLE and (bad & np.uint16(flag)).any()]
    return [f"{int(np.count_nonzero(bad))} of {len(bad)} samples flagged {', '.join(names)}"]


def _not_reached(trial: TrialData) -> list[str]:
    """A sentence if the measured pressure did not reach its command before the next one, or was off it at the begin."""
    if "pressure" not in trial.channels or not len(trial.t):
        return []
    commands = [c for c in trial.commands if c.output == "pressure"]
    if not commands and (held := trial.point.get("pressure")):
        first = (trial.t < trial.t[0] + BEGIN) & trial.usable
        return _off(float(trial.channels["pressure"][first].mean()), held, "held") if first.any() else []
    ends = [*(c.t for c in commands[1:]), float(trial.t[-1])]
    for command, end in zip(commands, ends, strict=False):
        if command.kind != "set" or end - command.t < 0.5 or command.phase == "vent":
            continue
        late = (trial.t > end - max(0.1, 0.05 * (end - command.t))) & (trial.t < end - 1e-9) & trial.usable
        if not late.any():
            continue
        if said := _off(float(trial.channels["pressure"][late].mean()), command.value, command.phase):
            return said
    return []


def _off(measured: float, asked: float, phase: str) -> list[str]:
    """A sentence if a measured pressure [Pa] is off the commanded one."""
    if abs(measured - asked) <= max(REACHED[0] * abs(asked), REACHED[1]):
        return []
    return [f"pressure not reached: {show(measured, 'pressure', 4)} of {show(asked, 'pressure', 4)} ({phase})"]


def prepare(name: str) -> None:
    """Import the modules of a kind in advance, which takes a second: keys must not be delayed at the first trial."""
    kind = registry.find(name)
    if kind and kind.live:
        kind.part("live")
        if kind.live.startswith("pmabench.kinds.reduce:"):  # it evaluates a trial by the reduction
            kind.part("reduction")


def measure(run: RunData, trial: TrialData, expected: Expected | None, quick: Quick) -> Found:
    """Quantities and doubts of a trial from its samples; none for kinds of test without live quantities."""
    kind = registry.find(run.kind)
    if kind is None or not kind.live:
        return [], []
    found: Found = kind.part("live")(run, trial, expected, quick)
    return found
