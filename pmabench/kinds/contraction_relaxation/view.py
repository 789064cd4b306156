"""What is said and shown of the pooled fit of contraction-relaxation runs: findings, facts, overlays; no estimate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from pmabench.analysis.shared.calibration import Scales
from pmabench.base.quantities import show
from pmabench.kinds.contraction_relaxation import checks
from pmabench.kinds.contraction_relaxation.checks import FreeRun
from pmabench.kinds.contraction_relaxation.diagnosis.hiding import GAIN, ZERO
from pmabench.kinds.contraction_relaxation.intervals import Pooled, bootstrap
from pmabench.kinds.contraction_relaxation.segments import ASSUMED_MASS, Campaign
from pmabench.store.analyses.results import Estimate, Finding, Trace

MISFIT = 3.0
"""A residual this many times larger than the channels' noise explains puts the model's form in doubt."""
UNEVEN = 2.0
"""Variance between trials by that of noise, from which on it is said that trials differ."""
SHOWN = 6
LONGEST_TRACE = 1500


def facts(campaign: Campaign, pooled: Pooled, runs: Sequence[FreeRun]) -> dict[str, Any]:
    """Numbers behind the fit and its free runs, SI."""
    used = np.unique(pooled.segments.trial)
    free = checks.check(campaign, runs)
    return {
        "trials_used": len(used),
        "cells": len(np.unique(campaign.cells)),
        "cells_used": len(np.unique(campaign.cells[used])),
        "segments": len(pooled.segments),
        "residual_rms": pooled.fit.rms,
        "expected_rms": pooled.expected,
        "knots": [float(P) for P in pooled.fit.knots],
        "noise": asdict(campaign.noise),
        "scatter_between_trials": {symbol: float(value) for symbol, value in pooled.trust.excess.items()},
        "load_cell": campaign.cell,
        "form": pooled.diagnosis.facts,
        "free_run_rms": checks.rms(runs),
        "free_run": checks.table(campaign, runs),
        "checks": [*([asdict(free)] if free else ()), *checks.checks(campaign, pooled)],
    }


def findings(campaign: Campaign, pooled: Pooled, estimates: Sequence[Estimate]) -> list[Finding]:
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
    lines += [*_of_the_form(campaign, pooled), *_of_the_weights(pooled)]
    if not campaign.cell:
        text = "no load cell: F_L is the weight, and M x'' of the moving mass; both are taken as exact, M is not fitted"
        if any("mass" not in trial.point for trial in campaign.trials):
            text += f"; where a trial names no moving mass, {show(ASSUMED_MASS, 'mass')} is taken"
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


def _of_the_form(campaign: Campaign, pooled: Pooled) -> list[Finding]:
    """What the tests of the form say, what was found and corrected, and what to look at."""
    found = pooled.diagnosis
    if found.reason:
        return [Finding("doubt", f"form: {found.reason}")]
    lines = []
    for one in found.named:
        of = "property of the muscle" if one.of_muscle else "fault of the bench"
        lines.append(Finding("doubt", f"diagnosis, {of}: {one.text}; corrected. Advice: {one.advice}"))
    if found.named:
        middle = campaign.tested[len(campaign.tested) // 2]
        which = f"; {found.between}" if found.between else ""
        lines.append(
            Finding("note", f"diagnosis: {_rivals(pooled)}corrected, {found.effect(pooled.fit, middle)}{which}")
        )
    text = (
        f"form: {found.missed} {found.ratio:.3g} times what the noise allows, residuals of neighbouring segments agree "
        f"by {found.rounds.after.test.alike:.2g} of the noise"
    )
    if found.hidden.found:
        more = f"but it fits that {found.fits}. {found.hidden.moved}; it is a line of each interval"
        return [*lines, Finding("doubt", f"{text}; {more}")]
    count = len(found.hidden.sizes)
    return [*lines, Finding("note", f"{text}; no departure of {count} moves a coefficient beyond its interval")]


def _rivals(pooled: Pooled) -> str:
    """What the form was missed by before, and the runner-up of each explanation, in words."""
    rounds = pooled.diagnosis.rounds
    if not rounds.rivals:
        return ""
    parts = [f"missed by {rounds.before.test.ratio:.3g} times the noise before, {rounds.after.test.ratio:.3g} after"]
    for facts in pooled.diagnosis.facts["explanations"]:
        if facts["runner_up"]:
            parts.append(f"next best to {facts['title']} is {facts['runner_up']}, {facts['runner_up_ratio']:.3g}")
    return f"{'; '.join(parts)}; "


def _of_the_weights(pooled: Pooled) -> list[Finding]:
    """Where the force cell and the weights that hang on it contradict each other."""
    seen, weighed = {one.name for one in pooled.trust.hides if one.seen}, pooled.diagnosis.weighed
    lines = []
    for name, found, quantity in ((GAIN, weighed.gain, "ratio"), (ZERO, weighed.offset, "force")):
        if name in seen and found is not None:
            size, unsure = (show(abs(value), quantity, 2) for value in (found[0], 2 * found[1]))
            way = "more" if found[0] > 0 else "less"
            text = f"{name}: it reads {size} {way} than they weigh, +- {unsure}, which its calibration does not allow"
            lines.append(Finding("doubt", f"{text}: one of them is wrong, and the intervals hold both"))
    if weighed.wrong is not None:
        load, off, error = weighed.wrong
        size, unsure = (show(value, "force", 2) for value in (abs(off), 2 * error))
        way = "more" if off > 0 else "less"
        text = f"the weight of {show(load, 'force', 4)} is {size} {way} by the force cell, +- {unsure}"
        lines.append(Finding("doubt", f"{text}; the others agree. Weigh it; no value of the fit rests on its mark"))
    return lines


def resampled(campaign: Campaign, pooled: Pooled, estimates: Sequence[Estimate], count: int) -> dict[str, Any]:
    """Half widths by a bootstrap of `count` draws next to the repeats part of each estimate that has a pressure."""
    if not count:
        return {}
    draws = bootstrap(pooled.segments, pooled.fit, campaign.cells, count, pooled.trust.within)
    known = [e for e in estimates if e.value is not None and "pressure" in e.at]
    return {
        "draws": count,
        "within_cells": pooled.trust.within,
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


def overlays(campaign: Campaign, runs: Sequence[FreeRun]) -> tuple[Trace, ...]:
    """Measured and modelled contraction of some of the free runs."""
    picks = dict.fromkeys(round(i) for i in np.linspace(0, len(runs) - 1, SHOWN)) if runs else ()
    traces = []
    for run in (runs[i] for i in picks):
        load, P_trial = campaign.samples[run.number].load, campaign.trials[run.number].point["pressure"]
        stride = -(-len(run.t) // LONGEST_TRACE)
        traces.append(
            Trace(
                name=f"overlay-{P_trial / 1e3:.0f}kPa-{load:.0f}N-{run.number}",
                figure="overlay",
                title=f"{show(P_trial, 'pressure', 4)}, {show(load, 'force', 4)}: measured and fitted muscle",
                columns={
                    "t": (run.t - run.t[0])[::stride],
                    "pressure": run.P[::stride],
                    "displacement": run.x[::stride],
                    "model": run.model[::stride],
                },
                quantities={"t": "time", "pressure": "pressure", "displacement": "length", "model": "length"},
                marks={"pressure": P_trial, "load": load},
            )
        )
    return tuple(traces)
