"""Open-loop pressure steps: K_u and T_u by set-point of the loop that a controller would have.

Command to pressure and pressure to displacement are fitted separately; K_u and T_u follow from the phase equation. Rest
positions that depend on the direction of approach show friction. Uses the trials' samples and commands.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import hypot, isfinite, sqrt

import numpy as np

from pmabench.analysis.shared import skew
from pmabench.analysis.shared.calibration import Scales
from pmabench.analysis.shared.form import Doubt, change_over, weighed
from pmabench.analysis.shared.samples import STEPS, step_of
from pmabench.base.quantities import show
from pmabench.kinds.ultimate_gain import ways
from pmabench.kinds.ultimate_gain.open_loop_fit import (
    Flow,
    Friction,
    Moved,
    Regulator,
    Step,
    better_by,
    fit,
    flow_limited,
    gauge_filter,
    hunting,
    read_in_steps,
)
from pmabench.kinds.ultimate_gain.open_loop_response import without_model
from pmabench.kinds.ultimate_gain.ways import Examined, GainCell, Pair
from pmabench.model.loop import Loop, Ultimate, ultimate
from pmabench.store.analyses.results import Estimate, Finding, Parts, Trace
from pmabench.store.records import Array, RunData, TrialData

PHASE = "open-loop"
BEFORE = 0.5
"""Time before the first step that is used [s]."""
FEWEST_CYCLES = 3
GAP = {"doubt": 0.002, "fault": 0.04}
"""Distance of the rest positions from both sides, relative to the swing between the outer ones: 0 without friction."""
FILTERED = "the displacement moves before the measured pressure does: the gauge has a filter"
FILTER_LEAVES = 0.5
"""If the displacement is still early by this share after correction for a filter of the gauge, the gauge has a delay
instead.
"""
LEAST_DRIFT = 1e-3
"""Drifts over all cycles that are smaller, as a share of the swing, change nothing."""
SURE, ALIKE, SHOWN = 10.0, 4.0, 2.0
"""Twice the log likelihood ratio from which on one form is certain, below which two are equivalent, and from which on
the simplest form is not enough.
"""
OF_GAP = 7.0
"""Relative error of K_u and T_u per gap of the rest positions: an upper bound found with play and creep in loops of
known gain.
"""


OFF = 0.01
"""Relative difference of the steps of pressure and command, beyond calibration, from which on the pressure counts as
not following.
"""
OF_SWING = {"K_u": 5.0, "T_u": 1.0}
"""Relative error of K_u and T_u per relative swing of the pressure at rest, found with 1 to 4 Hz."""


Departure = tuple[Doubt, Sequence[float] | Array]
"""A possible departure of the trial from its form, and its effect on K_u and T_u as shares."""


@dataclass(frozen=True, eq=False)
class StepsFound(Examined):
    """Result of one trial."""

    regulator: Regulator | None = None
    moved: Moved | None = None
    friction: Friction | None = None
    cycles: tuple[Ultimate, ...] = ()
    """K_u and T_u of each cycle of four steps fitted alone; their scatter gives the interval."""
    spans: tuple[float, float] = (0.0, 0.0)
    """Relative distance of K_u and of T_u with the lags of one direction alone, the larger of both."""
    amplitude: float = 0.0
    """Height of the steps [Pa]."""
    steps: tuple[Step, ...] = ()
    departures: tuple[Departure, ...] = ()
    """Possible departures from the form of the loop."""

    @property
    def pair(self) -> Pair:
        """K_u and T_u of its loop, with the scatter of its cycles."""
        return Pair.of(self.loop, self.cycles)

    @property
    def sided(self) -> Departure:
        """Effect on K_u and T_u of rest positions that depend on the direction of approach."""
        gap = 0.0 if self.friction is None else abs(self.friction.gap)
        reason = (
            f"rests reached from above and from below lie {gap:.2%} of the swing apart: friction, play or creep, which "
            "the fitted loop has not. Take larger steps, or a closed loop"
        )
        doubt = Doubt("rests that depend on their side", "method", 0.0, gap > GAP["doubt"], reason)
        return doubt, (OF_GAP * gap, OF_GAP * gap)

    @property
    def bent(self) -> float:
        """Change of the slope of displacement over pressure within the steps, over the slope [1]."""
        return 0.0 if self.moved is None else abs(2 * self.moved.curvature * self.amplitude / self.moved.gain)


def steps_of(trial: TrialData) -> list[Step]:
    """The steps of the command in a trial, as they were sent; empty where there are none."""
    found: list[Step] = []
    before = None
    for command in trial.commands:
        if command.phase != PHASE or command.kind != "set":
            continue
        value = float(command.data.get("sent", command.value))
        before = command.before if before is None else before
        found.append(Step(command.t, value, value - before))
        before = value
    return found


def examine(run: RunData, trial: TrialData) -> StepsFound:
    """The loop from the steps of a trial at its set-point, or why there is none."""
    steps = steps_of(trial)
    cycles = [steps[i : i + 4] for i in range(0, len(steps) - 3, 4)]
    if len(cycles) < FEWEST_CYCLES or trial.status != "finished":
        return StepsFound(refused=(f"{len(cycles)} whole cycles of steps, {FEWEST_CYCLES} are needed",))
    amplitude = max(abs(step.height) for step in steps)
    period = 1 / run.rate if run.rate > 0 else float(np.median(np.diff(trial.t)))
    t, x, P = samples_of(trial, steps, period)
    drift = drift_of(t, x, cycles)
    x = x - drift * (t - t.mean()) if drift else x
    declared = run.channels["pressure"].sensor_lag if "pressure" in run.channels else 0.0
    found = _fitted(t, x, P, steps, declared)
    if isinstance(found, str):
        return StepsFound(refused=(found,))
    regulator, moved, friction, late = found.regulator, found.moved, found.friction, found.undeclared
    refused, doubts = _against(friction, amplitude)
    if late:
        doubts.append(
            f"{FILTERED} of {show(late, 'time', 2)}, which is taken off: declare the `sensor_lag` of its channel"
        )
    if drift:
        doubts.append(
            f"from cycle to cycle the displacement moves on, by {show(60 * drift, 'length', 2)} in a minute, which is "
            "taken off: its gauge drifts, or the muscle creeps"
        )
    off = _pressure_at(moved, trial.point.get("setpoint", moved.x0))
    if off is None or abs(off) > amplitude:
        refused.append(_elsewhere(moved, trial.point, amplitude))
    loop = _loop(regulator, moved, period, off or 0.0)
    if loop is None:
        refused.append("the fitted parts make no loop that could oscillate")
    known = StepsFound(
        regulator, moved, friction, amplitude=amplitude, steps=tuple(steps), refused=tuple(refused),
        doubts=tuple(doubts),
    )  # fmt: skip
    if refused or loop is None:
        return known
    sizes = [step_of(trial.channels[name][trial.usable]) for name in ("displacement", "pressure")]
    gains = Scales.of([run]).gains
    apart = hypot(*(gains.get(name, 0.0) for name in ("pressure", "pressure_command")))
    apart += sizes[1] / amplitude if isfinite(sizes[1]) else 0.0
    return _with_spread(known, loop, found, (t, x, P), cycles, apart, off or 0.0, sizes)


@dataclass(frozen=True)
class _Fitted:
    """Both fitted parts of a trial, and the gauge's filter."""

    regulator: Regulator
    moved: Moved
    friction: Friction
    lag: float
    """Time constant of the gauge's filter [s]."""
    undeclared: float = 0.0
    """Part of `lag` that is not declared [s]."""
    other: tuple[Regulator, Moved] | None = None
    """Alternative with a delay of the gauge in place of its filter, or vice versa, if the record does not decide; or
    with the first guess of an undeclared filter.
    """


def _fitted(t: Array, x: Array, P: Array, steps: Sequence[Step], declared: float) -> _Fitted | str:
    """Both parts, with the declared lag of the gauge [s] as a filter or as a delay, whichever fits better.

    A delay of the gauge needs no correction: the displacement is then fitted as earlier by it, and the sum in the loop
    is right.
    """
    found = fit(t, x, P, steps, declared)
    if isinstance(found, str):
        return found
    lag, other = declared, None
    delayed = fit(t, x, P, steps, 0.0) if declared else found
    if declared and not isinstance(delayed, str):
        better = better_by(delayed[:2], found[:2], len(t))
        if better > 0:
            lag, found, delayed = 0.0, delayed, found
        other = delayed[:2] if abs(better) < SURE else None
    late = gauge_filter(*found[:2])
    again = fit(t, x, P, steps, lag + late) if late else ""
    if isinstance(again, str) or abs(again[1].late) > FILTER_LEAVES * late:
        return _Fitted(*found, lag, 0.0, other)
    late, other = late - again[1].late, again[:2]
    closer = fit(t, x, P, steps, lag + late)
    return _Fitted(*(again if isinstance(closer, str) else closer), lag + late, late, other)


def _with_spread(
    known: StepsFound, loop: Loop, found: _Fitted, samples: tuple[Array, Array, Array],
    cycles: Sequence[Sequence[Step]], apart: float, off: float, sizes: Sequence[float],
) -> StepsFound:  # fmt: skip
    """`known` with its `loop` from the parts in `found`, and the results of single cycles, single directions and other
    forms.

    `apart` is the largest relative difference of gauge and command at rest [1], `off` the pressure from the bias [Pa],
    `sizes` are the reading steps of displacement [m] and pressure [Pa].
    """
    (t, _, P), lag, truth = samples, found.lag, ultimate(loop)
    fitted = regulator, moved = found.regulator, found.moved
    period = float(t[1] - t[0])

    def ends(parts: Iterable[tuple[Regulator, Moved]]) -> list[Ultimate]:
        return [ultimate(loop) for pair in parts if (loop := _loop(*pair, period, off)) is not None]

    during = [(t >= c[0].t - BEFORE) & (t < c[-1].t + (c[-1].t - c[-2].t)) for c in cycles]
    parts = [[y[at] for y in samples] for at in during]
    alone = [fit(t, x, P, cycle, lag, fitted) for (t, x, P), cycle in zip(parts, cycles, strict=True)]
    single = ends(part[:2] for part in alone if not isinstance(part, str))
    sides = ends(
        (replace(regulator, fill=way, vent=way), replace(moved, tau=(tau, tau)))
        for way, tau in zip((regulator.fill, regulator.vent), moved.tau, strict=True)
    )
    flow = flow_limited(t, P, known.steps, lag)
    doubts = _pressures(regulator, hunting(P, t, known.steps), apart)
    doubts += [] if flow is None else [_flow(flow, truth, ends([(flow.small(regulator), moved)]))]
    if other := ends([found.other] if found.other is not None else []):
        doubts.append((Doubt("delay or filter of the gauge", "method", 0.0, False), _apart(other[0], truth)))
    doubts.append((Doubt(STEPS, "method", 0.0, False), read_in_steps(samples[1:], sizes)))
    if (at_bias := _loop(regulator, moved, period, 0.0)) is not None:
        doubts.append(without_model(t, samples[1], cycles, at_bias))
    spans = np.max([_apart(end, truth) for end in sides] or [(0.0, 0.0)], axis=0).tolist()
    return replace(known, loop=loop, cycles=tuple(single), spans=(spans[0], spans[1]), departures=tuple(doubts))


def _pressures(regulator: Regulator, swing: float, apart: float) -> list[Departure]:
    """Effects of a pressure that does not follow the command, or varies by itself by the share `swing` of the steps.

    `apart` is the largest relative difference of gauge and command at rest by their gains and reading steps [1].
    """
    short = abs(regulator.gain - 1)
    astray = (
        f"the steps of the pressure are {short:.1%} off those of the command: it meets a limit, or gauge and "
        "command are not calibrated alike. Take a bias or steps that it reaches, or calibrate both"
    )
    hunts = (
        f"at rest the pressure swings by {swing:.1%} of the steps (rms), as a regulator that hunts does. Take larger "
        "steps, or settle the regulator"
    )
    swings = Doubt("pressure that swings by itself", "method", 0.0, True, hunts)
    return [
        (Doubt("pressure over command", "method", 0.0, True, astray), (short if short > apart + OFF else 0.0, 0.0)),
        (swings, (OF_SWING["K_u"] * swing, OF_SWING["T_u"] * swing)),
    ]


def drift_of(t: Array, x: Array, cycles: Sequence[Sequence[Step]]) -> float:
    """Drift of the cycles' mean displacement [m/s]; 0 if not significant."""
    during = [(t >= c[0].t) & (t < c[-1].t + (c[-1].t - c[-2].t)) for c in cycles]
    means = np.array([x[at].mean() for at in during if at.any()])
    change = change_over([means]) if len(means) == len(cycles) else None
    if change is None or not change.seen or change.size < LEAST_DRIFT * np.ptp(x):
        return 0.0
    return float(np.polyfit([cycle[0].t for cycle in cycles], means, 1)[0])


def _apart(one: Ultimate, other: Ultimate) -> tuple[float, float]:
    """Relative distance of K_u and of T_u."""
    return abs(one.gain / other.gain - 1), abs(one.period / other.period - 1)


def _flow(flow: Flow, truth: Ultimate, small: Sequence[Ultimate]) -> Departure:
    """Effect of a valve that may limit the flow, if that fits as well as any lags.

    A limit at 90 % of the flow that the steps need is hidden by noise, but still delays them by 0.5 ms.
    """
    alike = flow.better > -ALIKE
    reason = (
        f"the pressure changes at no more than {flow.rate / 1e3:.0f} kPa/s while it is far from the command, which "
        "the fitted loop has not: a valve that limits the flow, filling and venting that begin after unlike times, or "
        "a pressure that has not settled before the next step. Take smaller steps, or longer holds"
    )
    seen = alike and flow.needed > SHOWN
    doubt = Doubt("a valve that limits the flow", "method", 0.0, seen, reason if flow.better > SURE else "")
    return doubt, alike * np.max([_apart(one, truth) for one in small] or [(0.0, 0.0)], axis=0)


def samples_of(trial: TrialData, steps: Sequence[Step], period: float) -> tuple[Array, Array, Array]:
    """Evenly spaced times [s], displacement [m] and pressure relative to the bias [Pa], from before the first step on.

    Flagged samples are replaced by interpolation.
    """
    x, P = trial.channels["displacement"], trial.channels["pressure"]
    mask = (trial.t >= steps[0].t - BEFORE) & trial.usable & np.isfinite(x) & np.isfinite(P)
    if mask.sum() < 2:
        return (np.empty(0),) * 3
    grid = np.arange(trial.t[mask][0], trial.t[mask][-1], period)
    return grid, np.interp(grid, trial.t[mask], x[mask]), np.interp(grid, trial.t[mask], P[mask]) - steps[3].value


def _pressure_at(moved: Moved, setpoint: float) -> float | None:
    """Pressure relative to the bias at which the muscle rests at `setpoint` [m]; None if the fitted curve has none."""
    away = setpoint - moved.x0
    inner = moved.gain**2 + 4 * moved.curvature * away
    return 2 * away / (moved.gain + sqrt(inner)) if inner > 0 else None


def _elsewhere(moved: Moved, point: Mapping[str, float], amplitude: float) -> str:
    reach = sorted(moved.x0 + moved.gain * p + moved.curvature * p * p for p in (-amplitude, amplitude))
    text = f"the steps led from {show(reach[0], 'length', 3)} to {show(reach[1], 'length', 3)} and not through the"
    text += f" set-point of {show(point.get('setpoint', 0.0), 'length', 3)}"
    wanted = point.get("bias", 0.0) + (point.get("setpoint", 0.0) - moved.x0) / moved.gain
    return f"{text}; try a bias of {show(wanted, 'pressure', 3)}" if wanted > 0 else text


def _against(friction: Friction, amplitude: float) -> tuple[list[str], list[str]]:
    """Reasons to refuse the result, and weaknesses of it."""
    gap = abs(friction.gap)
    text = f"rests reached from above and from below lie {gap:.1%} of the swing apart"
    if friction.balance.coulomb > 0:
        text += f", dry friction takes {show(friction.balance.coulomb, 'pressure', 2)} of the steps' "
        text += show(amplitude, "pressure", 2)
    if not gap <= GAP["fault"]:
        return [f"stiction: {text}"], []
    return [], [f"as with friction, {text}"] if gap > GAP["doubt"] else []


def _loop(regulator: Regulator, moved: Moved, period: float, off: float) -> Loop | None:
    """Loop for a controller sampled every `period` [s] at `off` [Pa] from the bias; None if it could not oscillate.

    The sample hold adds half a period; lags of filling and venting, and of both directions, are averaged.
    """
    gain = regulator.gain * (moved.gain + 2 * moved.curvature * off)
    lags = (*regulator.mean.lags(1.0), *ways.lags_of(sum(moved.tau) / 2, moved.beta))
    dead_time = max(0.0, regulator.dead_time + moved.late) + period / 2
    return ways.oscillating(gain, dead_time, [lag for lag in lags if lag])


METHOD = "open-loop"
DAMPING = 0.25
"""Error of the mean as a share of the difference between the two directions' K_u and T_u."""


@dataclass(frozen=True)
class StepsCell(GainCell[StepsFound]):
    """All open-loop trials at one operating point."""

    called = "trials of steps"
    method = METHOD
    alone = "one trial: the repeats part is the scatter between its cycles"
    note = "the method part is what unlike lags in the two directions and the bend of the steps are worth"

    @property
    def apart(self) -> float:
        """Bound of the time between commands and displacement [s], all of which is in the loop's dead time."""
        return max(super().apart, skew.off([one.run for one in self.members], "displacement"))

    def findings(self) -> list[Finding]:
        """Problems of the trials, the fitted loop, and effects of friction."""
        lines = super().findings()
        known = next((one.found for one in self.good), None)
        if known is not None and known.loop is not None and known.moved is not None:
            up, down = known.moved.tau
            muscle = f"that of the muscle {up:.3g} s contracting and {down:.3g} s relaxing"
            text = f"at {self.where} the steps give {ways.described(known.loop)}, {muscle}: {ways.limit_of(known.loop)}"
            lines.append(Finding("note", text))
        return lines

    def traces(self) -> list[Trace]:
        """Command, pressure and displacement of the last cycle, and the fitted displacement."""
        trial, found = self.shown.trial, self.shown.found
        steps = steps_of(trial)
        if len(steps) < 4:
            return []
        begin = steps[-4].t - 0.2
        t, x, P = samples_of(trial, steps, 1 / self.shown.run.rate)
        mask = t >= begin
        columns: dict[str, Array] = {"t": t[mask] - begin, "displacement": x[mask]}
        if found.moved is not None:
            columns["model"] = found.moved.fitted(t, P, steps)[mask]
        columns["pressure"] = P[mask] + steps[3].value
        return [self.trace("open-loop", "Open-loop steps", columns, {"setpoint": self.at.get("setpoint", 0.0)})]

    def _estimate(self, place: int) -> Estimate:
        good, value = [one.found for one in self.good], self.mean(place)
        damping = DAMPING * max(found.spans[place] for found in good)
        bent = 0.0 if place else max(found.bent for found in good) ** 2 / 2
        estimate = self.estimate(place, Parts(method=value * hypot(damping, bent), skew=self.by_clocks(place)))
        every = [one for found in good for one in (found.sided, *found.departures)]
        doubts = [replace(doubt, half=value * float(shares[place])) for doubt, shares in every]
        worst = {one.name: one for one in sorted(doubts, key=lambda one: one.half)}
        return skew.settled(weighed(estimate, worst.values()), "the commands and the displacement", self.apart)
