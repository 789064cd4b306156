"""Reduction of closed volumes: V over contraction at each start pressure, whether they agree, and V(eps) fitted to all.

One trial, the curve, and what the strokes leave open are in `stroke`. Also the figure, and with `one_trial` the values
of one trial for the display.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from math import degrees, hypot, isfinite
from typing import Any

import numpy as np

from pmabench.analysis.shared.calibration import Scales, sentences
from pmabench.analysis.shared.form import Doubt, weighed
from pmabench.analysis.shared.lines import mean_of_cycles
from pmabench.analysis.shared.samples import NotUsable, settings_of
from pmabench.analysis.shared.trials import Reduction, grouped
from pmabench.analysis.trial import Expected, Found, Measured, Quick
from pmabench.base.quantities import show
from pmabench.kinds.closed_volume import RESULTS
from pmabench.kinds.closed_volume.stroke import Gas, Stroke, fit_volume, measure, moved_by, spreads_of, volume_at
from pmabench.plotting.chart import PALETTE, Chart, Series
from pmabench.plotting.pictures import Picture, column, has, of_traces, spread, unit_of
from pmabench.store.analyses.results import Analysis, Estimate, Finding, Parts, Trace, withhold
from pmabench.store.records import Array, RunData, TrialData

KIND = "closed-volume"
TIGHT, PRINTED, CURVE = "closed, leak taken out", "closed, as printed", "closed, V(eps)"
LEAKS = 0.02
"""Share of the air lost over a trial from which on it is a doubt."""
LOST = "look for the leak, and whether the air or the room cools, or the gauge drifts"
NAMES = (("D_0", "length", "m"), ("theta_0", "angle", "rad"), ("alpha", "count", "1"))
NO_REPEATS = "no repeats part: one stroke"


def reduce(runs: Sequence[RunData], options: Mapping[str, Any] | None = None) -> Analysis:
    """V [m3] at pressures and contractions, with and without the leak, and D0 [m], theta0 [rad], alpha of V(eps).

    `options`: `atmosphere` [Pa absolute], `exponent`, `reference_volume`, `dead_volume` [m3] in place of the plan's.
    """
    settings = settings_of(runs[0], options) if runs else {}

    def stroke_of(run: RunData, trial: TrialData, asked: Mapping[str, Any]) -> Stroke:
        if settings_of(run, asked) != settings:
            raise NotUsable("its volumes, room or contractions are not those of the first run")
        if "pressure" not in trial.point:
            raise NotUsable("its point names no pressure")
        return measure(run, trial, settings)

    result = Reduction.of(KIND, RESULTS, runs, options, stroke_of)
    members, scales = result.measured, result.scales
    if not members:
        return result.analysis()
    gas, length = Gas.of(settings), float(settings["length"])
    cells = dict(result.cells(lambda stroke: round(stroke.trial.point["pressure"], 6)))
    estimates: list[Estimate] = []
    spreads = spreads_of(cells, gas)
    for pressure, group in cells.items():
        for leak, method in ((True, TIGHT), (False, PRINTED)):
            estimates += _volumes(pressure, group, settings, scales, method, leak=leak)
        result.findings.append(_leaks(pressure, group, gas))
    result.findings += _agree(estimates)
    estimates = [
        weighed(e, spreads[round(e.at["pressure"], 6)].doubts(e, n % len(members[0].x), leak=e.method == TIGHT))
        for n, e in enumerate(estimates)
    ]
    V = np.mean(
        [np.mean([m.volumes(gas, leak=True).mean(axis=0) for m in group], axis=0) for group in cells.values()], 0
    )
    apart = moved_by(members[0].x / length, V, length, spreads.values())
    curve = [
        weighed(e, [Doubt("volumes that differ", "method", half, seen=False)])
        for e, half in zip(_curve(members, settings, scales), apart, strict=True)
    ]
    if lacking := next((e.note for e in estimates if e.withheld and e.method == TIGHT), ""):
        curve = [withhold(e, f"a volume that it goes through is withheld: {lacking}") for e in curve]
    result.add([*sorted(estimates, key=lambda e: e.method != TIGHT), *curve], (), _traces(estimates, curve, length))
    result.note_lack(MEASURED, MEASURED)
    share = max((m.lost / (m.before + gas.atmosphere) for m in members), key=abs)
    return result.analysis(cells=len(cells), leak=share)


Errors = Mapping[str, tuple[float, float]]
"""Channel -> errors of its gain [1] and offset [SI]."""
MEASURED = ("pressure", "displacement")


def _values(
    of: Callable[[Gas, Errors], Array], each: Sequence[Array], settings: Mapping[str, Any], scales: Scales
) -> Iterator[tuple[float, Parts]]:
    """Each value of `of`(gas, errors), shape (n,), with its interval parts; `each` has the values by cycle, per stroke.

    The method part comes from the plan's half widths of the quantities in `Gas`, named `<name>_half`.
    """
    gas = Gas.of(settings)
    value = of(gas, {})
    names = ("reference", "dead", "atmosphere")
    others = [replace(gas, **{name: getattr(gas, name) + float(settings[f"{name}_half"])}) for name in names]
    method = np.sqrt(sum((of(other, {}) - value) ** 2 for other in others))
    wrong = [{name: (scales.gains[name], 0.0)} for name in MEASURED if name in scales.gains]
    wrong += [{name: (0.0, scales.offsets[name])} for name in MEASURED if name in scales.offsets]
    calibration = np.sqrt(sum((of(gas, one) - value) ** 2 for one in wrong)) if wrong else np.full(len(value), np.nan)
    for i, one in enumerate(value.tolist()):
        _, half = mean_of_cycles([cycles[:, i] for cycles in each])
        yield one, Parts(half, float(method[i]), float(calibration[i]) if np.isfinite(calibration[i]) else None)


def _mean(members: Sequence[Stroke], gas: Gas, errors: Errors, *, leak: bool) -> Array:
    """Mean volume at each contraction, with errors of pressure and displacement; the latter moves the contractions."""
    gain, offset = errors.get("pressure", (0.0, 0.0))

    def wrong(m: Stroke) -> Stroke:
        before, after = (one * (1 + gain) + offset for one in (m.before, m.after))
        return replace(m, P=m.P * (1 + gain) + offset, before=before, after=after)

    V = np.asarray(np.mean([wrong(m).volumes(gas, leak=leak).mean(axis=0) for m in members], axis=0))
    if (moves := errors.get("displacement")) is None:
        return V
    x = members[0].x
    return np.asarray(V - (moves[0] * x + moves[1]) * np.gradient(V, x, edge_order=2 if len(x) > 2 else 1))


def _volumes(
    pressure: float, group: Sequence[Stroke], settings: Mapping[str, Any], scales: Scales, method: str, *, leak: bool
) -> Iterator[Estimate]:
    """V at each contraction of one start pressure."""
    mean = partial(_mean, group, leak=leak)
    each = [m.volumes(Gas.of(settings), leak=leak) for m in group]
    names = tuple(m.trial.name for m in group)
    for x, (value, parts) in zip(group[0].x.tolist(), _values(mean, each, settings, scales), strict=True):
        at, note = {"pressure": pressure, "contraction": x}, "" if parts.repeats is not None else NO_REPEATS
        yield Estimate("V", value, "m3", "volume", method, at, parts, len(group), note=note, trials=names)


def _curve(members: Sequence[Stroke], settings: Mapping[str, Any], scales: Scales) -> Iterator[Estimate]:
    """D0, theta0 and alpha of V(eps), fitted to the mean of all pressures; repeats are fits to single strokes."""
    length, n = float(settings["length"]), len(members)
    eps, names = members[0].x / length, tuple(m.trial.name for m in members)

    def fitted(V: Array) -> Array:
        found = fit_volume(eps, V, length)
        return np.full(3, np.nan) if found is None else np.array(found)

    def all_in_one(gas: Gas, errors: Errors) -> Array:
        return fitted(_mean(members, gas, errors, leak=True))

    each = [np.array([fitted(V) for V in m.volumes(Gas.of(settings), leak=True)]) for m in members]
    found = list(_values(all_in_one, each, settings, scales))
    known = (
        all(isfinite(value + (parts.method or 0.0)) for value, parts in found)
        and np.isfinite(np.concatenate(each)).all()
    )
    for (symbol, quantity, unit), (value, parts) in zip(NAMES, found, strict=True):
        if known:
            note = sentences("" if parts.repeats is not None else NO_REPEATS, f"l0 {show(length, 'length')} as given")
            yield Estimate(symbol, value, unit, quantity, CURVE, {}, parts, n, note=note, trials=names)
        else:
            why = "V(eps) is not of this form within the intervals, or four contractions are not there"
            yield Estimate(symbol, None, unit, quantity, CURVE, n=n, note=why)


def _leaks(pressure: float, group: Sequence[Stroke], gas: Gas) -> Finding:
    """How much air leaked."""
    where = f"from {show(pressure, 'pressure')}"
    share = max((m.lost / (m.before + gas.atmosphere) for m in group), key=abs)
    lost = max((m.lost for m in group), key=abs)
    if share < 0 and -lost > 6 * group[0].noise:
        higher = f"{where} the pressure comes back {show(-lost, 'pressure', 3)} higher"
        return Finding(
            "doubt", f"{higher}: air comes in through the valve, the air or the room warms, or the gauge drifts"
        )
    if share > LEAKS:
        return Finding("doubt", f"{where} {share:.1%} of the air is lost over a trial: {LOST}")
    return Finding("note", f"{where} {max(share, 0.0):.2%} of the air is lost over a trial")


def _agree(estimates: Sequence[Estimate]) -> list[Finding]:
    """Whether start pressures give the same volume (paper 3). At the start the volume is given, so it tests nothing
    there.
    """
    tight = [e for e in estimates if e.method == TIGHT and e.value is not None]
    pairs = []
    for group in grouped(tight, lambda e: e.at["contraction"]).values():
        if len(group) > 1:
            low, high = (pick(group, key=lambda e: e.value or 0.0) for pick in (min, max))
            pairs.append(((high.value or 0.0) - (low.value or 0.0), low, high))
    if not pairs:
        return []
    apart, low, high = max(pairs, key=lambda pair: pair[0])
    room = hypot(*(e.parts.combined or e.parts.method or 0.0 for e in (low, high)))
    text = (
        f"start pressures give volumes that differ by at most {show(apart, 'volume', 2)} "
        f"({apart / (high.value or 1.0):.2%}), at {show(high.at['contraction'], 'length')} between "
        f"{show(low.at['pressure'], 'pressure')} and {show(high.at['pressure'], 'pressure')}"
    )
    if apart <= room:
        same = "the volume at the start is given, the same for each, so a muscle that swells with the pressure"
        return [
            Finding("note", f"{text}: within their intervals. But {same} is not seen: V is what it makes of that one")
        ]
    causes = "a dead volume, the room's pressure or k is wrong, or the muscle swells with the pressure"
    return [Finding("doubt", f"{text}: more than their intervals; {causes}")]


def _traces(estimates: Sequence[Estimate], curve: Sequence[Estimate], length: float) -> Iterator[Trace]:
    """Volumes of each start pressure over contraction, with the curve through all."""
    values = {e.symbol: e.value for e in curve if e.value is not None}
    tight = [e for e in estimates if e.method == TIGHT]
    for pressure in sorted({e.at["pressure"] for e in estimates}):
        own = [e for e in tight if e.at["pressure"] == pressure]
        columns = {
            "contraction": np.array([e.at["contraction"] for e in own]) / length,
            "volume": np.array([e.value for e in own], dtype=np.float64),
            "half": np.array([np.nan if e.parts.combined is None else e.parts.combined for e in own]),
        }
        if len(values) == 3:
            columns["curve"] = volume_at(columns["contraction"], length, **values)
        quantities = {name: "ratio" if name == "contraction" else "volume" for name in columns}
        marks = {"pressure": pressure} | (values if len(values) == 3 else {})
        title = f"{show(pressure, 'pressure')}: volume over contraction"
        yield Trace(f"volume-{pressure:g}", "volume", title, columns, quantities, marks)


COLUMNS = ("contraction", "volume", "half")
PRESSURES = 4


def volumes(traces: Sequence[Trace], analysis: Analysis) -> list[Picture]:
    """One figure with the volumes of all start pressures."""
    able = [t for t in traces if has(t, "contraction", "volume")]
    chosen = spread(able, PRESSURES)
    if not chosen:
        return []
    series = [one for i, trace in enumerate(chosen) for one in _series(trace, i)]
    labels = (unit_of(chosen[0], "contraction").label("contraction ε"), unit_of(chosen[0], "volume").label("V"))
    marks = chosen[0].marks
    curve = ""
    if {"D_0", "theta_0", "alpha"} <= set(marks):
        curve = (
            "; line: V(ε) of paper 3 through all of them, "
            f"D0 {show(marks['D_0'], 'length', 4)}, θ0 {degrees(marks['theta_0']):.4g}°, α {marks['alpha']:.4g}"
        )
    caption = (
        "Marks: volumes from the absolute pressure of the air shut in, what leaked taken out, with 95 % intervals, "
        f"from each pressure at which the valve shut{curve}. The pressures share volume at the start, dead volume and "
        f"room, so the marks differ by less than the intervals."
    )
    charts, title = [[Chart(*labels, tuple(series), legend=True)]], "Volume over contraction"
    return [of_traces(charts, title, caption, analysis, chosen, able, COLUMNS, [p.label for p in series if p.mark])]


def _series(trace: Trace, i: int) -> list[Series]:
    """The values from one start pressure, all but the first open and a little aside; with the first the curve."""
    x, y = column(trace, "contraction"), column(trace, "volume")
    half = column(trace, "half") if "half" in trace.columns else None
    curve = [Series("", x, column(trace, "curve"), PALETTE[0])] if i == 0 and "curve" in trace.columns else []
    name = show(trace.marks["pressure"], "pressure") if "pressure" in trace.marks else f"{i + 1}"
    aside = x + 0.012 * i * np.ptp(x)
    return [*curve, Series(f"from {name}", aside, y, PALETTE[i % len(PALETTE)], "o", half, hollow=i > 0)]


def one_trial(run: RunData, trial: TrialData, expected: Expected | None, quick: Quick) -> Found:
    """The volume at the end of the stroke, and the pressure that leaks away over the trial."""
    settings = settings_of(run)
    try:
        stroke = measure(run, trial, settings)
    except NotUsable as reason:
        return [Measured("V", "volume", None)], [str(reason)]
    gas = Gas.of(settings)
    V = stroke.volumes(gas, leak=True)[:, -1]
    share = stroke.lost / (stroke.before + gas.atmosphere)
    found = [Measured("V", "volume", float(V.mean())), Measured("leak", "pressure", stroke.lost, noise=stroke.noise)]
    return found, [f"{share:.1%} of the air is lost over the trial"] if share > LEAKS else []
