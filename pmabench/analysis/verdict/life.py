"""Life of one specimen: cycles, time at pressure, changes of coefficients, control charts of reference trials.

Individuals chart (Shewhart; ISO 7870-2) of daily means: trials of a day share mounting, zeros and temperature. Limits
are at least 2.66 = 3 / d2 times the mean moving range from the mean of the first values (d2 = 1.128 for ranges of two).
They are wider for few first values and for many later ones (Student's t of a prediction, Bonferroni). Eight values or
more in a row on one side of the centre, beyond its uncertainty, are a shift. At most about one in twenty charts of an
unchanged muscle has an alarm.

A pressure cycle is one rise of the commanded pressure from 50 kPa or less to 100 kPa or more; of several muscles the
one with most cycles counts. Cycles of a closed loop between two commands (ultimate gain, positioning) are not
commanded and not counted, but its time is.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import hypot, inf, isfinite, sqrt
from typing import Any

import numpy as np
from scipy.stats import linregress, studentized_range
from scipy.stats import t as student

from pmabench.analysis.shared.samples import step_of
from pmabench.analysis.shared.trials import Point, grouped, six_digits, stroke_of
from pmabench.analysis.verdict.comparison import Difference, named, percent
from pmabench.base.kind import Result
from pmabench.base.quantities import in_words, show
from pmabench.store.analyses.results import POINT_QUANTITIES, Analysis, Estimate, Finding, Parts
from pmabench.store.records import Event, RunData, is_number

FACTOR = 2.66
CHANCE = 0.05
"""Largest share of charts of an unchanged specimen with a value beyond the limits."""
TREND = 0.01
"""Significance level of a trend: largest share of unchanged series that show one."""
LEAST = 1e-4
"""Relative change below which nothing counts: no bench repeats a stroke better over days."""
KNOWN = 1.5
"""Standard deviations of the centre within which a value counts for neither side."""
FEWEST = 5
"""Fewest values for limits."""
FIRST = 12
"""Most first values from which limits are computed; later values are judged by these."""
NORMAL = 1.959964
"""Standard deviations within which 95 % of a normal distribution lie."""
CHANGED = "the muscle changed, or the sensor or its mounting"
"""Possible causes of a change over the runs of a life."""
ROW = 8
"""Values in a row on one side of the centre that count as a shift, and one more ..."""
LONGER = 40
"""... for every so many values, in which chance makes longer rows."""


@dataclass(frozen=True)
class Chart:
    """Control limits from the first `base` values, and the values beyond them."""

    values: tuple[float, ...]
    centre: float
    low: float
    high: float
    base: int
    beyond: tuple[int, ...]
    """Indices of values outside the limits."""
    shifted: int | None
    """Index at which the first row on one side is complete; None without one."""

    @property
    def first_alarm(self) -> int | None:
        """Index of the first value beyond the limits or completing a row; None without one."""
        return min([*self.beyond[:1], *([] if self.shifted is None else [self.shifted])], default=None)


def chart(values: Sequence[float], floor: float = 0.0) -> Chart | None:
    """Control chart of values in order of time, shape (n,); None with fewer than `FEWEST`.

    `floor`: possible error of a value by quantisation [as the values].
    """
    if len(values) < FEWEST:
        return None
    v = np.asarray(values, dtype=np.float64)
    first = v[:FIRST]
    base, centre = len(first), float(first.mean())
    floor = max(floor, LEAST * abs(centre))
    sigma = max(FACTOR / 3.0 * float(np.abs(np.diff(first)).mean()), float(first.std(ddof=1)))
    each = CHANCE / max(1, len(v) - base)
    predicted = float(student.ppf(1.0 - each / 2.0, base - 1)) * sqrt(1.0 + 1.0 / base)
    reach = max(floor, max(3.0, predicted) * sigma)
    beyond = tuple(int(i) for i in np.flatnonzero(np.abs(v - centre) > reach))
    sides = np.where(np.abs(v - centre) > max(floor, KNOWN * sigma / sqrt(base)), np.sign(v - centre), 0.0)
    side, row, shifted = 0.0, 0, None
    for place, way in enumerate(sides):
        row = row + 1 if way == side and way != 0 else 1
        side = float(way)
        if row >= ROW + len(v) // LONGER and shifted is None and way != 0:
            shifted = place
    return Chart(tuple(float(x) for x in v), centre, centre - reach, centre + reach, base, beyond, shifted)


def trend(values: Sequence[float], floor: float = 0.0) -> tuple[float, float] | None:
    """Change from first to last value by a straight line, and its 95 % half width; None where it is not significant.

    A change within `floor` counts as none. The significance is from the scatter about the line, which a constant error
    of calibration does not affect.
    """
    v = np.asarray(values, dtype=np.float64)
    if len(v) < FEWEST or not np.ptp(v):
        return None
    line, far = linregress(np.arange(len(v)), v), len(v) - 1
    if line.pvalue > TREND or abs(line.slope) * far <= max(floor, LEAST * abs(float(v.mean()))):
        return None
    return far * float(line.slope), far * float(line.stderr * student.ppf(0.975, len(v) - 2))


LOW, HIGH = 50e3, 100e3
"""A cycle is a rise of the commanded pressure from the first or less to the second or more [Pa]."""
SYMBOLS = ("K", "F_ce", "m", "W", "H", "B_c", "B_r", "B", "F_c", "leak")
"""Symbols that are tracked over a life, in this order."""
SELF_TEST = "self-test"
"""Kind and method of the result of a session's self-test."""
LEAK = Result("leak", "fall of the pressure behind the shut valve", "pressure rate", headline=True)
"""Result of the self-test."""


@dataclass(frozen=True)
class Use:
    """Use of the specimen in one run."""

    cycles: int = 0
    strokes: float = 0.0
    """Cycles of a driven end: those of sines, and half the number of ramps."""
    at_pressure: float = 0.0
    """Time with a commanded pressure above `LOW` [s], with ramps taken into account."""
    highest: float = 0.0
    """[Pa]"""
    led: float = 0.0
    """Time in which a closed loop changed the pressure [s]; it is counted with the command before."""


LED = 1e3
"""Difference between the last command and the pressure at the next one above which a closed loop was active [Pa]."""


@dataclass(frozen=True)
class _Aim:
    """A command for the pressure of a muscle at a time [s]."""

    t: float
    value: float
    """[Pa]"""
    rate: float = inf
    """[Pa/s]"""
    before: float | None = None
    """Pressure commanded before [Pa]; None where that is not recorded."""


def use_of(events: Sequence[Event]) -> Use:
    """Cycles, strokes and time at pressure of a run from its commands; of several muscles the largest of each.

    A vent counts as a command to 0.
    """
    strokes, muscles = 0.0, dict[str, list[_Aim]]()
    for event in events:
        data = event.data
        output, value = data.get("output"), data.get("value")
        if event.kind == "command" and output == "displacement":
            turns = data.get("cycles")
            sine = data.get("type") == "sine" and isinstance(turns, int | float)
            strokes += float(turns) if sine and turns is not None else 0.5 * (data.get("type") == "ramp")
        elif event.kind == "command" and str(output).startswith("pressure") and is_number(value):
            ramp = data.get("type") == "ramp" and is_number(data.get("rate"))
            before = float(data["before"]) if is_number(data.get("before")) else None
            aim = _Aim(event.t, float(value), abs(float(data["rate"])) if ramp else inf, before)
            muscles.setdefault(str(output), []).append(aim)
        elif event.kind == "steered":
            for name, aims in _steered(data).items():
                muscles.setdefault(name, []).extend(aims)
        elif event.kind in ("vent", "end"):
            for aims in muscles.values():
                aims.append(_Aim(event.t, 0.0))
    each = [_of_muscle(aims, events[-1].t) for aims in muscles.values()]
    most = {
        name: max(getattr(use, name) for use in each) for name in ("cycles", "at_pressure", "highest", "led") if each
    }
    return Use(strokes=strokes, **most)


def _steered(data: Mapping[str, Any]) -> dict[str, list[_Aim]]:
    """Muscle -> pressures sent by a control law, from rows whose first column is the time [s]."""
    names, rows = data.get("columns", ()), data.get("aims", ())
    return {
        name: [_Aim(float(row[0]), float(row[place])) for row in rows]
        for place, name in enumerate(names) if str(name).startswith("pressure")
    }  # fmt: skip


def _of_muscle(aims: Sequence[_Aim], end: float) -> Use:
    """Use of one muscle until `end` [s].

    A ramp that is interrupted ends at the pressure at which the next command begins.
    """
    cycles, time, highest, led, emptied, pressure = 0, 0.0, 0.0, 0.0, True, 0.0
    for aim, after in zip(aims, [*aims[1:], _Aim(end, 0.0)], strict=True):
        over = max(0.0, after.t - aim.t)
        begin = pressure if aim.before is None else aim.before
        pressure = aim.value
        if isfinite(aim.rate):
            reach = aim.rate * over
            pressure = min(max(aim.value, begin - reach), begin + reach)
            if after.before is not None and min(begin, pressure) <= after.before <= max(begin, pressure):
                pressure = after.before
        led += over if after.before is not None and abs(after.before - pressure) > LED else 0.0
        time += _above(begin, pressure, aim.rate, over)
        highest = max(highest, pressure, after.before or 0.0)
        if pressure <= LOW:
            emptied = True
        elif pressure >= HIGH and emptied:
            cycles, emptied = cycles + 1, False
    return Use(cycles, 0.0, time, highest, led)


def _above(begin: float, end: float, rate: float, over: float) -> float:
    """Time above `LOW` [s] within `over` [s], for a ramp from `begin` to `end` [Pa] at `rate` [Pa/s] and a hold."""
    if end > LOW:
        return over - min(over, max(0.0, LOW - begin) / rate)
    return min(over, max(0.0, begin - LOW) / rate)


@dataclass(frozen=True)
class Past:
    """One run of the specimen."""

    run: str
    date: str
    """Start, UTC, ISO 8601."""
    kind: str
    bench: str
    status: str
    simulated: bool
    use: Use
    before: int
    """Pressure cycles before it, from the specimen file and from earlier runs."""


def pasts(rows: Iterable[tuple[str, str, str, str, str, bool, int, Use]]) -> list[Past]:
    """Runs in order of time, from rows (id, date, kind, bench, status, simulated, cycles by the specimen file, use).

    The number in the specimen file counts where it exceeds that of earlier runs: the muscle was used elsewhere.
    """
    found: list[Past] = []
    counted = 0
    for run, date, kind, bench, status, simulated, given, use in sorted(rows, key=lambda row: (row[1], row[0])):
        counted = max(counted, given)
        found.append(Past(run, date, kind, bench, status, simulated, use, counted))
        counted += use.cycles
    return found


@dataclass(frozen=True)
class Moment:
    """A value at one time of the life."""

    date: str
    cycles: int
    estimate: Estimate
    run: str


@dataclass(frozen=True)
class Series:
    """One coefficient at one operating point by one method, in order of time."""

    kind: str
    moments: tuple[Moment, ...]
    name: str
    """Title given by its kind of test; else its symbol."""

    @property
    def first(self) -> Estimate:
        """The first value."""
        return self.moments[0].estimate

    @property
    def values(self) -> list[float]:
        """All values [SI]."""
        return [moment.estimate.value or 0.0 for moment in self.moments]

    @property
    def change(self) -> Difference:
        """The last value against the first."""
        last = self.moments[-1].estimate
        halves = [half for e in (last, self.first) if (half := e.parts.combined) is not None]
        return Difference(self.kind, last, self.first, hypot(*halves) if len(halves) == 2 else None)

    @property
    def title(self) -> str:
        """`K at 300 kPa`."""
        return named(self.change)


def series_of(analyses: Iterable[Analysis], life: Sequence[Past]) -> list[Series]:
    """Values of `SYMBOLS` over the life, each by the first method that gives it in a kind of test.

    An analysis has the date of its first run; of several analyses of the same runs the last one counts. The fact `leak`
    of an analysis, a share [1], is included as a symbol.
    """
    place = {past.run: past for past in life}
    latest = {(analysis.kind, tuple(sorted(analysis.runs))): analysis for analysis in analyses}
    found: dict[tuple[object, ...], list[Moment]] = {}
    names: dict[tuple[object, ...], str] = {}
    for analysis in latest.values():
        names |= {(analysis.kind, result.symbol): result.title for result in analysis.results}
        runs = [place[run] for run in analysis.runs if run in place]
        if not runs:
            continue
        past = min(runs, key=lambda run: (run.date, run.run))
        leak = analysis.facts.get("leak")
        lost = [Estimate("leak", float(leak), "1", "ratio", analysis.kind)] if is_number(leak) else []
        methods: dict[str, str] = {}
        for e in (*analysis.estimates, *lost):
            if e.symbol not in SYMBOLS or e.coordinate not in ("", "slope"):
                continue
            if methods.setdefault(e.symbol, e.method) == e.method and e.value is not None:
                key = (analysis.kind, e.symbol, e.coordinate, e.method, six_digits(e.at, "mass"))
                found.setdefault(key, []).append(Moment(past.date, past.before, e, past.run))
    made = [
        Series(str(key[0]), tuple(sorted(moments, key=lambda m: (m.date, m.run))), names.get(key[:2], str(key[1])))
        for key, moments in found.items()
    ]
    return sorted(made, key=lambda s: SYMBOLS.index(s.first.symbol))


def leak_of(run: str, events: Sequence[Event], *, simulated: bool) -> Analysis | None:
    """Leak with the isolation valve shut, from the self-test of a session, as an analysis; None without it.

    The value is the fall of the pressure of muscle, hoses and fittings [Pa/s], its half width that from noise alone.
    """
    for event in reversed(events):
        leak = event.data.get("leak") if event.kind == "self-test" else None
        if not isinstance(leak, Mapping):
            continue
        known = {name: float(value) for name, value in leak.items() if is_number(value) and isfinite(value)}
        if "pressure" in known and "falls" in known:
            at, parts = {"pressure": known["pressure"]}, Parts(repeats=known.get("half_width"))
            leak = Estimate("leak", known["falls"], "Pa/s", "pressure rate", SELF_TEST, at, parts, 1)
            return Analysis(SELF_TEST, (run,), simulated, (leak,), results=(LEAK,))
    return None


def chosen(series: Sequence[Series]) -> list[Series]:
    """One series per symbol and kind: that with most values, the middle one of several."""
    picked = []
    for group in grouped(series, lambda one: (one.kind, one.first.symbol)).values():
        most = max(len(one.moments) for one in group)
        longest = sorted((one for one in group if len(one.moments) == most), key=lambda s: sorted(s.first.at.items()))
        picked.append(longest[(len(longest) - 1) // 2])
    return picked


@dataclass(frozen=True)
class References:
    """Strokes of the reference trial at one operating point, in order of time."""

    point: Point
    moments: tuple[tuple[str, int, float, str], ...]
    """Date, cycles before the run, stroke [m], trial."""
    step: float = 0.0
    """Quantisation step of the displacement [m]; 0 for none."""

    @property
    def title(self) -> str:
        """`reference trial at load 157 N, pressure 300 kPa`."""
        places = (f"{name} {show(v, POINT_QUANTITIES[name], 4)}" for name, v in self.point if name in POINT_QUANTITIES)
        return f"reference trial at {', '.join(places)}"

    @property
    def days(self) -> list[tuple[str, int, float, str]]:
        """One moment per day: the first of the day, with the mean stroke of all."""
        days = grouped(self.moments, lambda moment: moment[0][:10]).values()
        return [(*day[0][:2], float(np.mean([stroke for _, _, stroke, _ in day])), day[0][3]) for day in days]

    @property
    def chart(self) -> Chart | None:
        """Control chart of the daily means; None with too few days."""
        return chart([stroke for _, _, stroke, _ in self.days], 1.01 * self.step)


def references_of(runs: Iterable[RunData], life: Sequence[Past]) -> list[References]:
    """Reference trials of all runs by operating point, including repeated ones.

    Only one run is in memory at a time where `runs` loads them one by one.
    """
    place = {past.run: past for past in life}
    found: dict[Point, list[tuple[str, int, float, str]]] = {}
    steps: dict[Point, float] = {}
    for run in runs:
        past = place[run.id]
        for trial in run.trials:
            used = trial.reference and trial.status == "finished"
            if used and (stroke := stroke_of(run, trial)) is not None:
                point = six_digits(trial.point, "mass")
                found.setdefault(point, []).append((past.date, past.before, stroke, trial.name))
                step = step_of(trial.channels["displacement"][trial.usable])
                steps[point] = max(steps.get(point, 0.0), step if isfinite(step) else 0.0)
    return [
        References(point, tuple(sorted(moments, key=lambda m: m[0])), steps[point]) for point, moments in found.items()
    ]


def findings(life: Sequence[Past], series: Sequence[Series], references: Sequence[References]) -> Iterator[Finding]:
    """Findings on the use of the specimen, changes of coefficients, and reference trials."""
    last = life[-1]
    total, time = last.before + last.use.cycles, sum(past.use.at_pressure for past in life)
    text = f"{len(life)} runs from {life[0].date[:10]} to {last.date[:10]}: {total:,} pressure cycles, "
    highest = max(past.use.highest for past in life)
    elsewhere = total - sum(past.use.cycles for past in life)
    own = f" ({elsewhere:,} of them before these runs or outside of them, by the specimen file)" if elsewhere else ""
    yield Finding("note", f"{text}{in_words(time)} at pressure, at most {show(highest, 'pressure', 4)}{own}")
    if silent := sum(past.use.highest == 0 for past in life):
        what = "commands no pressure" if silent == 1 else "command no pressure"
        yield Finding("note", f"{silent} of them {what}: what was done to the muscle there (imports) is not counted")
    if led := sum(past.use.led for past in life):
        text = f"for {in_words(led)} a closed loop led the pressure, counted as if it had stayed as commanded before"
        yield Finding("note", text)
    yield from (_change(one) for one in series if len(one.moments) > 1)
    yield from map(_reference, references)


def _change(one: Series) -> Finding:
    change = one.change
    cycles = one.moments[-1].cycles - one.moments[0].cycles
    over = f"{_size(change)} over {cycles:,} cycles, {len(one.moments)} values"
    between = "; ".join(filter(None, (_furthest(one), _steadily(one.values, one.first.quantity))))
    level = "doubt" if between or change.agrees is False else "note"
    between = between and f"; {between}: {CHANGED}"
    if change.score is None:
        return Finding(level, f"{one.title}: {over}; it has no interval, so this may be chance{between}")
    relation = "within their interval" if change.agrees else "more than their interval"
    text = f"{one.title}: {over}, last against first {relation} (E_n {change.score:+.2f})"
    return Finding(level, f"{text}{between}")


def _size(change: Difference) -> str:
    if change.relative is not None:
        return f"{percent(change.relative)} %"
    return show(change.value, change.a.quantity, 3)


def _furthest(one: Series) -> str:
    """Text on the two values with the largest E_n, where that is significant for the number of values; else empty.

    The limit is the 95 % quantile of the studentized range of n values, scaled so that it is E_n = 1 for two.
    """
    known = [m for m in one.moments if m.estimate.value is not None and m.estimate.parts.combined]
    if len(known) < 3:
        return ""
    value, half = np.array([(m.estimate.value, m.estimate.parts.combined) for m in known], dtype=np.float64).T
    score = np.abs(value[:, None] - value) / np.hypot(half[:, None], half)
    ends = [known[int(place)] for place in np.unravel_index(int(np.argmax(score)), score.shape)]
    before, after = sorted(ends, key=lambda m: (m.date, m.run))
    apart = replace(one, moments=(before, after)).change
    allowed = float(studentized_range.ppf(1.0 - CHANCE, len(known), inf)) / (NORMAL * sqrt(2.0))
    if apart.score is None or abs(apart.score) <= allowed:
        return ""
    dates = f"{before.date[:10]} to {after.date[:10]}"
    return f"from {dates} {_size(apart)}, more than the intervals of {len(known)} values (E_n {apart.score:+.2f})"


def _steadily(values: Sequence[float], quantity: str, floor: float = 0.0) -> str:
    """Text on a significant trend; empty without one."""
    if (found := trend(values, floor)) is None:
        return ""
    change, half = found
    way = "rises" if change > 0 else "falls"
    size, known = show(abs(change), quantity, 3), show(half, quantity, 2)
    share = f" ({percent(change / abs(values[0]))} %)" if values[0] else ""
    return f"it {way} steadily, by {size}{share} +- {known} over these values, which is more than their scatter"


def _reference(one: References) -> Finding:
    limits, values = one.chart, [stroke for _, _, stroke, _ in one.moments]
    ends = f"{show(values[0], 'length', 4)} at first, {show(values[-1], 'length', 4)} at last"
    text = f"{one.title}: {len(values)} times, {ends}"
    if limits is None:
        return Finding("note", f"{text}; too few days for control limits: {len(one.days)}")
    if (alarm := limits.first_alarm) is None:
        steadily = _steadily(limits.values, "length", 1.5 * one.step)  # a line through a step of 1 changes by 1.5
        if steadily:
            return Finding("doubt", f"{text}; all within the control limits, but {steadily}: {CHANGED}")
        return Finding("note", f"{text}; all within the control limits")
    date, cycles, _, trial = one.days[alarm]
    what = f"{len(limits.beyond)} beyond the control limits" if limits.beyond else "a row on one side of the centre"
    when = f"first on {date[:10]} after {cycles:,} cycles ({trial})"
    by_chance = "of charts of an unchanged muscle about 1 in 20 says so"
    return Finding("doubt", f"{text}; {what}, {when}: {CHANGED}; {by_chance}")
