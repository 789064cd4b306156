"""The papers' step-exponential method: K, F_ce and B = K tau from exponentials; dead times.

It assumes a pressure step, which biases B where the regulator is slow; kept for comparison. Uses the trials and the
primary method's results, and does not change the latter.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import hypot, isfinite, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmabench.analysis.shared import skew
from pmabench.analysis.shared.calibration import Scales, calibrated, sentences
from pmabench.analysis.shared.samples import KINDS, Samples, dead_times
from pmabench.analysis.shared.student import half_width, mean_over
from pmabench.analysis.shared.trials import grouped
from pmabench.base.quantities import show
from pmabench.kinds.contraction_relaxation.bandwidth import Recorded
from pmabench.kinds.contraction_relaxation.diagnosis.hiding import GAIN, ZERO
from pmabench.kinds.contraction_relaxation.intervals import AT_REST, CORRECTED, Pooled
from pmabench.kinds.contraction_relaxation.pooled import SYMBOLS
from pmabench.kinds.contraction_relaxation.segments import Campaign, Gate
from pmabench.kinds.contraction_relaxation.values import QUANTITY, biases, curve, with_bias
from pmabench.store.analyses.results import Curve, Estimate, Finding, Parts, without_value
from pmabench.store.records import Array, TrialData

LEAST_STEP = 0.2e-3
"""Steps that move less are not fitted [m]."""
MOST_SAMPLES = 1000
TOGETHER = 32
"""Steps that are fitted at once: few enough to stay in the fast memory of the processor."""
ITERATIONS = 60


@dataclass(frozen=True)
class Exponential:
    """x(t) = start, then start + (end - start)(1 - exp(-(t - t_d) / tau)) from t_d on (paper 0)."""

    start: float
    end: float
    t_d: float
    """From the command [s]."""
    tau: float
    rms: float
    """Rms residual [m]."""


@dataclass(frozen=True)
class Step:
    """One step of one trial, fitted."""

    trial: int
    phase: str
    load: float
    pressure: float
    """Commanded target [Pa]."""
    fit: Exponential


@dataclass(frozen=True)
class Regression:
    """K and F_ce at one pressure from final contractions over loads, with standard errors; None where unknown."""

    K: float
    F_ce: float
    se_K: float | None
    se_F_ce: float | None
    n: int


def exponentials(t: Array, x: Array, start: Array) -> list[Exponential | None]:
    """Least squares for end, t_d and tau of each step by damped Gauss-Newton, all steps at once; None where it fails.

    `t` [s] from the command and `x` [m] have shape (m, n), `start` [m] has shape (m, 1).
    """
    end = x[:, -max(3, x.shape[1] // 20) :].mean(axis=1)
    share = (x - start) / (end[:, None] - start)
    t28, t63 = (t[np.arange(len(t)), np.argmax(share > level, axis=1)] for level in (0.283, 0.632))
    tau = np.maximum(1.5 * (t63 - t28), 2 * (t[:, 1] - t[:, 0]))
    theta, longest = np.stack([end, np.maximum(0.0, t63 - tau), tau], axis=1), 10 * (t[:, -1] - t[:, 0])

    def residual(rows: NDArray[np.intp], at: Array) -> tuple[Array, Array, Array]:
        since = np.maximum(t[rows] - at[:, 1:2], 0.0)
        fade = np.exp(-since / at[:, 2:])
        return x[rows] - start[rows] - (at[:, :1] - start[rows]) * (1 - fade), fade, since

    going = np.arange(len(t))
    left, damping = residual(going, theta), np.full(len(t), 1e-3)
    for _ in range(ITERATIONS):
        at, (r, fade, since) = theta[going], (values[going] for values in left)
        grown = (at[:, :1] - start[going]) * fade / at[:, 2:]
        jacobian = np.stack([1 - fade, -grown * (since > 0), -grown * since / at[:, 2:]], axis=2)
        turned = jacobian.transpose(0, 2, 1)
        normal = turned @ jacobian
        diagonal = np.einsum("ijj->ij", normal)
        diagonal += damping[going, None] * diagonal + 1e-30
        move = np.linalg.solve(normal, turned @ r[:, :, None])[:, :, 0]
        tried = at + move
        within = (tried[:, 2] > 0) & (tried[:, 2] <= longest[going])
        new = residual(going, np.where(within[:, None], tried, at))
        better = within & [bool(one @ one <= other @ other) for one, other in zip(new[0], r, strict=True)]
        theta[going[better]] = tried[better]
        for values, changed in zip(left, new, strict=True):
            values[going[better]] = changed[better]
        damping[going] = np.where(better, np.maximum(1e-9, damping[going] / 5), damping[going] * 10)
        small = np.all(np.abs(move) < 1e-7 * np.abs(tried) + 1e-9, axis=1)
        going = going[~np.where(better, small, within & (damping[going] > 1e9))]
        if not len(going):
            break
    rms = np.sqrt(np.mean(left[0] ** 2, axis=1))
    found = zip(start[:, 0].tolist(), *theta.T.tolist(), rms.tolist(), strict=True)
    return [Exponential(*one) if all(map(isfinite, one[1:4])) else None for one in found]


def steps_of(trials: Iterable[tuple[Samples, TrialData]], lift: float) -> list[Step]:
    """Fits to the contraction and relaxation steps of trials that move and end off the support."""
    moves = [move for samples, trial in trials for move in _moves(samples, trial, lift)]
    alike = grouped(range(len(moves)), lambda number: len(moves[number][1]))
    together = [rows[first : first + TOGETHER] for rows in alike.values() for first in range(0, len(rows), TOGETHER)]
    fitted: dict[int, Exponential | None] = {}
    for rows in together:
        t, x, start = (np.array([moves[number][place] for number in rows]) for place in (1, 2, 3))
        fitted |= dict(zip(rows, exponentials(t, x, start[:, None]), strict=True))
    known = [(moves[number][0], fit) for number, fit in sorted(fitted.items())]
    return [Step(*about, fit) for about, fit in known if fit is not None]


Move = tuple[tuple[int, str, float, float], Array, Array, float]
"""Fields of a `Step` without its fit, times from the command [s], contraction, and contraction at the start [m]."""


def _moves(samples: Samples, trial: TrialData, lift: float) -> Iterator[Move]:
    """The steps of a trial."""
    commands = [c for c in trial.commands if c.output == "pressure" and c.phase in ("contract", "relax", "vent")]
    ends = [*(c.t for c in commands[1:]), float(samples.t[-1]) + 1e-9]
    t, x = samples.t[samples.ok], samples.x[samples.ok]
    for command, end in zip(commands, ends, strict=False):
        first, last = np.searchsorted(t, (command.t - 1e-9, end - 1e-9)).tolist()
        before = x[slice(*np.searchsorted(t, (command.t - 0.2, command.t + 1e-9), side="right"))]
        if last - first < 50 or not len(before) or command.phase == "vent":
            continue
        mine = x[first:last]
        start, rest = float(np.mean(before)), float(np.mean(mine[-len(mine) // 20 :]))
        if abs(rest - start) < LEAST_STEP or rest < lift:
            continue
        rows = slice(first, last, -(-len(mine) // MOST_SAMPLES))
        yield (samples.trial, command.phase, samples.load, command.value), t[rows] - command.t, x[rows], start


def regress(load: Array, x: Array) -> Regression | None:
    """Two parameters: x = (F_ce - F_L) / K by least squares of x on F_L (noise is in x); None below 2 loads."""
    if len(np.unique(load)) < 2:
        return None
    off = load - load.mean()
    power = float(off @ off)
    slope = float(off @ x) / power
    if slope >= 0:
        return None
    K = -1.0 / slope
    F_ce = K * float(x.mean()) + float(load.mean())
    left = len(load) - 2
    if left < 1:
        return Regression(K, F_ce, None, None, len(load))
    residual = x - x.mean() - slope * off
    variance = float(residual @ residual) / left
    se_K = K**2 * sqrt(variance / power)
    se_F = K * sqrt(variance * (1 / len(load) + (F_ce - float(load.mean())) ** 2 / power))
    return Regression(K, F_ce, se_K, se_F, len(load))


METHOD = "step-exponential"
ONSET = "onset"
ONCE = "no repeats part: each load and pressure was tested once"
SINGLE = "no repeats part: too few points for scatter about their line"


@dataclass(frozen=True)
class _Raw:
    """An estimate, and its derivative by the relative gain and the offset of each channel except pressure."""

    estimate: Estimate
    gains: Mapping[str, float]
    offsets: Mapping[str, float]


@dataclass(frozen=True)
class Stepwise:
    """Results of the papers' method."""

    estimates: tuple[Estimate, ...]
    curves: tuple[Curve, ...]
    findings: tuple[Finding, ...]
    steps: list[dict[str, Any]]
    """The fitted steps as plain data [SI]."""


def compare(pooled: Pooled, found: Sequence[Estimate]) -> Stepwise:
    """The papers' estimates compared with those of the primary method, `found`."""
    campaign, moved = pooled.campaign, np.unique(pooled.segments.trial).tolist()
    seen = {cause.name for cause in pooled.trust.causes if cause.seen} & {GAIN, ZERO, AT_REST.format("displacement")}
    seen |= {CORRECTED for one in pooled.diagnosis.of_cell if one.key == "gain"}
    scales = Scales.of(campaign.runs)
    steps = steps_of(((campaign.samples[n], campaign.trials[n]) for n in moved), Gate.lift)
    at_each = {(e.symbol, e.at["pressure"]): e for e in found if "pressure" in e.at}
    reference = {key: e for key, e in at_each.items() if e.value is not None}
    raw = [
        entry
        for P in campaign.tested
        for entry in _at(campaign, P, [step for step in steps if abs(step.pressure - P) < 1.0])
    ]
    weighed = [_weighed(e, at_each, seen) for e in _calibrated(raw, scales)]
    estimates = [_with_bias(e, reference) for e in weighed]
    known = [e for e in estimates if e.value is not None]
    curves = [curve([e for e in known if e.symbol == symbol], 1) for symbol in SYMBOLS]
    table = [
        {
            "trial": campaign.name(step.trial),
            "phase": step.phase,
            "load": step.load,
            "pressure": step.pressure,
            "x_inf": step.fit.end,
            "t_d": step.fit.t_d,
            "tau": step.fit.tau,
            "misfit_rms": step.fit.rms,
        }
        for step in steps
    ]
    ordered = sorted(estimates, key=lambda e: (*SYMBOLS, "tau_c", "tau_r").index(e.symbol))
    return Stepwise(
        tuple(ordered), tuple(through for through in curves if through is not None), _findings(estimates), table
    )


def _at(campaign: Campaign, P: float, steps: Sequence[Step]) -> list[_Raw]:
    """The papers' coefficients at one pressure [Pa]."""
    contract, relax = ([step for step in steps if step.phase == phase] for phase in ("contract", "relax"))
    loads, x = np.array([(step.load, step.fit.end) for step in contract]).reshape(-1, 2).T
    regression = regress(loads, x)
    half_K: float | None = None
    result: list[_Raw] = []

    def add(
        symbol: str, value: float, parts: Parts, among: Sequence[Step], gains: Mapping[str, float],
        offsets: Mapping[str, float], note: str = "",
    ) -> None:  # fmt: skip
        unit, quantity = QUANTITY.get(symbol, ("s", "time"))
        names = tuple(dict.fromkeys(campaign.name(step.trial) for step in among))
        found = Estimate(symbol, value, unit, quantity, METHOD, {"pressure": P}, parts, len(names), trials=names)
        result.append(_Raw(replace(found, note=note), gains, offsets))

    if regression is not None:
        half, half_K = (half_width(se, regression.n - 2) for se in (regression.se_F_ce, regression.se_K))
        note = "" if half is not None else SINGLE
        add("F_ce", regression.F_ce, Parts(half), contract, {"displacement": 0.0}, {"displacement": regression.K}, note)
        add("K", regression.K, Parts(half_K), contract, {"displacement": -regression.K}, {}, note)
    for symbol, members in (("c", contract), ("r", relax)):
        if not members:
            continue
        of_loads = [step.load for step in members]
        tau, half, ends = mean_over([step.fit.tau for step in members], of_loads)
        several = len(set(of_loads)) > 1
        note = _spread("the loads", ends) if several else "no method part: one load"
        once = "" if half is not None else ONCE
        parts = Parts(half, max(ends[1] - tau, tau - ends[0]) if several else None)
        add(f"tau_{symbol}", tau, parts, members, {}, {}, sentences(once, note))
        if regression is not None:
            both = None if half is None or half_K is None else hypot(regression.K * half, tau * half_K)
            gains = {"displacement": -regression.K * tau}
            add(f"B_{symbol}", regression.K * tau, Parts(both), members, gains, {}, once or ("" if half_K else SINGLE))
    return result


def _calibrated(raw: Sequence[_Raw], scales: Scales) -> list[Estimate]:
    """The estimates with their calibration part; the weights are taken as exact.

    Pressure enters through the slope of the coefficient over the tested pressures: an estimate is given for a pressure
    P that may be off by o + g P, with offset o and gain g.
    """
    result = []
    for one in raw:
        e = one.estimate
        alike = [r.estimate for r in raw if r.estimate.symbol == e.symbol]
        gains, offsets, alone = dict(one.gains), dict(one.offsets), ""
        if len(alike) > 1:
            P = [other.at["pressure"] for other in alike]
            slopes = np.gradient(np.array([other.value for other in alike]), np.array(P))
            offsets["pressure"] = float(slopes[P.index(e.at["pressure"])])
            gains["pressure"] = offsets["pressure"] * e.at["pressure"]
        else:
            alone = "calibration part without that of the pressure: one pressure only"
        result.append(calibrated(replace(e, note=sentences(e.note, alone)), scales, gains, offsets))
    return result


def _weighed(e: Estimate, found: Mapping[tuple[str, float], Estimate], seen: Collection[str]) -> Estimate:
    """The estimate with its change if the weights were wrong and not the cell, as the primary estimates `found` have
    it.
    """
    known = found.get((e.symbol, e.at["pressure"]))
    open_by = sum(line.half or 0.0 for line in known.budget if line.name in seen) if known is not None else 0.0
    if not open_by:
        return e
    return replace(e, parts=replace(e.parts, calibration=(e.parts.calibration or 0.0) + open_by))


def _with_bias(estimate: Estimate, reference: Mapping[tuple[str, float], Estimate]) -> Estimate:
    """The estimate with its difference to the primary method as bias, not subtracted, and as method part."""
    if estimate.symbol not in SYMBOLS:
        return estimate
    known = reference.get((estimate.symbol, estimate.at["pressure"]))
    if known is None or estimate.value is None:
        note = "the pressure is taken for a step, and measured-pressure gives no value to hold that against"
        return without_value(estimate, note)
    return with_bias(estimate, known)


def _findings(estimates: Sequence[Estimate]) -> tuple[Finding, ...]:
    """Differences between the papers' method and the primary one."""
    parts = biases(estimates, ("B_c", "B_r", "K"))
    forces = [e.bias for e in estimates if e.symbol == "F_ce" and e.bias is not None]
    if forces:
        parts.append(f"F_ce {min(forces):+.2g} to {max(forces):+.2g} N")
    if not parts:
        return ()
    text = f"step-exponential against measured-pressure: {', '.join(parts)}; it takes the pressure for a step"
    return (Finding("note", text + " and holds friction for a smaller F_ce"),)


def _spread(over: str, ends: tuple[float, float]) -> str:
    low, high = (show(end, "time", 3) for end in ends)
    return f"mean over {over}, from {low} to {high}; the method part reaches to the farther end"


def onsets(recorded: Recorded, pooled: Pooled) -> list[Estimate]:
    """Dead times of the contractions, per pressure and over all; those of motion only from trials that did move.

    The motion waits for the pressure to exceed what the load asks for: loads are unlike conditions for it, pressures
    are for all of them. The method part reaches to the farthest condition: a mean over them is not that of one.
    """
    campaign, behind, moved = recorded.campaign, recorded.behind, set(pooled.segments.trial.tolist())
    found: list[tuple[str, int, float]] = []
    for number, (trial, samples) in enumerate(zip(campaign.trials, campaign.samples, strict=True)):
        command = next((c for c in trial.commands if c.output == "pressure" and c.phase == "contract"), None)
        if command is None:
            continue
        for kind, value in dead_times(samples.t, samples.channels, samples.ok, command.t).items():
            timed = command.recorded or not kind.startswith("command")
            if timed and (number in moved or not kind.endswith("motion")):
                found.append((kind, number, value - _behind(kind, behind)[0]))
    estimates = []
    for kind in KINDS:
        members = [(number, value) for of, number, value in found if of == kind]
        tested = sorted(grouped(members, lambda one: campaign.trials[one[0]].point["pressure"]).items())
        unsure = _behind(kind, behind)[1]
        estimates += [_dead_time(campaign, kind, {"pressure": P}, group, unsure) for P, group in tested]
        estimates += [_dead_time(campaign, kind, {}, members, unsure)] if len(tested) > 1 else []
    return estimates


def _behind(kind: str, behind: Mapping[str, tuple[float, float]]) -> tuple[float, float]:
    """How much too long a kind of dead time is in the samples, and what is open of that [s]."""
    since, until = kind.split("-to-")
    (first, unsure), (last, more) = behind.get(since, (0.0, 0.0)), behind[until]
    return last - first, hypot(unsure, more)


def _dead_time(
    campaign: Campaign, kind: str, at: dict[str, float], group: Sequence[tuple[int, float]], unsure: float
) -> Estimate:
    """One kind of dead time at one pressure, or over all of them; `group` holds trial numbers and times [s], of which
    all may be off by `unsure` [s].
    """
    numbers = [number for number, _ in group]
    motion = kind.endswith("motion")
    conditions = [float(campaign.cells[n]) if motion else campaign.trials[n].point["pressure"] for n in numbers]
    mean, half, ends = mean_over([value for _, value in group], conditions)
    over = "the loads" if at else "loads and pressures" if motion else "the pressures"
    note = _spread(over, ends) if len(set(conditions)) > 1 else ""
    reach = max(ends[1] - mean, mean - ends[0])
    if kind == "pressure-to-motion":
        between, skewed = "pressure and displacement", skew.apart(campaign.runs, ("pressure", "displacement"))
    else:
        channel = "displacement" if motion else "pressure"
        between, skewed = f"command and {channel}", skew.off(campaign.runs, channel)
    parts = Parts(half, hypot(0.5 / campaign.rate, reach, unsure), 0.0, skewed)
    note, names = sentences(ONCE if half is None else "", note), tuple(map(campaign.name, numbers))
    found = Estimate("t_d", mean, "s", "time", ONSET, at, parts, len(group), note=note, trials=names, coordinate=kind)
    return skew.settled(found, between, skewed)
