"""Beside the pooled fit: the papers' exponentials (method `step-exponential`) and dead times of contraction runs.

Knows trials and what the primary method found; computes no interval of the latter.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import hypot
from typing import Any

import numpy as np

from pmabench.analysis.campaign import Campaign
from pmabench.analysis.curves import curve
from pmabench.analysis.onset import KINDS, dead_times
from pmabench.analysis.pooled import SYMBOLS, Fit
from pmabench.analysis.results import Curve, Estimate, Finding, Parts
from pmabench.analysis.segments import Gate
from pmabench.analysis.steps import Regression, Step, half_width, mean_with_half, regress, steps_of, stiffness
from pmabench.base.quantities import show

METHOD = "step-exponential"
KNOWN_F_CE = "step-exponential, F_ce known"
ONSET = "onset"
LOADS_ENOUGH = 2


@dataclass(frozen=True)
class Beside:
    """What stands beside the primary method."""

    estimates: tuple[Estimate, ...]
    curves: tuple[Curve, ...]
    findings: tuple[Finding, ...]
    table: list[dict[str, Any]]
    """Each step of each trial."""


def compare(
    campaign: Campaign, primary: Fit, found: Sequence[Estimate], options: Mapping[str, Any], moved: set[int]
) -> Beside:
    """The papers' estimates and the dead times; `found` are the primary method's, `moved` the trials in its fit."""
    steps = [
        step
        for number in sorted(moved)
        for step in steps_of(campaign.samples[number], campaign.trials[number], Gate.lift)
    ]
    reference = {(e.symbol, e.at["pressure"]): e.value for e in found if "pressure" in e.at}
    estimates: list[Estimate] = []
    for P in campaign.tested:
        estimates += _at(campaign, P, [step for step in steps if abs(step.pressure - P) < 1.0], primary, options)
    estimates = [_with_bias(e, reference) for e in estimates]
    curves = []
    for symbol in SYMBOLS:
        members = [e for e in estimates if e.symbol == symbol and e.method == METHOD]
        through = curve(members, 1) if members else None
        if through is not None:
            curves.append(through)
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
    ordered = sorted(estimates, key=lambda e: (e.method, ("F_ce", "K", "B_c", "B_r", "tau_c", "tau_r").index(e.symbol)))
    return Beside((*ordered, *_dead_times(campaign, moved)), tuple(curves), _findings(estimates), table)


def _at(
    campaign: Campaign, P: float, steps: Sequence[Step], primary: Fit, options: Mapping[str, Any]
) -> list[Estimate]:
    """All of the papers' coefficients at one pressure [Pa]."""
    contract = [step for step in steps if step.phase == "contract"]
    relax = [step for step in steps if step.phase == "relax"]
    result: list[Estimate] = []

    def add(symbol: str, value: float, half: float | None, among: Sequence[Step], method: str = METHOD) -> None:
        unit, quantity = {
            "F_ce": ("N", "force"),
            "K": ("N/m", "stiffness"),
            "B_c": ("N.s/m", "damping"),
            "B_r": ("N.s/m", "damping"),
        }.get(symbol, ("s", "time"))
        names = tuple(dict.fromkeys(campaign.name(step.trial) for step in among))
        result.append(
            Estimate(
                symbol, value, unit, quantity, method, {"pressure": P}, Parts(repeats=half), len(names), trials=names
            )
        )

    regression: Regression | None = None
    if contract:
        loads = np.array([step.load for step in contract])
        x = np.array([step.fit.end for step in contract])
        regression = regress(loads, x)
        known = options.get("static")
        F_ce = (
            float(known["intercept"]) + float(known["slope"]) * P
            if known
            else float(primary.values("F_ce", np.array([P]))[0])
        )
        one = stiffness(loads, x, F_ce)
        add("K", one.K, half_width(one.se_K, one.n - 1), contract, KNOWN_F_CE)
    if regression is not None:
        add("F_ce", regression.F_ce, half_width(regression.se_F_ce, regression.n - 2), contract)
        add("K", regression.K, half_width(regression.se_K, regression.n - 2), contract)
    for symbol, members in (("c", contract), ("r", relax)):
        if not members:
            continue
        tau, half = mean_with_half([step.fit.tau for step in members])
        add(f"tau_{symbol}", tau, half, members)
        if regression is not None:
            half_K = half_width(regression.se_K, regression.n - 2)
            both = None if half is None or half_K is None else hypot(regression.K * half, tau * half_K)
            add(f"B_{symbol}", regression.K * tau, both, members)
    return result


def _with_bias(estimate: Estimate, reference: Mapping[tuple[str, float], float | None]) -> Estimate:
    """The estimate with its distance to the primary method as bias, not taken off, and as method part."""
    known = reference.get((estimate.symbol, estimate.at["pressure"]))
    if known is None or estimate.value is None:
        return estimate
    bias = estimate.value - known
    return Estimate(
        **{
            **estimate.__dict__,
            "bias": bias,
            "parts": Parts(repeats=estimate.parts.repeats, method=abs(bias)),
            "note": "bias: against measured-pressure",
        }
    )


def _findings(estimates: Sequence[Estimate]) -> tuple[Finding, ...]:
    """How far the papers' way lies from the primary method."""
    parts = []
    for symbol in ("B_c", "B_r", "K"):
        off = [
            100 * e.bias / (e.value - e.bias)
            for e in estimates
            if e.symbol == symbol and e.method == METHOD and e.bias is not None and e.value is not None
        ]
        if off:
            parts.append(f"{symbol} {min(off):+.2g} to {max(off):+.2g} %")
    forces = [e.bias for e in estimates if e.symbol == "F_ce" and e.method == METHOD and e.bias is not None]
    if forces:
        parts.append(f"F_ce {min(forces):+.2g} to {max(forces):+.2g} N")
    if not parts:
        return ()
    text = f"step-exponential against measured-pressure: {', '.join(parts)}; it takes the pressure for a step"
    return (Finding("note", text + " and holds friction for a smaller F_ce"),)


def _dead_times(campaign: Campaign, moved: set[int]) -> list[Estimate]:
    """Dead times of the contractions, per pressure and over all; those of motion only from trials that did move."""
    found: dict[tuple[str, float], list[tuple[str, float]]] = {}
    for number, trial in enumerate(campaign.trials):
        command = next((c for c in trial.commands if c.output == "pressure" and c.phase == "contract"), None)
        if command is None:
            continue
        samples = campaign.samples[number]
        channels = {"pressure": samples.P, "displacement": samples.x}
        for kind, value in dead_times(samples.t, channels, samples.ok, command.t).items():
            if number in moved or not kind.endswith("motion"):
                found.setdefault((kind, trial.point["pressure"]), []).append((campaign.name(number), value))
    estimates = []
    for kind in KINDS:
        rows = [(P, members) for (k, P), members in sorted(found.items()) if k == kind]
        groups: list[tuple[dict[str, float], list[tuple[str, float]]]] = [({"pressure": P}, m) for P, m in rows]
        if len(rows) > 1:
            groups.append(({}, [member for _, members in rows for member in members]))
        for at, members in groups:
            mean, half = mean_with_half([value for _, value in members])
            estimates.append(
                Estimate(
                    symbol="t_d",
                    value=mean,
                    unit="s",
                    quantity="time",
                    method=ONSET,
                    at=at,
                    parts=Parts(repeats=half, method=0.5 / campaign.rate),
                    n=len(members),
                    note=kind,
                    trials=tuple(name for name, _ in members),
                    coordinate=kind,
                )
            )
    return estimates


def summary(estimates: Sequence[Estimate]) -> str:
    """The pooled dead times in words."""
    pooled = [e for e in estimates if e.symbol == "t_d" and not e.at and e.value is not None]
    return ", ".join(f"{e.coordinate} {show(e.value or 0.0, 'time', 3)}" for e in pooled)
