"""Reduction of driven sines: K, B, F_c and loop widths from the first harmonics of displacement and force.

Uses the samples and the protocol's settings; knows nothing of the bench. One trial is evaluated in `sine_loop`, the
lines through those of one cell are in `fit`. Effects of undeclared filters, steps of channels and a varying pressure
are found by changing the samples and evaluating them again. `one_trial`: values of one trial, for the display.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import astuple, dataclass, replace
from math import nan, pi
from typing import Any

import numpy as np

from pmabench.analysis.imported import import_of
from pmabench.analysis.shared import skew
from pmabench.analysis.shared.calibration import Scales
from pmabench.analysis.shared.form import (
    Doubt,
    off_command,
    off_command_findings,
    weighed,
    without_negative_friction,
)
from pmabench.analysis.shared.ramp_loop import LATE
from pmabench.analysis.shared.samples import PLACES, STEPS, NotUsable, lag_open, noise_of, rounded, settings_of
from pmabench.analysis.shared.sine_loop import Sine, along, evaluate, measure
from pmabench.analysis.shared.trials import Point, Reduction, grouped, point_by, thinned
from pmabench.analysis.trial import Expected, Found, Measured, Quick
from pmabench.analysis.verdict.agreement import Offer, exactly, values_of
from pmabench.base.quantities import show
from pmabench.kinds.sinusoidal_displacement import RESULTS
from pmabench.kinds.sinusoidal_displacement.fit import DISTORTED, HARMONIC, Fitted, Member, Muscle, of_like_motion
from pmabench.kinds.sinusoidal_displacement.form import Form, judged, pressure_of
from pmabench.kinds.sinusoidal_displacement.pressure import (
    SINE_MEAN,
    force_slopes,
    mean_force_estimates,
    pressure_and_force,
)
from pmabench.store.analyses.results import Analysis, Estimate, Finding, Trace
from pmabench.store.records import Array, RunData, TrialData

KIND = "sinusoidal-displacement"
CHANNELS = ("displacement", "force")
CELL = ("pressure", "mean", "amplitude")
ALIKE = {"amplitude": (0.02, "amplitude"), "mean": (0.02, "amplitude"), "pressure": (0.01, "pressure")}
"""Measured coordinates count as equal if they differ by at most this share of the named coordinate."""
UNEVEN = 0.01
"""Uncorrected force by pressure at the sine's frequency, as a share of the force, from which on it is a doubt."""


def reduce(runs: Sequence[RunData], options: Mapping[str, Any] | None = None) -> Analysis:
    """K [N/m], B [N.s/m], F_c, F_ce [N], loop widths [N] and areas [J] of sinusoidal displacement at constant pressure.

    The muscle's force is F = F_ce - K x - B x' - F_c sign x'. With the complex amplitudes of measured displacement and
    force at the known frequency (three-parameter sine fit, IEEE 1057): K = -Re(F/x), and -Im(F/x) A = B omega A + 4
    F_c/pi, a line over the speed omega A. B is (B_c + B_r)/2 if the directions differ. The width of the loop at mid
    stroke is 2 B omega A + 2 F_c: the value at 0 Hz is static hysteresis, the rest is phase lag. F_ce comes from the
    mean force if the stroke includes x = 0 (`mean_force`). The higher harmonics of the force correct K and F to those
    at the mean, and withhold what they contradict (`form`).

    `options`: `discard` (cycles at the start; else the plan's setting, else 1), `time_skew` [s] (bound of the time
    between displacement and force, to which that of their streams' clocks is added; else the plan's setting; without
    either, the lag of the force cell is an uncertainty), `force_per_pressure` dF/dP [N/Pa].
    """
    result = Reduction.of(KIND, RESULTS, runs, options, _member)
    result.measured, result.findings = _even_pressure(_as_alike(result.measured), result.options)
    members, scales, lines = result.measured, result.scales, list[dict[str, Any]]()
    fits, stated = _fits(members, result.options)
    rising, changing = force_slopes(fits), _over_pressure(fits)
    for key, fitted in fits.items():
        at, form, slopes = dict(key), fitted.form, changing.get(key)
        cell = Cell(at, scales, slopes, rising.get(key), form)
        found = _with_sensors(cell.estimates(fitted, form), fitted, cell, late=stated[key] == 0)
        result.estimates += found
        result.findings += [*fitted.findings(at), *form.findings(at)]
        result.findings += off_command_findings(pressure_of(at), cell.off(fitted), at.get("pressure", 0.0))
        lines.append({"at": at, **fitted.facts(), "h2/h1": form.h2 / form.h1, "h3/h1": form.h3 / form.h1})
        symbols = {e.symbol for e in found if e.method == HARMONIC and e.at == at and e.value is not None}
        result.traces += _traces(at, fitted.by_frequency, fitted.muscle if symbols >= {"K", "B", "F_c"} else None)
        if slopes is None:
            text = "is not in the calibration parts: one pressure does not show how K, B and F_c change over it"
            result.findings.append(Finding("note", f"at {pressure_of(at)}: what an error of the pressure adds {text}"))
    result.estimates = without_negative_friction(result.estimates)
    muscles = {member.name: fitted.muscle for fitted in fits.values() for member in fitted.group}
    result.add(*pressure_and_force(members, muscles, scales))
    most = max((fitted.skew for fitted in fits.values()), default=0.0)
    result.findings += skew.findings(runs, CHANNELS, most, result.estimates)
    result.note_lack(("force", "displacement", "pressure")[: 3 if len(fits) > 1 else 2])
    return result.analysis(lines=lines, cells=len(_cells(members, (*CELL, "frequency"))))


def _member(run: RunData, trial: TrialData, options: Mapping[str, Any]) -> Member:
    return Member.of(run, trial, float(settings_of(run, options).get("discard", 1)))


@dataclass(frozen=True, eq=False)
class Cell:
    """One pressure, mean and amplitude, with what is needed to evaluate its sines."""

    at: Mapping[str, float]
    scales: Scales
    slopes: Muscle | None
    """Derivatives of K, B and F_c by pressure; None where unknown."""
    rising: float | None
    """dF_ce/dP [N/Pa], where it is known."""
    form: Form
    """Harmonics of the measured sines."""

    def estimates(self, fitted: Fitted, form: Form) -> list[Estimate]:
        """All estimates from these lines, corrected and withheld by the harmonics of `form`."""
        found = judged(fitted.estimates(self.at, self.scales, self.slopes), form)
        return [*found, *mean_force_estimates(self.at, fitted, form, self.scales, self.rising)]

    def off(self, fitted: Fitted) -> float:
        """Measured pressure minus the set one [Pa], the largest of a trial; nan where either is unknown."""
        known = [m.sine.pressure for m in fitted.group if not np.isnan(m.sine.pressure)]
        return max((one - self.at.get("pressure", nan) for one in known), key=abs, default=nan)

    def off_command(self, e: Estimate, fitted: Fitted) -> float:
        """Possible error of an estimate that is given for the set pressure."""
        P = self.at.get("pressure", 0.0)
        if e.symbol in ("F_ce", "F"):
            most = max((m.guess * P for m in fitted.group if not np.isnan(m.guess)), default=0.0)
            return off_command(self.off(fitted), P, most, self.rising)
        return off_command(self.off(fitted), P, e.value or 0.0, getattr(self.slopes, e.symbol, None))

    def of_others(self, group: Sequence[Member]) -> Named:
        """Estimates from changed samples; where their own form withholds one, it is evaluated with the form of the
        measured ones.

        If that also withholds it, friction is taken from the plain lines, which no form corrects.
        """
        fitted = Fitted.of(group, 0.0)
        found = self.estimates(fitted, fitted.form)
        if any(e.withheld for e in found):
            plain = fitted.estimates(self.at, self.scales, self.slopes)
            friction = [e for e in plain if e.symbol in ("F_c", "H")]
            found = [*friction, *(e for e in [*self.estimates(fitted, self.form), *found] if e.value is not None)]
        return {name_of(e): e for e in found if e.value is not None}


def _fits(members: Sequence[Member], options: Mapping[str, Any]) -> tuple[dict[Point, Fitted], dict[Point, float]]:
    """The lines of each cell, and the stated bound of the time between displacement and force there [s]."""
    cells = _cells(members, CELL)
    stated = {
        key: max(float(settings_of(one.run, options).get("time_skew", 0.0)) for one in group) for key, group in cells
    }
    clocks = {key: skew.apart([one.run for one in group], CHANNELS) for key, group in cells}
    return {key: Fitted.of(group, stated[key] + clocks[key]) for key, group in cells}, stated


def _over_pressure(fits: Mapping[Point, Fitted]) -> dict[Point, Muscle]:
    """Derivatives of K, B and F_c by pressure, from cells of equal motion; cells without a second pressure are left
    out.
    """
    found: dict[Point, Muscle] = {}
    for keys in of_like_motion(fits):
        values = np.array([astuple(fits[key].muscle) for key in keys])
        slopes = np.gradient(values, [dict(key)["pressure"] for key in keys], axis=0)
        found |= {key: Muscle(*row) for key, row in zip(keys, slopes.tolist(), strict=True)}
    return found


def _as_alike(members: Sequence[Member]) -> list[Member]:
    """Members whose motion was measured and not commanded, moved to a common point where they differ by less than
    `ALIKE`.

    A drive may reach 3.99 mm of 4 mm at 2 Hz, which is the same amplitude.
    """
    measured = [m for m in members if import_of(m.run) and "displacement_command" not in m.trial.channels]
    points = {m.name: dict(m.trial.point) for m in measured}
    for name, (share, of) in ALIKE.items():
        last, group = nan, list[Member]()
        groups: list[list[Member]] = []
        for member in sorted((m for m in measured if name in m.trial.point), key=lambda m: m.trial.point[name]):
            here = member.trial.point[name]
            if not here - last <= share * member.trial.point.get(of, here):
                groups.append(group := [])
            group.append(member)
            last = here
        for group in groups:
            common = float(np.median([m.trial.point[name] for m in group]))
            points.update({m.name: {**points[m.name], name: common} for m in group})
    return [replace(m, trial=replace(m.trial, point=points.get(m.name, m.trial.point))) for m in members]


def _cells(members: Sequence[Member], names: Sequence[str]) -> list[tuple[Point, list[Member]]]:
    """The trials with equal values of `names`, by ascending values."""
    return sorted(grouped(members, lambda one: point_by(one.trial, names)).items())


def _even_pressure(members: Sequence[Member], options: Mapping[str, Any]) -> tuple[list[Member], list[Finding]]:
    """Members corrected for the force by pressure at the sine's frequency, dF/dP times that pressure; and findings.

    dF/dP [N/Pa] is the option `force_per_pressure`, else the slope of mean force over mean pressure among trials of the
    same mean displacement. Without either there is no correction, and a doubt where it would be large.
    """
    even: list[Member] = []
    findings: list[Finding] = []
    for _, group in _cells(members, ("mean",)):
        pressures = np.array([member.sine.pressure for member in group])
        forces = np.array([member.sine.force for member in group])
        slope = float(options.get("force_per_pressure", nan))
        if np.isnan(slope) and not np.isnan(pressures).any() and np.ptp(pressures) > 0.1 * pressures.max():
            slope = float(np.polyfit(pressures, forces, 1)[0])
        for member in group:
            sine, share = member.sine, 0.0
            if sine.ripple:
                worth = member.guess if np.isnan(slope) else slope
                share = abs(sine.ripple) * abs(worth) / (abs(sine.ratio) * sine.amplitude)
            if not np.isnan(slope) and share > 1e-4:
                even.append(member.again(per_pressure=slope))
                continue
            even.append(member)
            if share > UNEVEN:
                swing = f"the pressure swings by {show(abs(sine.ripple), 'pressure', 3)} with the sine, worth about"
                remedy = "give force_per_pressure, or run at two pressures"
                text = f"trial {member.name}: {swing} {share:.1%} of the force; {remedy}"
                findings.append(Finding("doubt", text))
    return even, findings


FILTERED, SWINGS = "filter of the pressure sensor", "pressure that swings with the sine"
OFF_COMMAND = "pressure off its command"
SEEN = 4.0
"""Standard errors from which on the pressure varies significantly with the sine."""
AT_MOST = 2.0
"""Factor on F_ce/P for an unknown force per pressure, since a muscle has force only above some pressure."""
ROOM = 1.02
"""Factor on the possible filters, so that noise does not hide a filter at its bound."""
Named = Mapping[tuple[object, ...], Estimate]
"""Estimates with a value by `name_of`."""
Effects = Mapping[tuple[object, ...], float]


def name_of(e: Estimate) -> tuple[object, ...]:
    """Key of an estimate within a cell."""
    return e.symbol, e.method, *e.at.items()


def _with_sensors(estimates: Sequence[Estimate], fitted: Fitted, cell: Cell, *, late: bool) -> list[Estimate]:
    """The estimates with the uncertainty due to their sensors; `late`: the delay of the force is not stated.

    Each effect is put into the samples, and all values of the cell are evaluated again. A filter may be of first order,
    which also reduces the amplitude, or a sharper one, which only delays.
    """
    group = list({member.sine.frequency: member for member in fitted.group}.values())
    given = cell.of_others(group)

    def changed(*groups: Sequence[Member]) -> Effects:
        """The largest change of each value."""
        others = [cell.of_others(group) for group in groups]
        return {name: max((_apart(e, other[name]) for other in others if name in other), default=0.0)
                for name, e in given.items()}  # fmt: skip

    off = {name_of(e): cell.off_command(e, fitted) for e in estimates}
    effects: list[tuple[str, bool, Effects]] = [(STEPS, False, _by_steps(fitted, cell)), (OFF_COMMAND, False, off)]
    if late:
        force, way = (max(ROOM * lag_open(m.run, name) for m in fitted.group) for name in ("force", "displacement"))
        filters = ([m.again(later) for m in group] for later in ({"force": force}, {"displacement": way}))
        delays = ([m.again(delay=by) for m in group] for by in (force, -way))
        effects.append((LATE, False, changed(*filters, *delays)))
    if any(m.per_pressure for m in fitted.group):
        filtered = [m.again({"pressure": ROOM * lag_open(m.run, "pressure")}) for m in group]
        effects.append((FILTERED, False, changed(filtered)))
    if any(map(_swings, fitted.group)):
        taken = changed([m.again(per_pressure=m.guess) for m in group])
        effects.append((SWINGS, True, {name: AT_MOST * change for name, change in taken.items()}))
    return [
        weighed(e, [Doubt(of, "method", sizes.get(name_of(e), 0.0), seen) for of, seen, sizes in effects])
        for e in estimates
    ]


def _apart(e: Estimate, other: Estimate) -> float:
    """Difference of another value to an estimate; for a line over frequency minus the increase of its interval.

    A filter that would bend the line contradicts a straight one, so K from many frequencies is not as uncertain as K at
    the highest.
    """
    more = 0.0 if e.at.get("frequency") else (other.parts.repeats or 0.0) - (e.parts.repeats or 0.0)
    return max(0.0, abs((other.value or 0.0) - (e.value or 0.0)) - max(0.0, more))


def _swings(member: Member) -> bool:
    """Whether the pressure varies significantly with the sine, and the force is not corrected for it."""
    if member.per_pressure or not member.sine.ripple:
        return False
    noise = noise_of(member.trial.channels["pressure"]) * np.sqrt(2 / len(member.sine.t))
    return bool(abs(member.sine.ripple) > SEEN * noise)


def _by_steps(fitted: Fitted, cell: Cell) -> Effects:
    """Effect of the channels' steps: the fitted muscle's signals, rounded and evaluated again."""
    muscle, rows = fitted.replayed, list[tuple[Member, Array, Array]]()
    for member in {member.sine.frequency: member for member in fitted.group}.values():
        x, F = along(member.sine, muscle.K, muscle.B, muscle.F_c)
        rows.append((member, rounded(x, member.sine.steps[0]), rounded(F, member.sine.steps[1], 1)))
    if not any(np.ptp(signals, axis=0).any() for _, *channels in rows for signals in channels):
        return {}
    values = []
    for i in range(1 + PLACES):
        group = [replace(m, sine=evaluate(m.sine.t, x[i], F[i], m.sine.frequency, m.sine.pressure)) for m, x, F in rows]
        values.append({name: e.value or 0.0 for name, e in cell.of_others(group).items()})
    return {
        name: 2 * float(np.sqrt(np.mean([(one.get(name, plain) - plain) ** 2 for one in values[1:]])))
        for name, plain in values[0].items()
    }


def _traces(at: Mapping[str, float], sines: Mapping[float, Sequence[Sine]], muscle: Muscle | None) -> list[Trace]:
    """One loop per frequency (last cycle of its first trial), and the Bode table.

    `sines` by frequency [Hz]; `muscle` is None where K, B and F_c are not all known: loops are then drawn without
    model.
    """
    where = ", ".join(
        show(at[name], quantity) for name, quantity in (("pressure", "pressure"), ("mean", "length")) if name in at
    )
    where += f" ± {show(at['amplitude'], 'length')}" if "amplitude" in at else ""
    name = "-".join(f"{at[key]:g}" for key in at)
    held = {key: at[key] for key in ("pressure",) if key in at}
    traces = []
    groups = sorted(sines.items())
    for frequency, members in groups:
        sine = members[0]
        last = sine.t >= sine.t[-1] - 1 / frequency
        columns = {"displacement": sine.x, "force": sine.F}
        if muscle is not None:
            columns["model"] = along(sine, muscle.K, muscle.B, muscle.F_c)[1]
        traces.append(
            Trace(
                f"loop-{name}-{frequency:g}",
                "loop",
                f"Loop at {frequency:g} Hz, {where}",
                thinned({name: values[last] for name, values in columns.items()}),
                {"displacement": "length", "force": "force", "model": "force"},
                {"frequency": frequency, "width": sine.width, "area": sine.area} | held,
            )
        )

    marks = {} if muscle is None else {"K": muscle.K, "B": muscle.B, "F_c": muscle.F_c}
    columns = {
        name: np.array([float(np.mean([of(sine) for sine in members])) for _, members in groups])
        for name, (_, of) in BODE.items()
    }
    quantities = {name: quantity for name, (quantity, _) in BODE.items()}
    return [*traces, Trace(f"bode-{name}", "bode", f"Force over displacement, {where}", columns, quantities, marks)]


BODE: Mapping[str, tuple[str, Callable[[Sine], float]]] = {
    "frequency": ("frequency", lambda sine: sine.frequency),
    "gain": ("stiffness", lambda sine: abs(sine.ratio)),
    "phase": ("angle", lambda sine: sine.phase),
    "stiffness": ("stiffness", lambda sine: sine.stiffness),
    "loss": ("force", lambda sine: sine.loss),
    "speed": ("speed", lambda sine: sine.speed),
    "width": ("force", lambda sine: sine.width),
}
"""Column of the Bode table, a mean over the sines of each frequency -> its quantity, and its value of one sine."""


def offers(analysis: Analysis) -> Iterator[Offer]:
    """K and F at the mean contraction of each cell, F_ce at x = 0, and B and F_c, which do not depend on it."""
    for symbol in ("K", "B", "F_c"):
        for e in values_of(analysis, symbol, HARMONIC):
            yield exactly(symbol, {(e.at["pressure"], e.at.get("mean") if symbol == "K" else None): e})
    for symbol in ("F_ce", "F"):
        for e in values_of(analysis, symbol, SINE_MEAN):
            yield exactly("F", {(e.at["pressure"], 0.0 if symbol == "F_ce" else e.at.get("mean")): e})


def one_trial(run: RunData, trial: TrialData, expected: Expected | None, quick: Quick) -> Found:
    """K, and B at this frequency including Coulomb friction: -Im(F/x)/omega = B + 4 F_c/(pi omega A)."""
    settings = run.plan.get("settings") or {}
    P = trial.point.get("pressure")
    try:
        sine = measure(run, trial, float(settings.get("discard", 1)))
    except NotUsable as reason:
        return [Measured("K", "stiffness", None), Measured("B", "damping", None)], [str(reason)]
    K_e = B_e = None
    if expected is not None and P is not None:
        K_e = expected.at("K", P)
        B_c, B_r = expected.at("B_c", P), expected.at("B_r", P)
        if B_c is not None and B_r is not None:
            B_e = 0.5 * (B_c + B_r) + 4 * expected.F_c / (pi * sine.speed)
    doubts = []
    if sine.distortion > DISTORTED:
        doubts.append(f"the displacement is no sine: {sine.distortion:.0%} of it is something else")
    asked = trial.point.get("amplitude", settings.get("amplitude"))
    if isinstance(asked, int | float) and asked > 0 and abs(sine.amplitude / asked - 1) > 0.05:
        doubts.append(f"amplitude {show(sine.amplitude, 'length', 3)}, asked for {show(float(asked), 'length', 3)}")
    pressure = None if np.isnan(sine.pressure) else sine.pressure
    return [
        Measured("K", "stiffness", sine.stiffness, K_e),
        Measured("B", "damping", sine.loss / sine.speed, B_e, tolerance=0.25 * B_e if B_e else 0.0),
        Measured("P", "pressure", pressure, P),
        Measured("A", "length", sine.amplitude),
    ], doubts
