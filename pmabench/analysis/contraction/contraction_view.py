"""What is said and shown of the pooled fit of contraction-relaxation runs: findings, facts, overlays; no estimate."""

from __future__ import annotations

from collections.abc import Sequence
from math import sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmabench.analysis.contraction import replay
from pmabench.analysis.contraction.bootstrap import bootstrap
from pmabench.analysis.contraction.campaign import Campaign
from pmabench.analysis.contraction.intervals import NORMAL, Pooled
from pmabench.analysis.contraction.pooled import SYMBOLS, spread
from pmabench.analysis.contraction.segments import Gate, Samples, velocity
from pmabench.analysis.results import Estimate, Finding, Trace
from pmabench.analysis.shared.calibration import Scales
from pmabench.analysis.verdict.contraction_checks import checks
from pmabench.base.quantities import show
from pmabench.store.records import Array

MISFIT = 3.0
"""A residual this many times larger than the channels' noise explains puts the model's form in doubt."""
UNEVEN = 2.0
"""Variance between trials by that of noise, from which on it is said that trials differ."""
WIDE = 0.25
"""A coefficient whose repeats part is wider than this share of its size is not identifiable."""
BLIND = 0.15
"""Share of the largest contraction that a free run may move where a coefficient is open."""
SHOWN = 6
LONGEST_TRACE = 1500
COARSE = 4
"""A free run steps over this many samples."""


def facts(campaign: Campaign, pooled: Pooled) -> dict[str, Any]:
    """Numbers behind the fit, SI."""
    used = np.unique(pooled.segments.trial)
    return {
        "trials_used": len(used),
        "cells": len(np.unique(campaign.cells)),
        "cells_used": len(np.unique(campaign.cells[used])),
        "segments": len(pooled.segments),
        "residual_rms": pooled.fit.rms,
        "expected_rms": pooled.expected,
        "knots": [float(P) for P in pooled.fit.knots],
        "noise": {
            "pressure": campaign.noise.pressure,
            "displacement": campaign.noise.displacement,
            "force": campaign.noise.force,
        },
        "scatter_between_trials": {symbol: float(value) for symbol, value in pooled.trust.excess.items()},
        "load_cell": campaign.cell,
        "checks": checks(campaign, pooled),
    }


def findings(
    campaign: Campaign, pooled: Pooled, estimates: Sequence[Estimate], free_run: float | None
) -> list[Finding]:
    """Adequacy of the model, what could not be identified, and how trials scatter."""
    rms, expected = pooled.fit.rms, pooled.expected
    size = f"residual {show(rms, 'force', 2)} rms over {len(pooled.segments)} segments"
    if rms > MISFIT * expected:
        text = (
            f"{size}, {rms / expected:.2g} times what the noise explains ({show(expected, 'force', 2)}): the model does"
            " not have the form of this muscle, the pressure is not that inside it, or trials differ by themselves"
        )
        lines = [Finding("doubt", text)]
    else:
        lines = [Finding("note", f"{size}; noise of the channels explains {show(expected, 'force', 2)}")]
    if free_run is not None:
        lines.append(
            Finding(
                "note", f"free run of the fitted muscle with the measured pressure: {show(free_run, 'length', 2)} rms"
            )
        )
    if not campaign.cell:
        text = "no load cell: F_L is the weight, taken as exact, with the inertia of the moving mass"
        lines.append(Finding("note", text))
    lack = Scales.of(campaign.runs).lack(campaign.channels)
    if lack:
        lines.append(Finding("note", lack))
    if not pooled.fit.friction:
        lines.append(Finding("doubt", "all samples move one way: F_ce carries the friction"))
    for symbol in ("F_ce", "K", "B_c", "B_r"):
        none = [e.at["pressure"] for e in estimates if e.symbol == symbol and e.value is None]
        if none:
            places = ", ".join(show(P, "pressure", 4) for P in none)
            lines.append(Finding("note", f"{symbol} is not identifiable at {places}"))
    trust = pooled.trust
    uneven = [symbol for symbol, value in trust.excess.items() if value > UNEVEN]
    if uneven:
        between = "repeats of a cell scatter" if trust.within else "trials scatter about the fit"
        lines.append(Finding("note", f"{between} more than the noise explains ({', '.join(uneven)}); intervals follow"))
    if not trust.within:
        lines.append(
            Finding("note", "hardly a cell is repeated: the repeats part rests on noise and on the fit's residual")
        )
    return lines


def resampled(campaign: Campaign, pooled: Pooled, estimates: Sequence[Estimate], count: int) -> dict[str, Any]:
    """Half widths by a bootstrap of `count` draws beside the repeats part of each estimate that has a pressure."""
    draws = bootstrap(pooled.segments, pooled.fit, campaign.cells, count, pooled.trust.within)
    known = [e for e in estimates if e.value is not None and "pressure" in e.at]
    return {
        "draws": count,
        "within_cells": draws.within,
        "half_widths": [
            {
                "symbol": e.symbol,
                "pressure": e.at["pressure"],
                "bootstrap": draws.half(pooled.fit.row(e.symbol, e.at["pressure"])),
                "repeats": e.parts.repeats,
            }
            for e in known
        ],
    }


def resampled_finding(found: dict[str, Any]) -> Finding:
    """What the bootstrap says of the repeats part, over all coefficients."""
    ratios = [one["bootstrap"] / one["repeats"] for one in found["half_widths"] if one["repeats"]]
    middle, (low, high) = float(np.median(ratios)), np.percentile(ratios, [10, 90])
    text = (
        f"bootstrap over trials, {found['draws']} draws: half widths {middle:.2g} times the repeats part"
        f" ({low:.2g} to {high:.2g} for most coefficients)"
    )
    return Finding("note", text)


def overlays(
    campaign: Campaign, pooled: Pooled, estimates: Sequence[Estimate]
) -> tuple[tuple[Trace, ...], float | None]:
    """Measured and modelled contraction of some trials, run freely from rest, and the root mean square error [m].

    Trials at pressures where a coefficient is not identifiable, but for B_r, are not run; the others as far as the
    coefficients are known that their motion asks for, nan from there on.
    """
    unknown = {e.at["pressure"] for e in estimates if e.value is None and e.symbol in ("F_ce", "K", "B_c")}
    used = [i for i in np.unique(pooled.segments.trial).tolist() if campaign.trials[i].point["pressure"] not in unknown]
    ordered = sorted(used, key=lambda i: (campaign.trials[i].point["pressure"], campaign.samples[i].load, i))
    if not ordered:
        return (), None
    picks = list(dict.fromkeys(ordered[round(i)] for i in np.linspace(0, len(ordered) - 1, SHOWN)))
    whole = [(campaign.samples[i], slice(0, len(campaign.samples[i].t))) for i in picks]
    work = replay.stretches(whole, 1 / campaign.rate, 1)
    P = _thinned(work.P)
    run = replay.run(pooled.fit, P, COARSE * work.dt, work.load, work.mass, work.x, substeps=1)
    traces = []
    power, count = 0.0, 0
    for column, i in enumerate(picks):
        samples, trial = campaign.samples[i], campaign.trials[i]
        rows = np.arange(0, len(samples.t), COARSE)
        model, x = run.x[: len(rows), column], samples.x[rows]
        model[samples.t[rows] >= _known_until(samples, pooled, campaign.rate)] = np.nan
        ok = samples.ok[rows] & (P[: len(rows), column] >= pooled.fit.knots[0]) & np.isfinite(model)
        power += float(np.sum((model - x)[ok] ** 2))
        count += int(ok.sum())
        stride = -(-len(rows) // LONGEST_TRACE)
        P_trial = trial.point["pressure"]
        traces.append(
            Trace(
                name=f"overlay-{P_trial / 1e3:.0f}kPa-{samples.load:.0f}N-{i}",
                figure="overlay",
                title=f"{show(P_trial, 'pressure', 4)}, {show(samples.load, 'force', 4)}: measured and fitted muscle",
                columns={
                    "t": (samples.t[rows] - samples.t[0])[::stride],
                    "pressure": P[: len(rows), column][::stride],
                    "displacement": x[::stride],
                    "model": model[::stride],
                },
                quantities={"t": "time", "pressure": "pressure", "displacement": "length", "model": "length"},
                marks={"pressure": P_trial, "load": samples.load},
            )
        )
    return tuple(traces), sqrt(power / max(1, count))


def _known_until(samples: Samples, pooled: Pooled, rate: float) -> float:
    """When the motion begins [s] that makes `BLIND` of it go where a coefficient is open that it asks for."""
    solved = pooled.fit
    low, high = solved.knots[0], solved.knots[-1]
    grid = np.linspace(low, high, 256)
    P = np.where(np.isfinite(samples.P), samples.P, low)
    cell = np.clip(((P - low) / (high - low) * 255).round().astype(np.intp), 0, 255)
    F_ce, K, B_c, B_r = (_told(pooled, symbol, grid)[cell] & (P >= low) for symbol in SYMBOLS)
    v = velocity(samples.t, samples.x, Gate().samples(rate)[1])
    blind = samples.ok & (samples.x > Gate.lift) & ~(F_ce & K & np.where(v > 0, B_c, B_r))
    travelled = np.cumsum(np.where(blind, np.abs(v) / rate, 0.0))
    lost = np.flatnonzero(travelled > BLIND * float(np.max(samples.x[samples.ok], initial=0.0)))
    if not len(lost):
        return float("inf")
    seeing = np.flatnonzero(~blind[: lost[0]])
    return float(samples.t[seeing[-1] + 1 if len(seeing) else 0])


def _told(pooled: Pooled, symbol: str, P: Array) -> NDArray[np.bool_]:
    """Whether a coefficient is known at pressures P (n,) [Pa], by the scatter that is left to it there."""
    solved = pooled.fit
    k = len(solved.knots)
    mine = slice(solved.index(symbol), solved.index(symbol) + k)
    hats = spread(P[:, None], np.ones((len(P), 1)), solved.knots)
    half = NORMAL * np.sqrt(np.maximum(0.0, np.sum(hats @ pooled.trust.covariance[mine, mine] * hats, axis=1)))
    size = float(np.median(np.abs(solved.theta[mine])))
    return np.asarray(half <= WIDE * np.maximum(np.abs(hats @ solved.theta[mine]), size))


def _thinned(P: Array) -> Array:
    """Every `COARSE`-th row, as the mean of the rows around it."""
    sums = np.cumsum(np.vstack([np.zeros((1, P.shape[1])), P]), axis=0)
    rows = np.arange(0, len(P), COARSE)
    first, last = np.maximum(0, rows - COARSE // 2), np.minimum(len(P), rows + COARSE // 2 + 1)
    return np.asarray((sums[last] - sums[first]) / (last - first)[:, None])
