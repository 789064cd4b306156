"""Steps of pressure that others recorded: dead time, rise, size of the stroke, and what its ringing says of K and B.

Knows trials with one command each and measured pressure and displacement; not where they come from.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmabench.analysis.imported import flagged_counts, import_findings, measured, unusable_because
from pmabench.analysis.shared.calibration import Scales, sentences
from pmabench.analysis.shared.form import Doubt, weighed
from pmabench.analysis.shared.samples import LAG_KNOWN, LEAST, Held, lags_of, left, noise_of, nothing_moved, onset
from pmabench.analysis.shared.student import mean_over, mean_with_half
from pmabench.analysis.verdict.agreement import Offer, everywhere, values_of
from pmabench.base.quantities import show
from pmabench.kinds.recorded_step import RESULTS
from pmabench.kinds.recorded_step.motion import (
    CLEAR,
    DAMPING,
    FREQUENCY,
    SHOWN,
    Motion,
    Swing,
    before_sensor,
    behind,
    extremes,
    fit_motion,
    free_swings,
    lagged_motions,
)
from pmabench.store.analyses.results import Analysis, Estimate, Finding, Parts, Trace, withhold
from pmabench.store.records import Array, Flag, RunData, TrialData

KIND = "recorded-step"
STEP, RINGING = "recorded-step", "ringing-of-known-mass"
BEFORE, AFTER = 0.5, 0.8
"""Samples so long before and after the command [s] enter the fit of the motion."""
FEWEST = 30
"""Samples on each side that are needed."""
SEEN = 5.0
"""An onset counts where it exceeds this many standard deviations of the baseline, and a twentieth of the step."""
FINE = 2
"""A log with at least so many samples between the level and a clear rise shows how the rise begins."""
RINGS = 0.5
"""Damping ratio from which on a motion does not ring: the mass shows in its fast pole only, which a few ms hide."""
RANGE = 0.15
"""K and B are given where they lie within so much of their value for all that is possible of times and lags."""
UNTOLD = 0.005
"""What pressure and position may be apart [s] where the map gives no `late_by`, for K and B."""
UNKNOWN = "nothing is known of the time between the channels"
ILL_FITTED = 0.1
"""Rms of the misfit as a share of the stroke, above which K and B are withheld."""
INSTEAD = "with a column of force or the load, a map of `kind: contraction-relaxation` gives K from such steps"
ONCE = "no repeats part: one step only"
STOPPED = 0.3
"""Share of the swing that the motion should have, below which friction has stopped it."""
SWUNG = 7.0
"""After so many times its time of decay a swing is over: a thousandth is left."""
SHIFTS = 4
OVERSHOOT = 0.05


@dataclass(frozen=True, eq=False)
class Step:
    """One measured step; times in seconds from the command."""

    trial: TrialData
    t: Array
    P: Array
    x: Array
    """Pressure and contraction, each behind the lag of the other's sensor, too: so neither lags behind the other."""
    size: float
    """Change of measured pressure [Pa]."""
    stroke: float
    """Change of contraction at the end of the trial [m]."""
    dead: float
    """Command to pressure [s]: both in the middle of the samples that they lie between, the lateness taken off."""
    dead_half: float
    """Half of those intervals together [s]."""
    rise: float
    """From onset to 63 % of the change of pressure [s]."""
    rise_half: float
    """Half the times between the samples that the onset, and the 63 %, lie between [s]."""
    motions: tuple[Motion, ...]
    slower: tuple[Motion, ...]
    """The best of them were the lags of the sensors as small and as large as they may be; none without lags."""
    noise: float
    """Of the displacement at rest before the step, as recorded [m]."""

    @property
    def near(self) -> NDArray[np.bool_]:
        """Samples that the fit of the motion uses."""
        return np.asarray((self.t >= -BEFORE) & (self.t <= AFTER))

    @property
    def best(self) -> Motion:
        """The motion with the least misfit."""
        return min(self.motions, key=lambda motion: motion.rms)

    @property
    def name(self) -> str:
        """`run/index`."""
        return self.trial.name

    @property
    def found(self) -> bool:
        """Found in the measured pressure, since no command was recorded."""
        return any(command.data.get("found") for command in self.trial.commands)


def reduce(runs: Sequence[RunData], options: Mapping[str, Any] | None = None) -> Analysis:
    """t_d [s], tau_P [s], X [m], dP/dx [Pa/m] and, where they can be found, K [N/m] and B [N.s/m] of recorded steps.

    Pressure and displacement at one load give the ratios B/K and (dF_ce/dP)/K only, never K itself. Where the moving
    `mass` of the point is known and the motion rings, M x'' + B x' + K x = (dF_ce/dP) P + const, driven by the measured
    pressure, gives K = M w^2 and B = 2 D w M. It rings where its damping ratio is below a half and two extremes or more
    are seen: else the mass shows in the fast pole B/M alone, which a few ms between the channels hide. The pressure may
    be older than its time stamp (`late_by` of the map) and lag behind the sensor: K and B are given as the range over
    that, and withheld where it is wider than 15 % either way. Lags of sensors (`sensor_lag`, first order) are taken
    off, a fifth of them being left open.

    Repeats are trials with the same load and commanded pressures before and after. `options`: `mass` [kg] and `late_by`
    [[least, most] in s] instead of what the record says.
    """
    options = options or {}
    steps, dropped, read_off = measured(runs, options, measure)
    groups: dict[tuple[float, ...], list[tuple[RunData, Step]]] = {}
    loads = len({_load(step) for _, step in steps}) > 1
    for run, step in steps:
        point = step.trial.point
        key: tuple[float, ...] = (round(point["from"], -2), round(point["pressure"], -2))
        groups.setdefault((*key, *_load(step)) if loads else key, []).append((run, step))
    commanded = [step for _, step in steps if not step.found]
    late = 0.0 if read_off else UNTOLD
    estimates: list[Estimate] = [_dead_time(commanded, late)] if commanded else []
    findings: list[Finding] = []
    for key, group in sorted(groups.items()):
        at = dict(zip(("from", "pressure", "load", "mass"), key, strict=False))
        estimates += _at(at, group, options, () if read_off else (-UNTOLD, UNTOLD))
        findings += _sentences(at, [step for _, step in group])
    if len(commanded) < len(steps):
        text = f"{len(steps) - len(commanded)} steps were found in the measured pressure: they tell no dead time"
        findings.append(Finding("note", text))
    if steps and not read_off:
        findings.append(Finding("doubt", f"{UNKNOWN}: K and B assume at most {show(UNTOLD, 'time')}"))
    if any(e.symbol == "K" and e.value is not None for e in estimates):
        text = "K and B rest on the moving mass alone, taken as exact; the load hangs and F_ce(P) is not known here"
        findings.append(Finding("doubt", text))
    return Analysis.of(
        KIND,
        runs,
        results=RESULTS,
        estimates=estimates,
        dropped=dropped,
        findings=(*import_findings(runs), *findings),
        traces=(_trace(group[0][1], by_load=loads) for _, group in sorted(groups.items())),
        facts={
            "options": dict(options),
            "trials": len(steps),
            "cells": len(groups),
            "flagged": flagged_counts(runs),
            "steps": [_facts(step) for _, step in steps],
        },
    )


def measure(run: RunData, trial: TrialData, late: tuple[float, float]) -> Step | str:
    """One step from its samples, or the reason why it cannot be measured."""
    missing = [name for name in ("pressure", "displacement") if name not in trial.channels]
    command = next((c for c in trial.commands if c.kind == "set" and c.output == "pressure"), None)
    if missing:
        return f"{' and '.join(missing)} not recorded"
    if command is None or not {"from", "pressure"} <= set(trial.point):
        if nothing_moved(trial, "displacement"):
            return "its length is held: with a column of force the map says `kind: isometric` for such a test"
        return "it has no step of pressure: the map cuts a file into steps with `trials: {by: step, smallest: 10 kPa}`"
    if trial.status != "finished":
        return f"the trial is {trial.status}"
    if np.any(trial.flags & np.uint16(Flag.TIME_JUMP)):
        return "its clock jumps"
    good = trial.usable
    t = trial.t[good] - command.t
    read, x = trial.channels["pressure"][good], trial.channels["displacement"][good]
    lags = lags_of(run, trial)
    over = _blurred(t, read, lags["pressure"])
    P = before_sensor(t, read, lags["pressure"], over) if over else read
    within = command.data.get("within", 0.0)
    before, after = (t >= -BEFORE) & (t < -within), t > 0
    if np.count_nonzero(before) < FEWEST or np.count_nonzero(after) < FEWEST or t[-1] < AFTER:
        return f"too few usable samples around the step (flagged: {unusable_because(trial)})"
    settled = t > max(AFTER, t[-1] - 1.0)
    size = float(np.median(P[settled]) - np.median(P[before])) if settled.any() else 0.0
    stroke = float(np.median(x[settled]) - np.median(x[before])) if settled.any() else 0.0
    noise = float(P[before].std())
    if abs(size) < 2 * SEEN * max(noise, 1.0):
        return f"the pressure follows by {show(size, 'pressure', 3)} only, no more than its noise"
    rise = (P - np.median(P[before])) * np.sign(size)
    begun = np.flatnonzero((rise > max(SEEN * noise, 0.05 * abs(size))) & (t > -within))
    most = np.flatnonzero((rise > (1 - np.exp(-1)) * abs(size)) & (t > -within))
    if not len(begun) or not len(most) or begun[0] == 0:
        return "no onset of the pressure is seen"
    begins, doubt = _onset(t, rise, int(begun[0]), within)
    unsure = over / 2 + LAG_KNOWN * lags["pressure"]
    dead = begins + within / 2 - (late[0] + late[1]) / 2
    dead_half = doubt + within / 2 + (late[1] - late[0]) / 2 + unsure
    crossed = t[max(0, most[0] - 1) : most[0] + 1]
    rise_half = doubt + float(np.ptp(crossed)) / 2 + unsure
    motions, slower = _motions(t, read, x, late, (lags["displacement"], lags["pressure"]))
    alike = behind(t, read, lags["displacement"]), behind(t, x, lags["pressure"])
    return Step(
        trial, t, *alike, size, stroke, dead, dead_half, float(crossed.mean()) - begins, rise_half, motions, slower,
        noise_of(x[t < 0]),
    )  # fmt: skip


def _motions(
    t: Array, P: Array, x: Array, late: tuple[float, float], lags: tuple[float, float]
) -> tuple[tuple[Motion, ...], tuple[Motion, ...]]:
    """Motions over the lateness of the pressure, and the best with each sensor's lag as small and large as it may be.

    `lags` [s] are those of displacement and pressure: pressure is put behind the first, contraction behind the second.
    """
    near = (t >= -BEFORE) & (t <= AFTER)

    def fitted(late: float, lags: tuple[float, float]) -> Motion:
        return fit_motion(t[near], behind(t, P, lags[0])[near], behind(t, x, lags[1])[near], late)

    motions = tuple(fitted(float(shift), lags) for shift in np.linspace(*late, SHIFTS if late[1] > late[0] else 1))
    best = min(motions, key=lambda motion: motion.rms)
    others = [(lags[0] * (1 + by), lags[1]) for by in (-LAG_KNOWN, LAG_KNOWN) if lags[0]]
    others += [(lags[0], lags[1] * (1 + by)) for by in (-LAG_KNOWN, LAG_KNOWN) if lags[1]]
    return motions, tuple(fitted(best.late, one) for one in others)


def _blurred(t: Array, P: Array, lag: float) -> float:
    """Time over which the pressure is averaged where the lag of its sensor is taken off [s]; 0 without one.

    Half the lag, so that noise grows little, and never less than a channel that is polled keeps its value for.
    """
    changes = np.diff(t[:-1][np.diff(P) != 0])
    return max(lag / 2, 2 * float(np.median(changes)) if len(changes) else 0.0) if lag else 0.0


def _onset(t: Array, rise: Array, first: int, within: float) -> tuple[float, float]:
    """When the pressure begins to rise [s], and how far that may be off; `first` is the first sample clearly above.

    A threshold is crossed late, so the first part of the rise is followed back to the level along a straight line
    (behind a lag pressure rises like t). Where a log has too few samples for that the rise begins between the last one
    that is still at its level and `first`.
    """
    rest = rise[t < -within]
    still = np.flatnonzero(rise[:first] <= np.median(rest) + float(np.std(rest)))
    early, late = float(t[still[-1]]) if len(still) else float(t[first - 1]), float(t[first])
    period = float(np.median(np.diff(t)))
    begun = onset(t, rise, -within, LEAST["pressure"]) if late - early > FINE * period - 1e-9 else None
    if begun is None or not early - period <= begun <= late:
        return (early + late) / 2, (late - early) / 2
    return begun, period / 2 + max(0.0, min(begun - early, late - begun)) / 2


def _load(step: Step) -> tuple[float, float]:
    """Load [N] and moving mass [kg]; 0 where they are not known."""
    return round(step.trial.point.get("load", 0.0), 2), round(step.trial.point.get("mass", 0.0), 3)


def _dead_time(steps: Sequence[Step], late: float) -> Estimate:
    """Of the regulator and its line: one value over all steps, of which those between other pressures are unlike.

    `late` [s] is what the pressure may be late where nothing says it.
    """
    pairs = [(round(step.trial.point["from"], -2), round(step.trial.point["pressure"], -2)) for step in steps]
    mean, half, _ = mean_over([step.dead for step in steps], [sorted(set(pairs)).index(pair) for pair in pairs])
    parts = Parts(repeats=half, method=late + max(step.dead_half for step in steps), calibration=0.0)
    parents = tuple(step.name for step in steps)
    resolved = "command to pressure, all steps; the log resolves no less than the method part"
    note = sentences(resolved, "no repeats part: no step was repeated" if half is None else "")
    return Estimate("t_d", mean, "s", "time", STEP, {}, parts, len(steps), note=note, trials=parents)


def _at(
    at: Mapping[str, float], group: Sequence[tuple[RunData, Step]], options: Mapping[str, Any], apart: Sequence[float]
) -> list[Estimate]:
    """All estimates at one pair of commanded pressures; `apart` [s] are further times between pressure and position."""
    steps = [step for _, step in group]
    parents = tuple(step.name for step in steps)
    scales = Scales.of([run for run, _ in group])

    def estimate(
        symbol: str, kind: tuple[str, str], values: Sequence[float], method: float | None, scaled: tuple[str, ...] = (),
        note: str = "", doubts: Sequence[Doubt] = (),
    ) -> Estimate:  # fmt: skip
        mean, half = mean_with_half(values)
        parts = Parts(half, method, scales.part(dict.fromkeys(scaled, mean)))
        note = sentences(note, ONCE if half is None else "", scales.lack(scaled))
        e = Estimate(symbol, mean, *kind, STEP, at, parts, len(values), note=note, trials=parents)
        return weighed(e, [replace(one, half=one.half * abs(mean)) for one in doubts])

    seconds = ("s", "time")
    moved = [step for step in steps if abs(step.stroke) > 2 * SEEN * step.noise]
    if not moved:
        why = f"the displacement moves by {show(steps[0].stroke, 'length', 2)} only: the load rests on its support"
        unmoved = [Estimate("dP/dx", None, "Pa/m", "gain", STEP, at, note=why, n=len(steps), trials=parents)]
    return [
        *(
            []
            if any(s.found for s in steps)
            else [
                estimate(
                    "t_d",
                    seconds,
                    [s.dead for s in steps],
                    max(apart, default=0.0) + max(s.dead_half for s in steps),
                    note="to pressure",
                )
            ]
        ),
        estimate("tau_P", seconds, [s.rise for s in steps], max(s.rise_half for s in steps), note="63 %"),
        estimate(
            "X", ("m", "length"), [step.stroke for step in steps], 0.0, ("displacement",), doubts=_unsettled(steps)
        ),
        *(
            [
                estimate(
                    "dP/dx",
                    ("Pa/m", "gain"),
                    [step.size / step.stroke for step in moved],
                    0.0,
                    ("pressure", "displacement"),
                    "at rest, includes friction",
                    _unsettled(moved),
                ),
                *_muscle(at, moved, options, apart),
            ]
            if moved
            else unmoved
        ),
    ]


def _unsettled(steps: Sequence[Step]) -> list[Doubt]:
    """What the contraction still moves before the step and after it, as a share of the stroke."""
    stroke = abs(float(np.mean([step.stroke for step in steps])))
    found = []
    for name, side in (("before the step", -1), ("after the step", 1)):
        holds = []
        for step in steps:
            swung = SWUNG / (step.best.D * step.best.w)
            rows = step.t < 0 if side < 0 else step.t > min(max(AFTER, swung), step.t[-1] - 1.0)
            t, x = step.t[rows], step.x[rows] * np.sign(step.stroke)
            holds.append(Held.of(t, x, max(float(t[0]), float(t[-1]) - 1.0)))
        further = left(holds)
        text = f"{name} the contraction is not at rest, it may change by {show(further.most, 'length', 2)} more"
        reason = f"{text}: creep, or a drift. Record longer before and after the step"
        share = further.most / stroke if stroke else 0.0
        found.append(Doubt(f"motion {name}", "method", share, further.seen, reason))
    return found


def _muscle(
    at: Mapping[str, float], steps: Sequence[Step], options: Mapping[str, Any], apart: Sequence[float]
) -> list[Estimate]:
    """K and B where the motion rings, or why not; from times and a mass, no scale of a channel enters."""
    parents = tuple(step.name for step in steps)
    kinds = (("K", "N/m", "stiffness"), ("B", "N.s/m", "damping"))
    masses = [float(options.get("mass", step.trial.point.get("mass", 0.0))) for step in steps]
    unknown = "pressure and displacement at one load give ratios only; `point: {mass: ...}` gives the moving mass"
    why = "" if all(masses) else unknown
    held = False
    ranges: dict[str, list[tuple[float, float]]] = {"K": [], "B": []}
    for step, mass in zip(steps, masses, strict=True):
        if not why:
            why = _why_not(step)
            held = bool(why)
        if why:
            break
        near = step.t[step.near], step.P[step.near], step.x[step.near]
        possible = [
            *step.motions,
            *step.slower,
            *(fit_motion(*near, late) for late in apart),
            *lagged_motions(*near, step.best),
        ]
        for symbol, values in (
            ("K", [mass * motion.w**2 for motion in possible]),
            ("B", [2 * motion.D * motion.w * mass for motion in possible]),
        ):
            ranges[symbol].append((min(values), max(values)))
    found: list[Estimate] = []
    for symbol, unit, quantity in kinds:
        empty = Estimate(symbol, None, unit, quantity, RINGING, at, n=len(steps), trials=parents)
        if why:
            reason = f"{why}; {INSTEAD}"
            found.append(withhold(empty, reason) if held else replace(empty, note=reason))
            continue
        value, half = mean_with_half([(low + high) / 2 for low, high in ranges[symbol]])
        wide = max((high - low) / 2 for low, high in ranges[symbol])
        if wide > RANGE * value:
            spread = f"+-{wide / value:.0%} for what is known of the time between pressure and position"
            found.append(withhold(empty, f"it lies within {spread}, accepted is +-{RANGE:.0%}; {INSTEAD}"))
            continue
        parts = Parts(repeats=half, method=wide, calibration=0.0)
        once = ONCE if half is None else ""
        given = replace(empty, value=value, parts=parts, note=once)
        found.append(weighed(given, _free_doubts(symbol, value, wide, steps, masses)))
    return found


def _free_doubts(symbol: str, value: float, wide: float, steps: Sequence[Step], masses: Sequence[float]) -> list[Doubt]:
    """What the free swinging after the step says against K or B, beyond the range `wide`: it knows no times."""
    others, stopped = [], False
    for step, mass in zip(steps, masses, strict=True):
        after, best = step.t > 0, step.best
        swings = free_swings(step.t[after], step.P[after], step.x[after], best, step.noise)[:2]
        expected = [abs(step.stroke) * np.exp(-best.D * best.w * one.at) for one in swings]
        sizes = [(one.size, size) for one, size in zip(swings, expected, strict=True) if size > CLEAR * step.noise]
        stopped = stopped or any(size < STOPPED * more for size, more in sizes)
        if symbol == "K":
            others += [mass * one.w**2 for one in swings[:1] if one.size > CLEAR * step.noise]
        elif len(sizes) > 1:
            others.append(_without_friction(swings[0], swings[1], mass))
    unit = "stiffness" if symbol == "K" else "damping"
    apart = abs(float(np.mean(others)) - value) - wide if others else 0.0
    text = f"the free swinging after the step gives a {symbol} that is {show(apart, unit, 2)} outside of its range"
    why = "the curve is bent, or the pressure is later than was said"
    if symbol == "B":
        why = "friction does not grow with the speed, for small swings die faster"
    if stopped:
        apart, text = abs(value), "the swinging after the step ends early"
        why = "dry friction holds it, and this form has none"
    return [Doubt("free swinging", "method", apart, seen=True, reason=f"{text}: {why}; {INSTEAD}")] if apart > 0 else []


def _without_friction(first: Swing, second: Swing, mass: float) -> float:
    """B [N s/m] of two stretches of free swinging: dry friction adds c/size, so a line over 1/size is B without it."""
    big, small = first.size, second.size
    one, other = (2 * mass * swing.D * swing.w for swing in (first, second))
    return (one * big - other * small) / (big - small) if big > small else one


def _ill_fitted(step: Step) -> str:
    share = max(motion.rms for motion in step.motions) / abs(step.stroke)
    return f"the misfit is {share:.0%} of the stroke (trial {step.name})" if share > ILL_FITTED else ""


def _why_not(step: Step) -> str:
    """The reason why the motion of a step says nothing of K; empty where it does."""
    damped = max(motion.D for motion in step.motions)
    frequencies = [motion.w for motion in step.motions]
    hidden = "its mass shows in a fast pole only, which a few ms between pressure and position hide"
    if damped >= RINGS:
        most = f"{damped:.1f}" if damped < DAMPING[1] / 1.02 else f"{DAMPING[1]:g} or more"
        return f"the motion does not ring (damping ratio {most}, less than {RINGS:g} is needed): {hidden}"
    if min(frequencies) <= 1.02 * FREQUENCY[0] or max(frequencies) >= FREQUENCY[1] / 1.02:
        low, high = FREQUENCY
        return f"the motion does not ring (no natural frequency from {low:g} to {high:g} rad/s fits it): {hidden}"
    if why := _ill_fitted(step):
        return why
    end = float(np.median(step.x[step.t > step.t[-1] - 1.0]))
    seen = extremes(step.x[step.t > 0], end, step.noise)
    if seen < 2:
        return f"the motion does not ring ({seen} extremes beyond {SHOWN:g} times its noise, 2 are needed): {hidden}"
    return ""


def _sentences(at: Mapping[str, float], steps: Sequence[Step]) -> list[Finding]:
    where = f"{show(at['from'], 'pressure')} to {show(at['pressure'], 'pressure')}"
    overshoot = [
        float(np.max(np.sign(s.size) * (s.P[s.t > 0] - np.median(s.P[s.t > AFTER])))) / abs(s.size) for s in steps
    ]
    best = [step.best.late for step in steps]
    lines = []
    if np.mean(overshoot) > OVERSHOOT:
        text = f"{where}: the pressure overshoots by {float(np.mean(overshoot)):.0%}: no first-order lag describes it"
        lines.append(Finding("note", text))
    if max(best) > 0:
        lines.append(
            Finding(
                "note",
                f"{where}: the motion fits best with the pressure {show(float(np.mean(best)), 'time', 2)} late: "
                "position seems to move before the pressure that drives it",
            )
        )
    return lines


def _facts(step: Step) -> dict[str, Any]:
    return {
        "trial": step.name,
        "from": step.trial.point["from"],
        "pressure": step.trial.point["pressure"],
        "size": step.size,
        "stroke": step.stroke,
        "motions": [
            {"late": m.late, "natural_frequency": m.w, "damping_ratio": m.D, "gain": m.g, "rms": m.rms}
            for m in step.motions
        ],
    }


def _trace(step: Step, *, by_load: bool) -> Trace:
    """The first trial of a pair of pressures, measured and with the best motion."""
    near = step.near
    point = step.trial.point
    before, after = point["from"], point["pressure"]
    return Trace(
        name=f"step-{before / 1e3:.0f}-{after / 1e3:.0f}kPa" + (f"-{_load(step)[0]:.0f}N" if by_load else ""),
        figure="overlay",
        title=f"{show(before, 'pressure')} to {show(after, 'pressure')}: measured and fitted motion",
        columns={"t": step.t[near], "pressure": step.P[near], "displacement": step.x[near], "model": step.best.model},
        quantities={"t": "time", "pressure": "pressure", "displacement": "length", "model": "length"},
        marks={"pressure": after, "load": point.get("load", 0.0)},
    )


def offers(analysis: Analysis) -> Iterator[Offer]:
    """K and B where the motion rings, at the pressure that the step ends at; each step for itself."""
    for symbol in ("K", "B"):
        yield from (everywhere(symbol, {e.at["pressure"]: e}) for e in values_of(analysis, symbol, RINGING))
